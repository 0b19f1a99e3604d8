//! `[[view]]` and `[[background]]`: from where a head is seen, and before what.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[view]]`: every combination of its angles is a viewpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ViewTable {
    /// Camera's place around the head: towards the subject's left, degrees, from -180 to 180.
    pub yaw_deg: Vec<f64>,
    /// Camera's place above the head, degrees, from -89 to 89.
    pub pitch_deg: Vec<f64>,
    /// Turn of the camera about its axis, counter-clockwise as the image shows the head, degrees.
    pub roll_deg: Vec<f64>,
    /// Vertical field of view, degrees, from 1 to 120.
    pub fov_y_deg: f64,
    /// Distance from the camera to the target, mm.
    pub distance_mm: f64,
    /// What the camera looks at, in the head's frame, mm.
    pub target_mm: [f64; 3],
    /// Motion of the image's content to the right and downwards, as a share of the image's height, each from -1 to 1: the
    /// camera's principal point moves, its direction does not.
    pub shift: [f64; 2],
    /// How rays come into the camera.
    pub projection: ProjectionTable,
    /// Diameter of the lens's opening, from 0, for a pinhole that is sharp everywhere, to 100 mm: 50 mm at f/2 have 25.
    /// Needs a number of `image.samples`, such as 32. Labels are those of the pinhole.
    pub aperture_mm: f64,
    /// Depth that is in focus, from 10 to 100,000 mm; that of the nearer eye if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_mm: Option<f64>,
}

/// How rays come into a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProjectionTable {
    /// Through one point: what is near looks large.
    #[default]
    Perspective,
    /// In parallel: everything is as large as `fov_y_deg` shows it at the target.
    Orthographic,
}

impl Default for ViewTable {
    fn default() -> Self {
        Self {
            yaw_deg: vec![0.0],
            pitch_deg: vec![0.0],
            roll_deg: vec![0.0],
            fov_y_deg: 18.0,
            distance_mm: 900.0,
            target_mm: [0.0, -18.0, 10.0],
            shift: [0.0; 2],
            projection: ProjectionTable::Perspective,
            aperture_mm: 0.0,
            focus_mm: None,
        }
    }
}

/// `[[background]]`: what is behind the head. Does not multiply: each image draws one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BackgroundTable {
    /// Kind of background.
    pub kind: BackgroundKind,
    /// How often it comes relative to the others.
    #[serde(default = "default_weight")]
    pub weight: f64,
    /// sRGB colour, from 0 to 255; of a gradient at the top.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[u8; 3]>,
    /// sRGB colour of a gradient at the bottom, from 0 to 255.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bottom: Option<[u8; 3]>,
    /// Softness of a room, from 0 to 0.2 of the image's side; 0.06 if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blur: Option<f64>,
    /// Pictures as globs, relative to the recipe: PNG, JPEG, WebP, BMP. Each image draws one, cut to its shape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub files: Option<Vec<String>>,
    /// Picture of an environment, as that of a light; that of the image's lighting if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Factor on the light of pictures and environments; 1 if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intensity: Option<f64>,
    /// Turn of an environment about the vertical axis, to the subject's left, from -360 to 360 degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<f64>,
}

/// Kind of a background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BackgroundKind {
    /// One colour.
    Color,
    /// From one colour at the top to another at the bottom.
    Gradient,
    /// A room out of focus, another one in each image.
    Room,
    /// Pictures of a folder.
    Images,
    /// Surroundings that turn with the camera.
    Environment,
}

fn default_weight() -> f64 {
    1.0
}
