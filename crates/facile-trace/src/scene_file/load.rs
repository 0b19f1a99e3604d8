//! Meshes of a scene file, with what comes with them.

use std::path::Path;

use facile_core::io::{load_scan, read_file};
use facile_core::{Mesh, Texture};

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

/// Reads a mesh of any format that a scan can have. `texture` takes the place of the texture that the file names.
pub(super) fn load_mesh(path: &Path, texture: Option<&Path>) -> Result<Loaded, TraceError> {
    let scan = load_scan(path, texture)?;
    let is_obj = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("obj"));
    let normals = if is_obj {
        vertex_normals(&read_file(path)?, scan.mesh.positions.len())
    } else {
        None
    };
    Ok(Loaded {
        mesh: scan.mesh,
        texture: scan.texture,
        normals,
    })
}
