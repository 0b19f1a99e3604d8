//! The reference head as a subject: what tests, benches and measurements pose.

use facile_core::{Attributes, ReferenceHead, Similarity3, Subject};

/// The mean head itself, on its own skull.
pub fn mean_subject(reference: &ReferenceHead) -> Subject {
    Subject {
        id: "mean".to_owned(),
        attributes: Attributes::default(),
        positions: reference.mesh.positions.clone(),
        expected_error: vec![0.0; reference.mesh.positions.len()],
        texture: reference.texture.clone(),
        eyes: reference.eyes,
        eye_color: "brown".to_owned(),
        skull_from_reference: Similarity3::identity(),
    }
}
