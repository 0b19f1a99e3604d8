//! The record of an image: one line of `annotations.jsonl`.
//!
//! Units are in the names. Image positions are in pixels from the upper left corner; the centre of the first pixel is
//! `(0.5, 0.5)`. Positions in mm are in the head's frame, which is the world: `x` to the subject's left, `y` up, `z` out
//! of the face. The camera's axes are `OpenCV`'s: `x` right, `y` down, `z` forward.

use std::collections::BTreeMap;

use facile_core::{Attributes, Matrix3, Point3, Vector3};
use facile_flow::RegistrationReport;
use facile_sim::{Certificate, Sides};
use facile_trace::LightSource;
use facile_trace::hair::Hair;
use serde::Serialize;

use crate::pipeline::BackgroundRecord;
use crate::recipe::Occluder;

/// Decimals of image positions and lengths in records: a tenth of a micrometre, a ten-thousandth of a pixel.
const DECIMALS: f64 = 1e4;

/// Everything that is known of an image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Record {
    /// Number of the sample.
    pub index: u64,
    /// The image's file within the dataset.
    pub image: String,
    /// Columns and rows.
    pub size: [u32; 2],
    /// Hash of the recipe.
    pub recipe: String,
    /// Whose face.
    pub subject: SubjectRecord,
    /// What the face does.
    pub expression: ExpressionRecord,
    /// The lighting.
    pub light: LightRecord,
    /// The camera.
    pub camera: CameraRecord,
    /// How the head is turned as the camera sees it.
    pub head_pose: HeadPose,
    /// What is in front of the face.
    pub occluder: Occluder,
    /// What is behind the head.
    pub background: BackgroundRecord,
    /// Box around the face, occluded or not, parts outside the image included: left, top, right, bottom, px. The face is
    /// the skin in front of the ears from the hairline to the chin.
    pub face_box_px: [f64; 4],
    /// The smallest square around that box, with the same middle.
    pub face_square_px: [f64; 4],
    /// That square, larger on each side by the recipe's `box_margin` times its side.
    pub face_margin_px: [f64; 4],
    /// Landmarks by scheme.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub landmarks: BTreeMap<String, LandmarkRecord>,
    /// Maps by kind of truth. Images that differ in light alone share theirs.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub maps: BTreeMap<&'static str, MapRecord>,
}

/// Whose face an image shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SubjectRecord {
    /// Name, unique in the dataset.
    pub id: String,
    /// `scan`, `builtin` or `sampled`.
    pub kind: &'static str,
    /// What is known of the person.
    pub attributes: Attributes,
    /// How well the scan was registered; `null` for sampled subjects.
    pub registration: Option<RegistrationReport>,
    /// Style and colour of the hair; none but what the skin shows if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hair: Option<Hair>,
    /// sRGB colour of the shirt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clothes: Option<[u8; 3]>,
}

/// What a face does.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExpressionRecord {
    /// Name in the recipe.
    pub name: String,
    /// Intensity in the recipe.
    pub intensity: f64,
    /// Contraction of each muscle, left and right, in `[0, 1]`; zeros included.
    pub contractions: BTreeMap<String, Sides>,
    /// Intensities of the action units that the recipe names.
    pub action_units: BTreeMap<String, f64>,
    /// The jaw.
    pub jaw: JawRecord,
    /// Yaw of the gaze towards the subject's left and pitch upwards, degrees.
    pub gaze_deg: [f64; 2],
    /// How far from equilibrium the face is; `null` for the face at rest, which is not simulated.
    pub equilibrium: Option<Certificate>,
}

/// Position of the jaw.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JawRecord {
    /// Opening, degrees.
    pub open_deg: f64,
    /// Forward motion, mm.
    pub protrusion_mm: f64,
    /// Motion towards the subject's left, mm.
    pub lateral_mm: f64,
}

/// A lighting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LightRecord {
    /// Name in the recipe.
    pub name: String,
    /// Its sources.
    pub sources: Vec<LightSource>,
}

