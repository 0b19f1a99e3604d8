//! What can go wrong with a scene that enters.

use std::path::PathBuf;

/// An error of `facile-trace`: a scene, camera or file that cannot be rendered, with the fact that is wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TraceError {
    /// A mesh or texture could not be read or breaks a rule.
    #[error(transparent)]
    Core(#[from] facile_core::CoreError),
    /// A coordinate is NaN or infinite.
    #[error("{what} {index}: coordinates must be finite, found {value}")]
    NotFinite {
        /// `vertex`, `normal`, `object pose`.
        what: &'static str,
        /// Position in its list, from 0.
        index: usize,
        /// What was found.
        value: String,
    },
    /// An index points past the end of its list.
    #[error("{what} {index} is out of range, there are {count}")]
    OutOfRange {
        /// What the index names.
        what: &'static str,
        /// The index.
        index: usize,
        /// Number of elements there are.
        count: usize,
    },
    /// Two lists that belong together have different lengths.
    #[error("{what}: expected {expected}, got {got}")]
    SizeMismatch {
        /// What was counted.
        what: &'static str,
        /// Wanted count.
        expected: usize,
        /// Found count.
        got: usize,
    },
    /// A number is outside its allowed range.
    #[error("{name}: expected {expected}, got {got}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// What is allowed.
        expected: &'static str,
        /// What was found.
        got: String,
    },
    /// The tree of a degenerate mesh is deeper than the traversal's stack.
    #[error("the triangle tree is {depth} levels deep, at most {limit} can be traversed")]
    TreeTooDeep {
        /// Levels of the tree.
        depth: usize,
        /// Levels the traversal can hold.
        limit: usize,
    },
    /// A scene file is wrong.
    #[error("{path}: {reason}")]
    SceneFile {
        /// The file.
        path: PathBuf,
        /// What was expected and found, with the line where it is known.
        reason: String,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// An image could not be encoded as PNG.
    #[error("an image of {width} x {height} pixels could not be encoded: {reason}")]
    Png {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// What the encoder said.
        reason: String,
    },
    /// A record could not be encoded.
    #[error("{path}: {reason}")]
    Encode {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        reason: String,
    },
}
