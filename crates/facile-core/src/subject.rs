//! A person: own shape and texture on the reference topology.

use serde::{Deserialize, Serialize};

use crate::{Mesh, Point3, ReferenceHead, Segment, Similarity3, Texture};

/// What is known of a person besides shape and colour.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attributes {
    /// `female`, `male`, or what the source says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sex: Option<String>,
    /// Ancestry, as the source names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ancestry: Option<String>,
    /// Age in years, or the source's age group.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub age: Option<String>,
    /// Colour of the irises, as the source names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eye_color: Option<String>,
    /// Colour of the hair, as the source names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hair: Option<String>,
    /// Where the data comes from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Its licence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
}

/// An eyeball.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Eye {
    /// Centre of rotation, mm.
    pub center: Point3,
    /// Radius of the sclera, mm.
    pub radius: f64,
}

/// A person's head on the reference topology, neutral.
#[derive(Clone, Debug, PartialEq)]
pub struct Subject {
    /// Name in records, unique in a dataset.
    pub id: String,
    /// What is known of the person.
    pub attributes: Attributes,
    /// Positions of the fine reference vertices, mm, head frame.
    pub positions: Vec<Point3>,
    /// Expected registration error of each fine vertex, mm; 0 for subjects made by the identity model.
    pub expected_error: Vec<f32>,
    /// Skin texture in the reference UV.
    pub texture: Texture,
    /// Left and right eye.
    pub eyes: [Eye; 2],
    /// Name of the eye texture, one of [`ReferenceHead::eye_textures`].
    pub eye_color: String,
    /// Places what the skull carries, teeth and tongue, from the reference head.
    pub skull_from_reference: Similarity3,
}

impl Subject {
    /// The head as a mesh with texture coordinates and segments.
    pub fn mesh(&self, reference: &ReferenceHead) -> Mesh {
        Mesh {
            positions: self.positions.clone(),
            ..reference.mesh.clone()
        }
    }

    /// Where a rigid part of the neutral head lies, from its place in the reference head: an eyeball turns about the
    /// subject's own eye centre and has its own size, teeth and tongue follow the skull.
    pub fn part_from_reference(&self, part: Segment, reference: &ReferenceHead) -> Similarity3 {
        reference.part_place(part, &self.eyes, &self.skull_from_reference)
    }

    /// The rigid parts of the neutral head in their places, with the names of their classes.
    pub fn part_meshes(&self, reference: &ReferenceHead) -> Vec<(&'static str, Mesh)> {
        reference
            .parts
            .iter()
            .map(|part| {
                let place = self.part_from_reference(part.segment, reference);
                let mut mesh = part.mesh.clone();
                for position in &mut mesh.positions {
                    *position = place * *position;
                }
                (part.segment.name(), mesh)
            })
            .collect()
    }
}
