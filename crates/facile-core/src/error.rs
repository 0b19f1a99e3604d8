//! What can go wrong with data that enters.

use std::path::PathBuf;

/// An error of `facile-core`: bad or unreadable outside data, with its file and place.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CoreError {
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file does not follow its format.
    #[error("{path}{}: {reason}", place.as_ref().map(|p| format!(", {p}")).unwrap_or_default())]
    Format {
        /// The file.
        path: PathBuf,
        /// Line, element or accessor, where known.
        place: Option<String>,
        /// What was expected and what was found.
        reason: String,
    },
    /// A mesh breaks a rule: an index out of range, a coordinate that is not finite, no triangles.
    #[error("{path}: {element} {index}: {reason}")]
    Mesh {
        /// The file, or the name of the mesh.
        path: PathBuf,
        /// `vertex`, `triangle`, `texture coordinate`.
        element: &'static str,
        /// Position in the list of these elements, from 0.
        index: usize,
        /// What was expected and what was found.
        reason: String,
    },
    /// Two things that belong together have different sizes.
    #[error("{what}: expected {expected}, got {got}")]
    SizeMismatch {
        /// What was counted.
        what: &'static str,
        /// Wanted count.
        expected: usize,
        /// Found count.
        got: usize,
    },
    /// A name that nothing carries.
    #[error("unknown {kind} `{name}`; known: {known}")]
    UnknownName {
        /// What kind of name: `segment`, `subject`, `landmark scheme`.
        kind: &'static str,
        /// The name.
        name: String,
        /// The allowed ones, separated by commas.
        known: String,
    },
}

impl CoreError {
    /// A file that does not follow its format.
    pub(crate) fn format(
        path: &std::path::Path,
        place: Option<String>,
        reason: impl Into<String>,
    ) -> Self {
        Self::Format {
            path: path.to_owned(),
            place,
            reason: reason.into(),
        }
    }
}
