//! Landmarks as points fixed to the reference topology: they move with any subject and any expression.

use crate::mesh::closest_barycentric;
use crate::{Mesh, Point3, Segment};

/// A point of a triangle mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// The triangle.
    pub triangle: u32,
    /// Weights of its corners; they sum to 1.
    pub barycentric: [f64; 3],
}

impl SurfacePoint {
    /// The point on a mesh with these vertex positions.
    pub fn position(&self, positions: &[Point3], triangles: &[[u32; 3]]) -> Point3 {
        let corners = triangles[self.triangle as usize].map(|v| positions[v as usize].coords);
        let [a, b, c] = self.barycentric;
        Point3::from(corners[0] * a + corners[1] * b + corners[2] * c)
    }

    /// The point of `mesh` nearest to `target` among triangles whose class passes `keep`. `None` if none passes.
    /// Cost O(triangles).
    pub fn nearest(mesh: &Mesh, target: &Point3, keep: impl Fn(Segment) -> bool) -> Option<Self> {
        let mut best: Option<(f64, Self)> = None;
        for t in 0..mesh.triangles.len() {
            if mesh.segments.get(t).is_some_and(|s| !keep(*s)) {
                continue;
            }
            let corners = mesh.corners(t);
            let barycentric = closest_barycentric(target, &corners);
            let point = Self {
                triangle: t as u32,
                barycentric,
            };
            let distance =
                (point.position(&mesh.positions, &mesh.triangles) - target).norm_squared();
            if best.is_none_or(|(d, _)| distance < d) {
                best = Some((distance, point));
            }
        }
        best.map(|(_, point)| point)
    }
}

/// A named, ordered list of landmarks, such as `ibug68`.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkScheme {
    /// The scheme's name in recipes and annotations.
    pub name: String,
    /// The landmarks on the fine reference mesh, in the scheme's order.
    pub points: Vec<SurfacePoint>,
}

impl LandmarkScheme {
    /// All landmarks on a head with these fine vertex positions, mm.
    pub fn positions(&self, positions: &[Point3], triangles: &[[u32; 3]]) -> Vec<Point3> {
        self.points
            .iter()
            .map(|p| p.position(positions, triangles))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_respects_the_filter() {
        let mesh = Mesh {
            positions: vec![
                Point3::origin(),
                Point3::new(1.0, 0.0, 0.0),
                Point3::new(0.0, 1.0, 0.0),
                Point3::new(0.0, 0.0, 9.0),
                Point3::new(1.0, 0.0, 9.0),
                Point3::new(0.0, 1.0, 9.0),
            ],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            segments: vec![Segment::InnerMouth, Segment::Skin],
            ..Mesh::default()
        };
        let target = Point3::new(0.2, 0.2, 1.0);
        let at = |keep: fn(Segment) -> bool| {
            SurfacePoint::nearest(&mesh, &target, keep).map(|p| p.triangle)
        };
        assert_eq!(at(|_| true), Some(0));
        assert_eq!(at(|s| s == Segment::Skin), Some(1));
        assert_eq!(at(|s| s == Segment::Nose), None);
    }
}
