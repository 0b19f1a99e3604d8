//! Flesh around bones: a smooth surface around rounded cones that grow together where they meet.
//!
//! Parts are unions of cones; parts grow into the first one with a smooth minimum of their distances, and stay apart from each
//! other. The surface is found on a grid. Sources: Quilez, Smooth Minimum, 2013; Gibson, Constrained Elastic Surface Nets,
//! MICCAI 1998.

use std::collections::BTreeMap;

use facile_core::{Mesh, Point3, Segment, Vector3};

/// Distance over which parts grow together, mm.
const BLEND_MM: f64 = 9.0;
/// The same of the cones of one part.
const JOINT_MM: f64 = 2.5;

/// A rounded cone between two points, flattened along `z`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bone {
    pub(super) ends: [Point3; 2],
    /// At either end, mm.
    pub(super) radii: [f64; 2],
    /// Depth along `z` over width.
    pub(super) flatness: f64,
}

impl Bone {
    /// Signed distance from the surface, nearly, mm.
    fn distance(&self, p: &Point3) -> f64 {
        let [a, b] = self.ends;
        let way = b - a;
        let share = ((p - a).dot(&way) / way.norm_squared().max(1e-9)).clamp(0.0, 1.0);
        let mut off = p - (a + way * share);
        off.z /= self.flatness;
        off.norm() - (self.radii[0] + (self.radii[1] - self.radii[0]) * share)
    }
}

/// The smaller of two distances, rounded where they are within `blend` of each other.
fn smooth_min(a: f64, b: f64, blend: f64) -> f64 {
    let near = (blend - (a - b).abs()).max(0.0) / blend;
    a.min(b) - near * near * blend / 4.0
}

/// Signed distance from the flesh around parts, the first of which the others grow into.
fn distance(parts: &[Vec<Bone>], p: &Point3) -> f64 {
    let of_part = |part: &Vec<Bone>| {
        let distances = part.iter().map(|bone| bone.distance(p));
        distances.fold(1e3, |a, b| smooth_min(a, b, JOINT_MM))
    };
    let trunk = of_part(&parts[0]);
    let limbs = parts[1..]
        .iter()
        .map(|part| smooth_min(trunk, of_part(part), BLEND_MM));
    limbs.fold(trunk, f64::min)
}

/// The surface around parts, at least one, as triangles of about `step` mm.
pub(super) fn surface(parts: &[Vec<Bone>], step: f64) -> Mesh {
    let bones = || parts.iter().flatten();
    let reach = bones().flat_map(|b| b.radii).fold(0.0, f64::max) + 2.0 * step;
    let corner = |pick: fn(f64, f64) -> f64, start: f64| {
        let ends = bones().flat_map(|b| b.ends);
        ends.fold(Vector3::repeat(start), |v, p| v.zip_map(&p.coords, pick))
    };
    let low = corner(f64::min, f64::MAX) - Vector3::repeat(reach);
    let high = corner(f64::max, f64::MIN) + Vector3::repeat(reach);
    let size = (high - low).map(|v| (v / step).ceil() as usize + 1);
    let [nx, ny, nz]: [usize; 3] = size.into();
    let index = |x: usize, y: usize, z: usize| (z * ny + y) * nx + x;
    let place = |x: usize, y: usize, z: usize| {
        Point3::from(low + Vector3::new(x as f64, y as f64, z as f64) * step)
    };
    let mut field = Vec::with_capacity(nx * ny * nz);
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                field.push(distance(parts, &place(x, y, z)));
            }
        }
    }
    // A vertex in each cell that the surface passes, in the middle of where it crosses the cell's edges
    let mut mesh = Mesh::default();
    let mut vertices: BTreeMap<usize, u32> = BTreeMap::new();
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let corners: [[usize; 3]; 8] =
                    std::array::from_fn(|k| [x + (k & 1), y + (k >> 1 & 1), z + (k >> 2)]);
                let values = corners.map(|[x, y, z]| field[index(x, y, z)]);
                let (mut sum, mut count) = (Vector3::zeros(), 0.0);
                for (a, b) in (0..8).flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit))) {
                    if a != b && (values[a] < 0.0) != (values[b] < 0.0) {
                        let share = values[a] / (values[a] - values[b]);
                        let [from, to] = [a, b].map(|k| {
                            let [x, y, z] = corners[k];
                            place(x, y, z).coords
                        });
                        sum += from.lerp(&to, share);
                        count += 1.0;
                    }
                }
                if count > 0.0 {
                    vertices.insert(index(x, y, z), mesh.positions.len() as u32);
                    mesh.positions.push(Point3::from(sum / count));
                }
            }
        }
    }
    // A quad around each edge of the grid that the surface crosses
    let strides = [1, nx, nx * ny];
    for z in 1..nz - 1 {
        for y in 1..ny - 1 {
            for x in 1..nx - 1 {
                let at = index(x, y, z);
                for axis in 0..3 {
                    let [inside, outside] = [at, at + strides[axis]].map(|i| field[i] < 0.0);
                    if inside == outside {
                        continue;
                    }
                    let (u, v) = (strides[(axis + 1) % 3], strides[(axis + 2) % 3]);
                    let around = [at - u - v, at - v, at, at - u].map(|i| vertices.get(&i));
                    let [Some(&a), Some(&b), Some(&c), Some(&d)] = around else {
                        continue;
                    };
                    mesh.triangles.extend(if inside {
                        [[a, b, c], [a, c, d]]
                    } else {
                        [[a, c, b], [a, d, c]]
                    });
                }
            }
        }
    }
    mesh.segments = vec![Segment::Other; mesh.triangles.len()];
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(x: f64, radius: f64) -> Bone {
        Bone {
            ends: [Point3::new(x, 0.0, 0.0); 2],
            radii: [radius; 2],
            flatness: 1.0,
        }
    }

    #[test]
    fn a_single_ball_is_a_closed_sphere() {
        let mesh = surface(&[vec![ball(3.0, 20.0)]], 2.0);
        let volume: f64 = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t).map(|p| p.coords);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum();
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 8000.0;
        assert!((volume / exact - 1.0).abs() < 0.03, "{volume} {exact}");
        for p in &mesh.positions {
            let off = (p - Point3::new(3.0, 0.0, 0.0)).norm() - 20.0;
            assert!(off.abs() < 0.3, "{off}");
        }
        let mut edges = BTreeMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                *edges.entry((t[k], t[(k + 1) % 3])).or_insert(0) += 1;
            }
        }
        let is_closed = |((a, b), n): (&(u32, u32), &i32)| *n == 1 && edges.contains_key(&(*b, *a));
        assert!(edges.iter().all(is_closed));
    }

    #[test]
    fn parts_grow_into_the_first_and_not_into_each_other() {
        let alone = |a: f64, b: f64| a.min(b);
        let p = Point3::new(0.0, 9.0, 0.0);
        let (left, right) = (ball(-8.0, 10.0), ball(8.0, 10.0));
        let plain = alone(left.distance(&p), right.distance(&p));
        let trunk = ball(0.0, 5.0);
        assert!(distance(&[vec![left], vec![right]], &p) < plain - 2.0);
        let apart = distance(&[vec![ball(0.0, -500.0)], vec![left], vec![right]], &p);
        assert!((apart - plain).abs() < 1e-9);
        assert!(distance(&[vec![trunk], vec![left], vec![right]], &p) < plain);
    }
}
