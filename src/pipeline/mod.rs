//! The stages that turn a recipe's sample into an image with its truth, one file each.
//!
//! [`Pipeline`] holds what all samples share and never changes: recipe, reference head, muscles, caches. `register`
//! makes a [`Person`] of a subject's number, `animate` a [`Face`] of a person and an expression, `render` a scene and
//! its views, `truth` the labels; [`Worker`] runs them in order and keeps what the next sample shares.

mod animate;
mod background;
mod cache;
mod clock;
mod equilibria;
mod hair;
mod maps;
mod pose;
mod register;
mod render;
mod schemes;
mod skips;
mod truth;
mod worker;

use std::collections::BTreeSet;

use facile_core::{CoreError, ReferenceHead};
use facile_flow::RegistrationParams;
use facile_sim::{FaceRig, MuscleSet};
use facile_trace::LightSource;

pub use animate::Face;
pub use background::BackgroundRecord;
pub use cache::{CACHE_SIZE_VARIABLE, CACHE_VARIABLE, Counts};
pub use clock::{Clock, Work};
use equilibria::Equilibria;
pub use maps::Maps;
pub use pose::{PosedHead, face_model};
pub use register::{Person, Registered, Registrations};
pub use schemes::Scheme;
pub use skips::Skips;
pub use truth::ViewTruth;
pub use worker::{Sample, Worker, render_subject};

use crate::Error;
use crate::recipe::{Background, Recipe};
use crate::sampling::Sampling;

/// What all samples of a recipe share.
#[derive(Debug)]
pub struct Pipeline {
    recipe: Recipe,
    recipe_hash: String,
    reference: &'static ReferenceHead,
    /// What all faces that move share; `None` where every face of the recipe is at rest.
    rig: Option<FaceRig>,
    schemes: Vec<Scheme>,
    face_vertices: Vec<u32>,
    registrations: Registrations,
    equilibria: Equilibria,
    wardrobe: hair::Wardrobe,
    gallery: background::Gallery,
    clock: Clock,
    skips: Skips,
}

impl Pipeline {
    /// Prepares the samples of a recipe. Reads the scans once, to know their content.
    ///
    /// # Errors
    /// [`Error::Core`] for a landmark scheme that is not there.
    pub fn new(recipe: Recipe) -> Result<Self, Error> {
        Self::with(recipe, Skips::default())
    }

    /// As [`Self::new`], with some savings switched off.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with(recipe: Recipe, skips: Skips) -> Result<Self, Error> {
        let reference = ReferenceHead::embedded();
        let schemes = recipe
            .image
            .landmarks
            .iter()
            .map(|name| {
                Scheme::named(name).ok_or_else(|| {
                    Error::Core(CoreError::UnknownName {
                        kind: "landmark scheme",
                        name: name.clone(),
                        known: Scheme::names().join(", "),
                    })
                })
            })
            .collect::<Result<_, _>>()?;
        let is_moved = recipe.expressions.iter().any(|e| !e.pose.is_neutral())
            || recipe.sampling.as_ref().is_some_and(Sampling::moves)
            || !skips.faces_at_rest;
        let rig = is_moved.then(|| FaceRig::new(reference, MuscleSet::embedded()));
        Ok(Self {
            recipe_hash: recipe_hash(&recipe),
            reference,
            rig: rig.transpose()?,
            schemes,
            face_vertices: face_vertices(reference),
            registrations: Registrations::with(RegistrationParams {
                delight: recipe.subjects.delight,
                ..RegistrationParams::default()
            })
            .taking_cached(skips.cached_registrations),
            equilibria: Equilibria::new(),
            wardrobe: hair::Wardrobe::new(),
            gallery: background::Gallery::new(&recipe),
            clock: Clock::default(),
            skips,
            recipe,
        })
    }

    /// The recipe.
    pub fn recipe(&self) -> &Recipe {
        &self.recipe
    }

    /// Hash of everything the dataset's bytes depend on: the recipe without its output folder, the scans' content, the
    /// program's version. Hexadecimal.
    pub fn recipe_hash(&self) -> &str {
        &self.recipe_hash
    }

    /// The head that all subjects share their topology with.
    pub fn reference(&self) -> &'static ReferenceHead {
        self.reference
    }

    /// The muscles.
    pub fn muscles(&self) -> &'static MuscleSet {
        MuscleSet::embedded()
    }

    /// The landmark schemes that the recipe asks for.
    pub fn schemes(&self) -> &[Scheme] {
        &self.schemes
    }

    /// What is not done.
    pub fn skips(&self) -> &Skips {
        &self.skips
    }

    /// Where the time goes.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// How many equilibria were solved for, and how many taken from the cache.
    pub fn equilibrium_counts(&self) -> &Counts {
        self.equilibria.counts()
    }

    /// How many registrations were made, and how many taken from the cache.
    pub fn registration_counts(&self) -> &Counts {
        self.registrations.counts()
    }

    /// Whether the registration of subject number `subject` is in the cache.
    pub(crate) fn is_cached(&self, subject: u64) -> bool {
        self.registrations
            .is_cached(&self.recipe.subjects.get(subject))
    }

    fn face_vertices(&self) -> &[u32] {
        &self.face_vertices
    }
}

/// Fine vertices of the face, sorted.
fn face_vertices(reference: &ReferenceHead) -> Vec<u32> {
    let mesh = &reference.mesh;
    let face = mesh
        .triangles
        .iter()
        .zip(&mesh.segments)
        .filter(|(_, segment)| truth::is_face(**segment))
        .flat_map(|(triangle, _)| *triangle);
    face.collect::<BTreeSet<u32>>().into_iter().collect()
}

fn recipe_hash(recipe: &Recipe) -> String {
    let mut file = recipe.file.clone();
    file.dataset.output.clear();
    let mut hasher = blake3::Hasher::new();
    let content = serde_json::to_vec(&file).expect("a recipe is plain JSON");
    hasher
        .update(&content)
        .update(env!("CARGO_PKG_VERSION").as_bytes());
    for path in &recipe.subjects.scans {
        register::hash_scan_files(path, &mut hasher);
    }
    // Pictures by their content; those of lights were read already
    for background in &recipe.backgrounds {
        match &background.background {
            Background::Images { files, .. } => {
                for file in files {
                    let bytes = std::fs::read(file).unwrap_or_default();
                    hasher.update(blake3::hash(&bytes).as_bytes());
                }
            }
            Background::Environment {
                map: Some((_, map)),
                ..
            } => {
                hasher.update(&map.to_bytes());
            }
            _ => {}
        }
    }
    for source in recipe.lightings.iter().flat_map(|l| &l.sources) {
        if let LightSource::Environment { map: Some(map), .. } = source {
            hasher.update(&map.to_bytes());
        }
    }
    hasher.finalize().to_hex()[..32].to_owned()
}
