//! Things in front of a face, made to measure: each is built from a subject's own landmarks and surface, so that it fits
//! everyone without cutting into the face.
//!
//! [`FaceFit`] measures the head; [`Glasses`], [`Prop`]s and a user's [`Model`] build meshes from it and add them to a scene
//! as occluders. Everything is deterministic and in the head's frame, mm.

mod drape;
mod fit;
mod flesh;
mod fringe;
mod glasses;
mod hand;
mod headphones;
mod limb;
mod model;
mod prop;
mod sweep;

pub use fit::FaceFit;
pub use glasses::{Glasses, RimShape};
pub use model::{Anchor, Model};
pub use prop::{Prop, PropKind};
