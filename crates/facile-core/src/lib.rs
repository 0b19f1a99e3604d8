//! The vocabulary of Facile: meshes, textures, planes, the reference head, subjects, landmarks.
//!
//! Everything two stages share lives here, and nothing else. Lengths are millimetres, angles radians, `y` is up, the
//! face looks along `+z` and `x` points to the subject's left. Colours are linear inside and sRGB in files.
//! The crate owns no thread pool, no clock and no global random state. Read [`mesh`] first, then [`reference`].

pub mod builtin;
pub mod clothes;
pub mod color;
pub mod grid;
pub mod hair;
pub mod identity;
pub mod io;
pub mod landmarks;
pub mod math;
pub mod mesh;
pub mod reference;
pub mod reshape;
pub mod rng;
pub mod segment;
pub mod simd;
pub mod subdivision;
pub mod subject;
pub mod texture;

mod assets;
mod error;
mod identity_sample;

pub use error::CoreError;
pub use grid::Plane;
pub use hair::HairStyle;
pub use identity::{IdentityModel, IdentityShape};
pub use landmarks::{LandmarkScheme, SurfacePoint};
pub use math::{Isometry3, Matrix3, Point3, Similarity3, UnitQuaternion, Vector2, Vector3};
pub use mesh::Mesh;
pub use reference::{Part, ReferenceHead, Role};
pub use reshape::HeadShape;
pub use segment::Segment;
pub use subject::{Attributes, Eye, Subject};
pub use texture::Texture;
