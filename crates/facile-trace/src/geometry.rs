//! A mesh as the tracer keeps it: `f32`, checked once, with normals that follow its vertices.

use std::collections::BTreeMap;

use facile_core::{Mesh, Point3, Segment};

use crate::TraceError;
use crate::lanes::Eight;
use crate::math::{Vec3, unit_or, vec3_from_point};

/// Where shading normals come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normals {
    /// Every triangle is flat.
    Flat,
    /// Vertex normals, the mean of a vertex's triangles weighted by area.
    #[default]
    Smooth,
    /// As [`Normals::Smooth`], vertices at the same place counting as one: for meshes that are cut at texture seams.
    SmoothWelded,
}

/// Triangles with normals, texture coordinates, colours and segments.
#[derive(Clone, Debug)]
pub struct Geometry {
    pub(crate) positions: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Unit vertex normals; empty when flat.
    pub(crate) normals: Vec<Vec3>,
    /// Position and normal of each vertex side by side, as the kernels fetch them: six numbers and two idle ones.
    pub(crate) vertex_rows: Vec<Eight>,
    /// Texture coordinates of the corners of each triangle, six numbers and two idle ones; empty if there are none.
    pub(crate) texcoord_rows: Vec<Eight>,
    /// Linear RGB of the vertices; empty if there are none.
    pub(crate) colors: Vec<[f32; 3]>,
    /// Class of each triangle; empty if there are none.
    pub(crate) segments: Vec<Segment>,
    /// Representative of each vertex among those at the same place; empty without welding.
    weld: Vec<u32>,
    shading: Normals,
}

impl Geometry {
    /// Takes over a mesh, rounded to `f32`. A mesh without triangles is allowed and is never hit.
    ///
    /// # Errors
    /// [`TraceError::NotFinite`] and [`TraceError::OutOfRange`] with the first bad vertex or triangle,
    /// [`TraceError::SizeMismatch`] for lists of unequal length.
    pub fn new(mesh: &Mesh, shading: Normals) -> Result<Self, TraceError> {
        check_indices(mesh)?;
        let mut geometry = Self {
            positions: Vec::with_capacity(mesh.positions.len()),
            triangles: mesh.triangles.clone(),
            normals: Vec::new(),
            vertex_rows: Vec::new(),
            texcoord_rows: mesh
                .texcoord_triangles
                .iter()
                .map(|t| texcoord_row(t.map(|v| mesh.texcoords[v as usize])))
                .collect(),
            colors: mesh.colors.clone(),
            segments: mesh.segments.clone(),
            weld: Vec::new(),
            shading,
        };
        if shading == Normals::SmoothWelded {
            geometry.weld = weld_map(&mesh.positions);
        }
        geometry.take_positions(&mesh.positions)?;
        Ok(geometry)
    }

    /// Vertex positions, mm.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Vertex indices of the triangles.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Unit vertex normals; empty for flat shading.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Moves the vertices and brings the normals after them. Cost O(n).
    ///
    /// # Errors
    /// [`TraceError::SizeMismatch`] for another number of vertices, [`TraceError::NotFinite`] for a bad one; the
    /// geometry is then unchanged.
    pub(crate) fn set_positions(&mut self, positions: &[Point3]) -> Result<(), TraceError> {
        if positions.len() != self.positions.len() {
            return Err(TraceError::SizeMismatch {
                what: "vertices of a moved mesh",
                expected: self.positions.len(),
                got: positions.len(),
            });
        }
        self.take_positions(positions)
    }

    /// Takes given normals over the computed ones, until vertices move.
    pub(crate) fn set_normals(&mut self, normals: Vec<Vec3>) -> Result<(), TraceError> {
        if normals.len() != self.positions.len() {
            return Err(TraceError::SizeMismatch {
                what: "vertex normals",
                expected: self.positions.len(),
                got: normals.len(),
            });
        }
        let is_bad = |n: &Vec3| !n.iter().all(|v| v.is_finite());
        if let Some(index) = normals.iter().position(is_bad) {
            return Err(TraceError::NotFinite {
                what: "normal",
                index,
                value: format!("{:?}", normals[index].as_slice()),
            });
        }
        if self.normals.is_empty() {
            self.normals = vec![Vec3::y(); normals.len()];
        }
        for (own, given) in self.normals.iter_mut().zip(normals) {
            *own = unit_or(given, *own);
        }
        self.update_rows();
        Ok(())
    }

    fn take_positions(&mut self, positions: &[Point3]) -> Result<(), TraceError> {
        if let Some(index) = positions
            .iter()
            .position(|p| !p.iter().all(|v| (*v as f32).is_finite()))
        {
            return Err(TraceError::NotFinite {
                what: "vertex",
                index,
                value: positions[index].to_string(),
            });
        }
        self.positions.clear();
        self.positions.extend(positions.iter().map(vec3_from_point));
        if self.shading != Normals::Flat {
            self.update_normals();
        }
        self.update_rows();
        Ok(())
    }

    fn update_rows(&mut self) {
        let normals = self
            .normals
            .iter()
            .copied()
            .chain(std::iter::repeat(Vec3::zeros()));
        let rows = self.positions.iter().zip(normals);
        self.vertex_rows.clear();
        self.vertex_rows
            .extend(rows.map(|(p, n)| Eight([p.x, p.y, p.z, n.x, n.y, n.z, 0.0, 0.0])));
    }

