//! The checked recipe: every value in range, names resolved, angles in radians, colours linear.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use facile_sim::{Pose, SolverKind};
use facile_trace::occluder::{Glasses, Model, Prop, PropKind};
use facile_trace::{EnvironmentMap, LightSource, Samples, Sensor};
use serde::Serialize;

use super::file::{ClothesTable, Encoding, Format, HairTable, RecipeFile, SubjectKind, Truth};
use crate::sampling::Sampling;

/// A checked recipe. The lists multiply: every combination of their entries is one image, unless samples are drawn.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Name of the dataset.
    pub name: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Folder to write.
    pub output: PathBuf,
    /// How the dataset is stored.
    pub formats: Vec<Format>,
    /// Number of images in each file of the formats that hold many in one.
    pub images_per_shard: u64,
    /// Whether to write a COCO file.
    pub coco: bool,
    /// Size and encoding of images, and what comes with them.
    pub image: ImageSettings,
    /// Whose faces.
    pub subjects: Subjects,
    /// Whose hair is which.
    pub hair: HairSettings,
    /// Whose shirt has which colour.
    pub clothes: ClothesTable,
    /// How faces are brought to equilibrium.
    pub solver: SolverKind,
    /// What the camera does to an image's light.
    pub sensor: Sensor,
    /// Quality of the JPEG that images go through, 1 to 100; `None` for none.
    pub jpeg_quality: Option<u8>,
    /// Expressions, each at one intensity.
    pub expressions: Vec<Expression>,
    /// Things in front of the face.
    pub occluders: Vec<Occluder>,
    /// Viewpoints.
    pub views: Vec<View>,
    /// Lightings.
    pub lightings: Vec<Lighting>,
    /// What is behind the head; the image's colour if there are none.
    pub backgrounds: Vec<WeightedBackground>,
    /// How samples are drawn; `None` for every combination of the lists.
    pub sampling: Option<Sampling>,
    /// The tables this was made from.
    pub file: RecipeFile,
}

impl Recipe {
    /// Number of images in each file, if any format holds many in one.
    pub fn images_per_file(&self) -> Option<u64> {
        let many = self.formats.iter().any(|f| *f != Format::Folder);
        many.then_some(self.images_per_shard)
    }
}

/// Size and encoding of images, and what comes with them.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageSettings {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// File format.
    pub encoding: Encoding,
    /// JPEG quality, 1 to 100.
    pub quality: u8,
    /// Ground truth to write, sorted, each once.
    pub truth: Vec<Truth>,
    /// Names of landmark schemes, in the order of the recipe.
    pub landmarks: Vec<String>,
    /// Samples per pixel.
    pub samples: Samples,
    /// sRGB colour behind the head.
    pub background: [u8; 3],
    /// What the box with margin adds on each side of the face's square, as a share of its side.
    pub box_margin: f64,
}

impl ImageSettings {
    /// Whether a kind of ground truth is asked for.
    pub fn wants(&self, truth: Truth) -> bool {
        self.truth.contains(&truth)
    }
}

/// Whose faces: scans first, then built-in subjects, then sampled identities.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Subjects {
    /// Scan files.
    pub scans: Vec<PathBuf>,
    /// Names of built-in subjects.
    pub builtin: Vec<String>,
    /// Number of sampled identities.
    pub sampled: u64,
    /// Whether the light baked into the colours of scans is evened out.
    pub delight: bool,
}

/// Whose hair is which.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HairSettings {
    /// Subjects that get hair and lashes.
    pub on: Vec<SubjectKind>,
    /// Styles to draw from, `none` among them perhaps; empty for what suits.
    pub styles: Vec<String>,
    /// sRGB colours to draw from; empty for the person's own.
    pub colors: Vec<[u8; 3]>,
    /// Whether these subjects get lashes.
    pub lashes: bool,
}

impl From<&HairTable> for HairSettings {
    fn from(table: &HairTable) -> Self {
        Self {
            on: table.on.clone(),
            styles: table.styles.clone(),
            colors: table.colors.clone(),
            lashes: table.lashes,
        }
    }
}

impl Default for HairSettings {
    fn default() -> Self {
        Self::from(&HairTable::default())
    }
}

/// Where one subject comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum SubjectSource {
    /// A file, to be registered.
    Scan {
        /// The file.
        file: PathBuf,
    },
    /// A subject that ships with the program, to be registered like a file.
    Builtin {
        /// Its name.
        name: String,
    },
    /// A draw from the identity model.
    Sampled {
        /// Number of the random stream.
        number: u64,
    },
}

