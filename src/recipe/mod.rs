//! The recipe: `dataset.toml` as tables ([`file`]), checked once into [`Recipe`].
//!
//! Whatever is wrong in a recipe is found here, before any work, and shown with its file, line and column. Read
//! [`file`] for what a recipe may say, [`Recipe`] for what it means, and `plan.rs` for how it becomes samples.

use std::io::Read as _;
use std::path::Path;

use check::background::Surroundings;
use facile_trace::LightSource;

use crate::Error;

mod check;
pub mod file;
mod problem;
mod settings;

pub use file::RecipeFile;
pub use problem::RecipeError;
pub use settings::{
    Background, Expression, HairSettings, ImageSettings, Lighting, Occluder, Optics, Recipe,
    SubjectSource, Subjects, View, WeightedBackground,
};

/// Most bytes of a recipe.
const MAX_BYTES: u64 = 16 << 20;

impl Recipe {
    /// Reads and checks a recipe. Scans are looked for relative to its folder.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Recipe`] with line and column of the first thing that is wrong.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
        let mut text = String::new();
        let read = file.take(MAX_BYTES + 1).read_to_string(&mut text);
        read.map_err(|e| Error::io(path, e))?;
        if text.len() as u64 > MAX_BYTES {
            let message = format!("a recipe has at most {MAX_BYTES} bytes");
            return Err(RecipeError::at(path, "", None, message, None).into());
        }
        let base = path.parent().unwrap_or(Path::new(""));
        Self::parse(&text, path, base)
    }

    /// Checks a recipe given as text. `path` names it in errors; `base` is the folder that scans are relative to.
    ///
    /// # Errors
    /// [`Error::Recipe`] with line and column of the first thing that is wrong.
    pub fn parse(text: &str, path: &Path, base: &Path) -> Result<Self, Error> {
        let file: RecipeFile =
            toml::from_str(text).map_err(|e| RecipeError::from_toml(path, text, &e))?;
        let recipe =
            check::check(file, base).map_err(|p| RecipeError::from_problem(path, text, p))?;
        Ok(recipe)
    }

    /// Checks a recipe given as JSON with the same keys; `base` is the folder that scans are relative to.
    ///
    /// # Errors
    /// [`Error::Recipe`] with the place of the first thing that is wrong, as it would stand in TOML.
    pub fn from_json(value: &serde_json::Value, base: &Path) -> Result<Self, Error> {
        let path = Path::new("recipe");
        let text = toml::to_string(value).map_err(|e| {
            let message = format!("not the tables of a recipe: {e}");
            RecipeError::at(path, "", None, message, None)
        })?;
        Self::parse(&text, path, base)
    }
}

/// A lighting whose numbers were drawn; `base` is as the recipe has it.
pub(crate) fn drawn_lighting(table: &file::LightTable, base: &Lighting) -> Result<Lighting, Error> {
    let maps = base.sources.iter().filter_map(|source| match source {
        LightSource::Environment {
            file,
            map: Some(map),
            ..
        } => Some((file.clone(), map.clone())),
        _ => None,
    });
    let surroundings = Surroundings::known(maps.collect());
    let (tables, place) = (std::slice::from_ref(table), problem::Place::default());
    let mut list = check::light::lightings(tables, &surroundings, &place).map_err(|problem| {
        Error::Internal {
            reason: format!("light `{}` as drawn: {problem}", table.name),
        }
    })?;
    Ok(list.remove(0))
}

/// JSON Schema of the recipe, for editors that complete and check TOML.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(RecipeFile).to_value()
}

#[cfg(test)]
mod tests;
