//! Muscles: their definition on the cylinder of the reference head, their path on a subject, their contraction.
//!
//! Section 4.2 of the paper with the readings of one rule for both kinds: a point at normalised arc length `a` moves to
//! `d = o + (1 - c)(a - o)`, with the origin `o = 0` (linear) or `1/2` (sphincter). Read [`set`], then `path`.

pub mod set;

mod bind;
mod path;

pub(crate) use bind::{Actuator, Bound, Reach};
pub use set::{Key, LidDrive, Muscle, MuscleKind, MuscleSet, Side, Symmetry};
