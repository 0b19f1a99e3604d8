//! Between Python's values and ours.

use facile::core::{Plane, Point3};
use numpy::{IntoPyArray as _, PyArray2, PyArray3, PyArrayMethods as _};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A list of points as an `(n, 3)` array.
pub(crate) fn points<'py>(
    py: Python<'py>,
    points: &[Point3],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let flat: Vec<f64> = points.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    flat.into_pyarray(py).reshape([points.len(), 3])
}

/// Triangles as an `(m, 3)` array.
pub(crate) fn triangles<'py>(
    py: Python<'py>,
    triangles: &[[u32; 3]],
) -> PyResult<Bound<'py, PyArray2<u32>>> {
    triangles
        .as_flattened()
        .to_vec()
        .into_pyarray(py)
        .reshape([triangles.len(), 3])
}

/// A plane as an `(h, w)` array. Maps are shared by the samples of a view, so they are copied.
pub(crate) fn plane<'py, T: numpy::Element + Clone>(
    py: Python<'py>,
    plane: &Plane<T>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let shape = [plane.height(), plane.width()];
    plane.as_slice().to_vec().into_pyarray(py).reshape(shape)
}

/// Planes of `height` rows below one another as a `(k, h, w)` array.
pub(crate) fn planes<'py, T: numpy::Element + Clone>(
    py: Python<'py>,
    planes: &Plane<T>,
    height: usize,
) -> PyResult<Bound<'py, PyArray3<T>>> {
    let shape = [planes.height() / height, height, planes.width()];
    planes.as_slice().to_vec().into_pyarray(py).reshape(shape)
}

/// A plane of `N` numbers a pixel as an `(h, w, N)` array, which takes over its memory.
pub(crate) fn pixels<T: numpy::Element, const N: usize>(
    py: Python<'_>,
    plane: Plane<[T; N]>,
) -> PyResult<Bound<'_, PyArray3<T>>> {
    let shape = [plane.height(), plane.width(), N];
    plane
        .into_vec()
        .into_flattened()
        .into_pyarray(py)
        .reshape(shape)
}

/// JSON text as Python values.
pub(crate) fn from_json<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (text,))
}

/// Python values as JSON text; `None` stays absent.
pub(crate) fn to_json(value: &Bound<'_, PyAny>) -> PyResult<serde_json::Value> {
    let mapping = PyDict::new(value.py());
    mapping.set_item("default", value.py().import("builtins")?.getattr("dict")?)?;
    let text: String = value
        .py()
        .import("json")?
        .call_method("dumps", (value,), Some(&mapping))?
        .extract()?;
    serde_json::from_str(&text).map_err(|e| pyo3::exceptions::PyValueError::new_err(e.to_string()))
}