impl Subjects {
    /// Number of subjects.
    pub fn len(&self) -> u64 {
        (self.scans.len() + self.builtin.len()) as u64 + self.sampled
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Subject number `i`, below [`Self::len`].
    pub fn get(&self, i: u64) -> SubjectSource {
        let (scans, builtin) = (self.scans.len() as u64, self.builtin.len() as u64);
        if i < scans {
            let file = self.scans[i as usize].clone();
            SubjectSource::Scan { file }
        } else if i < scans + builtin {
            let name = self.builtin[(i - scans) as usize].clone();
            SubjectSource::Builtin { name }
        } else {
            let number = i - scans - builtin;
            SubjectSource::Sampled { number }
        }
    }
}

/// An expression at one intensity.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    /// Name in records.
    pub name: String,
    /// In `(0, 1]`.
    pub intensity: f64,
    /// Intensities of FACS action units as the recipe gives them, times the intensity.
    pub action_units: BTreeMap<String, f64>,
    /// What the face does, at this intensity.
    pub pose: Pose,
}

/// Something in front of the face.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Occluder {
    /// Nothing.
    None,
    /// Glasses.
    Glasses(Glasses),
    /// Dark glasses.
    Sunglasses(Glasses),
    /// A user's mesh.
    Model(Model),
    /// Anything else that is worn or held.
    #[serde(untagged)]
    Prop(Prop),
}

impl Occluder {
    /// Whether it is worn over the hair.
    pub fn presses_hair(&self) -> bool {
        let Self::Prop(prop) = self else {
            return false;
        };
        matches!(
            prop.kind,
            PropKind::Cap | PropKind::Hat | PropKind::HeadBand | PropKind::Headphones
        )
    }

    /// The occluder with a colour for what was given none: a fringe has that of the person's hair.
    #[must_use]
    pub fn colored(mut self, hair: Option<[u8; 3]>) -> Self {
        if let Self::Prop(prop) = &mut self {
            let usual = match prop.kind {
                PropKind::Fringe => hair,
                _ => None,
            };
            let color = prop.color.or(usual);
            prop.color = Some(color.unwrap_or(prop.kind.usual_color()));
        }
        self
    }

    /// The name of its kind in recipes and records.
    pub fn kind(&self) -> String {
        let value = serde_json::to_value(self).unwrap_or_default();
        value["kind"].as_str().unwrap_or("none").to_owned()
    }
}

/// A background and how often it comes.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightedBackground {
    /// Relative to the others, at least 0.
    pub weight: f64,
    /// The background.
    pub background: Background,
}

/// What is behind the head. Colours are sRGB.
#[derive(Clone, Debug, PartialEq)]
pub enum Background {
    /// One colour.
    Color([u8; 3]),
    /// A vertical gradient.
    Gradient {
        /// At the top.
        top: [u8; 3],
        /// At the bottom.
        bottom: [u8; 3],
    },
    /// A drawn room.
    Room {
        /// Softness, a share of the image's side.
        blur: f64,
    },
    /// Pictures, of which one is drawn.
    Images {
        /// The files, at least one.
        files: Vec<PathBuf>,
        /// Factor on their light.
        intensity: f32,
    },
    /// Surroundings.
    Environment {
        /// File and picture; those of the lighting if there are none.
        map: Option<(String, Arc<EnvironmentMap>)>,
        /// To the subject's left, rad.
        turn: f32,
        /// Factor on its light.
        intensity: f32,
    },
}

/// A viewpoint: the camera on a sphere around its target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Towards the subject's left, rad.
    pub yaw: f64,
    /// Upwards, rad.
    pub pitch: f64,
    /// About the camera's axis, rad; positive turns the head counter-clockwise in the image.
    pub roll: f64,
    /// Vertical field of view, rad.
    pub fov_y: f64,
    /// From the camera to the target, mm.
    pub distance: f64,
    /// What the camera looks at, mm.
    pub target: [f64; 3],
    /// Motion of the content to the right and downwards, shares of the image's height.
    pub shift: [f64; 2],
    /// How rays come in.
    pub optics: Optics,
}

/// How rays come into the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Optics {
    /// Through one point.
    Pinhole,
    /// In parallel; what the image's height spans at the target it spans everywhere.
    Orthographic,
    /// Through a lens.
    Lens {
        /// Diameter of its opening, mm.
        aperture: f64,
        /// Depth in focus, mm; that of the nearer eye if not given.
        focus: Option<f64>,
    },
}

/// Light sources that shine at the same time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Lighting {
    /// Name in records.
    pub name: String,
    /// The sources.
    pub sources: Vec<LightSource>,
}
