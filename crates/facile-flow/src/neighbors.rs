//! Which triangles of a scan share an edge, and consistent orientation over them.

use facile_core::{Mesh, Point3, Vector3, mesh::closest_barycentric};

/// No triangle across: a border, or an edge of more than two triangles.
pub(crate) const NONE: u32 = u32::MAX;

/// Most triangles that a walk over the surface visits.
const LONGEST_WALK: usize = 24;
/// Most triangles that are passed by signs alone.
const SHORT_WALK: usize = 8;

/// For each triangle the neighbours across its edges `(0, 1)`, `(1, 2)`, `(2, 0)`.
#[derive(Clone, Debug)]
pub(crate) struct TriangleNeighbors {
    across: Vec<[u32; 3]>,
}

impl TriangleNeighbors {
    /// Pairs the edges of `triangles`, whose corners are less than `vertices`. Cost O(n): edges are put in the bucket of
    /// their smaller vertex, and each bucket holds a few.
    pub(crate) fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let edges = |t: usize| {
            let [a, b, c] = triangles[t];
            [(a, b), (b, c), (c, a)].map(|(p, q)| (p.min(q), p.max(q)))
        };
        let mut starts = vec![0_u32; vertices + 1];
        for (p, _) in (0..triangles.len()).flat_map(edges) {
            starts[p as usize + 1] += 1;
        }
        for v in 0..vertices {
            starts[v + 1] += starts[v];
        }
        let mut next = starts.clone();
        // The larger vertex, and the edge of its triangle.
        let mut buckets = vec![(0_u32, 0_u32); 3 * triangles.len()];
        for t in 0..triangles.len() {
            for (k, (p, q)) in edges(t).into_iter().enumerate() {
                let place = &mut next[p as usize];
                buckets[*place as usize] = (q, 3 * t as u32 + k as u32);
                *place += 1;
            }
        }
        let mut across = vec![[NONE; 3]; triangles.len()];
        for range in starts.windows(2) {
            let bucket = &mut buckets[range[0] as usize..range[1] as usize];
            bucket.sort_unstable();
            for run in bucket.chunk_by(|a, b| a.0 == b.0) {
                if let [(_, e), (_, f)] = *run {
                    across[e as usize / 3][e as usize % 3] = f / 3;
                    across[f as usize / 3][f as usize % 3] = e / 3;
                }
            }
        }
        Self { across }
    }

    /// Vertices on an edge without exactly two triangles.
    pub(crate) fn border_vertices(&self, vertices: usize, triangles: &[[u32; 3]]) -> Vec<bool> {
        let mut on_border = vec![false; vertices];
        for (across, corners) in self.across.iter().zip(triangles) {
            for k in 0..3 {
                if across[k] == NONE {
                    on_border[corners[k] as usize] = true;
                    on_border[corners[(k + 1) % 3] as usize] = true;
                }
            }
        }
        on_border
    }

    /// Which triangles must be turned so that neighbours agree and every connected piece faces away from the centre
    /// of the whole on balance. Flipped patches of dirty scans come out right; an edge of three triangles parts pieces.
    pub(crate) fn turned(&self, mesh: &Mesh) -> Vec<bool> {
        let n = mesh.triangles.len();
        let facet = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            (
                (a.coords + b.coords + c.coords) / 3.0,
                (b - a).cross(&(c - a)),
            )
        };
        let (mut center, mut total) = (Vector3::zeros(), 0.0);
        for (at, area) in (0..n).map(facet) {
            center += at * area.norm();
            total += area.norm();
        }
        center /= f64::max(total, 1e-300);
        let mut turned = vec![false; n];
        let mut seen = vec![false; n];
        for seed in 0..n {
            if seen[seed] {
                continue;
            }
            seen[seed] = true;
            let mut piece = vec![seed];
            let mut outwards = 0.0;
            let mut next = 0;
            while next < piece.len() {
                let t = piece[next];
                next += 1;
                let (at, area) = facet(t);
                outwards += (at - center).dot(&area) * if turned[t] { -1.0 } else { 1.0 };
                for (k, &u) in self.across[t].iter().enumerate() {
                    if u == NONE || seen[u as usize] {
                        continue;
                    }
                    let u = u as usize;
                    let (a, b) = (mesh.triangles[t][k], mesh.triangles[t][(k + 1) % 3]);
                    // Neighbours that agree run along their edge in opposite directions.
                    let same_way = (0..3)
                        .any(|j| (mesh.triangles[u][j], mesh.triangles[u][(j + 1) % 3]) == (a, b));
                    seen[u] = true;
                    turned[u] = turned[t] ^ same_way;
                    piece.push(u);
                }
            }
            if outwards < 0.0 {
                for t in piece {
                    turned[t] = !turned[t];
                }
            }
        }
        turned
    }

    /// Walks from triangle `start` towards the point nearest to `p`. Returns the triangle, the point's weights and the
    /// squared distance. Cost: the walk.
    pub(crate) fn walk(&self, mesh: &Mesh, start: u32, p: &Point3) -> (u32, [f64; 3], f64) {
        // What stands over a triangle not far away is found by signs alone.
        let bound = (mesh.positions[mesh.triangles[start as usize][0] as usize] - p).norm_squared();
        match self.stroll(mesh, start, p) {
            Some(found) if found.2 <= bound => found,
            _ => self.descend(mesh, start, p),
        }
    }

    /// From triangle to triangle across the edge that `p` is furthest beyond, until it stands over one.
    fn stroll(&self, mesh: &Mesh, start: u32, p: &Point3) -> Option<(u32, [f64; 3], f64)> {
        let mut t = start;
        for _ in 0..SHORT_WALK {
            let [a, b, c] = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
            let (ab, ac, ap) = (b - a, c - a, p - a);
            let normal = ab.cross(&ac);
            let square = normal.norm_squared();
            let v = ap.cross(&ac).dot(&normal);
            let w = ab.cross(&ap).dot(&normal);
            let u = square - v - w;
            if square <= 0.0 {
                return None;
            }
            if u >= 0.0 && v >= 0.0 && w >= 0.0 {
                let height = ap.dot(&normal);
                let weights = [u / square, v / square, w / square];
                return Some((t, weights, height * height / square));
            }
            // Edge `k` lies opposite corner `k + 2`.
            let edge = if u < v && u < w {
                1
            } else if v < w {
                2
            } else {
                0
            };
            t = self.across[t as usize][edge];
            if t == NONE {
                return None;
            }
        }
        None
    }

    /// To the neighbour across the nearest edge for as long as that comes closer.
    fn descend(&self, mesh: &Mesh, start: u32, p: &Point3) -> (u32, [f64; 3], f64) {
        let look = |t: u32| {
            let corners = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
            let w = closest_barycentric(p, &corners);
            let q = corners[0].coords * w[0] + corners[1].coords * w[1] + corners[2].coords * w[2];
            (w, (q - p.coords).norm_squared())
        };
        let (mut best, (mut weights, mut distance)) = (start, look(start));
        for _ in 0..LONGEST_WALK {
            let mut moved = false;
            for k in 0..3 {
                // Across edge (k, k + 1) only if the nearest point lies on it.
                let u = self.across[best as usize][k];
                if weights[(k + 2) % 3] > 1e-9 || u == NONE {
                    continue;
                }
                let (w, d) = look(u);
                if d < distance - 1e-12 {
                    (best, weights, distance) = (u, w, d);
                    moved = true;
                    break;
                }
            }
            if !moved {
                break;
            }
        }
        (best, weights, distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bulging sheet of `n` x `n` squares, one unit each, facing `+z`.
    fn sheet(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        let half = f64::from(n) / 2.0;
        for j in 0..=n {
            for i in 0..=n {
                let (x, y) = (f64::from(i) - half, f64::from(j) - half);
                mesh.positions
                    .push(Point3::new(x, y, -0.02 * (x * x + y * y)));
            }
        }
        for j in 0..n {
            for i in 0..n {
                let (v, w) = (j * (n + 1) + i, n + 1);
                mesh.triangles.push([v, v + 1, v + w]);
                mesh.triangles.push([v + 1, v + w + 1, v + w]);
            }
        }
        mesh
    }

    #[test]
    fn flipped_patches_are_found_and_nothing_else_is_turned() {
        let mut mesh = sheet(10);
        let flipped: Vec<usize> = (40..75).chain([3, 150]).collect();
        for &t in &flipped {
            mesh.triangles[t].swap(1, 2);
        }
        let turned = TriangleNeighbors::new(mesh.positions.len(), &mesh.triangles).turned(&mesh);
        for (t, turned) in turned.iter().enumerate() {
            assert_eq!(*turned, flipped.contains(&t), "triangle {t}");
        }
    }

    #[test]
    fn a_walk_ends_at_the_nearest_point() {
        let mesh = sheet(20);
        let neighbors = TriangleNeighbors::new(mesh.positions.len(), &mesh.triangles);
        let target = Point3::new(3.3, -4.2, 0.1);
        let (_, _, found) = neighbors.walk(&mesh, 410, &target);
        let nearest = (0..mesh.triangles.len() as u32)
            .map(|t| {
                let corners = mesh.corners(t as usize);
                let w = closest_barycentric(&target, &corners);
                let q =
                    corners[0].coords * w[0] + corners[1].coords * w[1] + corners[2].coords * w[2];
                (q - target.coords).norm_squared()
            })
            .fold(f64::INFINITY, f64::min);
        assert!((found - nearest).abs() < 1e-12, "{found} against {nearest}");
    }
}
