//! Where a nose could be: places that stick out of their surroundings.

use facile_core::{Point3, Vector3};

use super::cubes::{Cubes, SIDE};

/// Radius of the surroundings that a nose sticks out of, mm.
const REACH: f64 = 24.0;
/// Candidates closer than this are one, mm.
const SEPARATION: f64 = 18.0;

/// A place that sticks out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tip {
    /// The point, mm.
    pub(crate) point: Point3,
    /// Mean normal around it.
    pub(crate) normal: Vector3,
    /// Mean depth of the surroundings below the tip, mm: about 2 on a head, 8 and more at a nose.
    pub(crate) depth: f64,
}

/// The places of a surface that stick out most and face `+z` within about 65 degrees, best first.
///
/// At most `count`, apart by 18 mm. Deterministic. Cost O(area of the surface).
pub(crate) fn tips(surface: &Cubes, count: usize) -> Vec<Tip> {
    let mut found: Vec<Tip> = Vec::new();
    for (p, own) in surface.points.iter().zip(&surface.normals) {
        // The tip's own normal may lean away from that of its surroundings.
        if own.z < 0.0 {
            continue;
        }
        let around = surface
            .near(p, 0.6 * REACH)
            .fold(Vector3::zeros(), |s, i| s + surface.normals[i]);
        let Some(normal) = around.try_normalize(1e-9) else {
            continue;
        };
        if normal.z < 0.4 {
            continue;
        }
        let (mut depth, mut neighbors) = (0.0, 0.0);
        for i in surface.near(p, REACH) {
            depth += normal.dot(&(p - surface.points[i]));
            neighbors += 1.0;
        }
        // The rim of a patch sticks out of nothing: ask for surroundings like those of a smooth surface.
        let full = std::f64::consts::PI * (REACH / SIDE).powi(2);
        if neighbors > 0.5 * full {
            found.push(Tip {
                point: Point3::from(*p),
                normal,
                depth: depth / neighbors,
            });
        }
    }
    found.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    let mut kept: Vec<Tip> = Vec::new();
    for tip in found {
        if kept.len() == count {
            break;
        }
        if kept
            .iter()
            .all(|k| (k.point - tip.point).norm() > SEPARATION)
        {
            kept.push(tip);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::Mesh;

    /// A gently curved sheet with one bump of height `bump` mm at (20, -10).
    fn sheet(bump: f64) -> Mesh {
        let n = 60_u32;
        let mut mesh = Mesh::default();
        for j in 0..=n {
            for i in 0..=n {
                let (x, y) = (f64::from(i) * 3.0 - 90.0, f64::from(j) * 3.0 - 90.0);
                let d = ((x - 20.0).powi(2) + (y + 10.0).powi(2)) / (2.0 * 81.0);
                let z = bump * libm::exp(-d) - (x * x + y * y) / 200.0;
                mesh.positions.push(Point3::new(x, y, z));
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
    fn the_bump_is_the_first_tip() {
        let mesh = sheet(20.0);
        let tips = tips(&Cubes::new(&mesh, &mesh.vertex_normals(), 1.0), 5);
        assert!((tips[0].point.x - 20.0).abs() < 4.0 && (tips[0].point.y + 10.0).abs() < 4.0);
        assert!(tips[0].depth > 2.0 * tips[1].depth);
        for pair in tips.windows(2) {
            assert!((pair[0].point - pair[1].point).norm() > SEPARATION);
        }
    }
}
