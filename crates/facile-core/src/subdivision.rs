//! One level of Catmull-Clark subdivision, as a linear map from cage to fine vertices.
//!
//! The render mesh is the subdivided simulation mesh, so every displacement of the cage reaches the fine vertices
//! through the same smooth stencils. Source: Catmull and Clark, Recursively generated B-spline surfaces on arbitrary
//! topological meshes, 1978; boundaries as in `DeRose` et al. 1998.

use std::collections::BTreeMap;
use std::ops::{Add, Mul};

/// Sparse rows: every fine vertex as a weighted sum of cage vertices. Weights of a row sum to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Stencils {
    starts: Vec<u32>,
    entries: Vec<(u32, f64)>,
}

impl Stencils {
    /// Number of fine vertices.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Whether there are no fine vertices.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Cage vertices and weights of one fine vertex, by increasing cage index.
    pub fn row(&self, fine: usize) -> &[(u32, f64)] {
        &self.entries[self.starts[fine] as usize..self.starts[fine + 1] as usize]
    }

    /// Applies the stencils to one value per cage vertex: positions' coordinates, displacements, weights.
    pub fn apply<T>(&self, cage: &[T], zero: T) -> Vec<T>
    where
        T: Copy + Add<T, Output = T> + Mul<f64, Output = T>,
    {
        (0..self.len())
            .map(|i| {
                self.row(i)
                    .iter()
                    .fold(zero, |s, &(v, w)| s + cage[v as usize] * w)
            })
            .collect()
    }

    fn from_rows(rows: Vec<BTreeMap<u32, f64>>) -> Self {
        let mut starts = vec![0];
        let mut entries = Vec::new();
        for row in rows {
            entries.extend(row);
            starts.push(entries.len() as u32);
        }
        Self { starts, entries }
    }
}

/// A subdivided polygon mesh.
#[derive(Clone, Debug)]
pub struct Subdivision {
    /// Fine vertices from cage vertices: first one per cage vertex (same index), then one per edge (sorted), then one
    /// per face.
    pub stencils: Stencils,
    /// Fine quads, `[vertex point, edge point, face point, edge point]`, by face and corner.
    pub quads: Vec<[u32; 4]>,
    /// The cage face of each fine quad.
    pub parents: Vec<u32>,
}

/// Subdivides `faces` (each at least 3 cage vertices, counter-clockwise) once. Cost O(n log n).
pub fn catmull_clark(vertex_count: usize, faces: &[Vec<u32>]) -> Subdivision {
    let edges = edges_of(faces);
    let (edge_start, face_start) = (vertex_count as u32, (vertex_count + edges.len()) as u32);
    let edge_index: BTreeMap<(u32, u32), u32> = edges
        .keys()
        .zip(edge_start..)
        .map(|(k, i)| (*k, i))
        .collect();

    let mut rows: Vec<BTreeMap<u32, f64>> = vertex_rows(vertex_count, faces, &edges);
    for ((a, b), sides) in &edges {
        let mut row = BTreeMap::new();
        if let [f, g] = sides[..] {
            add(&mut row, &[*a, *b], 0.5);
            add(&mut row, &faces[f as usize], 0.25);
            add(&mut row, &faces[g as usize], 0.25);
        } else {
            add(&mut row, &[*a, *b], 1.0);
        }
        rows.push(row);
    }
    for face in faces {
        let mut row = BTreeMap::new();
        add(&mut row, face, 1.0);
        rows.push(row);
    }

    let mut quads = Vec::new();
    let mut parents = Vec::new();
    for (f, face) in faces.iter().enumerate() {
        for (k, &v) in face.iter().enumerate() {
            let next = face[(k + 1) % face.len()];
            let previous = face[(k + face.len() - 1) % face.len()];
            quads.push([
                v,
                edge_index[&key(v, next)],
                face_start + f as u32,
                edge_index[&key(previous, v)],
            ]);
            parents.push(f as u32);
        }
    }
    Subdivision {
        stencils: Stencils::from_rows(rows),
        quads,
        parents,
    }
}

fn key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

