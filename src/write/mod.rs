//! Storing datasets: encoders, formats, journals, the manifest; merging parts.

mod card;
mod coco;
mod contact;
mod encode;
mod folder;
mod journal;
mod labels;
mod manifest;
mod merge;
mod parquet;
mod restore;
mod sample;
mod stored;
mod unit;
mod webdataset;

pub(crate) use card::Tally;
pub use card::{CARD, CROISSANT};
pub use coco::COCO;
pub use contact::CONTACT_SHEET;
pub use encode::encode_image;
pub(crate) use encode::encode_jpeg;
pub use facile_trace::png_file::{encode_gray8, encode_gray16, encode_rgb8};
pub use folder::{ANNOTATIONS, CHECKSUMS, Folder, finished};
pub use journal::{FileEntry, Journal};
pub use labels::LABELS;
pub use manifest::{Failure, Labels, MANIFEST, Manifest};
pub use merge::merge;
pub use parquet::{PARQUET, VISIBILITIES, parquet_name};
pub use sample::{EncodedMaps, EncodedSample, Encoder, image_name, map_name};
pub(crate) use stored::{Stored, table_cell};
pub use unit::UnitWriter;
pub use webdataset::{WEBDATASET, tar_name};

/// Folder of the images.
pub const IMAGES: &str = "images";
/// Folders of the maps, by kind of truth.
pub const MAP_FOLDERS: [&str; 13] = [
    "segments",
    "depth",
    "normals",
    "visibility",
    "occlusion",
    "amodal",
    "layers",
    "layer_depth",
    "coverage",
    "instances",
    "reference",
    "albedo",
    "shadow",
];
