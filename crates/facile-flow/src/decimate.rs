//! Thins a dense scan out: vertices in one cube become one.
//!
//! Source: Rossignac and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993. Texture
//! coordinates stay exact to second order: each corner's are carried along its own triangle's map to the cube's vertex.

use std::borrow::Cow;

use facile_core::{Mesh, Point3, Vector3};

/// A surface with more triangles than this is thinned out: a face has no detail that needs more.
pub(crate) const MOST_TRIANGLES: usize = 250_000;

/// Cubes that a thinned surface fills, about; it has twice as many triangles.
const CUBES: f64 = 90_000.0;

/// The surface of `mesh` with one vertex for each cube that holds some, if it is too dense; cost O(n log n).
pub(crate) fn thin_out(mesh: &Mesh) -> Cow<'_, Mesh> {
    if mesh.triangles.len() <= MOST_TRIANGLES {
        return Cow::Borrowed(mesh);
    }
    let area: f64 = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            0.5 * (b - a).cross(&(c - a)).norm()
        })
        .sum();
    // A slanted sheet fills about one and a half times as many cubes as it has square sides.
    Cow::Owned(merge(mesh, (1.5 * area / CUBES).sqrt()))
}

/// Merges the vertices in each cube of side `side` (scan's unit) to their mean.
fn merge(mesh: &Mesh, side: f64) -> Mesh {
    let mut keys: Vec<([i32; 3], u32)> = (mesh.positions.iter().enumerate())
        .map(|(v, p)| {
            let cube = [p.x, p.y, p.z].map(|c| (c / side).floor() as i32);
            (cube, v as u32)
        })
        .collect();
    keys.sort_unstable();
    let mut cluster = vec![0_u32; mesh.positions.len()];
    let mut thin = Mesh::default();
    for run in keys.chunk_by(|a, b| a.0 == b.0) {
        let index = thin.positions.len() as u32;
        let mut sum = Vector3::zeros();
        let mut color = [0.0_f32; 3];
        for &(_, v) in run {
            cluster[v as usize] = index;
            sum += mesh.positions[v as usize].coords;
            if let Some(c) = mesh.colors.get(v as usize) {
                color = std::array::from_fn(|k| color[k] + c[k]);
            }
        }
        let n = run.len() as f64;
        thin.positions.push(Point3::from(sum / n));
        if !mesh.colors.is_empty() {
            thin.colors.push(color.map(|c| c / n as f32));
        }
    }
    drop(keys);
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let merged = corners.map(|v| cluster[v as usize]);
        if merged[0] == merged[1] || merged[1] == merged[2] || merged[2] == merged[0] {
            continue;
        }
        thin.triangles.push(merged);
        if let Some(texcoords) = mesh.texcoord_triangles.get(t) {
            let index = thin.texcoords.len() as u32;
            let uv = texcoords.map(|i| mesh.texcoords[i as usize]);
            let old = mesh.corners(t);
            thin.texcoords
                .extend(merged.map(|v| carried(&old, &uv, &thin.positions[v as usize])));
            thin.texcoord_triangles.push([index, index + 1, index + 2]);
        }
    }
    thin
}

/// Texture coordinate of a point near a triangle: the triangle's own affine map, at the foot of the point.
fn carried([a, b, c]: &[Point3; 3], uv: &[[f32; 2]; 3], p: &Point3) -> [f32; 2] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let normal = ab.cross(&ac);
    let square = normal.norm_squared();
    if square <= 0.0 {
        return uv[0];
    }
    // A sliver's map runs away: at most a dozen times its size.
    let v = (ap.cross(&ac).dot(&normal) / square).clamp(-12.0, 13.0) as f32;
    let w = (ab.cross(&ap).dot(&normal) / square).clamp(-12.0, 13.0) as f32;
    std::array::from_fn(|k| uv[0][k] + (uv[1][k] - uv[0][k]) * v + (uv[2][k] - uv[0][k]) * w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_sheet_keeps_its_shape_and_its_texture_coordinates() {
        let n = 200_u32;
        let mut mesh = Mesh::default();
        for j in 0..=n {
            for i in 0..=n {
                let (x, y) = (f64::from(i) * 0.1, f64::from(j) * 0.1);
                mesh.positions.push(Point3::new(x, y, 0.02 * x * y));
                mesh.texcoords.push([x as f32 / 20.0, y as f32 / 20.0]);
            }
        }
        for j in 0..n {
            for i in 0..n {
                let (v, w) = (j * (n + 1) + i, n + 1);
                for t in [[v, v + 1, v + w], [v + 1, v + w + 1, v + w]] {
                    mesh.triangles.push(t);
                    mesh.texcoord_triangles.push(t);
                }
            }
        }
        let thin = merge(&mesh, 0.7);
        assert!(thin.triangles.len() < mesh.triangles.len() / 20);
        assert!(thin.triangles.len() > 1000);
        for (corners, texcoords) in thin.triangles.iter().zip(&thin.texcoord_triangles) {
            for (v, i) in corners.iter().zip(texcoords) {
                let p = thin.positions[*v as usize];
                let [u, w] = thin.texcoords[*i as usize].map(f64::from);
                assert!((p.z - 0.02 * p.x * p.y).abs() < 0.01);
                assert!((p.x - 20.0 * u).abs() < 0.02 && (p.y - 20.0 * w).abs() < 0.02);
            }
        }
    }
}
