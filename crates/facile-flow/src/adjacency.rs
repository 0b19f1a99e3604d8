//! Who is next to whom on a mesh: neighbours of vertices.

/// Neighbours of each vertex in compressed rows, sorted by index.
#[derive(Clone, Debug)]
pub(crate) struct Adjacency {
    starts: Vec<u32>,
    neighbors: Vec<u32>,
}

impl Adjacency {
    /// Neighbours over the edges of triangles. Cost O(n log n).
    pub(crate) fn from_triangles(vertex_count: usize, triangles: &[[u32; 3]]) -> Self {
        Self::from_edges(
            vertex_count,
            triangles
                .iter()
                .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]),
        )
    }

    /// Neighbours over the edges of polygons. Cost O(n log n).
    pub(crate) fn from_faces(vertex_count: usize, faces: &[Vec<u32>]) -> Self {
        let edges = (faces.iter())
            .flat_map(|face| (0..face.len()).map(move |k| (face[k], face[(k + 1) % face.len()])));
        Self::from_edges(vertex_count, edges)
    }

    fn from_edges(vertex_count: usize, edges: impl Iterator<Item = (u32, u32)>) -> Self {
        let mut keys: Vec<(u32, u32)> = edges
            .filter(|(a, b)| a != b)
            .map(|(a, b)| (a.min(b), a.max(b)))
            .collect();
        keys.sort_unstable();
        let mut pairs = Vec::with_capacity(keys.len());
        for run in keys.chunk_by(|a, b| a == b) {
            let (a, b) = run[0];
            pairs.push((a, b));
            pairs.push((b, a));
        }
        pairs.sort_unstable();
        let mut starts = vec![0_u32; vertex_count + 1];
        for &(a, _) in &pairs {
            starts[a as usize + 1] += 1;
        }
        for i in 0..vertex_count {
            starts[i + 1] += starts[i];
        }
        let neighbors = pairs.into_iter().map(|(_, b)| b).collect();
        Self { starts, neighbors }
    }

    /// Number of vertices.
    pub(crate) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Neighbours of vertex `v`, by increasing index.
    pub(crate) fn of(&self, v: usize) -> &[u32] {
        &self.neighbors[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Number of rings between each vertex and the nearest of `seeds`, up to `limit`; `u32::MAX` further away.
    pub(crate) fn rings_from(&self, seeds: impl Iterator<Item = usize>, limit: u32) -> Vec<u32> {
        let mut ring = vec![u32::MAX; self.len()];
        let mut front: Vec<usize> = seeds.collect();
        for &v in &front {
            ring[v] = 0;
        }
        for distance in 1..=limit {
            let mut next = Vec::new();
            for &v in &front {
                for &u in self.of(v) {
                    if ring[u as usize] == u32::MAX {
                        ring[u as usize] = distance;
                        next.push(u as usize);
                    }
                }
            }
            front = next;
        }
        ring
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_triangles_know_their_neighbors_and_border() {
        let adjacency = Adjacency::from_triangles(5, &[[0, 1, 2], [1, 3, 2]]);
        assert_eq!(adjacency.of(1), &[0, 2, 3]);
        assert_eq!(adjacency.of(4), &[] as &[u32]);
        let rings = adjacency.rings_from([0].into_iter(), 5);
        assert_eq!(rings, [0, 1, 1, 2, u32::MAX]);
    }
}
