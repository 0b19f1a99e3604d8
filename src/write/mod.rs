//! Storing datasets: encoders, the folder format, the manifest.

mod encode;
mod folder;
mod journal;
mod manifest;
mod sample;

pub use encode::encode_image;
pub use facile_trace::png_file::{encode_gray8, encode_gray16, encode_rgb8};
pub use folder::{ANNOTATIONS, CHECKSUMS, Folder, finished};
pub use journal::{FileEntry, Journal};
pub use manifest::{Failure, MANIFEST, Manifest};
pub use sample::{EncodedFile, encode_sample, image_name, map_name};

/// Folder of the images.
pub const IMAGES: &str = "images";
/// Folders of the maps, by kind of truth.
pub const MAP_FOLDERS: [&str; 5] = ["segments", "depth", "normals", "visibility", "occlusion"];
