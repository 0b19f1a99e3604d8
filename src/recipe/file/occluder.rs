//! `[[occluder]]`: what is in front of the face.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[occluder]]`: keys that are not given are the kind's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OccluderTable {
    /// Kind of occluder.
    pub kind: OccluderKind,
    /// Outline of the lenses of glasses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<RimTable>,
    /// sRGB colour of the frame of glasses or of anything else, from 0 to 255.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[u8; 3]>,
    /// Linear RGB share of light that passes a lens, each from 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tint: Option<[f64; 3]>,
    /// Refracting power of the lenses, from -8 to 8 dioptres: negative ones make the eyes smaller. 0 if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diopters: Option<f64>,
    /// Thickness of the rims of glasses, from 0.5 to 8 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rim_mm: Option<f64>,
    /// Size relative to a usual one, from 0.7 to 1.3: lenses, height of a mask, thickness of a scarf, length of a brim or
    /// fringe, width of a band, cups, hand, pole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<f64>,
    /// Motion of a hand, bar or model to the subject's left, from -150 to 150 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<f64>,
    /// Motion upwards of anything but glasses, from -150 to 150 mm: -25 uncovers the nose over a mask.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<f64>,
    /// Motion of a model away from the face, from -150 to 150 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z_mm: Option<f64>,
    /// Turn of a hand, bar or model, counter-clockwise for the viewer, or of a cap's brim to the subject's left, from -180 to
    /// 180 degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<f64>,
    /// Mesh of a model: OBJ, PLY, GLB or glTF, relative to the recipe; `y` up, `z` out of the face.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Feature that a model's origin is put on; the tip of the nose if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<AnchorTable>,
    /// Millimetres of one unit of a model's file, from 0.001 to 10,000; 1,000 for GLB and glTF, 1 for others if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
    /// Whether a model is pushed out until it does not cut into the face; `true` if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clear: Option<bool>,
}

/// Feature of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AnchorTable {
    /// Tip of the nose.
    Nose,
    /// Between the eyes.
    Eyes,
    /// Middle of the mouth.
    Mouth,
    /// Chin.
    Chin,
    /// Between the brows.
    Forehead,
    /// Where the left ear meets the head.
    LeftEar,
    /// Where the right ear meets the head.
    RightEar,
    /// Middle of the head: the head frame's origin.
    Head,
}

/// Kind of an occluder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OccluderKind {
    /// Nothing.
    None,
    /// Glasses with clear lenses.
    Glasses,
    /// Glasses with dark lenses in a larger frame.
    Sunglasses,
    /// Cloth over nose, mouth and chin, with loops around the ears.
    SurgicalMask,
    /// Cloth around neck, chin and mouth.
    Scarf,
    /// Cloth over the skull, with a brim over the forehead.
    Cap,
    /// Felt over the skull, with a brim all around.
    Hat,
    /// A band around the head, over the forehead.
    HeadBand,
    /// Cups over the ears and a bow over the head.
    Headphones,
    /// A hand before the face, fingers up.
    Hand,
    /// A pole across the face.
    Bar,
    /// Hair that falls over the forehead.
    Fringe,
    /// A mesh of yours.
    Model,
}

impl OccluderKind {
    /// The name in recipes and records.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Glasses => "glasses",
            Self::Sunglasses => "sunglasses",
            Self::SurgicalMask => "surgical_mask",
            Self::Scarf => "scarf",
            Self::Cap => "cap",
            Self::Hat => "hat",
            Self::HeadBand => "head_band",
            Self::Headphones => "headphones",
            Self::Hand => "hand",
            Self::Bar => "bar",
            Self::Fringe => "fringe",
            Self::Model => "model",
        }
    }
}

/// Outline of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RimTable {
    /// A circle, nearly.
    Round,
    /// A rectangle with round corners.
    Rectangular,
}
