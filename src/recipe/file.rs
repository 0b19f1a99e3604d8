//! The recipe as it stands in the file: one struct per table, every key documented, unknown keys refused.
//!
//! The doc comments here are the descriptions in the JSON Schema that `facile schema` prints. Angles are in degrees,
//! as their names say; lengths in mm. What the values must satisfy is checked in [`super::check`].

use std::collections::BTreeMap;

use facile_sim::SolverKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sampling_file::SamplingTable;

/// A dataset: what is in it, and how it is written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Facile recipe")]
pub struct RecipeFile {
    /// Name, seed, place and format.
    pub dataset: DatasetTable,
    /// Size and encoding of the images, and the ground truth beside them.
    #[serde(default)]
    pub image: ImageTable,
    /// Whose faces.
    pub subjects: SubjectsTable,
    /// How faces are brought to equilibrium.
    #[serde(default)]
    pub simulation: SimulationTable,
    /// What the camera does to the light of an image; maps and labels are not touched.
    #[serde(default)]
    pub sensor: SensorTable,
    /// Expressions; the neutral face if there are none.
    #[serde(default, rename = "expression")]
    pub expressions: Vec<ExpressionTable>,
    /// Lightings; a key light with a fill if there are none.
    #[serde(default, rename = "light")]
    pub lights: Vec<LightTable>,
    /// Viewpoints; a frontal one if there are none.
    #[serde(default, rename = "view")]
    pub views: Vec<ViewTable>,
    /// Things in front of the face; nothing if there are none.
    #[serde(default, rename = "occluder")]
    pub occluders: Vec<OccluderTable>,
    /// Draws a number of samples instead of multiplying the lists.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sampling: Option<SamplingTable>,
}

/// `[dataset]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DatasetTable {
    /// Name of the dataset.
    pub name: String,
    /// Seed of everything random; the same seed gives the same bytes.
    #[serde(default)]
    pub seed: u64,
    /// Folder to write, relative to the current folder; `--output` overrides it.
    #[serde(default = "default_output")]
    pub output: String,
    /// How the dataset is stored.
    #[serde(default = "default_formats")]
    pub formats: Vec<Format>,
    /// Number of images in each file of the formats that hold many in one, from 1 to 1,000,000.
    #[serde(default = "default_images_per_shard")]
    pub images_per_shard: i64,
    /// Write `coco.json` too: boxes, keypoints and the mask of the visible face. Needs the truth `landmarks` and `segments`.
    #[serde(default)]
    pub coco: bool,
}

/// How a dataset is stored.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// A folder of images and maps with one line of JSON for each image.
    Folder,
    /// Tar files in the order and naming of `WebDataset`: image, record and maps of a sample side by side.
    Webdataset,
    /// Tables with the images inside, as Hugging Face `datasets` loads them, labels and classes typed.
    Parquet,
}

/// `[image]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ImageTable {
    /// Width and height in pixels, each from 8 to 8192.
    pub size: [i64; 2],
    /// File format of the images. Maps are always PNG.
    pub encoding: Encoding,
    /// Quality of JPEG images, from 1 to 100.
    pub quality: i64,
    /// Ground truth to write.
    pub truth: Vec<Truth>,
    /// Landmark schemes to write, by name: `five`, `ibug51`, `ibug68`, `wflw98`, `dense` (every vertex of the reference
    /// mesh); `ibug68_contour` and `wflw98_contour` have the jaw on the visible contour.
    pub landmarks: Vec<String>,
    /// Samples per pixel, from 1 to 256, or `adaptive`: 16 where neighbouring pixels differ, 1 elsewhere.
    pub samples: SamplesTable,
    /// sRGB colour behind the head, from 0 to 255.
    pub background: [u8; 3],
    /// What `face_margin_px` adds on each side of the square around the face, as a share of its side, from 0 to 2.
    pub box_margin: f64,
}

impl Default for ImageTable {
    fn default() -> Self {
        Self {
            size: [256, 256],
            encoding: Encoding::Png,
            quality: 92,
            truth: vec![Truth::Landmarks],
            landmarks: vec!["ibug68".to_owned()],
            samples: SamplesTable::Word("adaptive".to_owned()),
            background: [125, 134, 142],
            box_margin: 0.25,
        }
    }
}

/// A number of samples or the word `adaptive`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum SamplesTable {
    /// The same number in every pixel.
    Count(i64),
    /// `adaptive`.
    Word(String),
}

/// File format of images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// Lossless.
    Png,
    /// Lossy, small.
    Jpeg,
    /// Lossless WebP.
    Webp,
}

impl Encoding {
    /// Ending of the file's name.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
            Self::Webp => "webp",
        }
    }
}

/// A kind of ground truth.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Truth {
    /// Landmarks in pixels and mm, visible or what hides them.
    Landmarks,
    /// Class of the surface at each pixel, 8 bit.
    Segments,
    /// Distance along the optical axis, 16 bit.
    Depth,
    /// Unit normals in the camera's frame, 8-bit RGB.
    Normals,
    /// Where the head is seen, directly or through a lens: 255, elsewhere 0.
    Visibility,
    /// 0 no head, 1 seen, 2 covered by an occluder, 3 seen through something transparent.
    Occlusion,
    /// Class of the surface at each pixel as if there were no occluders, 8 bit: the amodal mask of the face.
    Amodal,
    /// Classes and distances of the first four surfaces of each pixel, the nearest on top, the others below it in the same
    /// files `layers` (8 bit) and `layer_depth` (16 bit): what lies under glasses, masks and hair.
    Layers,
    /// Share of each pixel that shows any surface, 8 bit: alpha.
    Coverage,
}

