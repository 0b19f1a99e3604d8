//! The files in `assets/`, embedded so that the program runs from anywhere, or read from a folder of the same layout.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::CoreError;
use crate::io::read_file;

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
    ($path:expr) => {
        include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/", $path))
    };
}

macro_rules! include_text {
    ($path:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/", $path))
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
        let bytes = |name: &str| read_file(&dir.join(name));
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

/// The raw files of an identity model.
pub(crate) struct IdentityFiles {
    pub(crate) identity_toml: String,
    pub(crate) modes: Cow<'static, [u8]>,
    /// Where skins are read from; the embedded ones if there is no folder.
    dir: Option<PathBuf>,
}

impl IdentityFiles {
    pub(crate) fn embedded() -> Self {
        Self {
            identity_toml: include_text!("identity/identity.toml").to_owned(),
            modes: Cow::Borrowed(embed!("identity/modes.npy")),
            dir: None,
        }
    }

    pub(crate) fn read(dir: &Path) -> Result<Self, CoreError> {
        let toml = read_file(&dir.join("identity.toml"))?;
        Ok(Self {
            identity_toml: String::from_utf8_lossy(&toml).into_owned(),
            modes: read_file(&dir.join("modes.npy"))?.into(),
            dir: Some(dir.to_owned()),
        })
    }

    /// The JPEG of a skin, named as in `identity.toml`.
    pub(crate) fn skin(&self, file: &str) -> Result<Cow<'static, [u8]>, CoreError> {
        match &self.dir {
            Some(dir) => Ok(read_file(&dir.join(file))?.into()),
            None => SKIN_FILES
                .iter()
                .find(|(name, _)| *name == file)
                .map(|(_, bytes)| Cow::Borrowed(*bytes))
                .ok_or_else(|| CoreError::format(file.as_ref(), None, "is not embedded")),
        }
    }
}

/// A table of embedded files of one folder, by the name their list uses.
macro_rules! embed_all {
    ($($name:literal => $path:literal,)*) => { &[$(($name, embed!($path)),)*] };
}

/// Skins of the identity model.
const SKIN_FILES: &[(&str, &[u8])] = embed_all! {
    "skins/african_female_middle.jpg" => "identity/skins/african_female_middle.jpg",
    "skins/african_female_old.jpg" => "identity/skins/african_female_old.jpg",
    "skins/african_female_young.jpg" => "identity/skins/african_female_young.jpg",
    "skins/african_male_middle.jpg" => "identity/skins/african_male_middle.jpg",
    "skins/african_male_old.jpg" => "identity/skins/african_male_old.jpg",
    "skins/african_male_young.jpg" => "identity/skins/african_male_young.jpg",
    "skins/asian_female_middle.jpg" => "identity/skins/asian_female_middle.jpg",
    "skins/asian_female_old.jpg" => "identity/skins/asian_female_old.jpg",
    "skins/asian_female_young.jpg" => "identity/skins/asian_female_young.jpg",
    "skins/asian_male_middle.jpg" => "identity/skins/asian_male_middle.jpg",
    "skins/asian_male_old.jpg" => "identity/skins/asian_male_old.jpg",
    "skins/asian_male_young.jpg" => "identity/skins/asian_male_young.jpg",
    "skins/caucasian_female_middle.jpg" => "identity/skins/caucasian_female_middle.jpg",
    "skins/caucasian_female_old.jpg" => "identity/skins/caucasian_female_old.jpg",
    "skins/caucasian_female_young.jpg" => "identity/skins/caucasian_female_young.jpg",
    "skins/caucasian_female_young2.jpg" => "identity/skins/caucasian_female_young2.jpg",
    "skins/caucasian_male_middle.jpg" => "identity/skins/caucasian_male_middle.jpg",
    "skins/caucasian_male_old.jpg" => "identity/skins/caucasian_male_old.jpg",
    "skins/caucasian_male_young.jpg" => "identity/skins/caucasian_male_young.jpg",
    "skins/caucasian_male_young2.jpg" => "identity/skins/caucasian_male_young2.jpg",
};

macro_rules! embed_hair {
    ($($name:literal,)*) => {
        [$((
            $name,
            [
                embed!(concat!("hair/", $name, ".obj")),
                embed!(concat!("hair/", $name, ".png")),
            ],
        ),)*]
    };
}

/// Cards and texture of each hair style, by name.
pub(crate) const HAIR_FILES: [(&str, [&[u8]; 2]); 10] = embed_hair! {
    "afro01",
    "bob01",
    "bob02",
    "braid01",
    "long01",
    "ponytail01",
    "short01",
    "short02",
    "short03",
    "short04",
};

/// Cards and texture of the lashes.
pub(crate) const LASHES_FILES: [&[u8]; 2] = [embed!("hair/lashes.obj"), embed!("hair/lashes.png")];

/// Share of hair in the reference UV.
pub(crate) const SCALP_FILE: &[u8] = embed!("hair/scalp.png");

/// The shirt.
pub(crate) const SHIRT_FILE: &[u8] = embed!("clothes/shirt.obj");

/// Scans of the built-in subjects.
pub(crate) const SUBJECT_FILES: &[(&str, &[u8])] = embed_all! {
    "amara.glb" => "subjects/amara.glb",
    "bjorn.glb" => "subjects/bjorn.glb",
    "carmen.glb" => "subjects/carmen.glb",
    "desta.glb" => "subjects/desta.glb",
    "emi.glb" => "subjects/emi.glb",
    "farid.glb" => "subjects/farid.glb",
    "greta.glb" => "subjects/greta.glb",
    "haruto.glb" => "subjects/haruto.glb",
    "ivy.glb" => "subjects/ivy.glb",
    "jomo.glb" => "subjects/jomo.glb",
    "kwang.glb" => "subjects/kwang.glb",
    "lerato.glb" => "subjects/lerato.glb",
};

/// The list of the built-in subjects.
pub(crate) const SUBJECTS_TOML: &str = include_text!("subjects/subjects.toml");

/// Parses TOML; `name` is the file in errors.
pub(crate) fn parse_toml<T: DeserializeOwned>(text: &str, name: &str) -> Result<T, CoreError> {
    toml::from_str(text).map_err(|e| CoreError::Format {
        path: name.into(),
        place: None,
        reason: e.to_string(),
    })
}
