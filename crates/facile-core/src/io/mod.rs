//! Files: meshes in and out, textures, with validation. Every error names the file and the place.

pub mod obj;
