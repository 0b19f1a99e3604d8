//! What every reader delivers before validation: a mesh, its materials, its groups. [`Draft::finish`] makes it a scan.

use std::path::Path;

use super::atlas::{self, Painted};
use super::picture::load_texture;
use super::{MAX_COORDINATE, MAX_ELEMENTS, Scan};
use crate::{CoreError, Mesh, Segment, Texture};

/// How a material colours its triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Paint {
    /// By a texture of the draft, times a linear colour.
    Image { texture: usize, factor: [f32; 3] },
    /// By one linear colour that the file states.
    Color([f32; 3]),
    /// Not at all: the file says nothing.
    Unknown,
}

/// The linear colour of triangles without any, where others have some: an 18 % grey.
pub(crate) const NO_COLOR: [f32; 3] = [0.18; 3];

/// An unvalidated scan.
#[derive(Clone, Debug, Default)]
pub(crate) struct Draft {
    /// Surface; `texcoord_triangles` is empty if no triangle has texture coordinates.
    pub(crate) mesh: Mesh,
    /// Index in `materials` of each triangle; empty means none is known.
    pub(crate) triangle_materials: Vec<u32>,
    pub(crate) materials: Vec<Paint>,
    pub(crate) textures: Vec<Texture>,
    pub(crate) groups: Vec<String>,
    /// Index in `groups` of each triangle, or empty.
    pub(crate) triangle_groups: Vec<u32>,
    pub(crate) notices: Vec<String>,
}

impl Draft {
    /// Validates, merges textures, names segments.
    pub(crate) fn finish(
        mut self,
        path: &Path,
        texture_override: Option<&Path>,
    ) -> Result<Scan, CoreError> {
        check_counts(&self.mesh, path)?;
        check_texcoords(&self.mesh, path)?;
        self.drop_degenerate();
        if let Some(image) = texture_override {
            self.paint_all(image, path)?;
        }
        self.mesh.segments = self.segments();
        let Painted { texture, notices } = atlas::paint(
            &mut self.mesh,
            &self.triangle_materials,
            &self.materials,
            self.textures,
        );
        self.notices.extend(notices);
        if texture.is_some() {
            self.mesh.colors.clear();
        } else {
            self.mesh.texcoords.clear();
            self.mesh.texcoord_triangles.clear();
            if self.mesh.colors.is_empty() {
                self.notices
                    .push("the scan has neither a texture nor vertex colours".to_owned());
            }
        }
        self.mesh.validate(path)?;
        check_extent(&self.mesh, path)?;
        Ok(Scan {
            name: path
                .file_stem()
                .map(|s| s.to_string_lossy().into_owned())
                .unwrap_or_default(),
            path: path.to_owned(),
            mesh: self.mesh,
            texture,
            groups: self.groups,
            triangle_groups: self.triangle_groups,
            notices: self.notices,
        })
    }

    /// Drops triangles that name a vertex twice: they have no area and no normal.
    fn drop_degenerate(&mut self) {
        let keep: Vec<bool> = self
            .mesh
            .triangles
            .iter()
            .map(|[a, b, c]| a != b && b != c && c != a)
            .collect();
        let dropped = keep.iter().filter(|k| !**k).count();
        if dropped == 0 {
            return;
        }
        retain(&mut self.mesh.triangles, &keep);
        retain(&mut self.mesh.texcoord_triangles, &keep);
        retain(&mut self.triangle_materials, &keep);
        retain(&mut self.triangle_groups, &keep);
        self.notices.push(format!(
            "{dropped} triangles that name a vertex twice were left out"
        ));
    }

    /// Makes one image the texture of everything.
    fn paint_all(&mut self, image: &Path, path: &Path) -> Result<(), CoreError> {
        if self.mesh.texcoord_triangles.is_empty() {
            let reason = format!(
                "has no texture coordinates, so that the texture {} cannot be put on it",
                image.display()
            );
            return Err(CoreError::format(path, None, reason));
        }
        self.textures = vec![load_texture(image)?];
        self.materials = vec![Paint::Image {
            texture: 0,
            factor: [1.0; 3],
        }];
        self.triangle_materials = vec![0; self.mesh.triangles.len()];
        Ok(())
    }

    /// The class of each triangle, if any group bears the name of a class.
    fn segments(&self) -> Vec<Segment> {
        let classes: Vec<Option<Segment>> = self
            .groups
            .iter()
            .map(|name| Segment::ALL.iter().copied().find(|s| s.name() == name))
            .collect();
        if classes.iter().all(Option::is_none) {
            return Vec::new();
        }
        self.triangle_groups
            .iter()
            .map(|&g| {
                let class = classes.get(g as usize).copied().flatten();
                class.unwrap_or(Segment::Other)
            })
            .collect()
    }
}

/// Keeps the elements whose flag is set; an empty list stays empty.
fn retain<T>(list: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    list.retain(|_| keep.next().copied().unwrap_or(true));
}

/// Checks that the lists fit the limits of a scan.
pub(crate) fn check_counts(mesh: &Mesh, path: &Path) -> Result<(), CoreError> {
    let counts = [
        ("vertices", mesh.positions.len()),
        ("triangles", mesh.triangles.len()),
        ("texture coordinates", mesh.texcoords.len()),
    ];
    for (what, count) in counts {
        check_count(what, count, path)?;
    }
    Ok(())
}

/// Checks a count that a file states or that reading it has reached.
pub(crate) fn check_count(what: &str, count: usize, path: &Path) -> Result<(), CoreError> {
    if count > MAX_ELEMENTS {
        let reason = format!("has {count} {what}; the limit is {MAX_ELEMENTS}");
        return Err(CoreError::format(path, None, reason));
    }
    Ok(())
}

fn check_texcoords(mesh: &Mesh, path: &Path) -> Result<(), CoreError> {
    let broken = |uv: &[f32; 2]| !(uv[0].is_finite() && uv[1].is_finite());
    match mesh.texcoords.iter().position(broken) {
        None => {}
        Some(index) => {
            return Err(CoreError::Mesh {
                path: path.to_owned(),
                element: "texture coordinate",
                index,
                reason: format!("must be finite, found {:?}", mesh.texcoords[index]),
            });
        }
    }
    Ok(())
}

fn check_extent(mesh: &Mesh, path: &Path) -> Result<(), CoreError> {
    let far = |p: &crate::Point3| p.coords.amax() > MAX_COORDINATE;
    if let Some(index) = mesh.positions.iter().position(far) {
        let reason = format!(
            "coordinates must be within {MAX_COORDINATE:e} of the origin, found {}",
            mesh.positions[index]
        );
        return Err(CoreError::Mesh {
            path: path.to_owned(),
            element: "vertex",
            index,
            reason,
        });
    }
    let is_point = mesh.bounds().is_some_and(|(low, high)| low == high);
    if is_point {
        let reason = "all vertices lie at one point";
        return Err(CoreError::format(path, None, reason));
    }
    Ok(())
}