/// `[subjects]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SubjectsTable {
    /// Scan files (OBJ, PLY, GLB) as globs, relative to the recipe.
    pub scans: Vec<String>,
    /// Built-in subjects by name, or `all`.
    pub builtin: Vec<String>,
    /// Number of new identities to draw from the identity model.
    pub sampled: i64,
    /// Even out the light that is baked into the colours of scans.
    pub delight: bool,
}

/// `[simulation]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationTable {
    /// The solver. All reach the same equilibrium; `quasi_static` is by far the fastest.
    pub solver: SolverWord,
}

/// `[sensor]`: blur, then brightness, then noise. Nothing is changed by default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorTable {
    /// Brightness in stops, each of which doubles the light, from -10 to 10.
    pub exposure_stops: f64,
    /// Gain of red, green and blue, each from 0 to 10.
    pub white_balance: [f64; 3],
    /// Standard deviation of the lens's blur, from 0 to 20 px.
    pub blur_px: f64,
    /// Variance of the noise over the light's value, where white is 1, from 0 to 1: 0.0005 for daylight, 0.005 for a dim
    /// room.
    pub photon_noise: f64,
    /// Standard deviation of the noise in the dark, from 0 to 1.
    pub read_noise: f64,
}

impl Default for SensorTable {
    fn default() -> Self {
        Self {
            exposure_stops: 0.0,
            white_balance: [1.0; 3],
            blur_px: 0.0,
            photon_noise: 0.0,
            read_noise: 0.0,
        }
    }
}

/// Name of a solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SolverWord {
    /// Minimises the energy, contact as a bound.
    #[default]
    QuasiStatic,
    /// The paper's damped motion, followed until it rests.
    Verlet,
    /// Motion that is stopped whenever it goes uphill.
    Fire,
}

impl From<SolverWord> for SolverKind {
    fn from(word: SolverWord) -> Self {
        match word {
            SolverWord::QuasiStatic => Self::QuasiStatic,
            SolverWord::Verlet => Self::Verlet,
            SolverWord::Fire => Self::Fire,
        }
    }
}

/// `[[expression]]`: muscles, action units, jaw and gaze add up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExpressionTable {
    /// Name in records. Alone it selects a built-in expression.
    pub name: String,
    /// Each intensity, over 0 and up to 1, makes an expression of its own: contractions, action units, jaw and gaze times
    /// the intensity.
    #[serde(default = "default_intensities")]
    pub intensities: Vec<f64>,
    /// Contraction from 0 to 1 of each muscle or group of muscles, of one side with `.left` or `.right` after the name.
    #[serde(default)]
    pub muscles: BTreeMap<String, f64>,
    /// Intensity from 0 to 1 of each FACS action unit, such as `AU12`, of one side with `.left` or `.right`.
    #[serde(default)]
    pub action_units: BTreeMap<String, f64>,
    /// Opening of the jaw, from 0 to 40 degrees.
    #[serde(default)]
    pub jaw_deg: f64,
    /// Motion of the jaw forwards, mm.
    #[serde(default)]
    pub jaw_protrusion_mm: f64,
    /// Motion of the jaw to the subject's left, mm.
    #[serde(default)]
    pub jaw_lateral_mm: f64,
    /// Turn of the eyes to the subject's left, from -40 to 40 degrees.
    #[serde(default)]
    pub gaze_yaw_deg: f64,
    /// Turn of the eyes upwards, from -40 to 40 degrees.
    #[serde(default)]
    pub gaze_pitch_deg: f64,
}

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
    /// takes as many shadow rays.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<u32>,
    /// Linear RGB of a hemisphere's ground, each from 0 to 1; `color` is its sky.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground: Option<[f64; 3]>,
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
        }
    }
}

/// `[[occluder]]`: keys that are not given are the kind's own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OccluderTable {
    /// Kind of occluder.
    pub kind: OccluderKind,
    /// Outline of the lenses of glasses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<RimTable>,
    /// sRGB colour of the frame of glasses or of the cloth, from 0 to 255.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[u8; 3]>,
    /// Linear RGB share of light that passes a lens, each from 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tint: Option<[f64; 3]>,
    /// Thickness of the rims of glasses, from 0.5 to 8 mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rim_mm: Option<f64>,
    /// Size of the lenses relative to usual ones, from 0.7 to 1.3.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<f64>,
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

fn default_output() -> String {
    "out".to_owned()
}

fn default_formats() -> Vec<Format> {
    vec![Format::Folder]
}

fn default_images_per_shard() -> i64 {
    1000
}

fn default_intensities() -> Vec<f64> {
    vec![1.0]
}

fn default_intensity() -> f64 {
    1.0
}

fn default_light_color() -> [f64; 3] {
    [1.0; 3]
}
