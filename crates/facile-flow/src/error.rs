//! What can go wrong when a scan is registered.

/// An error of `facile-flow`: the scan cannot be registered, and why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FlowError {
    /// The scan has too little surface to look at.
    #[error("the scan has {triangles} usable triangles; at least {needed} are needed")]
    TooFewTriangles {
        /// Triangles with three finite, distinct corners.
        triangles: usize,
        /// The least that a face can be found in.
        needed: usize,
    },
    /// Nothing in the scan looks like a face.
    #[error("no face in the scan: {measure} is {found:.3}, a face has {relation} {limit:.3}")]
    NoFace {
        /// The measure that failed.
        measure: &'static str,
        /// Its best value over all poses and scales that were tried.
        found: f64,
        /// `at least` or `at most`.
        relation: &'static str,
        /// The value a face must reach.
        limit: f64,
    },
    /// A linear system of the fit could not be factored.
    #[error("the fit's linear system of {unknowns} unknowns is singular")]
    Singular {
        /// Size of the system.
        unknowns: usize,
    },
    /// Landmarks that were given cannot be used.
    #[error("landmarks: {reason}")]
    Landmarks {
        /// What is wrong with them.
        reason: String,
    },
    /// Too few faces for a mean.
    #[error(
        "{registered} of {given} scans could be registered; a reference head needs at least {needed} faces{}",
        example.as_ref().map(|e| format!(" (the first failure: {e})")).unwrap_or_default()
    )]
    Population {
        /// Faces that were registered.
        registered: usize,
        /// Scans that were given.
        given: usize,
        /// The least number.
        needed: usize,
        /// Why the first scan that failed did.
        example: Option<String>,
    },
    /// A parameter is outside its range.
    #[error("parameter {name} is {found}; allowed: {allowed}")]
    Parameter {
        /// The parameter's name in [`RegistrationParams`](crate::RegistrationParams).
        name: &'static str,
        /// Its value.
        found: f64,
        /// The allowed range, in words.
        allowed: &'static str,
    },
}