fn edges_of(faces: &[Vec<u32>]) -> BTreeMap<(u32, u32), Vec<u32>> {
    let mut edges: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
    for (f, face) in faces.iter().enumerate() {
        for (k, &v) in face.iter().enumerate() {
            edges
                .entry(key(v, face[(k + 1) % face.len()]))
                .or_default()
                .push(f as u32);
        }
    }
    edges
}

/// Adds the mean of `vertices`, times `weight`, to a row.
fn add(row: &mut BTreeMap<u32, f64>, vertices: &[u32], weight: f64) {
    for &v in vertices {
        *row.entry(v).or_insert(0.0) += weight / vertices.len() as f64;
    }
}

fn vertex_rows(
    vertex_count: usize,
    faces: &[Vec<u32>],
    edges: &BTreeMap<(u32, u32), Vec<u32>>,
) -> Vec<BTreeMap<u32, f64>> {
    let mut faces_at = vec![Vec::new(); vertex_count];
    for (f, face) in faces.iter().enumerate() {
        for &v in face {
            faces_at[v as usize].push(f);
        }
    }
    let mut neighbours = vec![Vec::new(); vertex_count];
    let mut border = vec![Vec::new(); vertex_count];
    for (&(a, b), sides) in edges {
        for (v, other) in [(a, b), (b, a)] {
            neighbours[v as usize].push(other);
            if sides.len() != 2 {
                border[v as usize].push(other);
            }
        }
    }
    (0..vertex_count as u32)
        .map(|v| {
            let i = v as usize;
            let mut row = BTreeMap::new();
            match (&border[i][..], faces_at[i].len() as f64) {
                // Inner vertex of valence n: (mean face point + 2 mean edge midpoint + (n - 3) v) / n.
                ([], n) if n > 0.0 => {
                    for &f in &faces_at[i] {
                        add(&mut row, &faces[f], 1.0 / (n * n));
                    }
                    add(&mut row, &neighbours[i], 1.0 / n);
                    add(&mut row, &[v], 1.0 / n + (n - 3.0) / n);
                }
                // Border vertex: cubic B-spline along the border.
                ([a, b], _) => {
                    add(&mut row, &[*a, *b], 0.25);
                    add(&mut row, &[v], 0.75);
                }
                // Corner, non-manifold or isolated vertex: stays.
                _ => add(&mut row, &[v], 1.0),
            }
            row
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn cube() -> Vec<Vec<u32>> {
        [
            [0, 3, 2, 1],
            [4, 5, 6, 7],
            [0, 1, 5, 4],
            [1, 2, 6, 5],
            [2, 3, 7, 6],
            [3, 0, 4, 7],
        ]
        .iter()
        .map(|f| f.to_vec())
        .collect()
    }

    #[test]
    fn a_cube_gives_the_known_points() {
        let subdivision = catmull_clark(8, &cube());
        assert_eq!(subdivision.stencils.len(), 8 + 12 + 6);
        assert_eq!(subdivision.quads.len(), 24);
        // x of the corners of a unit cube centred at the origin.
        let x: Vec<f64> = [-1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0].into();
        let fine = subdivision.stencils.apply(&x, 0.0);
        // Vertex point of a cube of half edge 1: 5/9; edge point: 3/4.
        assert_relative_eq!(fine[1], 5.0 / 9.0, epsilon = 1e-12);
        assert!(fine[8..20].iter().any(|v| (v - 0.75).abs() < 1e-12));
    }

    #[test]
    fn weights_sum_to_one_and_a_flat_sheet_stays_flat() {
        let faces: Vec<Vec<u32>> = (0..2)
            .flat_map(|y| (0..2).map(move |x| y * 3 + x))
            .map(|v| vec![v, v + 1, v + 4, v + 3])
            .collect();
        let subdivision = catmull_clark(9, &faces);
        let x: Vec<f64> = (0..9).map(|v| f64::from(v % 3)).collect();
        for (i, value) in subdivision.stencils.apply(&x, 0.0).iter().enumerate() {
            let sum: f64 = subdivision.stencils.row(i).iter().map(|e| e.1).sum();
            assert_relative_eq!(sum, 1.0, epsilon = 1e-12);
            assert!((0.0..=2.0).contains(value));
        }
        assert_relative_eq!(subdivision.stencils.apply(&x, 0.0)[4], 1.0, epsilon = 1e-12);
    }
}
