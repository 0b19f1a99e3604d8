//! Meshes and textures of a scene file.

use std::path::Path;

use facile_core::io::obj::{NO_TEXCOORD, ObjFile};
use facile_core::{CoreError, Mesh, Segment, Texture};

use super::obj_normals::vertex_normals;
use crate::TraceError;
use crate::math::Vec3;

/// A mesh and what comes with it.
pub(super) struct Loaded {
    pub(super) mesh: Mesh,
    pub(super) texture: Option<Texture>,
    /// Unit normals of the vertices.
    pub(super) normals: Option<Vec<Vec3>>,
}

/// Reads a mesh.
pub(super) fn load_mesh(path: &Path) -> Result<Loaded, TraceError> {
    let bytes = read(path)?;
    let obj = ObjFile::parse(&bytes, path)?;
    let mut mesh = Mesh {
        positions: obj.positions.clone(),
        texcoords: obj.texcoords.clone(),
        ..Mesh::default()
    };
    let has_texcoords = obj.corners.iter().all(|c| c[1] != NO_TEXCOORD);
    let classes: Vec<Segment> = obj
        .groups
        .iter()
        .map(|g| Segment::from_name(g).unwrap_or(Segment::Other))
        .collect();
    for polygon in &obj.polygons {
        let corners = obj.corners_of(polygon);
        for k in 1..corners.len() - 1 {
            let triangle = [corners[0], corners[k], corners[k + 1]];
            mesh.triangles.push(triangle.map(|c| c[0]));
            if has_texcoords {
                mesh.texcoord_triangles.push(triangle.map(|c| c[1]));
            }
            let class = polygon
                .group
                .map_or(Segment::Other, |g| classes[g as usize]);
            mesh.segments.push(class);
        }
    }
    mesh.validate(path)?;
    Ok(Loaded {
        normals: vertex_normals(&bytes, mesh.positions.len()),
        mesh,
        texture: None,
    })
}

/// Reads an image file.
pub(super) fn load_texture(path: &Path) -> Result<Texture, TraceError> {
    let bytes = read(path)?;
    let bad = |e: image::ImageError| {
        TraceError::Core(CoreError::Format {
            path: path.to_owned(),
            place: None,
            reason: e.to_string(),
        })
    };
    let image = image::load_from_memory(&bytes).map_err(bad)?.into_rgb8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let texels = image.as_raw().as_chunks::<3>().0.to_vec();
    Ok(Texture::new(width, height, texels))
}

fn read(path: &Path) -> Result<Vec<u8>, TraceError> {
    std::fs::read(path).map_err(|source| TraceError::Io {
        path: path.to_owned(),
        source,
    })
}
