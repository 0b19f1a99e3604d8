//! Exact distances for the certificate: how deep a point lies below skull or eyeball.
//!
//! The solvers measure gaps along the radius, times the slope at rest. The certificate asks the surface itself, in the
//! frame of the piece below the node: the part of it that can hold the nearest point is drawn as triangles, and `parry`
//! finds that point. Surfaces are the ones nodes are kept off: the skull's field, shifted along the radius to where the
//! fascia rests on it, and the sphere around an eyeball. This file alone speaks `parry`.

use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery as _;
use parry3d_f64::shape::{Ball, Triangle};

use crate::skull::HeightField;
use crate::vector::V3;

/// Least half width of the surface that is drawn, mm.
const MIN_REACH_MM: f64 = 0.02;
/// Squares of the drawn surface along each side.
const SQUARES: usize = 2;

fn vector(p: V3) -> Vector {
    Vector::new(p[0], p[1], p[2])
}

/// Distance of a point below the surface `offset` mm outside of the field, mm; 0 for a point on or above it. Exact to
/// the curvature within a quarter of the depth: a point 1 mm deep is off by 0.02 mm, one 0.02 mm deep by 1e-5 mm.
pub(crate) fn below_field(field: &HeightField, offset: f64, point: V3) -> f64 {
    let radius = point[0].hypot(point[2]);
    let gap = field.gap(point).0 - offset;
    if gap >= 0.0 {
        return 0.0;
    }
    // The nearest point is no farther away than the one along the radius.
    let reach = (-gap).max(MIN_REACH_MM);
    let phi = libm::atan2(point[0], point[2]);
    let turn = reach / radius.max(reach);
    let at = |k: usize| 2.0 * k as f64 / SQUARES as f64 - 1.0;
    let corner = |i: usize, j: usize| {
        let (h, phi) = (point[1] + reach * at(i), phi + turn * at(j));
        let r = field.at(h, libm::sin(0.5 * phi)).radius + offset;
        Vector::new(r * libm::sin(phi), h, r * libm::cos(phi))
    };
    let point = vector(point);
    let mut nearest = -gap;
    for i in 0..SQUARES {
        for j in 0..SQUARES {
            let [a, b, c, d] = [
                corner(i, j),
                corner(i, j + 1),
                corner(i + 1, j + 1),
                corner(i + 1, j),
            ];
            for triangle in [Triangle::new(a, b, c), Triangle::new(a, c, d)] {
                nearest = nearest.min(triangle.distance_to_local_point(point, true));
            }
        }
    }
    nearest
}

/// Distance of a point inside a ball of this radius around the origin from its surface, mm; 0 outside.
pub(crate) fn inside_ball(radius: f64, point: V3) -> f64 {
    (-Ball::new(radius).distance_to_local_point(vector(point), false)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skull::test_patch;

    /// The whole field, a triangle every 0.4 mm.
    fn drawn(field: &HeightField, offset: f64) -> Vec<Triangle> {
        let corner = |i: i32, j: i32| {
            let (h, phi) = (f64::from(i) * 0.4 - 30.0, f64::from(j) * 0.005 - 0.5);
            let r = field.at(h, libm::sin(0.5 * phi)).radius + offset;
            Vector::new(r * libm::sin(phi), h, r * libm::cos(phi))
        };
        let squares = (0..150).flat_map(|i| (0..200).map(move |j| (i, j)));
        squares
            .flat_map(|(i, j)| {
                let [a, b] = [corner(i, j), corner(i, j + 1)];
                let [c, d] = [corner(i + 1, j + 1), corner(i + 1, j)];
                [Triangle::new(a, b, c), Triangle::new(a, c, d)]
            })
            .collect()
    }

    #[test]
    fn the_drawn_part_of_the_surface_holds_the_nearest_point_of_the_whole() {
        let field = test_patch();
        for offset in [0.0, 0.3] {
            let whole = drawn(&field, offset);
            for k in 0..40 {
                let t = f64::from(k);
                let (h, phi) = (20.0 * libm::sin(2.1 * t), 0.3 * libm::sin(1.3 * t));
                let depth = 0.6 * libm::sin(0.7 * t);
                let r = field.at(h, libm::sin(0.5 * phi)).radius + offset - depth;
                let point = [r * libm::sin(phi), h, r * libm::cos(phi)];
                let away = |t: &Triangle| t.distance_to_local_point(vector(point), true);
                let truth = whole.iter().map(away).fold(f64::INFINITY, f64::min);
                let found = below_field(&field, offset, point);
                if depth <= 0.0 {
                    assert!(found.abs() < 1e-12, "{found}");
                } else {
                    assert!((found - truth).abs() < 2e-3, "{found} {truth}");
                    assert!(found <= depth + 1e-12 && found > 0.5 * depth);
                }
            }
        }
    }

    #[test]
    fn a_point_in_a_ball_is_as_deep_as_its_radius_lacks() {
        assert!((inside_ball(12.0, [0.0, 3.0, -4.0]) - 7.0).abs() < 1e-12);
        assert!(inside_ball(12.0, [0.0, 12.1, 0.0]).abs() < 1e-12);
    }
}
