//! Files: meshes in and out, textures, with validation. Every error names the file and the place.
//!
//! [`load_scan`] is the way in for every mesh of a user: OBJ, PLY, GLB and glTF become a [`Scan`], one mesh with at most
//! one texture, or one clear error. Readers trust nothing: counts are checked against the bytes that are there before
//! memory is taken, indices and numbers are checked once, here, so that later stages need not. The way out is [`glb`].
//! Read `draft` next, where the readers meet.

pub mod glb;
pub mod obj;

mod atlas;
mod draft;
mod folder;
mod gltf;
mod gltf_accessor;
mod gltf_json;
mod mtl;
mod obj_scan;
mod picture;
mod ply;
mod ply_source;
mod polygon;
mod reference_folder;
mod subject_file;

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use crate::{CoreError, Mesh, Texture};

pub use picture::decode_texture;
pub use subject_file::{head_glb, is_subject};

/// Most bytes of a file that is read, 2 GiB: more than any scan of [`MAX_ELEMENTS`] needs to be useful.
pub const MAX_FILE_BYTES: u64 = 2 << 30;

/// Most vertices, texture coordinates or triangles of a scan.
pub const MAX_ELEMENTS: usize = 50_000_000;

/// Largest coordinate of a vertex, in the file's unit: squares and products of it stay far from overflow.
pub const MAX_COORDINATE: f64 = 1e9;

/// A mesh as a user brings it: own triangulation, own unit, at most one texture.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Name in records: the file's name without its extension.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// Surface in the file's unit and frame, except that files Facile wrote come back in mm. Colours are linear.
    /// Segments are set if groups bear names of [`crate::Segment`]; triangles of other groups are then `Other`.
    pub mesh: Mesh,
    /// Colour texture; several textures of a file are merged into one.
    pub texture: Option<Texture>,
    /// Names of the file's groups or nodes, in order of appearance.
    pub groups: Vec<String>,
    /// Index in `groups` of each triangle; empty if the file has no groups.
    pub triangle_groups: Vec<u32>,
    /// What a user should know: fallbacks taken, things left out.
    pub notices: Vec<String>,
}

/// How a scan is read.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScanOptions<'a> {
    /// Takes this image instead of what the file names. The mesh then needs texture coordinates.
    pub texture: Option<&'a Path>,
    /// Lets a file name textures and libraries outside its own folder. Off by default: a scan from elsewhere must not
    /// make the program read `../../secret.png`. Links inside the folder are followed either way.
    pub outside_folder: bool,
}

/// Reads and validates a scan: OBJ with MTL, PLY, GLB or glTF. `texture` overrides the texture that the file names.
///
/// # Errors
/// One [`CoreError`] with the file and the place of the first thing that is wrong.
pub fn load_scan(path: &Path, texture: Option<&Path>) -> Result<Scan, CoreError> {
    let options = ScanOptions {
        texture,
        ..ScanOptions::default()
    };
    load_scan_with(path, &options)
}

/// As [`load_scan`], with all options.
///
/// # Errors
/// As [`load_scan`].
pub fn load_scan_with(path: &Path, options: &ScanOptions<'_>) -> Result<Scan, CoreError> {
    let bytes = read_file(path)?;
    parse_scan(&bytes, path, options)
}

/// Reads a scan from the bytes of a file; `path` names it, tells its format, and is where its textures are looked for.
///
/// # Errors
/// As [`load_scan`].
pub fn parse_scan(bytes: &[u8], path: &Path, options: &ScanOptions<'_>) -> Result<Scan, CoreError> {
    if bytes.is_empty() {
        return Err(CoreError::format(path, None, "the file is empty"));
    }
    let folder = folder::Folder::of(path, options.outside_folder);
    let extension = path
        .extension()
        .map(|e| e.to_string_lossy().to_ascii_lowercase());
    let draft = match extension.as_deref() {
        Some("obj") => obj_scan::read(bytes, path, &folder, options.texture)?,
        Some("ply") => ply::read(bytes, path, &folder, options.texture)?,
        Some("glb" | "gltf") => gltf::read(bytes, path, &folder)?,
        _ => {
            let reason = "unknown file type; known are .obj, .ply, .glb and .gltf";
            return Err(CoreError::format(path, None, reason));
        }
    };
    draft.finish(path, options.texture)
}

/// Reads a whole file of at most [`MAX_FILE_BYTES`].
///
/// # Errors
/// [`CoreError::Io`] if it cannot be read, [`CoreError::Format`] if it is larger.
pub fn read_file(path: &Path) -> Result<Vec<u8>, CoreError> {
    let io = |source| CoreError::Io {
        path: path.to_owned(),
        source,
    };
    let file = std::fs::File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    if metadata.is_dir() {
        return Err(CoreError::format(path, None, "is a folder, not a file"));
    }
    let too_large = || {
        let reason = format!("the file is larger than the limit of {MAX_FILE_BYTES} bytes");
        CoreError::format(path, None, reason)
    };
    if metadata.len() > MAX_FILE_BYTES {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(metadata.len() as usize);
    file.take(MAX_FILE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(too_large());
    }
    Ok(bytes)
}

/// Writes a whole file. An existing file of that name is replaced only when the new one is complete on disk.
///
/// # Errors
/// [`CoreError::Io`] with the file.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), CoreError> {
    let io = |source| CoreError::Io {
        path: path.to_owned(),
        source,
    };
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // As any new file: read and write, less the user's mask.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.prefix(".facile-").tempfile_in(folder).map_err(io)?;
    file.write_all(bytes).map_err(io)?;
    file.as_file().sync_all().map_err(io)?;
    file.persist(path).map_err(|e| io(e.error))?;
    Ok(())
}
