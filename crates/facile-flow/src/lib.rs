//! Registration of a scan to the reference head (paper, section 3).
//!
//! [`normalise`] finds unit, pose and size of the face; [`radial_map`] and [`channels`] show reference and scan on the
//! cylinder (eq. 1 and 4); [`flow`] computes the displacement field between them (eq. 2 and 3, over a [`pyramid`]);
//! rounds of flow and smooth deformation draw the reference onto the scan; the last step ends on its surface. The
//! result is a [`facile_core::Subject`] with a texture, eyes, and an expected error per vertex. Start with
//! [`register()`].

pub mod channels;
pub mod curvature;
pub mod flow;
pub mod normalise;
pub mod pyramid;
pub mod radial_map;
pub mod synthetic;
pub mod transfer;
pub mod work_precision;

mod adjacency;
mod blur;
mod cage;
mod cage_on_surface;
mod decimate;
mod ears;
mod error;
mod expected_error;
mod eyes;
mod fit;
mod folds;
mod identity_fit;
mod iris;
mod landmarks;
mod lips;
mod neighbors;
mod onto_surface;
mod params;
mod population;
mod register;
mod report;
mod scan;
mod shading;
mod surface;
mod template;
mod texel_map;
mod texture;

pub use error::FlowError;
pub use eyes::seat_skull;
pub use landmarks::ScanLandmarks;
pub use params::RegistrationParams;
pub use population::{PopulationMean, PopulationParams, Round, build_reference};
pub use register::{Registrar, Registration, StageTime, register};
pub use report::RegistrationReport;
