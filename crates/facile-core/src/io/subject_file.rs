//! Subjects as GLB files: a head any viewer shows, and the exact values beside it.
//!
//! The drawn mesh is single precision. What makes the subject is kept bit for bit: positions and expected errors as
//! raw blocks (`positions`: little-endian f64 triples, `expected_error`: f32), the skin as PNG, everything else as
//! JSON in `asset.extras.facile`. A subject only makes sense with the reference head it was made with; a digest of
//! that head's topology is stored and compared.

use std::path::Path;

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::folder::Folder;
use super::glb::{Glb, GlbPart, GlbTexture, Packing};
use super::gltf_accessor::Buffers;
use super::gltf_json::Document;
use super::picture::decode_texture_at;
use super::{gltf, read_file};
use crate::{Attributes, CoreError, Eye, Mesh, Point3, ReferenceHead, Similarity3, Subject};

/// Version of the layout of `asset.extras.facile`.
const VERSION: u32 = 1;

/// What `asset.extras.facile` holds of a subject.
#[derive(Debug, Serialize, Deserialize)]
struct Record {
    kind: String,
    version: u32,
    /// [`ReferenceHead::topology_digest`] of the head it belongs to.
    reference: String,
    id: String,
    attributes: Attributes,
    eyes: [Eye; 2],
    eye_color: String,
    skull_from_reference: Placement,
}

/// A similarity: scale, then rotation (quaternion x, y, z, w), then translation, mm.
#[derive(Debug, Serialize, Deserialize)]
struct Placement {
    translation: [f64; 3],
    rotation: [f64; 4],
    scale: f64,
}

impl Subject {
    /// Writes the subject as a GLB file: nodes `head`, eyes, teeth and tongue with their textures, and the exact values
    /// that [`Subject::load`] reads back bit for bit.
    ///
    /// # Errors
    /// [`CoreError::Io`] if the file cannot be written.
    pub fn save(&self, path: &Path, reference: &ReferenceHead) -> Result<(), CoreError> {
        super::write_file(path, &self.to_glb(path, reference)?)
    }

    /// The bytes of [`Subject::save`]; `path` is only used in errors.
    ///
    /// # Errors
    /// [`CoreError::SizeMismatch`] or [`CoreError::Mesh`] if the subject does not belong to this head.
    pub fn to_glb(&self, path: &Path, reference: &ReferenceHead) -> Result<Vec<u8>, CoreError> {
        self.check(path, reference)?;
        let record = self.record(reference);
        let mut parts = self.part_meshes(reference);
        parts.insert(0, ("head", self.mesh(reference)));
        let positions = self.positions.iter().flat_map(|p| p.coords.data.0[0]);
        let positions = positions.flat_map(f64::to_le_bytes).collect();
        let errors = self.expected_error.iter().flat_map(|e| e.to_le_bytes());
        let mut glb = head_glb(&parts, self, reference, record);
        glb.blocks = vec![
            ("positions", positions),
            ("expected_error", errors.collect()),
        ];
        glb.to_bytes(path)
    }

    /// Reads a subject that [`Subject::save`] wrote.
    ///
    /// # Errors
    /// [`CoreError::Format`] for a file of another kind, a damaged one, or a subject of another reference head.
    pub fn load(path: &Path, reference: &ReferenceHead) -> Result<Self, CoreError> {
        Self::from_glb(&read_file(path)?, path, reference)
    }

