//! Things in front of a face, made to measure: each is built from a subject's own landmarks and surface, so that it fits
//! everyone without cutting into the face.
//!
//! [`FaceFit`] measures the head; [`Glasses`] and [`Drape`]s build meshes from it and add them to a scene as occluders.
//! Everything is deterministic and in the head's frame, mm.

mod drape;
mod fit;
mod glasses;
mod sweep;

pub use drape::{Drape, DrapeKind};
pub use fit::FaceFit;
pub use glasses::{Glasses, RimShape};
