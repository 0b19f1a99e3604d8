//! Mean and Gaussian curvature of a triangle mesh, for the channels of eq. 4.
//!
//! The shape operator of every triangle is the gradient of its corner normals; operators are averaged over a
//! neighbourhood of fixed size in mm, so that neither noise nor the density of the mesh changes the result.
//! Sources: Rusinkiewicz, Estimating curvatures and their derivatives on triangle meshes, 2004 (operator from corner
//! normals); averaging of tensors as in Kalogerakis et al., Robust statistical estimation of curvature, 2007.

use facile_core::{Matrix3, Mesh, Vector3};
use rayon::prelude::*;

use crate::adjacency::Adjacency;

/// Most vertices that one average looks at: bounds the cost on dense meshes.
const MAX_NEIGHBORHOOD: usize = 256;

/// Curvature of each vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curvature {
    /// Mean curvature, 1/mm; `1/r` on a sphere of radius `r` seen from outside, negative in hollows.
    pub mean: Vec<f64>,
    /// Gaussian curvature, 1/mm^2; `1/r^2` on a sphere.
    pub gaussian: Vec<f64>,
}

/// Curvature of every vertex, averaged with a Gaussian of standard deviation `sigma` mm along the surface.
///
/// Exact on spheres and cylinders up to the discretisation: 2 % at eight vertices per radius. Vertices without
/// triangles get 0. Cost O(n k) with k vertices within `2 sigma`, at most 256.
pub fn vertex_curvature(mesh: &Mesh, normals: &[Vector3], sigma: f64) -> Curvature {
    let n = mesh.positions.len();
    let adjacency = Adjacency::from_triangles(n, &mesh.triangles);
    // Shape operators of triangles, gathered at vertices with the triangles' areas as weights.
    let mut operators = vec![Matrix3::zeros(); n];
    let mut areas = vec![0.0; n];
    for triangle in &mesh.triangles {
        let corner_normals = triangle.map(|v| normals[v as usize]);
        let corners = triangle.map(|v| mesh.positions[v as usize]);
        let Some((operator, area)) = triangle_operator(&corners, &corner_normals) else {
            continue;
        };
        for &v in triangle {
            operators[v as usize] += operator * area;
            areas[v as usize] += area;
        }
    }
    let averaged: Vec<(f64, f64)> = (0..n)
        .into_par_iter()
        .map_init(
            || (vec![u32::MAX; n], Vec::new()),
            |(seen, queue), v| {
                let area = |u: usize| (operators[u], areas[u]);
                let (operator, normal) =
                    average(mesh, normals, &adjacency, &area, sigma, v, seen, queue);
                principal_invariants(&operator, &normal)
            },
        )
        .collect();
    let (mean, gaussian) = averaged.into_iter().unzip();
    Curvature { mean, gaussian }
}

/// Symmetric 3x3 shape operator of one triangle in its plane, and its area. `None` for a degenerate triangle.
fn triangle_operator(
    [a, b, c]: &[facile_core::Point3; 3],
    normals: &[Vector3; 3],
) -> Option<(Matrix3, f64)> {
    let area_vector = (b - a).cross(&(c - a));
    let double_area = area_vector.norm();
    let normal = area_vector.try_normalize(1e-12)?;
    // Gradient of the hat function of a corner: the opposite edge turned by 90 degrees, over twice the area.
    let gradients = [c - b, a - c, b - a].map(|edge| normal.cross(&edge) / double_area);
    let mut derivative = Matrix3::zeros();
    for (n, g) in normals.iter().zip(&gradients) {
        derivative += n * g.transpose();
    }
    let tangent = Matrix3::identity() - normal * normal.transpose();
    let operator = tangent * derivative * tangent;
    Some(((operator + operator.transpose()) * 0.5, 0.5 * double_area))
}

/// Area-weighted Gaussian average of operators and normals around `v`. `seen` holds the last vertex that visited.
#[expect(
    clippy::too_many_arguments,
    reason = "scratch buffers of a hot loop, private"
)]
fn average(
    mesh: &Mesh,
    normals: &[Vector3],
    adjacency: &Adjacency,
    operators: &dyn Fn(usize) -> (Matrix3, f64),
    sigma: f64,
    v: usize,
    seen: &mut [u32],
    queue: &mut Vec<u32>,
) -> (Matrix3, Vector3) {
    let center = mesh.positions[v];
    let reach = 4.0 * sigma * sigma;
    queue.clear();
    queue.push(v as u32);
    seen[v] = v as u32;
    let (mut sum, mut normal, mut weight_sum) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    let mut next = 0;
    while next < queue.len() {
        let u = queue[next] as usize;
        next += 1;
        let distance = (mesh.positions[u] - center).norm_squared();
        let (operator, area) = operators(u);
        let weight = libm::exp(-distance / (2.0 * sigma * sigma));
        sum += operator * weight;
        normal += normals[u] * (weight * area);
        weight_sum += weight * area;
        for &w in adjacency.of(u) {
            let near = (mesh.positions[w as usize] - center).norm_squared() <= reach;
            // Surfaces that face away, such as the other lip, are not the same surface.
            let same_side = normals[w as usize].dot(&normals[v]) > 0.0;
            if seen[w as usize] != v as u32 && near && same_side && queue.len() < MAX_NEIGHBORHOOD {
                seen[w as usize] = v as u32;
                queue.push(w);
            }
        }
    }
    if weight_sum <= 0.0 {
        return (Matrix3::zeros(), normals[v]);
    }
    (
        sum / weight_sum,
        normal.try_normalize(1e-12).unwrap_or(normals[v]),
    )
}

