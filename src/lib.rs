//! Labelled face datasets from 3D scans: registration, muscle simulation, ray tracing.
//!
//! A [`Recipe`] says what a dataset holds, [`plan`] numbers its samples, [`sampling`] draws them where it is asked to, [`pipeline`] makes them, [`write`](mod@write)
//! stores them, and [`generate`](mod@generate) runs it all. The stages come from the crates re-exported here: [`core`]
//! the vocabulary, [`flow`] registration, [`sim`] the muscles, [`trace`] rendering. Read `ARCHITECTURE.md` first.

pub use facile_core as core;
pub use facile_flow as flow;
pub use facile_sim as sim;
pub use facile_trace as trace;

pub mod bench;
mod error;
pub mod generate;
pub mod pipeline;
pub mod plan;
pub mod predict;
pub mod recipe;
pub mod record;
pub mod report;
pub mod sampling;
pub mod sheet;
mod threads;
pub mod units;
pub mod verify;
pub mod write;

pub use error::Error;
pub use recipe::Recipe;