    /// Reads a subject from the bytes of its file; `path` is only used in errors.
    ///
    /// # Errors
    /// As [`Subject::load`].
    pub fn from_glb(
        bytes: &[u8],
        path: &Path,
        reference: &ReferenceHead,
    ) -> Result<Self, CoreError> {
        let bad = |reason: String| CoreError::format(path, None, reason);
        let container = gltf::open(bytes, path)?;
        let document = &container.document;
        let facile = &document.asset.extras["facile"];
        if facile["kind"] != "subject" {
            return Err(bad("is not a subject that Facile wrote".to_owned()));
        }
        if facile["version"] != VERSION {
            let version = &facile["version"];
            return Err(bad(format!(
                "expected subject version {VERSION}, found {version}"
            )));
        }
        let record: Record = serde_json::from_value(facile.clone())
            .map_err(|e| bad(format!("the subject's record cannot be read: {e}")))?;
        if record.reference != reference.topology_digest() {
            let reason = "the subject was made with another reference head; register it again";
            return Err(bad(reason.to_owned()));
        }
        let folder = Folder::of(path, false);
        let mut notices = Vec::new();
        let buffers = Buffers::load(document, container.binary, path, &folder, &mut notices)?;
        let texture = match document.images.first().and_then(|i| i.buffer_view) {
            Some(view) => decode_texture_at(buffers.view(view)?.0, path, Some("image 0"))?,
            None => return Err(bad("the subject has no skin texture".to_owned())),
        };
        let subject = Self {
            positions: read_positions(block(&buffers, document, "positions", path)?),
            expected_error: block(&buffers, document, "expected_error", path)?
                .as_chunks::<4>()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b))
                .collect(),
            texture,
            eyes: record.eyes,
            skull_from_reference: record.skull_from_reference.similarity(path)?,
            eye_color: record.eye_color,
            id: record.id,
            attributes: record.attributes,
        };
        subject.check(path, reference)?;
        Ok(subject)
    }

    fn record(&self, reference: &ReferenceHead) -> Map<String, Value> {
        let skull = &self.skull_from_reference;
        let record = Record {
            kind: "subject".to_owned(),
            version: VERSION,
            reference: reference.topology_digest(),
            id: self.id.clone(),
            attributes: self.attributes.clone(),
            eyes: self.eyes,
            eye_color: self.eye_color.clone(),
            skull_from_reference: Placement {
                translation: skull.isometry.translation.vector.into(),
                rotation: skull.isometry.rotation.coords.into(),
                scale: skull.scaling(),
            },
        };
        match serde_json::to_value(record) {
            Ok(Value::Object(map)) => map,
            _ => Map::new(),
        }
    }

    fn check(&self, path: &Path, reference: &ReferenceHead) -> Result<(), CoreError> {
        let expected = reference.mesh.positions.len();
        for (what, got) in [
            ("vertices of the subject", self.positions.len()),
            ("expected errors of the subject", self.expected_error.len()),
        ] {
            if got != expected {
                return Err(CoreError::SizeMismatch {
                    what,
                    expected,
                    got,
                });
            }
        }
        self.mesh(reference).validate(path)?;
        let is_eye = |e: &Eye| e.center.iter().all(|v| v.is_finite()) && e.radius > 0.0;
        if !self.eyes.iter().all(is_eye) {
            return Err(CoreError::format(
                path,
                None,
                "the eyes have no place or size",
            ));
        }
        if !reference.eye_textures.contains_key(&self.eye_color) {
            return Err(CoreError::UnknownName {
                kind: "eye colour",
                name: self.eye_color.clone(),
                known: reference
                    .eye_textures
                    .keys()
                    .map(String::as_str)
                    .collect::<Vec<_>>()
                    .join(", "),
            });
        }
        Ok(())
    }
}

/// A head with its parts, as any viewer shows it: for a subject, or for one that makes a face.
///
/// `parts`: names and meshes, mm. Names of eyes, teeth and tongue ([`crate::Segment::name`]) choose the texture, all
/// others wear the subject's skin. `extras` go to `asset.extras.facile`.
pub fn head_glb<'a>(
    parts: &'a [(&'a str, Mesh)],
    subject: &'a Subject,
    reference: &'a ReferenceHead,
    extras: Map<String, Value>,
) -> Glb<'a> {
    let mut textures = vec![GlbTexture {
        name: "skin",
        texture: &subject.texture,
        packing: Packing::Png,
    }];
    let eye = reference.eye_textures.get(&subject.eye_color);
    textures.extend(eye.map(|texture| GlbTexture {
        name: "eye",
        texture,
        packing: Packing::Png,
    }));
    let mouth = textures.len();
    textures.push(GlbTexture {
        name: "mouth",
        texture: &reference.mouth_texture,
        packing: Packing::Png,
    });
    let parts = parts
        .iter()
        .map(|(name, mesh)| GlbPart {
            name,
            mesh,
            texture: Some(match *name {
                "left_eye" | "right_eye" if eye.is_some() => 1,
                "upper_teeth" | "lower_teeth" | "tongue" => mouth,
                _ => 0,
            }),
        })
        .collect();
    Glb {
        parts,
        textures,
        extras,
        blocks: Vec::new(),
    }
}

/// Whether the bytes of a file are a subject that Facile wrote, so that it needs no registration.
pub fn is_subject(bytes: &[u8]) -> bool {
    bytes.starts_with(b"glTF")
        && gltf::open(bytes, Path::new(""))
            .is_ok_and(|c| c.document.asset.extras["facile"]["kind"] == "subject")
}

impl Placement {
    fn similarity(&self, path: &Path) -> Result<Similarity3, CoreError> {
        let [x, y, z, w] = self.rotation;
        let rotation = Quaternion::new(w, x, y, z);
        let is_unit = (rotation.norm_squared() - 1.0).abs() < 1e-6;
        let is_placed = self.translation.iter().all(|v| v.is_finite());
        if !(is_unit && is_placed && self.scale.is_finite() && self.scale > 0.0) {
            let reason = "the placement of the skull is not a similarity";
            return Err(CoreError::format(path, None, reason));
        }
        Ok(Similarity3::from_parts(
            Translation3::from(self.translation),
            UnitQuaternion::new_unchecked(rotation),
            self.scale,
        ))
    }
}

fn block<'b>(
    buffers: &'b Buffers<'_>,
    document: &Document,
    name: &str,
    path: &Path,
) -> Result<&'b [u8], CoreError> {
    let view = document.asset.extras["facile"]["blocks"][name].as_u64();
    match view {
        Some(view) => Ok(buffers.view(view as usize)?.0),
        None => Err(CoreError::format(
            path,
            None,
            format!("the block `{name}` is missing"),
        )),
    }
}

fn read_positions(bytes: &[u8]) -> Vec<Point3> {
    let values = bytes.as_chunks::<8>().0.iter();
    let values: Vec<f64> = values.map(|b| f64::from_le_bytes(*b)).collect();
    let triples = values.as_chunks::<3>().0.iter();
    triples.map(|p| Point3::from(*p)).collect()
}
