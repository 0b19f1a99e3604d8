//! Splits polygons into triangles.

use crate::{Point3, Vector3};

/// Polygons with more corners than this are fanned without looking at their shape, which costs O(n^2).
const MAX_CLIPPED: usize = 2_000;

/// Appends the triangles of a polygon, as indices into `points`, with the polygon's orientation: `n - 2` of them.
///
/// Convex polygons become fans from the first corner. Others lose one ear at a time, in the plane of the mean normal; a
/// polygon that crosses itself, or has no area, is fanned.
///
/// Source of the ear test: Meisters, Polygons have ears, 1975.
pub(crate) fn triangulate(points: &[Point3], triangles: &mut Vec<[u32; 3]>) {
    let n = points.len() as u32;
    match points {
        [] | [_] | [_, _] => {}
        [_, _, _] => triangles.push([0, 1, 2]),
        _ if points.len() > MAX_CLIPPED || is_fan(points, newell_normal(points)) => {
            triangles.extend((1..n - 1).map(|k| [0, k, k + 1]));
        }
        _ => clip_ears(points, triangles),
    }
}

/// Twice the area vector of a polygon. Source: Newell's method, Sutherland et al. 1974.
fn newell_normal(points: &[Point3]) -> Vector3 {
    let origin = points[0];
    (1..points.len() - 1)
        .map(|k| (points[k] - origin).cross(&(points[k + 1] - origin)))
        .sum()
}

fn is_fan(points: &[Point3], normal: Vector3) -> bool {
    (1..points.len() - 1).all(|k| {
        let [a, b, c] = [points[0], points[k], points[k + 1]];
        (b - a).cross(&(c - a)).dot(&normal) >= 0.0
    })
}

fn clip_ears(points: &[Point3], triangles: &mut Vec<[u32; 3]>) {
    let normal = newell_normal(points);
    let turn = |a: u32, b: u32, c: u32| {
        let [a, b, c] = [a, b, c].map(|i| points[i as usize]);
        (b - a).cross(&(c - a)).dot(&normal)
    };
    let mut left: Vec<u32> = (0..points.len() as u32).collect();
    while left.len() > 3 {
        let n = left.len();
        let ear = (0..n).find(|&k| {
            let [a, b, c] = [left[(k + n - 1) % n], left[k], left[(k + 1) % n]];
            turn(a, b, c) > 0.0
                && !left.iter().any(|&p| {
                    p != a
                        && p != b
                        && p != c
                        && turn(a, b, p) >= 0.0
                        && turn(b, c, p) >= 0.0
                        && turn(c, a, p) >= 0.0
                })
        });
        let Some(k) = ear else {
            triangles.extend((1..n - 1).map(|k| [left[0], left[k], left[k + 1]]));
            return;
        };
        triangles.push([left[(k + n - 1) % n], left[k], left[(k + 1) % n]]);
        left.remove(k);
    }
    triangles.push([left[0], left[1], left[2]]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(xy: &[[f64; 2]]) -> Vec<Point3> {
        xy.iter()
            .map(|&[x, y]| Point3::new(x, y, 0.3 * x))
            .collect()
    }

    fn area(points: &[Point3], triangles: &[[u32; 3]]) -> (f64, bool) {
        let mut sum = Vector3::zeros();
        let mut one_way = true;
        for t in triangles {
            let [a, b, c] = t.map(|i| points[i as usize]);
            let area = (b - a).cross(&(c - a)) / 2.0;
            one_way &= area.z > 0.0;
            sum += area;
        }
        (sum.z, one_way)
    }

    #[test]
    fn a_concave_quad_is_cut_at_its_inner_corner() {
        for shift in 0..4 {
            let mut arrow = [[0.0, 0.0], [4.0, -4.0], [1.0, 0.0], [4.0, 4.0]];
            arrow.rotate_left(shift);
            let points = points(&arrow);
            let mut triangles = Vec::new();
            triangulate(&points, &mut triangles);
            assert_eq!(triangles.len(), 2);
            let (area, one_way) = area(&points, &triangles);
            assert!(one_way, "shift {shift}: {triangles:?}");
            assert!((area - 4.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_comb_keeps_its_area() {
        let comb = [
            [0.0, 0.0],
            [6.0, 0.0],
            [6.0, 5.0],
            [5.0, 1.0],
            [4.0, 5.0],
            [3.0, 1.0],
            [2.0, 5.0],
            [1.0, 1.0],
            [0.0, 5.0],
        ];
        let points = points(&comb);
        let mut triangles = Vec::new();
        triangulate(&points, &mut triangles);
        let (area, one_way) = area(&points, &triangles);
        assert_eq!(triangles.len(), 7);
        assert!(one_way);
        assert!((area - 18.0).abs() < 1e-12, "{area}");
    }

    proptest! {
        #[test]
        fn any_corners_give_n_minus_2_triangles(corners in prop::collection::vec(
            prop::array::uniform3(-1e6_f64..1e6), 0..40)) {
            let points: Vec<Point3> = corners.iter().map(|c| Point3::from(*c)).collect();
            let mut triangles = Vec::new();
            triangulate(&points, &mut triangles);
            prop_assert_eq!(triangles.len(), points.len().saturating_sub(2));
        }
    }
}
