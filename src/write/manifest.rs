//! `manifest.json`: what a dataset is, from which recipe and program, and what failed.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::Error;

/// Name of the manifest in a dataset.
pub const MANIFEST: &str = "manifest.json";

/// What a dataset is. Holds nothing that differs between two runs of one recipe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// Name and version of the program.
    pub program: String,
    /// The recipe's name.
    pub recipe: String,
    /// Hash of the recipe's content, the scans' bytes and the program's version.
    pub recipe_hash: String,
    /// Number of samples the recipe has.
    pub samples: u64,
    /// Number of samples in the dataset.
    pub written: u64,
    /// Whether every sample is there.
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

impl Manifest {
    /// The manifest of a dataset before its first sample.
    pub fn new(recipe: &str, recipe_hash: &str, samples: u64) -> Self {
        Self {
            program: format!("facile {}", env!("CARGO_PKG_VERSION")),
            recipe: recipe.to_owned(),
            recipe_hash: recipe_hash.to_owned(),
            samples,
            written: 0,
            complete: false,
            failures: Vec::new(),
        }
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
