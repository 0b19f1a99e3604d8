//! What can go wrong in building or solving a face.

/// An error of the physics.
#[derive(Clone, Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum SimError {
    /// A TOML file of muscles or expressions that does not parse.
    #[error("{file}: {reason}")]
    Format {
        /// The file.
        file: String,
        /// What is wrong, with the place if known.
        reason: String,
    },
    /// A name that nobody defined.
    #[error("unknown {kind} `{name}`; known are {known}")]
    UnknownName {
        /// Kind of thing: muscle, expression, action unit.
        kind: &'static str,
        /// The name.
        name: String,
        /// The allowed names, comma-separated.
        known: String,
    },
    /// A muscle of the mid-plane was asked for on one side only.
    #[error("muscle `{name}` has no sides: it crosses the mid-plane; use `{name}` alone")]
    NoSides {
        /// The muscle.
        name: String,
    },
    /// A number outside its range.
    #[error("{what} = {value} must be in [{min}, {max}]")]
    OutOfRange {
        /// The quantity, with the muscle or expression it belongs to.
        what: String,
        /// Its value.
        value: f64,
        /// Smallest allowed value.
        min: f64,
        /// Largest allowed value.
        max: f64,
    },
    /// A muscle whose path cannot be used.
    #[error("muscle `{name}`: {reason}")]
    Muscle {
        /// The muscle.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Data that does not belong to this reference head.
    #[error("{what}: expected {expected}, got {got}")]
    SizeMismatch {
        /// What was counted.
        what: &'static str,
        /// The count that fits.
        expected: usize,
        /// The count found.
        got: usize,
    },
    /// A shape that cannot carry a model, such as one with coordinates that are not finite.
    #[error("subject `{subject}`: {reason}")]
    Subject {
        /// The subject.
        subject: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A matrix that should be positive definite is not.
    #[error("{what}: the matrix is not positive definite at row {row}")]
    Singular {
        /// The system that was solved.
        what: &'static str,
        /// First bad pivot.
        row: usize,
    },
    /// The solver stopped before the tolerance was met.
    #[error(
        "{solver}: no equilibrium after {iterations} iterations: residual {residual:.3e}, tolerance {tolerance:.3e}, penetration {penetration_mm:.3} mm"
    )]
    NotConverged {
        /// The solver.
        solver: &'static str,
        /// Iterations spent.
        iterations: usize,
        /// Relative residual reached.
        residual: f64,
        /// Relative residual asked for.
        tolerance: f64,
        /// Largest penetration of the skull, mm.
        penetration_mm: f64,
    },
}
