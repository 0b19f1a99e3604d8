//! The watertight ray-triangle test, scalar. Packets repeat the same operations in the same order and give the same
//! bits.
//!
//! Source: Woop, Benthin, Wald, Watertight Ray/Triangle Intersection, JCGT 2(1), 2013. The corners are sheared into a
//! frame where the ray is an axis; the edge tests are then exact signs of 2D cross products (`f64` where `f32` gives 0),
//! the same for both triangles of an edge, so no ray slips through an edge or a vertex.

use crate::math::Vec3;
use crate::ray::Ray;

/// The shear that maps a ray's direction to the axis `z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayShear {
    /// Axes that become `x`, `y`, `z`; `z` is the direction's largest component.
    pub axes: [usize; 3],
    /// Shear along `x`.
    pub shear_x: f32,
    /// Shear along `y`.
    pub shear_y: f32,
    /// Scale along `z`.
    pub shear_z: f32,
}

/// The axis of a direction's largest component, the first one of equals.
pub fn dominant_axis(direction: Vec3) -> usize {
    let [x, y, z] = [direction.x.abs(), direction.y.abs(), direction.z.abs()];
    if x >= y && x >= z {
        0
    } else if y >= z {
        1
    } else {
        2
    }
}

impl RayShear {
    /// The shear of a direction.
    pub fn new(direction: Vec3) -> Self {
        let z = dominant_axis(direction);
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let shear_z = 1.0 / direction[z];
        Self {
            axes: [x, y, z],
            shear_x: direction[x] * shear_z,
            shear_y: direction[y] * shear_z,
            shear_z,
        }
    }
}

/// The ray's parameter and the weights of the second and third corner where it meets a triangle past `t_min`. The
/// caller compares with `t_max`. Both sides count. A triangle without area, or seen edge-on, is never met.
pub fn intersect(ray: &Ray, shear: &RayShear, corners: &[Vec3; 3]) -> Option<(f32, f32, f32)> {
    // Shear the corners into the ray's frame
    let [x, y, z] = shear.axes;
    let sheared = corners.map(|corner| {
        let p = corner - ray.origin;
        (
            p[x] - shear.shear_x * p[z],
            p[y] - shear.shear_y * p[z],
            shear.shear_z * p[z],
        )
    });
    let [(ax, ay, az), (bx, by, bz), (cx, cy, cz)] = sheared;
    // Take the signs of the edge functions, exactly
    let mut u = cx * by - cy * bx;
    let mut v = ax * cy - ay * cx;
    let mut w = bx * ay - by * ax;
    if has_both_signs(u, v, w) {
        return None;
    }
    if u == 0.0 || v == 0.0 || w == 0.0 {
        u = edge_function(cx, by, cy, bx);
        v = edge_function(ax, cy, ay, cx);
        w = edge_function(bx, ay, by, ax);
        if has_both_signs(u, v, w) {
            return None;
        }
    }
    let determinant = u + v + w;
    if determinant == 0.0 {
        return None;
    }
    // Find the distance
    let inverse = 1.0 / determinant;
    let t = (u * az + v * bz + w * cz) * inverse;
    (t > ray.t_min).then_some((t, v * inverse, w * inverse))
}

fn has_both_signs(u: f32, v: f32, w: f32) -> bool {
    (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0)
}

/// `a b - c d` in `f64`: the sign is exact because products of two `f32` are.
pub(crate) fn edge_function(a: f32, b: f32, c: f32, d: f32) -> f32 {
    (f64::from(a) * f64::from(b) - f64::from(c) * f64::from(d)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn corners() -> [Vec3; 3] {
        [
            Vec3::new(0.0, 0.0, 5.0),
            Vec3::new(2.0, 0.0, 5.0),
            Vec3::new(0.0, 2.0, 7.0),
        ]
    }

    #[test]
    fn distance_and_weights_are_those_of_the_plane() {
        for sign in [1.0, -1.0] {
            let ray = Ray::new(
                Vec3::new(0.5, 0.5, 5.5 - 3.0 * sign),
                Vec3::new(0.0, 0.0, sign),
            );
            let hit = intersect(&ray, &RayShear::new(ray.direction), &corners());
            let (t, u, v) = hit.expect("the ray goes through the triangle");
            assert_relative_eq!(t, 3.0, epsilon = 1e-6);
            assert_relative_eq!(u, 0.25, epsilon = 1e-6);
            assert_relative_eq!(v, 0.25, epsilon = 1e-6);
        }
    }

    #[test]
    fn a_hit_at_the_start_does_not_count() {
        let ray = Ray::new(Vec3::zeros(), Vec3::new(0.1, 0.0, 5.0));
        let shear = RayShear::new(ray.direction);
        assert!(intersect(&ray, &shear, &corners()).is_some());
        let late = Ray { t_min: 1.0, ..ray };
        assert!(intersect(&late, &shear, &corners()).is_none());
    }

    #[test]
    fn a_triangle_without_area_is_never_met() {
        let ray = Ray::new(Vec3::zeros(), Vec3::z());
        let line = [
            Vec3::new(-1.0, 0.0, 3.0),
            Vec3::new(1.0, 0.0, 3.0),
            Vec3::new(0.0, 0.0, 3.0),
        ];
        assert!(intersect(&ray, &RayShear::new(ray.direction), &line).is_none());
    }
}
