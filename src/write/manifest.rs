//! `manifest.json`: what a dataset is, from which recipe and program, and what failed.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::plan::Grid;
use crate::recipe::Recipe;
use crate::recipe::file::Format;
use crate::units::{Part, Units};

/// Name of the manifest in a dataset.
pub const MANIFEST: &str = "manifest.json";

/// Names of classes, in the order of their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Labels {
    /// Expressions.
    pub expressions: Vec<String>,
    /// Lightings.
    pub lights: Vec<String>,
    /// Kinds of occluders.
    pub occluders: Vec<String>,
}

impl Labels {
    /// The classes of a recipe.
    pub fn of(recipe: &Recipe) -> Self {
        let mut labels = Self::default();
        let add = |list: &mut Vec<String>, name: String| {
            if !list.contains(&name) {
                list.push(name);
            }
        };
        for expression in &recipe.expressions {
            add(&mut labels.expressions, expression.name.clone());
        }
        for lighting in &recipe.lightings {
            add(&mut labels.lights, lighting.name.clone());
        }
        for occluder in &recipe.occluders {
            add(&mut labels.occluders, occluder.kind());
        }
        labels
    }
}

/// What a dataset is. Holds nothing that differs between two runs of one recipe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// Name and version of the program.
    pub program: String,
    /// The recipe's name.
    pub recipe: String,
    /// Hash of the recipe's content, the scans' bytes and the program's version.
    pub recipe_hash: String,
    /// How it is stored.
    pub formats: Vec<Format>,
    /// Whether a COCO file is written.
    pub coco: bool,
    /// Names of classes.
    #[serde(default)]
    pub labels: Labels,
    /// Number of samples the recipe has.
    pub samples: u64,
    /// Number of samples that are stored together, see [`crate::units::Units`].
    pub samples_per_unit: u64,
    /// Which part of the recipe's samples this folder is for; `null` for all.
    pub part: Option<Part>,
    /// Number of samples in this folder.
    pub written: u64,
    /// Whether every sample is there or known to fail.
    pub complete: bool,
    /// What could not be made.
    pub failures: Vec<Failure>,
}

/// Samples that could not be made.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Failure {
    /// First sample.
    pub first: u64,
    /// Number of samples.
    pub samples: u64,
    /// Subject.
    pub subject: String,
    /// Expression; `None` if the subject itself failed.
    pub expression: Option<String>,
    /// Why.
    pub reason: String,
}

impl Failure {
    /// Joins failures of neighbouring samples that have all else in common. `failures` is sorted.
    pub(crate) fn joined(failures: Vec<Self>) -> Vec<Self> {
        let mut joined: Vec<Self> = Vec::new();
        for failure in failures {
            match joined.last_mut() {
                Some(last)
                    if last.first + last.samples == failure.first
                        && last.subject == failure.subject
                        && last.expression == failure.expression
                        && last.reason == failure.reason =>
                {
                    last.samples += failure.samples;
                }
                _ => joined.push(failure),
            }
        }
        joined
    }
}

impl Manifest {
    /// The manifest of a dataset before its first sample.
    pub fn new(recipe: &Recipe, recipe_hash: &str, part: Option<Part>) -> Self {
        let samples = Grid::of(recipe).len();
        Self {
            program: format!("facile {}", env!("CARGO_PKG_VERSION")),
            recipe: recipe.name.clone(),
            recipe_hash: recipe_hash.to_owned(),
            formats: recipe.formats.clone(),
            coco: recipe.coco,
            labels: Labels::of(recipe),
            samples,
            samples_per_unit: Units::of(recipe, samples).unit_len(),
            part,
            written: 0,
            complete: false,
            failures: Vec::new(),
        }
    }

    /// Number of units of the whole dataset.
    pub fn units(&self) -> u64 {
        self.samples.div_ceil(self.samples_per_unit.max(1))
    }

    /// The manifest in a folder; `None` if there is none.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Dataset`] if it is not a manifest.
    pub fn read(root: &Path) -> Result<Option<Self>, Error> {
        let path = root.join(MANIFEST);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(&path, e)),
        };
        serde_json::from_str(&text).map(Some).map_err(|e| {
            let reason = format!("not a manifest of this program: {e}");
            Error::Dataset { path, reason }
        })
    }

    pub(super) fn to_text(&self) -> String {
        let text = serde_json::to_string_pretty(self).expect("names and numbers are plain JSON");
        text + "\n"
    }
}
