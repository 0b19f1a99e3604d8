//! Mean and Gaussian curvature of a triangle mesh, for the channels of eq. 4.
//!
//! The shape operator of every triangle is the gradient of its corner normals; a vertex takes the mean of its triangles'
//! operators, weighted by area. The channels average operators over a neighbourhood of fixed size in mm before they take
//! the invariants, so that neither noise nor the density of the mesh changes the result. Sources: Rusinkiewicz,
//! Estimating curvatures and their derivatives on triangle meshes, 2004 (operator from corner normals); averaging of
//! tensors as in Kalogerakis et al., Robust statistical estimation of curvature, 2007.

use facile_core::{Matrix3, Mesh, Vector3};

/// A symmetric 3x3 tensor, `[xx, yy, zz, xy, yz, zx]`, 1/mm.
pub type Operator = [f64; 6];

/// Shape operator of every vertex of `mesh` with unit `normals`, 1/mm; 0 for vertices without triangles. Cost O(n).
pub fn vertex_operators(mesh: &Mesh, normals: &[Vector3]) -> Vec<Operator> {
    let mut operators = vec![[0.0; 6]; mesh.positions.len()];
    let mut areas = vec![0.0; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let corner_normals = triangle.map(|v| normals[v as usize]);
        let corners = triangle.map(|v| mesh.positions[v as usize]);
        let Some((m, area)) = triangle_operator(&corners, &corner_normals) else {
            continue;
        };
        let flat = [
            m[(0, 0)],
            m[(1, 1)],
            m[(2, 2)],
            m[(0, 1)],
            m[(1, 2)],
            m[(2, 0)],
        ];
        for v in triangle.map(|v| v as usize) {
            for (sum, value) in operators[v].iter_mut().zip(flat) {
                *sum += value * area;
            }
            areas[v] += area;
        }
    }
    for (operator, area) in operators.iter_mut().zip(&areas) {
        if *area > 0.0 {
            for value in operator {
                *value /= area;
            }
        }
    }
    operators
}

/// Mean curvature `H` (1/mm; `1/r` on a sphere of radius `r` seen from outside, negative in hollows) and Gaussian
/// curvature `K` (1/mm^2; `1/r^2` on a sphere) of an operator. Both are the same in every frame.
pub fn invariants(&[xx, yy, zz, xy, yz, zx]: &Operator) -> (f64, f64) {
    let trace = xx + yy + zz;
    // Sum of the principal 2x2 minors: the product of the two eigenvalues that are not 0.
    let minors = xx * yy + yy * zz + zz * xx - xy * xy - yz * yz - zx * zx;
    (0.5 * trace, minors)
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
    // The gradients lie in the plane already: only what leaves it is taken out.
    let operator = derivative - normal * (normal.transpose() * derivative);
    Some(((operator + operator.transpose()) * 0.5, 0.5 * double_area))
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

    /// Invariants at the centre of a grid of `n` cells, averaged over the `rings` cells around it.
    fn at_center(mesh: &Mesh, n: usize, rings: usize) -> (f64, f64) {
        let operators = vertex_operators(mesh, &mesh.vertex_normals());
        let mut sum = [0.0; 6];
        let mut count = 0.0;
        for j in n / 2 - rings..=n / 2 + rings {
            for i in n / 2 - rings..=n / 2 + rings {
                for (s, v) in sum.iter_mut().zip(operators[j * (n + 1) + i]) {
                    *s += v;
                }
                count += 1.0;
            }
        }
        invariants(&sum.map(|s| s / count))
    }

    #[test]
    fn a_sphere_has_its_curvature_at_any_resolution() {
        for n in [16, 32, 64] {
            let (h, k) = at_center(&sphere(n, 40.0), n, 0);
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
        let (h, k) = at_center(&mesh, 40, 0);
        assert!((h * 100.0 - 1.0).abs() < 0.02, "2 H r = {}", h * 100.0);
        assert!(k.abs() < 1e-6, "K = {k}");
    }

    #[test]
    fn a_saddle_is_negative_and_a_hollow_has_negative_mean() {
        let saddle = patch(32, |u, v| {
            let (x, y) = (40.0 * (u - 0.5), 40.0 * (v - 0.5));
            Point3::new(x, y, (x * x - y * y) / 100.0)
        });
        let (h, k) = at_center(&saddle, 32, 0);
        assert!(
            h.abs() < 1e-3 && (k * 2500.0 + 1.0).abs() < 0.15,
            "H {h}, K {k}"
        );
        let hollow = patch(32, |u, v| {
            let (x, y) = (40.0 * (u - 0.5), 40.0 * (v - 0.5));
            Point3::new(x, y, (x * x + y * y) / 200.0)
        });
        assert!(at_center(&hollow, 32, 0).0 < -0.009);
    }

    #[test]
    fn averaging_takes_the_noise_out_of_the_mean_curvature() {
        let mut noisy = sphere(48, 60.0);
        for (i, p) in noisy.positions.iter_mut().enumerate() {
            let t = ((i as u64 * 2_654_435_761) % 1000) as f64 / 1000.0 - 0.5;
            *p += p.coords.normalize() * (0.3 * t);
        }
        let (h, _) = at_center(&noisy, 48, 4);
        assert!((h * 60.0 - 1.0).abs() < 0.3, "H r = {}", h * 60.0);
    }
}
