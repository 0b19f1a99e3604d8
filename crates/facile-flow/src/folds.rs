//! Folded triangles: found against the reference's shape, and smoothed away.

use facile_core::{Matrix3, Point3, Vector3};

use crate::template::Template;

/// Cosine between a triangle's normal now and on the reference from which it is not looked at any closer.
const CLEARLY_FLAT: f64 = 0.5;
/// Rounds of relaxation before the surroundings that are relaxed grow.
const PATIENCE: usize = 8;

/// Triangles whose normal turned by more than 90 degrees against the rotation of their surroundings.
pub(crate) fn folded_triangles(template: &Template<'_>, positions: &[Point3]) -> Vec<u32> {
    let mesh = &template.reference.mesh;
    let normal = |points: &[Point3], t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| points[v as usize]);
        (b - a).cross(&(c - a))
    };
    (mesh.triangles.iter().enumerate())
        .filter(|(_, t)| {
            let (was, is) = (normal(&mesh.positions, t), normal(positions, t));
            if was.dot(&is) > CLEARLY_FLAT * was.norm() * is.norm() {
                return false;
            }
            let rotation = local_rotation(template, positions, t);
            (rotation * was).dot(&is) <= 0.0
        })
        .map(|(t, _)| t as u32)
        .collect()
}

/// The rotation that carries the reference's vertices within two rings of a triangle nearest to where they are now.
fn local_rotation(template: &Template<'_>, positions: &[Point3], triangle: &[u32; 3]) -> Matrix3 {
    let mut ring: Vec<u32> = triangle.to_vec();
    for _ in 0..2 {
        let next: Vec<u32> = (ring.iter())
            .flat_map(|v| template.adjacency.of(*v as usize).iter().copied())
            .collect();
        ring.extend(next);
        ring.sort_unstable();
        ring.dedup();
    }
    let rest = &template.reference.mesh.positions;
    let mean = |points: &[Point3]| {
        let sum = (ring.iter()).fold(Vector3::zeros(), |s, v| s + points[*v as usize].coords);
        sum / ring.len() as f64
    };
    let (from, to) = (mean(rest), mean(positions));
    let mut covariance = Matrix3::zeros();
    for &v in &ring {
        let (p, q) = (rest[v as usize].coords, positions[v as usize].coords);
        covariance += (q - to) * (p - from).transpose();
    }
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Matrix3::identity();
    };
    let sign = (u * v_t).determinant().signum();
    // The weakest axis of a nearly flat neighbourhood decides the sign: that of a rotation.
    let mut flip = Vector3::new(1.0, 1.0, 1.0);
    flip[svd.singular_values.imin()] = sign;
    u * Matrix3::from_diagonal(&flip) * v_t
}

/// Relaxes the surroundings of folded triangles towards the reference's own shape until none is left or `rounds` are
/// over; returns how many remain.
///
/// Each round replaces the displacement (against the reference, scaled by `size`) of every vertex within two rings of
/// a fold by the mean of its neighbours' displacements. Folds that outlast [`PATIENCE`] rounds are pushed in from around:
/// the rings grow by one.
pub(crate) fn unfold(
    template: &Template<'_>,
    positions: &mut [Point3],
    size: f64,
    rounds: usize,
) -> usize {
    let mesh = &template.reference.mesh;
    for round in 0..rounds {
        let reach = 2 + (round / PATIENCE) as u32;
        let folded = folded_triangles(template, positions);
        if folded.is_empty() {
            return 0;
        }
        let seeds = folded
            .iter()
            .flat_map(|t| mesh.triangles[*t as usize])
            .map(|v| v as usize);
        let rings = template.adjacency.rings_from(seeds, reach);
        let shift = |v: usize, p: &[Point3]| p[v].coords - mesh.positions[v].coords * size;
        let moved: Vec<(usize, Vector3)> = (0..positions.len())
            .filter(|&v| rings[v] <= reach)
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
