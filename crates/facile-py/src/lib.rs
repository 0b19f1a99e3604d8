//! Python bindings: convert, one call, convert. No algorithm, default value or unit conversion lives here.
//!
//! The Python side is `python/facile/__init__.pyi`; every heavy call goes through [`errors::heavy`].

#![expect(
    clippy::needless_pass_by_value,
    reason = "arguments from Python arrive by value"
)]
#![expect(
    clippy::unused_self,
    reason = "properties need an object, even where all share the value"
)]

use pyo3::prelude::*;

mod convert;
mod errors;
mod pipeline;
mod subject;

#[pymodule]
mod _facile {
    #[pymodule_export]
    use super::errors::{
        CoreError, FacileError, FlowError, PipelineError, RecipeError, SimError, TraceError,
    };
    #[pymodule_export]
    use super::pipeline::{Dataset, generate, merge, render, render_scene, schema, verify};
    #[pymodule_export]
    use super::subject::{Face, Subject};
    #[pymodule_export]
    #[expect(
        non_upper_case_globals,
        reason = "the name that Python packages give their version"
    )]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
