//! The muscle-driven face of Facile: layers of springs over a skull, moved by muscles, jaw and lids to rest.
//!
//! Section 4 of the paper. [`MuscleSet`] holds the muscles, [`ExpressionSet`] and [`action_unit`] turn words into a
//! [`Pose`], [`FaceModel`] is a subject's face, [`Solver`] finds the [`Equilibrium`] of a pose and certifies it.
//! Lengths are millimetres, angles radians, `f64` throughout; results depend on the input alone, to the last bit.
//! Read [`model`] first, then [`solver`].

pub mod action_units;
pub mod expression;
pub mod model;
pub mod muscle;
pub mod params;
pub mod pose;
pub mod resolution;
pub mod solver;
pub mod stress;
pub mod template;
pub mod work_precision;

mod contact;
mod depth;
mod elements;
mod error;
mod follow;
mod kernels;
mod kinematics;
mod layers;
mod lids;
mod load;
mod mandible;
mod mean;
mod simd;
mod skull;
mod sparse;
mod springs;
mod vector;

pub use action_units::{ActionUnit, action_unit, action_units};
pub use error::SimError;
pub use expression::{Expression, ExpressionSet};
pub use mean::mean_subject;
pub use model::{FaceModel, FaceRig};
pub use muscle::{Muscle, MuscleKind, MuscleSet, Side};
pub use params::PaperParams;
pub use pose::{Gaze, JawPose, Pose, Sides};
pub use solver::{Certificate, Equilibrium, Solver, SolverKind, SolverParams};
pub use template::Template;
