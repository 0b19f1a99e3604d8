//! What can go wrong in a run.

use std::path::{Path, PathBuf};

use facile_core::CoreError;
use facile_flow::FlowError;
use facile_sim::SimError;
use facile_trace::TraceError;

use crate::recipe::RecipeError;

/// An error of the dataset generator.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The recipe is wrong; nothing was done.
    #[error(transparent)]
    Recipe(Box<RecipeError>),
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The output folder holds something else.
    #[error("{folder}: {reason}; give another --output, or --overwrite to replace it")]
    Occupied {
        /// The output folder.
        folder: PathBuf,
        /// What it holds.
        reason: String,
    },
    /// Another process writes to the output folder.
    #[error("{folder}: another process is writing to this folder")]
    Locked {
        /// The output folder.
        folder: PathBuf,
    },
    /// A file of a dataset does not follow its format.
    #[error("{path}: {reason}")]
    Dataset {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        reason: String,
    },
    /// An image could not be encoded.
    #[error("an image of {width} x {height} pixels could not be encoded: {reason}")]
    Encode {
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
        /// What the encoder said.
        reason: String,
    },
    /// A sample that the dataset does not have.
    #[error("sample {index} is out of range: the dataset has {len}")]
    Index {
        /// The sample's number.
        index: u64,
        /// The dataset's size.
        len: u64,
    },
    /// A sample for which no draw meets the constraints of `[sampling]`.
    #[error(
        "{tries} tries find no draw of sample {index} that meets sampling.constraint[{constraint}]"
    )]
    Draw {
        /// The sample's number.
        index: u64,
        /// How many draws were tried.
        tries: u32,
        /// The constraint, counted from 0, that the last of them broke.
        constraint: usize,
    },
    /// The thread pool could not be made.
    #[error("could not start {threads} threads: {reason}")]
    Threads {
        /// Wanted number of threads.
        threads: usize,
        /// What the system said.
        reason: String,
    },
    /// A bug of this program.
    #[error("internal error, please report it: {reason}")]
    Internal {
        /// What was found.
        reason: String,
    },
    /// Bad or unreadable mesh, texture or name.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// A scan cannot be registered.
    #[error(transparent)]
    Flow(#[from] FlowError),
    /// A face finds no equilibrium, or cannot be asked for it.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// A scene cannot be rendered.
    #[error(transparent)]
    Trace(#[from] TraceError),
}

impl Error {
    /// The error of a file operation.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        let path = path.to_owned();
        Self::Io { path, source }
    }
}

impl From<RecipeError> for Error {
    fn from(error: RecipeError) -> Self {
        Self::Recipe(Box::new(error))
    }
}
