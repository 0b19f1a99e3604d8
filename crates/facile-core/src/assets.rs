//! The files in `assets/`, embedded so that the program runs from anywhere, or read from a folder of the same layout.

use std::collections::BTreeMap;
use std::path::Path;

use serde::de::DeserializeOwned;

use crate::{CoreError, Texture};

/// The raw files of a reference head.
pub(crate) struct Files {
    pub(crate) head_obj: Vec<u8>,
    pub(crate) head_vertices_csv: String,
    pub(crate) head_toml: String,
    pub(crate) landmarks_toml: String,
    pub(crate) parts_obj: Vec<u8>,
    pub(crate) skin: Vec<u8>,
    pub(crate) mouth: Vec<u8>,
    pub(crate) eye_textures: BTreeMap<String, Vec<u8>>,
}

macro_rules! embed {
    ($path:literal) => {
        include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/", $path))
    };
}

const EYE_COLORS: [&str; 3] = ["blue", "brown", "green"];

impl Files {
    pub(crate) fn embedded() -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let eyes: [&[u8]; 3] = [
            embed!("reference/eye_blue.png"),
            embed!("reference/eye_brown.png"),
            embed!("reference/eye_green.png"),
        ];
        Self {
            head_obj: embed!("reference/head.obj").to_vec(),
            head_vertices_csv: text(embed!("reference/head_vertices.csv")),
            head_toml: text(embed!("reference/head.toml")),
            landmarks_toml: text(embed!("reference/landmarks.toml")),
            parts_obj: embed!("reference/parts.obj").to_vec(),
            skin: embed!("reference/skin.jpg").to_vec(),
            mouth: embed!("reference/mouth.png").to_vec(),
            eye_textures: EYE_COLORS
                .iter()
                .zip(eyes)
                .map(|(n, b)| ((*n).to_owned(), b.to_vec()))
                .collect(),
        }
    }

    pub(crate) fn read(dir: &Path) -> Result<Self, CoreError> {
        let bytes = |name: &str| {
            let path = dir.join(name);
            std::fs::read(&path).map_err(|source| CoreError::Io { path, source })
        };
        let text = |name: &str| bytes(name).map(|b| String::from_utf8_lossy(&b).into_owned());
        let mut eye_textures = BTreeMap::new();
        for color in EYE_COLORS {
            eye_textures.insert(color.to_owned(), bytes(&format!("eye_{color}.png"))?);
        }
        Ok(Self {
            head_obj: bytes("head.obj")?,
            head_vertices_csv: text("head_vertices.csv")?,
            head_toml: text("head.toml")?,
            landmarks_toml: text("landmarks.toml")?,
            parts_obj: bytes("parts.obj")?,
            skin: bytes("skin.jpg")?,
            mouth: bytes("mouth.png")?,
            eye_textures,
        })
    }
}

/// Parses TOML; `name` is the file in errors.
pub(crate) fn parse_toml<T: DeserializeOwned>(text: &str, name: &str) -> Result<T, CoreError> {
    toml::from_str(text).map_err(|e| CoreError::Format {
        path: name.into(),
        place: None,
        reason: e.to_string(),
    })
}

/// Decodes a PNG, JPEG, BMP or WebP; `name` is the file in errors.
pub(crate) fn decode_texture(bytes: &[u8], name: &str) -> Result<Texture, CoreError> {
    let bad = |e: image::ImageError| CoreError::Format {
        path: name.into(),
        place: None,
        reason: e.to_string(),
    };
    let image = image::load_from_memory(bytes).map_err(bad)?.into_rgb8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let texels: Vec<[u8; 3]> = image
        .as_raw()
        .chunks_exact(3)
        .map(|t| [t[0], t[1], t[2]])
        .collect();
    if texels.is_empty() {
        let reason = "the image has no pixels".to_owned();
        return Err(CoreError::Format {
            path: name.into(),
            place: None,
            reason,
        });
    }
    Ok(Texture::new(width, height, texels))
}
