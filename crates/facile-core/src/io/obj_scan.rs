//! OBJ files as scans: polygons split, material libraries and textures found.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::draft::{Draft, Paint, check_count};
use super::folder::{Folder, shown};
use super::mtl::{self, Material};
use super::obj::{NO_TEXCOORD, ObjFile};
use super::picture::load_texture;
use super::polygon::triangulate;
use super::read_file;
use crate::color::linear_from_srgb;
use crate::{CoreError, Mesh, Point3};

/// Reads an OBJ file with its libraries; with an overriding texture those are not looked for.
pub(crate) fn read(
    bytes: &[u8],
    path: &Path,
    folder: &Folder,
    texture_override: Option<&Path>,
) -> Result<Draft, CoreError> {
    let mut obj = ObjFile::parse(bytes, path)?;
    let mut draft = Draft {
        groups: std::mem::take(&mut obj.groups),
        ..Draft::default()
    };
    draft.mesh.colors = linear_colors(std::mem::take(&mut obj.colors), &mut draft.notices);
    split(&obj, path, &mut draft)?;
    draft.mesh.positions = std::mem::take(&mut obj.positions);
    if !draft.mesh.texcoord_triangles.is_empty() {
        draft.mesh.texcoords = std::mem::take(&mut obj.texcoords);
    }
    if texture_override.is_none() {
        let mut painter = Painter {
            path,
            folder,
            draft: &mut draft,
            loaded: HashMap::new(),
            missing: Vec::new(),
        };
        painter.paint(&obj)?;
    }
    Ok(draft)
}

/// sRGB colours in `[0, 1]`, or in `[0, 255]` as some programs write them, to linear light.
fn linear_colors(mut colors: Vec<[f32; 3]>, notices: &mut Vec<String>) -> Vec<[f32; 3]> {
    let largest = colors.as_flattened().iter().copied().fold(0.0, f32::max);
    let scale = if largest > 1.0 {
        notices.push("vertex colours above 1 were taken as 0 to 255".to_owned());
        1.0 / 255.0
    } else {
        1.0
    };
    for value in colors.as_flattened_mut() {
        *value = linear_from_srgb(f64::from((*value * scale).clamp(0.0, 1.0))) as f32;
    }
    colors
}

/// Splits polygons into triangles with their texture coordinates, materials and groups.
fn split(obj: &ObjFile, path: &Path, draft: &mut Draft) -> Result<(), CoreError> {
    let count = obj.corners.len() - 2 * obj.polygons.len();
    check_count("triangles", count, path)?;
    let has_texcoords = obj.corners.iter().any(|c| c[1] != NO_TEXCOORD);
    let has_groups = obj.polygons.iter().any(|p| p.group.is_some());
    let has_materials = obj.polygons.iter().any(|p| p.material.is_some());
    // Polygons before the first `g` belong to an unnamed group.
    let no_group = draft.groups.len() as u32;
    if has_groups && obj.polygons.iter().any(|p| p.group.is_none()) {
        draft.groups.push(String::new());
    }
    let Mesh {
        triangles,
        texcoord_triangles,
        ..
    } = &mut draft.mesh;
    triangles.reserve(count);
    let mut points: Vec<Point3> = Vec::new();
    let mut local: Vec<[u32; 3]> = Vec::new();
    for polygon in &obj.polygons {
        let corners = obj.corners_of(polygon);
        local.clear();
        if corners.len() == 3 {
            local.push([0, 1, 2]);
        } else {
            points.clear();
            points.extend(corners.iter().map(|c| obj.positions[c[0] as usize]));
            triangulate(&points, &mut local);
        }
        let n = local.len();
        triangles.extend(local.iter().map(|t| t.map(|k| corners[k as usize][0])));
        if has_texcoords {
            let complete = corners.iter().all(|c| c[1] != NO_TEXCOORD);
            let at = |k: u32| {
                if complete {
                    corners[k as usize][1]
                } else {
                    NO_TEXCOORD
                }
            };
            texcoord_triangles.extend(local.iter().map(|t| t.map(at)));
        }
        if has_groups {
            let group = polygon.group.unwrap_or(no_group);
            draft.triangle_groups.extend(std::iter::repeat_n(group, n));
        }
        if has_materials {
            let material = polygon.material.unwrap_or(u32::MAX);
            draft
                .triangle_materials
                .extend(std::iter::repeat_n(material, n));
        }
    }
    Ok(())
}

/// Finds the textures of a file.
struct Painter<'a> {
    path: &'a Path,
    folder: &'a Folder,
    draft: &'a mut Draft,
    loaded: HashMap<PathBuf, usize>,
    missing: Vec<String>,
}