/// The camera: `x_camera = R x_head + t`, `pixel = K x_camera`, where an orthographic camera takes 1 for the third
/// component of `x_camera`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[expect(non_snake_case, reason = "the names of the field")]
pub struct CameraRecord {
    /// Intrinsics, px, by rows.
    pub K: [[f64; 3]; 3],
    /// Rotation, by rows.
    pub R: [[f64; 3]; 3],
    /// Translation, mm.
    pub t_mm: [f64; 3],
    /// `orthographic`; perspective if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projection: Option<&'static str>,
    /// Diameter of the lens's opening, mm; a pinhole's if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aperture_mm: Option<f64>,
    /// Depth that is in focus, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_mm: Option<f64>,
}

/// The head's turn against a camera that looks it in the face.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HeadPose {
    /// To the image's left, which is the subject's right, degrees.
    pub yaw_deg: f64,
    /// Upwards, degrees.
    pub pitch_deg: f64,
    /// Counter-clockwise in the image, degrees.
    pub roll_deg: f64,
}

/// The landmarks of one scheme.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LandmarkRecord {
    /// Positions in the image, px.
    pub px: Vec<[f64; 2]>,
    /// Positions on the face, mm, head frame.
    pub mm: Vec<[f64; 3]>,
    /// Whether each is seen, or what hides it.
    pub visibility: Vec<&'static str>,
}

/// A map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapRecord {
    /// Its file within the dataset.
    pub file: String,
    /// Depth only: steps of the 16-bit value for each mm along the optical axis; the value 0 means nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_per_mm: Option<f64>,
}

impl Record {
    /// The record as one line of JSON.
    ///
    /// # Panics
    /// Never: names and finite numbers are plain JSON.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("names and numbers are plain JSON")
    }
}

/// Rounds to the decimals that records keep.
pub(crate) fn rounded(v: f64) -> f64 {
    // Adding 0 turns -0 into 0.
    (v * DECIMALS).round() / DECIMALS + 0.0
}

/// A point as records hold it.
pub(crate) fn rounded_point(p: &Point3) -> [f64; 3] {
    [p.x, p.y, p.z].map(rounded)
}

/// A matrix by rows, not rounded.
pub(crate) fn rows(m: &Matrix3) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

impl CameraRecord {
    /// The record of a camera.
    pub fn of(camera: &facile_trace::Camera) -> Self {
        let mut k = *camera.intrinsics();
        if camera.is_orthographic() {
            let scale = 1.0 / camera.scale_depth(0.0);
            k.column_mut(0).scale_mut(scale);
            k.column_mut(1).scale_mut(scale);
        }
        let lens = camera.lens();
        Self {
            K: rows(&k),
            R: rows(camera.camera_from_world()),
            t_mm: (*camera.translation()).into(),
            projection: camera.is_orthographic().then_some("orthographic"),
            aperture_mm: lens.map(|l| rounded(2.0 * l.radius_mm)),
            focus_mm: lens.map(|l| rounded(l.focus_mm)),
        }
    }
}

impl HeadPose {
    /// The head's turn as a camera sees it, from `R` of the camera.
    pub fn of(camera_from_head: &Matrix3) -> Self {
        // Out of the face, and up the head, in the camera's axes.
        let face: Vector3 = camera_from_head.column(2).into();
        let crown: Vector3 = camera_from_head.column(1).into();
        let yaw = libm::atan2(-face.x, -face.z);
        let pitch = libm::asin((-face.y).clamp(-1.0, 1.0));
        // What is up in the image for a head of this yaw and pitch without roll, and to its right.
        let up = (-Vector3::y() - face * (-Vector3::y()).dot(&face))
            .try_normalize(1e-12)
            .unwrap_or(crown);
        let right = up.cross(&face);
        let roll = libm::atan2(-crown.dot(&right), crown.dot(&up));
        Self {
            yaw_deg: rounded(yaw.to_degrees()),
            pitch_deg: rounded(pitch.to_degrees()),
            roll_deg: rounded(roll.to_degrees()),
        }
    }
}
