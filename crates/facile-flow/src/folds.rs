//! Folded triangles: found against the reference's shape, and smoothed away.

use facile_core::{Point3, Vector3};

use crate::template::Template;

/// Triangles whose normal turned by more than 90 degrees against the rotation of their surroundings.
pub(crate) fn folded_triangles(template: &Template<'_>, positions: &[Point3]) -> Vec<u32> {
    let mesh = &template.reference.mesh;
    let normal = |points: &[Point3], t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| points[v as usize]);
        (b - a).cross(&(c - a))
    };
    // The rotation of the surroundings is that of the two normals of the vertices around the triangle.
    let now = facile_core::mesh::vertex_normals(positions, &mesh.triangles);
    let before = facile_core::mesh::vertex_normals(&mesh.positions, &mesh.triangles);
    let mean = |normals: &[Vector3], t: &[u32; 3]| {
        let mut sum = Vector3::zeros();
        for &v in t {
            sum += normals[v as usize];
            for &u in template.adjacency.of(v as usize) {
                sum += normals[u as usize];
            }
        }
        sum
    };
    mesh.triangles
        .iter()
        .enumerate()
        .filter(|(_, t)| {
            let was = normal(&mesh.positions, t).dot(&mean(&before, t));
            let is = normal(positions, t).dot(&mean(&now, t));
            // Where the reference itself is folded tightly (lip rims), its own sign is the measure.
            was * is < 0.0
        })
        .map(|(t, _)| t as u32)
        .collect()
}

/// Relaxes the surroundings of folded triangles towards the reference's own shape until none is left or `rounds` are
/// over; returns how many remain.
///
/// Each round replaces the displacement (against the reference, scaled by `size`) of every vertex within two rings of
/// a fold by the mean of its neighbours' displacements.
pub(crate) fn unfold(
    template: &Template<'_>,
    positions: &mut [Point3],
    size: f64,
    rounds: usize,
) -> usize {
    let mesh = &template.reference.mesh;
    for _ in 0..rounds {
        let folded = folded_triangles(template, positions);
        if folded.is_empty() {
            return 0;
        }
        let seeds = folded
            .iter()
            .flat_map(|t| mesh.triangles[*t as usize])
            .map(|v| v as usize);
        let rings = template.adjacency.rings_from(seeds, 2);
        let shift = |v: usize, p: &[Point3]| p[v].coords - mesh.positions[v].coords * size;
        let moved: Vec<(usize, Vector3)> = (0..positions.len())
            .filter(|&v| rings[v] <= 2)
            .map(|v| {
                let neighbors = template.adjacency.of(v);
                let sum = neighbors
                    .iter()
                    .fold(Vector3::zeros(), |s, u| s + shift(*u as usize, positions));
                let mean = sum / neighbors.len().max(1) as f64;
                (v, mesh.positions[v].coords * size + mean)
            })
            .collect();
        for (v, p) in moved {
            positions[v] = Point3::from(p);
        }
    }
    folded_triangles(template, positions).len()
}