impl Painter<'_> {
    fn paint(&mut self, obj: &ObjFile) -> Result<(), CoreError> {
        let libraries = self.libraries(obj)?;
        let is_used = self.used_materials(obj);
        self.draft.materials = vec![Paint::Unknown; obj.materials.len()];
        for (i, name) in obj.materials.iter().enumerate() {
            let known = libraries
                .iter()
                .flat_map(|(file, materials)| materials.iter().map(move |m| (file, m)))
                .find(|(_, m)| m.name == *name);
            match known {
                Some((file, material)) if is_used[i] => {
                    self.draft.materials[i] = self.paint_of(file, material)?;
                }
                None if is_used[i] && !libraries.is_empty() => {
                    let name = shown(name);
                    let notice = format!("no material library describes the material `{name}`");
                    self.draft.notices.push(notice);
                }
                _ => {}
            }
        }
        let has_image = |p: &Paint| matches!(p, Paint::Image { .. });
        if self.draft.materials.iter().any(has_image) || self.draft.mesh.texcoords.is_empty() {
            self.report_missing();
            return Ok(());
        }
        self.fall_back(&libraries)
    }

    /// Whether a triangle has each material.
    fn used_materials(&self, obj: &ObjFile) -> Vec<bool> {
        let mut used = vec![false; obj.materials.len()];
        for &m in &self.draft.triangle_materials {
            if let Some(u) = used.get_mut(m as usize) {
                *u = true;
            }
        }
        used
    }

    fn libraries(&mut self, obj: &ObjFile) -> Result<Vec<(PathBuf, Vec<Material>)>, CoreError> {
        let mut libraries = Vec::new();
        for reference in &obj.material_libraries {
            let place = || Some("mtllib".to_owned());
            let notices = &mut self.draft.notices;
            let whole = self
                .folder
                .require_inside(reference, self.path, place(), notices)?;
            // A name may hold spaces, or be a list of names.
            let found = if let Some(file) = whole {
                vec![file]
            } else {
                let mut files = Vec::new();
                for word in reference.split_ascii_whitespace() {
                    match self
                        .folder
                        .require_inside(word, self.path, place(), notices)?
                    {
                        Some(file) => files.push(file),
                        None => self.missing.push(word.to_owned()),
                    }
                }
                files
            };
            for file in found {
                let materials = mtl::parse(&read_file(&file)?);
                libraries.push((file, materials));
            }
        }
        Ok(libraries)
    }

    fn paint_of(&mut self, library: &Path, material: &Material) -> Result<Paint, CoreError> {
        let Some(reference) = &material.texture else {
            return Ok(material.color.map_or(Paint::Unknown, |color| {
                Paint::Color(color.map(|v| linear_from_srgb(f64::from(v)) as f32))
            }));
        };
        let place = Some(format!("line {}", material.texture_line));
        let notices = &mut self.draft.notices;
        let found = self
            .folder
            .require_inside(reference, library, place.clone(), notices)?;
        let Some(file) = found else {
            let reference = shown(reference);
            let reason = format!(
                "the texture `{reference}` of the material `{}` is missing",
                shown(&material.name)
            );
            return Err(CoreError::format(library, place, reason));
        };
        let texture = self.load(file)?;
        Ok(Paint::Image {
            texture,
            factor: [1.0; 3],
        })
    }

    fn load(&mut self, file: PathBuf) -> Result<usize, CoreError> {
        if let Some(index) = self.loaded.get(&file) {
            return Ok(*index);
        }
        self.draft.textures.push(load_texture(&file)?);
        let index = self.draft.textures.len() - 1;
        self.loaded.insert(file, index);
        Ok(index)
    }

    /// Takes the image with the scan's own name where no library names one, as is common in scans that lost theirs.
    fn fall_back(&mut self, libraries: &[(PathBuf, Vec<Material>)]) -> Result<(), CoreError> {
        let has_colors = self
            .draft
            .materials
            .iter()
            .any(|p| matches!(p, Paint::Color(_)));
        if has_colors && self.missing.is_empty() {
            return Ok(());
        }
        if let Some(image) = self.folder.image_beside(self.path) {
            let name = image
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let why = match self.missing.first() {
                Some(library) => format!("the material library `{}` is missing", shown(library)),
                None if libraries.is_empty() => "the file names no material library".to_owned(),
                None => "the material library names no texture".to_owned(),
            };
            let texture = self.load(image)?;
            self.draft
                .notices
                .push(format!("{why}; took the texture `{name}`"));
            self.draft.materials = vec![Paint::Image {
                texture,
                factor: [1.0; 3],
            }];
            self.draft.triangle_materials = vec![0; self.draft.mesh.triangles.len()];
            return Ok(());
        }
        let names_a_look = !self.missing.is_empty() && libraries.is_empty();
        if names_a_look && self.draft.mesh.colors.is_empty() {
            let library = self.missing.first().map_or("", String::as_str);
            let reason = format!(
                "the material library `{}` is missing, and no image of the scan's name lies beside it; \
                 name the texture to take",
                shown(library)
            );
            return Err(CoreError::format(self.path, None, reason));
        }
        self.report_missing();
        Ok(())
    }

    fn report_missing(&mut self) {
        let missing = self.missing.drain(..);
        self.draft.notices.extend(
            missing.map(|library| format!("the material library `{}` is missing", shown(&library))),
        );
    }
}
