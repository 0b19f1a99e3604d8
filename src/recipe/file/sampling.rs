//! `[sampling]` as it stands in the file: what is drawn instead of multiplied.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[sampling]`: a number of samples drawn from distributions instead of the product of all lists. The lists of the
/// recipe are then choices, and the numbers below vary the entry that was chosen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SamplingTable {
    /// Number of images, at least 1.
    pub count: i64,
    /// How the draws fill their space.
    #[serde(default)]
    pub pattern: PatternWord,
    /// Poses of one subject that follow each other, at least 1. If not given, as many as let every subject come once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses_per_subject: Option<i64>,
    /// Views of each pose, at least 1: they share its equilibrium.
    #[serde(default = "one")]
    pub views_per_pose: i64,
    /// Lightings of each view, at least 1: they share its rays and maps.
    #[serde(default = "one")]
    pub lights_per_view: i64,
    /// How often a draw is tried until it meets the constraints, from 1 to 1,000,000; then the sample fails.
    #[serde(default = "default_tries")]
    pub max_tries: i64,
    /// What the face does.
    #[serde(default)]
    pub expression: SampledExpressionTable,
    /// From where it is seen.
    #[serde(default)]
    pub view: SampledViewTable,
    /// How it is lit.
    #[serde(default)]
    pub light: SampledLightTable,
    /// What is in front of it.
    #[serde(default)]
    pub occluder: SampledOccluderTable,
    /// What must hold for the numbers that are drawn.
    #[serde(default, rename = "constraint")]
    pub constraints: Vec<ConstraintTable>,
}

/// How draws fill their space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PatternWord {
    /// Independent draws.
    #[default]
    Random,
    /// A Latin hypercube over all samples: each number comes once from each of as many equal shares as there are draws.
    Stratified,
    /// An Owen-scrambled Sobol sequence: the beginning of the dataset covers everything evenly, too.
    Sobol,
}

/// A distribution of a number: exactly one of `uniform`, `normal` and `choice`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DistributionTable {
    /// Smallest and largest value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uniform: Option<[f64; 2]>,
    /// Mean and standard deviation of a normal distribution that is cut off at `within`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal: Option<[f64; 2]>,
    /// Smallest and largest value of a normal distribution; all that is allowed if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within: Option<[f64; 2]>,
    /// Values to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub choice: Option<Vec<f64>>,
    /// How often each value of `choice` comes relative to the others; equally if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<Vec<f64>>,
}

/// `[sampling.expression]`: an entry of `[[expression]]`, and what is added to it. Sums are cut to what a face can do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SampledExpressionTable {
    /// How often an expression comes relative to the others, by its name; 1 if not given.
    pub weights: BTreeMap<String, f64>,
    /// Intensity of the expression, from 0 to 1, instead of its `intensities`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intensity: Option<DistributionTable>,
    /// Contraction added to each of these muscles or groups, from 0 to 1, of one side with `.left` or `.right`.
    pub muscles: BTreeMap<String, DistributionTable>,
    /// Opening added to the jaw's, from 0 to 40 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jaw_deg: Option<DistributionTable>,
    /// Forward motion added to the jaw's, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jaw_protrusion_mm: Option<DistributionTable>,
    /// Motion to the subject's left added to the jaw's, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jaw_lateral_mm: Option<DistributionTable>,
    /// Turn of the eyes to the subject's left added to the expression's, from -40 to 40 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaze_yaw_deg: Option<DistributionTable>,
    /// Turn of the eyes upwards added to the expression's, from -40 to 40 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaze_pitch_deg: Option<DistributionTable>,
}

/// `[sampling.view]`: an entry of `[[view]]`, with these numbers instead of its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SampledViewTable {
    /// Camera's place around the head, towards the subject's left, from -180 to 180 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub yaw_deg: Option<DistributionTable>,
    /// Camera's place above the head, from -89 to 89 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_deg: Option<DistributionTable>,
    /// Turn of the camera about its axis, from -180 to 180 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roll_deg: Option<DistributionTable>,
    /// Vertical field of view, which is the focal length, from 1 to 120 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_y_deg: Option<DistributionTable>,
    /// Distance from the camera to the target, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distance_mm: Option<DistributionTable>,
    /// Motion of the image's content to the right, as a share of the image's height, from -1 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift_x: Option<DistributionTable>,
    /// Motion of the image's content downwards, as a share of the image's height, from -1 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shift_y: Option<DistributionTable>,
    /// How often rays come in through one point and how often in parallel; as the view says if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projection: Option<ProjectionWeights>,
    /// Diameter of the lens's opening, from 0, for a pinhole, to 100 mm. Views of parallel rays have no lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub aperture_mm: Option<DistributionTable>,
    /// Depth in focus of views with a lens, from 10 to 100,000 mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focus_mm: Option<DistributionTable>,
}

/// How often each projection comes relative to the other; one must be over 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ProjectionWeights {
    /// Through one point.
    pub perspective: f64,
    /// In parallel.
    pub orthographic: f64,
}

/// `[sampling.light]`: an entry of `[[light]]`, turned, moved and made stronger or weaker as a whole. Sources that are
/// fixed to the camera stay in their places.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SampledLightTable {
    /// How often a light comes relative to the others, by its name; 1 if not given.
    pub weights: BTreeMap<String, f64>,
    /// Factor of the strength of all its sources, from 0 to 1,000.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intensity: Option<DistributionTable>,
    /// Turn of positions and directions about the head's vertical axis, to the subject's left, from -180 to 180 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<DistributionTable>,
    /// Motion of its positions to the subject's left, after the turn, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<DistributionTable>,
    /// Motion of its positions upwards, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<DistributionTable>,
    /// Motion of its positions away from the face, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_mm: Option<DistributionTable>,
}

/// `[sampling.occluder]`: an entry of `[[occluder]]`, varied as far as its kind has what is drawn.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SampledOccluderTable {
    /// How often an occluder comes relative to the others, by its kind; 1 if not given.
    pub weights: BTreeMap<String, f64>,
    /// Size relative to a usual one, from 0.7 to 1.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<DistributionTable>,
    /// Thickness of the rims of glasses, from 0.5 to 8 mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rim_mm: Option<DistributionTable>,
    /// Motion of a hand, bar or model to the subject's left, from -150 to 150 mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x_mm: Option<DistributionTable>,
    /// Motion of anything but glasses upwards, from -150 to 150 mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y_mm: Option<DistributionTable>,
    /// Turn of a hand, bar, model, or a cap's brim, from -180 to 180 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turn_deg: Option<DistributionTable>,
    /// sRGB colours of frames, cloth and so on to choose from, each from 0 to 255.
    pub colors: Vec<[u8; 3]>,
}

/// `[[sampling.constraint]]`: what breaks it is drawn again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ConstraintTable {
    /// Names of numbers that are drawn: `intensity`, `jaw_deg`, `muscles.risorius`, `yaw_deg`, `light.turn_deg`,
    /// `occluder.size` and so on.
    pub of: Vec<String>,
    /// Drop their signs.
    pub absolute: bool,
    /// Smallest sum.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_sum: Option<f64>,
    /// Largest sum.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_sum: Option<f64>,
    /// Only where the entry of a list is one of these: names by `expression`, `light` or `occluder` (kinds).
    pub when: BTreeMap<String, Vec<String>>,
}

fn one() -> i64 {
    1
}

fn default_tries() -> i64 {
    1000
}
