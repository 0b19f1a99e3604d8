//! Nearest points of a surface; the only file that speaks parry and glam.

use facile_core::{Mesh, Point3, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQueryWithLocation;
use parry3d_f64::shape::TriMesh;

/// A point found on a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nearest {
    /// Where it is, mm.
    pub(crate) point: Point3,
    /// Its triangle.
    pub(crate) triangle: u32,
    /// Weights of the triangle's corners.
    pub(crate) barycentric: [f64; 3],
}

/// A triangle mesh prepared for nearest-point queries.
pub(crate) struct Surface {
    shape: TriMesh,
    normals: Vec<Vector3>,
}

impl Surface {
    /// Prepares `mesh`, whose vertices have unit `normals`. `None` if it has no triangles. Cost O(n log n).
    pub(crate) fn new(mesh: &Mesh, normals: Vec<Vector3>) -> Option<Self> {
        let points: Vec<Vector> = mesh
            .positions
            .iter()
            .map(|p| Vector::new(p.x, p.y, p.z))
            .collect();
        let shape = TriMesh::new(points, mesh.triangles.clone()).ok()?;
        Some(Self { shape, normals })
    }

    /// The point nearest to `p` within `max_distance` mm. Cost O(log n).
    pub(crate) fn nearest(&self, p: &Point3, max_distance: f64) -> Option<Nearest> {
        let query = Vector::new(p.x, p.y, p.z);
        let (projection, (triangle, location)) = self
            .shape
            .project_local_point_and_get_location_with_max_dist(query, false, max_distance)?;
        let at = projection.point;
        Some(Nearest {
            point: Point3::new(at.x, at.y, at.z),
            triangle,
            barycentric: location
                .barycentric_coordinates()
                .unwrap_or([1.0, 0.0, 0.0]),
        })
    }

    /// Unit normal at a point of the surface, interpolated between vertices.
    pub(crate) fn normal(&self, at: &Nearest) -> Vector3 {
        let corners = self.shape.indices()[at.triangle as usize];
        let sum = (0..3).fold(Vector3::zeros(), |s, k| {
            s + self.normals[corners[k] as usize] * at.barycentric[k]
        });
        sum.try_normalize(1e-12)
            .unwrap_or(self.normals[corners[0] as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_is_found_and_far_ones_are_not() {
        let mesh = Mesh {
            positions: vec![
                Point3::origin(),
                Point3::new(4.0, 0.0, 0.0),
                Point3::new(0.0, 4.0, 0.0),
            ],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let surface = Surface::new(&mesh, mesh.vertex_normals()).expect("triangles");
        let hit = surface
            .nearest(&Point3::new(1.0, 1.0, 2.0), 3.0)
            .expect("within 3 mm");
        assert!((hit.point - Point3::new(1.0, 1.0, 0.0)).norm() < 1e-12);
        assert_eq!(surface.normal(&hit), Vector3::z());
        assert!(surface.nearest(&Point3::new(1.0, 1.0, 2.0), 1.0).is_none());
    }
}
