//! PLY files as scans: vertices with colours and texture coordinates, polygons with texture coordinates of their own.
//!
//! A reader of our own: the known crate names neither the row nor the line of an error. Textures follow `MeshLab`'s way:
//! `comment TextureFile NAME` in the header, one line per texture, and `texnumber` in each face.

use std::path::Path;

use super::draft::{Draft, Paint, check_count};
use super::folder::{Folder, shown};
use super::picture::load_texture;
use super::ply_source::{Element, Header, Source, open};
use super::polygon::triangulate;
use crate::color::linear_from_srgb;
use crate::{CoreError, Point3};

/// What a property of a vertex means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slot {
    Position(usize),
    Color(usize),
    Texcoord(usize),
    Other,
}

impl Slot {
    fn from_name(name: &str) -> Self {
        match name {
            "x" => Self::Position(0),
            "y" => Self::Position(1),
            "z" => Self::Position(2),
            "red" | "r" | "diffuse_red" => Self::Color(0),
            "green" | "g" | "diffuse_green" => Self::Color(1),
            "blue" | "b" | "diffuse_blue" => Self::Color(2),
            "s" | "u" | "texture_u" | "texture_s" => Self::Texcoord(0),
            "t" | "v" | "texture_v" | "texture_t" => Self::Texcoord(1),
            _ => Self::Other,
        }
    }
}

/// Reads a PLY file; with an overriding texture its own is not looked for.
pub(crate) fn read(
    bytes: &[u8],
    path: &Path,
    folder: &Folder,
    texture_override: Option<&Path>,
) -> Result<Draft, CoreError> {
    let (header, mut source) = open(bytes, path)?;
    let mut draft = Draft::default();
    let mut row = Vec::new();
    for element in &header.elements {
        check_count(
            &format!("rows of `{}`", shown(&element.name)),
            element.count,
            path,
        )?;
        source.begin(element)?;
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut source, &mut draft)?,
            "face" => Faces::new(&mut draft).read(element, &mut source, path)?,
            _ if element.properties.is_empty() => {}
            name => {
                if name == "tristrips" {
                    draft
                        .notices
                        .push("triangle strips are not read".to_owned());
                }
                for i in 0..element.count {
                    source.set_row(i);
                    for property in &element.properties {
                        source.values(property, &mut row)?;
                    }
                }
            }
        }
    }
    if texture_override.is_none() {
        paint(&header, path, folder, &mut draft)?;
    }
    Ok(draft)
}

fn read_vertices(
    element: &Element,
    source: &mut Source<'_>,
    draft: &mut Draft,
) -> Result<(), CoreError> {
    let slots: Vec<Slot> = element
        .properties
        .iter()
        .map(|p| match p.list {
            None => Slot::from_name(&p.name),
            Some(_) => Slot::Other,
        })
        .collect();
    for k in 0..3 {
        if !slots.contains(&Slot::Position(k)) {
            let name = ["x", "y", "z"][k];
            return Err(source.error(format!("the vertices have no property `{name}`")));
        }
    }
    let has_colors = (0..3).all(|k| slots.contains(&Slot::Color(k)));
    let has_texcoords = (0..2).all(|k| slots.contains(&Slot::Texcoord(k)));
    let mesh = &mut draft.mesh;
    mesh.positions.reserve(element.count);
    let mut list = Vec::new();
    for i in 0..element.count {
        source.set_row(i);
        let (mut position, mut color, mut texcoord) = ([0.0; 3], [0.0; 3], [0.0; 2]);
        for (property, slot) in element.properties.iter().zip(&slots) {
            if property.list.is_some() {
                source.values(property, &mut list)?;
                continue;
            }
            let value = source.value(property.scalar)?;
            match *slot {
                Slot::Position(k) if value.is_finite() => position[k] = value,
                Slot::Position(_) => {
                    let name = &property.name;
                    let reason = format!("{name}: expected a finite number, found {value}");
                    return Err(source.error(reason));
                }
                Slot::Color(k) => {
                    let light = value / property.scalar.full_light();
                    color[k] = linear_from_srgb(light.clamp(0.0, 1.0)) as f32;
                }
                Slot::Texcoord(k) => texcoord[k] = value as f32,
                Slot::Other => {}
            }
        }
        mesh.positions.push(Point3::from(position));
        if has_colors {
            mesh.colors.push(color);
        }
        if has_texcoords {
            mesh.texcoords.push(texcoord);
        }
    }
    Ok(())
}

/// Splits the polygons of a file as they are read.
struct Faces<'a> {
    draft: &'a mut Draft,
    /// Texture coordinates of vertices, if they have some.
    shared: bool,
    points: Vec<Point3>,
    local: Vec<[u32; 3]>,
}

impl<'a> Faces<'a> {
    fn new(draft: &'a mut Draft) -> Self {
        let shared = !draft.mesh.texcoords.is_empty();
        Self {
            draft,
            shared,
            points: Vec::new(),
            local: Vec::new(),
        }
    }

