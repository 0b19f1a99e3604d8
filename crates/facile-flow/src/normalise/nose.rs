//! Where a nose could be: places that stick out of their surroundings.

use std::collections::BTreeMap;

use facile_core::{Mesh, Point3, Vector3};

/// Side of the cubes that thin a surface out to even points, mm.
const SPACING: f64 = 4.0;
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

/// Even points of a surface with their normals: one for each cube that holds vertices.
struct Points {
    cubes: BTreeMap<[i32; 3], (Vector3, Vector3, f64)>,
}

fn cube(p: &Vector3) -> [i32; 3] {
    [0, 1, 2].map(|k| (p[k] / SPACING).floor() as i32)
}

impl Points {
    fn new(mesh: &Mesh, normals: &[Vector3], scale: f64) -> Self {
        let mut cubes: BTreeMap<[i32; 3], (Vector3, Vector3, f64)> = BTreeMap::new();
        for triangle in &mesh.triangles {
            // Corners and centre, so that coarse meshes leave no gaps.
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].coords * scale);
            let [na, nb, nc] = triangle.map(|v| normals[v as usize]);
            let center = (a + b + c) / 3.0;
            for (p, n) in [(a, na), (b, nb), (c, nc), (center, na + nb + nc)] {
                let entry =
                    cubes
                        .entry(cube(&p))
                        .or_insert((Vector3::zeros(), Vector3::zeros(), 0.0));
                entry.0 += p;
                entry.1 += n;
                entry.2 += 1.0;
            }
        }
        Self { cubes }
    }

    fn near(&self, at: &Vector3, radius: f64) -> impl Iterator<Item = (Vector3, Vector3)> {
        let low = cube(&at.add_scalar(-radius));
        let high = cube(&at.add_scalar(radius));
        let at = *at;
        (low[0]..=high[0])
            .flat_map(move |i| (low[1]..=high[1]).map(move |j| (i, j)))
            .flat_map(move |(i, j)| self.cubes.range([i, j, low[2]]..=[i, j, high[2]]))
            .map(|(_, (p, n, count))| (p / *count, *n))
            .filter(move |(p, _)| (p - at).norm_squared() <= radius * radius)
    }
}

/// The places of a mesh that stick out most and face `+z` within about 60 degrees, best first.
///
/// `scale` brings the mesh to mm. At most `count`, apart by 18 mm. Deterministic. Cost O(area of the surface).
pub(crate) fn tips(mesh: &Mesh, normals: &[Vector3], scale: f64, count: usize) -> Vec<Tip> {
    let points = Points::new(mesh, normals, scale);
    let mut found: Vec<Tip> = Vec::new();
    for (sum, _, n) in points.cubes.values() {
        let p = sum / *n;
        let around = points
            .near(&p, 0.6 * REACH)
            .fold(Vector3::zeros(), |s, (_, n)| s + n);
        let Some(normal) = around.try_normalize(1e-9) else {
            continue;
        };
        if normal.z < 0.4 {
            continue;
        }
        let (mut depth, mut neighbors) = (0.0, 0.0);
        for (q, _) in points.near(&p, REACH) {
            depth += normal.dot(&(p - q));
            neighbors += 1.0;
        }
        // The rim of a patch sticks out of nothing: ask for surroundings like those of a smooth surface.
        let full = std::f64::consts::PI * (REACH / SPACING).powi(2);
        if neighbors > 0.5 * full {
            found.push(Tip {
                point: Point3::from(p),
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
        let tips = tips(&mesh, &mesh.vertex_normals(), 1.0, 5);
        assert!((tips[0].point.x - 20.0).abs() < 4.0 && (tips[0].point.y + 10.0).abs() < 4.0);
        assert!(tips[0].depth > 2.0 * tips[1].depth);
        for pair in tips.windows(2) {
            assert!((pair[0].point - pair[1].point).norm() > SEPARATION);
        }
    }
}