/// `(H, K)` of an operator seen in the plane across `normal`.
fn principal_invariants(operator: &Matrix3, normal: &Vector3) -> (f64, f64) {
    let tangent = Matrix3::identity() - normal * normal.transpose();
    let flat = tangent * operator * tangent;
    let trace = flat.trace();
    // Sum of the principal 2x2 minors: the product of the two eigenvalues that are not 0.
    let minors = 0.5 * (trace * trace - (flat * flat).trace());
    (0.5 * trace, minors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::Point3;

    /// A grid over `[0, 1]^2` mapped into space, `n` cells a side.
    fn patch(n: usize, f: impl Fn(f64, f64) -> Point3) -> Mesh {
        let mut mesh = Mesh::default();
        for j in 0..=n {
            for i in 0..=n {
                mesh.positions
                    .push(f(i as f64 / n as f64, j as f64 / n as f64));
            }
        }
        let w = n as u32 + 1;
        for j in 0..n as u32 {
            for i in 0..n as u32 {
                let v = j * w + i;
                mesh.triangles.push([v, v + 1, v + w]);
                mesh.triangles.push([v + 1, v + w + 1, v + w]);
            }
        }
        mesh
    }

    fn sphere(n: usize, r: f64) -> Mesh {
        patch(n, |u, v| {
            facile_core::math::point_from_cylinder(
                r * libm::sin(1.2 * (v - 0.5)),
                1.2 * (u - 0.5),
                r * libm::cos(1.2 * (v - 0.5)),
            )
        })
    }

    fn at_center(mesh: &Mesh, n: usize) -> (f64, f64) {
        let c = vertex_curvature(mesh, &mesh.vertex_normals(), 4.0);
        let v = (n / 2) * (n + 1) + n / 2;
        (c.mean[v], c.gaussian[v])
    }

    #[test]
    fn a_sphere_has_its_curvature_at_any_resolution() {
        for n in [16, 32, 64] {
            let (h, k) = at_center(&sphere(n, 40.0), n);
            assert!((h * 40.0 - 1.0).abs() < 0.02, "n {n}: H r = {}", h * 40.0);
            assert!(
                (k * 1600.0 - 1.0).abs() < 0.04,
                "n {n}: K r^2 = {}",
                k * 1600.0
            );
        }
    }

    #[test]
    fn a_cylinder_is_bent_one_way_only() {
        let mesh = patch(40, |u, v| {
            facile_core::math::point_from_cylinder(60.0 * v, 1.5 * (u - 0.5), 50.0)
        });
        let (h, k) = at_center(&mesh, 40);
        assert!((h * 100.0 - 1.0).abs() < 0.02, "2 H r = {}", h * 100.0);
        assert!(k.abs() < 1e-6, "K = {k}");
    }

    #[test]
    fn a_saddle_is_negative_and_a_hollow_has_negative_mean() {
        let saddle = patch(32, |u, v| {
            let (x, y) = (40.0 * (u - 0.5), 40.0 * (v - 0.5));
            Point3::new(x, y, (x * x - y * y) / 100.0)
        });
        let (h, k) = at_center(&saddle, 32);
        assert!(
            h.abs() < 1e-4 && (k * 2500.0 + 1.0).abs() < 0.15,
            "H {h}, K {k}"
        );
        let hollow = patch(32, |u, v| {
            let (x, y) = (40.0 * (u - 0.5), 40.0 * (v - 0.5));
            Point3::new(x, y, (x * x + y * y) / 200.0)
        });
        assert!(at_center(&hollow, 32).0 < -0.009);
    }

    #[test]
    fn noise_barely_moves_the_mean_curvature() {
        let clean = sphere(48, 60.0);
        let mut noisy = clean.clone();
        for (i, p) in noisy.positions.iter_mut().enumerate() {
            let t = ((i as u64 * 2_654_435_761) % 1000) as f64 / 1000.0 - 0.5;
            *p += p.coords.normalize() * (0.3 * t);
        }
        let (h, _) = at_center(&noisy, 48);
        assert!((h * 60.0 - 1.0).abs() < 0.3, "H r = {}", h * 60.0);
    }
}
