//! The recipe as it stands in the file: one struct per table, every key documented, unknown keys refused.
//!
//! The doc comments here are the descriptions in the JSON Schema that `facile schema` prints. Angles are in degrees,
//! as their names say; lengths in mm. What the values must satisfy is checked in `check`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod expression;
mod image;
mod light;
mod occluder;
pub mod sampling;
mod subject;
mod view;

pub use expression::{ExpressionTable, SimulationTable, SolverWord};
pub use image::{Encoding, ImageTable, SamplesTable, SensorTable, Truth};
pub use light::{Attach, LightTable, SourceKind, SourceTable};
pub use occluder::{AnchorTable, OccluderKind, OccluderTable, RimTable};
pub use sampling::SamplingTable;
pub use subject::{ClothesTable, HairTable, SubjectKind, SubjectsTable};
pub use view::{BackgroundKind, BackgroundTable, ProjectionTable, ViewTable};

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
    /// Hair of the heads that the program makes; scans bring their own.
    #[serde(default)]
    pub hair: HairTable,
    /// Shirts of the heads that the program makes.
    #[serde(default)]
    pub clothes: ClothesTable,
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
    /// What is behind the head: each image draws one of these; the colour `image.background` if there are none.
    #[serde(default, rename = "background")]
    pub backgrounds: Vec<BackgroundTable>,
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

fn default_output() -> String {
    "out".to_owned()
}

fn default_formats() -> Vec<Format> {
    vec![Format::Folder]
}

fn default_images_per_shard() -> i64 {
    1000
}
