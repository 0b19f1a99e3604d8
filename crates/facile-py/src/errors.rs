//! Rust errors as Python exceptions, and the one way in which heavy calls run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use facile::Error;
use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

create_exception!(
    facile,
    FacileError,
    PyException,
    "What can go wrong in Facile."
);
create_exception!(
    facile,
    RecipeError,
    FacileError,
    "A recipe is wrong; the message shows the line."
);
create_exception!(
    facile,
    CoreError,
    FacileError,
    "A mesh, texture or name is bad."
);
create_exception!(
    facile,
    FlowError,
    FacileError,
    "A scan cannot be registered."
);
create_exception!(
    facile,
    SimError,
    FacileError,
    "A face finds no equilibrium, or cannot be asked for it."
);
create_exception!(
    facile,
    TraceError,
    FacileError,
    "A scene cannot be rendered."
);
create_exception!(
    facile,
    PipelineError,
    FacileError,
    "A dataset cannot be read or written."
);

/// The exception for an error.
pub(crate) fn exception(error: &Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Recipe(_) => RecipeError::new_err(text),
        Error::Core(_) => CoreError::new_err(text),
        Error::Flow(_) => FlowError::new_err(text),
        Error::Sim(_) => SimError::new_err(text),
        Error::Trace(_) => TraceError::new_err(text),
        Error::Index { .. } => pyo3::exceptions::PyIndexError::new_err(text),
        _ => PipelineError::new_err(text),
    }
}

/// Time between two looks at Python's signals.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(100);

/// Runs `work` on a thread of its own without the interpreter's lock. Meanwhile this thread hears Ctrl-C, then sets the
/// flag that `work` is given, waits for it to end and raises what Python asks for. `tick` is called at each look.
pub(crate) fn heavy<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> Result<T, Error> + Send,
    tick: impl Fn(Python<'_>) -> PyResult<()>,
) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    let waiting = std::thread::current();
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let result = work(&stop);
            waiting.unpark();
            result
        });
        let mut raised = Ok(());
        while !worker.is_finished() {
            py.detach(|| std::thread::park_timeout(SIGNAL_INTERVAL));
            if raised.is_ok() {
                raised = py.check_signals().and_then(|()| tick(py));
                stop.store(raised.is_err(), Ordering::Relaxed);
            }
        }
        let result = worker.join();
        raised?;
        match result {
            Ok(result) => result.map_err(|e| exception(&e)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}
