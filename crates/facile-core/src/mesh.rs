//! Triangle meshes with texture coordinates, colours and segment labels.

use std::path::Path;

use crate::{CoreError, Point3, Segment, Vector3};

/// A triangle mesh. Positions and texture coordinates are indexed apart, so that a texture seam does not cut the
/// surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, mm.
    pub positions: Vec<Point3>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates, `(0, 0)` at the lower left corner of the texture.
    pub texcoords: Vec<[f32; 2]>,
    /// Texture coordinate indices of each triangle; empty if the mesh has none.
    pub texcoord_triangles: Vec<[u32; 3]>,
    /// Linear RGB of each vertex; empty if the mesh has none.
    pub colors: Vec<[f32; 3]>,
    /// Class of each triangle; empty if the mesh has none.
    pub segments: Vec<Segment>,
}

impl Mesh {
    /// Checks every rule a mesh must follow; `path` names it in errors.
    ///
    /// # Errors
    /// [`CoreError::Mesh`] with the first element that breaks a rule, [`CoreError::SizeMismatch`] for lists of unequal
    /// length.
    pub fn validate(&self, path: &Path) -> Result<(), CoreError> {
        let bad = |element, index, reason| {
            Err(CoreError::Mesh {
                path: path.to_owned(),
                element,
                index,
                reason,
            })
        };
        if self.triangles.is_empty() {
            return bad("triangle", 0, "the mesh has no triangles".to_owned());
        }
        if let Some(i) = self
            .positions
            .iter()
            .position(|p| !p.coords.iter().all(|v| v.is_finite()))
        {
            return bad(
                "vertex",
                i,
                format!("coordinates must be finite, found {}", self.positions[i]),
            );
        }
        let out_of_range = |triangles: &[[u32; 3]], n: usize| {
            triangles
                .iter()
                .position(|t| t.iter().any(|&v| v as usize >= n))
        };
        if let Some(i) = out_of_range(&self.triangles, self.positions.len()) {
            let n = self.positions.len();
            return bad(
                "triangle",
                i,
                format!("vertex indices {:?} must be below {n}", self.triangles[i]),
            );
        }
        if let Some(i) = out_of_range(&self.texcoord_triangles, self.texcoords.len()) {
            let (t, n) = (self.texcoord_triangles[i], self.texcoords.len());
            return bad(
                "triangle",
                i,
                format!("texture coordinate indices {t:?} must be below {n}"),
            );
        }
        let counts = [
            (
                "texture coordinate triangles",
                self.texcoord_triangles.len(),
                self.triangles.len(),
            ),
            ("vertex colours", self.colors.len(), self.positions.len()),
            (
                "triangle segments",
                self.segments.len(),
                self.triangles.len(),
            ),
        ];
        for (what, got, expected) in counts {
            if got != 0 && got != expected {
                return Err(CoreError::SizeMismatch {
                    what,
                    expected,
                    got,
                });
            }
        }
        Ok(())
    }

    /// The corners of triangle `t`, mm.
    pub fn corners(&self, t: usize) -> [Point3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize])
    }

    /// Unit normals of the vertices, weighted by triangle area.
    pub fn vertex_normals(&self) -> Vec<Vector3> {
        vertex_normals(&self.positions, &self.triangles)
    }

    /// Smallest and largest corner of the box around all vertices, mm. `None` for an empty mesh.
    pub fn bounds(&self) -> Option<(Point3, Point3)> {
        let first = *self.positions.first()?;
        Some(
            self.positions
                .iter()
                .fold((first, first), |(low, high), p| (low.inf(p), high.sup(p))),
        )
    }
}

/// Unit normals of vertices, each the mean of its triangles' normals weighted by area; `+y` where the sum vanishes.
pub fn vertex_normals(positions: &[Point3], triangles: &[[u32; 3]]) -> Vec<Vector3> {
    let mut normals = vec![Vector3::zeros(); positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| positions[v as usize]);
        let area_vector = (b - a).cross(&(c - a));
        for &v in triangle {
            normals[v as usize] += area_vector;
        }
    }
    for normal in &mut normals {
        *normal = normal.try_normalize(1e-300).unwrap_or_else(Vector3::y);
    }
    normals
}

/// Point of triangle `abc` nearest to `p`, as barycentric weights of `a`, `b`, `c`.
///
/// Source: Ericson, Real-Time Collision Detection, 5.1.5. Degenerate triangles give the nearest corner or edge point.
pub fn closest_barycentric(p: &Point3, [a, b, c]: &[Point3; 3]) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn triangle() -> Mesh {
        Mesh {
            positions: vec![
                Point3::origin(),
                Point3::new(2.0, 0.0, 0.0),
                Point3::new(0.0, 2.0, 0.0),
            ],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        }
    }

    #[test]
    fn normals_point_outside() {
        assert_eq!(triangle().vertex_normals(), vec![Vector3::z(); 3]);
    }

    #[test]
    fn the_closest_point_lies_in_the_right_region() {
        let corners = triangle().corners(0);
        let at = |x, y| {
            let w = closest_barycentric(&Point3::new(x, y, 3.0), &corners);
            Point3::from(
                corners[0].coords * w[0] + corners[1].coords * w[1] + corners[2].coords * w[2],
            )
        };
        assert_relative_eq!(at(0.5, 0.5), Point3::new(0.5, 0.5, 0.0));
        assert_relative_eq!(at(-1.0, 0.5), Point3::new(0.0, 0.5, 0.0));
        assert_relative_eq!(at(2.0, 2.0), Point3::new(1.0, 1.0, 0.0));
        assert_relative_eq!(at(-1.0, -1.0), Point3::origin());
    }

    #[test]
    fn broken_rules_are_named() {
        let path = Path::new("a.ply");
        let mut mesh = triangle();
        assert!(mesh.validate(path).is_ok());
        mesh.triangles.push([0, 1, 9]);
        assert_eq!(
            mesh.validate(path).expect_err("index").to_string(),
            "a.ply: triangle 1: vertex indices [0, 1, 9] must be below 3"
        );
        mesh.positions[1].y = f64::NAN;
        assert!(
            mesh.validate(path)
                .expect_err("NaN")
                .to_string()
                .starts_with("a.ply: vertex 1: ")
        );
    }
}