    /// Texture coordinates of a triangle's corners, `None` if the mesh has none.
    pub(crate) fn texcoords(&self, triangle: u32) -> Option<[[f32; 2]; 3]> {
        let row = &self.texcoord_rows.get(triangle as usize)?.0;
        Some([[row[0], row[1]], [row[2], row[3]], [row[4], row[5]]])
    }

    fn update_normals(&mut self) {
        self.normals.clear();
        self.normals.resize(self.positions.len(), Vec3::zeros());
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|v| self.positions[v as usize]);
            let area_vector = (b - a).cross(&(c - a));
            for &v in triangle {
                let v = self.weld.get(v as usize).copied().unwrap_or(v);
                self.normals[v as usize] += area_vector;
            }
        }
        for v in 0..self.normals.len() {
            // Representatives come first in their group, so theirs is already normalised
            self.normals[v] = match self.weld.get(v) {
                Some(&first) if first as usize != v => self.normals[first as usize],
                _ => unit_or(self.normals[v], Vec3::y()),
            };
        }
    }

    pub(crate) fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Class of a triangle, [`Segment::Other`] if the mesh has none.
    pub fn segment(&self, triangle: u32) -> Segment {
        self.segments
            .get(triangle as usize)
            .copied()
            .unwrap_or(Segment::Other)
    }
}

fn texcoord_row([a, b, c]: [[f32; 2]; 3]) -> Eight {
    Eight([a[0], a[1], b[0], b[1], c[0], c[1], 0.0, 0.0])
}

fn check_indices(mesh: &Mesh) -> Result<(), TraceError> {
    let lists = [
        ("vertex index", &mesh.triangles, mesh.positions.len()),
        (
            "texture coordinate index",
            &mesh.texcoord_triangles,
            mesh.texcoords.len(),
        ),
    ];
    for (what, list, count) in lists {
        if let Some(&index) = list.iter().flatten().find(|v| **v as usize >= count) {
            let index = index as usize;
            return Err(TraceError::OutOfRange { what, index, count });
        }
    }
    let n = mesh.triangles.len();
    let counts = [
        (
            "texture coordinate triangles",
            mesh.texcoord_triangles.len(),
            n,
        ),
        ("triangle segments", mesh.segments.len(), n),
        ("vertex colours", mesh.colors.len(), mesh.positions.len()),
    ];
    match counts
        .into_iter()
        .find(|(_, got, expected)| *got != 0 && got != expected)
    {
        Some((what, got, expected)) => Err(TraceError::SizeMismatch {
            what,
            expected,
            got,
        }),
        None => Ok(()),
    }
}

/// The first vertex at the place of each vertex; equality is exact, `-0` equals `0`.
fn weld_map(positions: &[Point3]) -> Vec<u32> {
    let mut first = BTreeMap::new();
    positions
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let key: [u64; 3] = std::array::from_fn(|k| (p[k] + 0.0).to_bits());
            *first.entry(key).or_insert(i as u32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    /// Two triangles of a roof, its ridge doubled.
    fn roof() -> Mesh {
        let p = |x, y, z| Point3::new(x, y, z);
        Mesh {
            positions: vec![
                p(-1.0, 0.0, 0.0),
                p(0.0, 0.0, 1.0),
                p(0.0, 2.0, 1.0),
                p(0.0, 0.0, 1.0),
                p(1.0, 0.0, 0.0),
                p(-0.0, 2.0, 1.0),
            ],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            ..Mesh::default()
        }
    }

    #[test]
    fn welding_smooths_over_seams() {
        let welded = Geometry::new(&roof(), Normals::SmoothWelded).expect("valid");
        assert_relative_eq!(welded.normals()[1], Vec3::z(), epsilon = 1e-6);
        assert_eq!(welded.normals()[1], welded.normals()[3]);
        assert_eq!(welded.normals()[2], welded.normals()[5]);
        let plain = Geometry::new(&roof(), Normals::Smooth).expect("valid");
        assert!(plain.normals()[1].x < -0.5 && plain.normals()[3].x > 0.5);
        assert!(
            Geometry::new(&roof(), Normals::Flat)
                .expect("valid")
                .normals()
                .is_empty()
        );
    }

    #[test]
    fn bad_meshes_are_named() {
        let mut mesh = roof();
        mesh.positions[4].y = f64::NAN;
        let error = Geometry::new(&mesh, Normals::Flat)
            .expect_err("NaN")
            .to_string();
        assert!(
            error.starts_with("vertex 4: coordinates must be finite"),
            "{error}"
        );
        mesh.positions[4].y = 1e300;
        assert!(
            Geometry::new(&mesh, Normals::Flat).is_err(),
            "too large for f32"
        );
        let mut mesh = roof();
        mesh.triangles[1][2] = 77;
        assert!(Geometry::new(&mesh, Normals::Flat).is_err());
        let mut mesh = roof();
        mesh.segments = vec![Segment::Skin];
        assert!(Geometry::new(&mesh, Normals::Flat).is_err());
    }

    #[test]
    fn moved_vertices_are_checked() {
        let mut geometry = Geometry::new(&roof(), Normals::Smooth).expect("valid");
        let before = geometry.clone();
        assert!(geometry.set_positions(&[Point3::origin()]).is_err());
        let mut moved = roof().positions;
        moved[0].x = f64::INFINITY;
        assert!(geometry.set_positions(&moved).is_err());
        assert_eq!(geometry.positions(), before.positions());
    }
}
