//! `[[light]]`: lightings and their sources.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[light]]`: one lighting, made of sources that shine at the same time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LightTable {
    /// Name in records.
    pub name: String,
    /// The sources.
    pub sources: Vec<SourceTable>,
}

/// One source of light. Intensity 1 lights a white surface that faces the source to 1; point and spot sources do so at
/// 1,000 mm and fall off with the square of the distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SourceTable {
    /// Kind of source.
    pub kind: SourceKind,
    /// Place of a point or spot source, or of the middle of an area source, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<[f64; 3]>,
    /// Where the middle of a spot's cone goes, or what an area source faces, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<[f64; 3]>,
    /// Direction in which the light of a directional source travels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// Strength.
    #[serde(default = "default_intensity")]
    pub intensity: f64,
    /// Linear RGB, each from 0 to 1; white if not given.
    #[serde(default = "default_light_color")]
    pub color: [f64; 3],
    /// Angle between the middle and the end of a spot's cone, over 0 and up to 90 degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle_deg: Option<f64>,
    /// Share of a spot's angle over which the light fades to 0, from 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub softness: Option<f64>,
    /// Width and height of an area source, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<[f64; 2]>,
    /// Points that stand for an area source, from 1 to 256; 16 if not given. Its shadows have as many steps, and rendering
    /// takes as many shadow rays. Lamps that stand for an environment, from 0, for smooth light without shadows, to 1024; 32
    /// if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<u32>,
    /// Linear RGB of a hemisphere's ground, each from 0 to 1; `color` is its sky.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground: Option<[f64; 3]>,
    /// What a white surface of unit normal `n` gets from a spherical harmonic source, linear RGB: the constant, then the
    /// factors of `x, y, z, xy, yz, zx, 3 z^2 - 1, x^2 - y^2` of `n`. Nine of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coefficients: Option<Vec<[f64; 3]>>,
    /// Picture of an environment source, relative to the recipe: equirectangular, its middle behind a head that looks at the
    /// viewer; Radiance HDR, `OpenEXR`, PNG, JPEG or WebP.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Turn of an environment or spherical harmonic about the head's vertical axis, to the subject's left, from -360 to 360
    /// degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<f64>,
    /// What the source is fixed to; the head if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attach: Option<Attach>,
}

/// Kind of a light source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SourceKind {
    /// Shines from one point in all directions.
    Point,
    /// Shines from far away in one direction.
    Directional,
    /// Shines evenly from everywhere, without shadows.
    Ambient,
    /// Shines from one point within a cone.
    Spot,
    /// Shines from a rectangle to its front: soft shadows.
    Area,
    /// A sky above and a ground below, without shadows.
    Hemisphere,
    /// Changes smoothly with direction, without shadows: nine numbers a channel.
    SphericalHarmonic,
    /// A picture of the surroundings.
    Environment,
}

impl SourceKind {
    /// The name in recipes and records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Directional => "directional",
            Self::Ambient => "ambient",
            Self::Spot => "spot",
            Self::Area => "area",
            Self::Hemisphere => "hemisphere",
            Self::SphericalHarmonic => "spherical_harmonic",
            Self::Environment => "environment",
        }
    }
}

/// What a light source is fixed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Attach {
    /// The head's frame: x to the subject's left, y up, z out of the face.
    Head,
    /// The camera's frame: x right and y up in the image, z towards the viewer, origin at the camera.
    Camera,
}

fn default_intensity() -> f64 {
    1.0
}

fn default_light_color() -> [f64; 3] {
    [1.0; 3]
}