    fn read(
        mut self,
        element: &Element,
        source: &mut Source<'_>,
        path: &Path,
    ) -> Result<(), CoreError> {
        let find = |names: &[&str], is_list: bool| {
            element
                .properties
                .iter()
                .position(|p| names.contains(&p.name.as_str()) && p.list.is_some() == is_list)
        };
        let Some(corners_at) = find(&["vertex_indices", "vertex_index"], true) else {
            return Err(source.error("the faces have no list `vertex_indices`"));
        };
        let texcoords_at = find(&["texcoord"], true);
        let number_at = find(&["texnumber"], false);
        let (mut corners, mut texcoords, mut number) = (Vec::new(), Vec::new(), Vec::new());
        let mut skipped = Vec::new();
        self.draft.mesh.triangles.reserve(element.count);
        for i in 0..element.count {
            source.set_row(i);
            for (k, property) in element.properties.iter().enumerate() {
                let into = if k == corners_at {
                    &mut corners
                } else if Some(k) == texcoords_at {
                    &mut texcoords
                } else if Some(k) == number_at {
                    &mut number
                } else {
                    &mut skipped
                };
                source.values(property, into)?;
            }
            self.polygon(&corners, &texcoords, source)?;
            if number_at.is_some() {
                let texture = number.first().copied().unwrap_or(-1.0);
                let material = if texture >= 0.0 {
                    texture as u32
                } else {
                    u32::MAX
                };
                let n = self.draft.mesh.triangles.len();
                self.draft.triangle_materials.resize(n, material);
            }
            check_count("triangles", self.draft.mesh.triangles.len(), path)?;
        }
        Ok(())
    }

    fn polygon(
        &mut self,
        corners: &[f64],
        texcoords: &[f64],
        source: &Source<'_>,
    ) -> Result<(), CoreError> {
        let mesh = &mut self.draft.mesh;
        let count = mesh.positions.len();
        if corners.len() < 3 {
            let n = corners.len();
            return Err(source.error(format!("a face needs at least 3 corners, found {n}")));
        }
        let is_index = |v: &f64| *v >= 0.0 && *v < count as f64 && v.fract() == 0.0;
        if let Some(v) = corners.iter().find(|v| !is_index(v)) {
            return Err(source.error(format!(
                "vertex index {v} is out of range, the file has {count} vertices"
            )));
        }
        self.points.clear();
        self.points
            .extend(corners.iter().map(|&v| mesh.positions[v as usize]));
        self.local.clear();
        triangulate(&self.points, &mut self.local);
        let vertices = |t: &[u32; 3]| t.map(|k| corners[k as usize] as u32);
        mesh.triangles.extend(self.local.iter().map(vertices));
        if texcoords.len() == 2 * corners.len() {
            let first = mesh.texcoords.len() as u32;
            let pairs = texcoords.chunks_exact(2);
            mesh.texcoords
                .extend(pairs.map(|p| [p[0] as f32, p[1] as f32]));
            let own = self.local.iter().map(|t| t.map(|k| first + k));
            // Faces before the first one with coordinates of its own have none.
            let missing = mesh.triangles.len() - self.local.len() - mesh.texcoord_triangles.len();
            let none = std::iter::repeat_n([u32::MAX; 3], missing);
            mesh.texcoord_triangles.extend(none.chain(own));
        } else if self.shared {
            mesh.texcoord_triangles
                .extend(self.local.iter().map(vertices));
        } else if !mesh.texcoord_triangles.is_empty() {
            let none = std::iter::repeat_n([u32::MAX; 3], self.local.len());
            mesh.texcoord_triangles.extend(none);
        }
        Ok(())
    }
}

/// Loads the textures that the header names, or the image with the file's own name.
fn paint(
    header: &Header,
    path: &Path,
    folder: &Folder,
    draft: &mut Draft,
) -> Result<(), CoreError> {
    if draft.mesh.texcoord_triangles.is_empty() {
        return Ok(());
    }
    let mut files = Vec::new();
    for name in &header.textures {
        let place = || Some("comment TextureFile".to_owned());
        let found = folder.require_inside(name, path, place(), &mut draft.notices)?;
        files.push(found.ok_or_else(|| {
            let reason = format!("the texture `{}` is missing", shown(name));
            CoreError::format(path, place(), reason)
        })?);
    }
    if files.is_empty()
        && let Some(image) = folder.image_beside(path)
    {
        let name = image.file_name().unwrap_or_default().to_string_lossy();
        draft.notices.push(format!(
            "the file names no texture; took the texture `{name}`"
        ));
        files.push(image);
    }
    for (texture, file) in files.iter().enumerate() {
        draft.textures.push(load_texture(file)?);
        draft.materials.push(Paint::Image {
            texture,
            factor: [1.0; 3],
        });
    }
    if !files.is_empty() && draft.triangle_materials.is_empty() {
        draft.triangle_materials = vec![0; draft.mesh.triangles.len()];
    }
    Ok(())
}
