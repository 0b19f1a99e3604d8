//! Datasets from Python: `generate`, `Dataset`, `render`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use facile::Recipe;
use facile::generate::{Options, Watch};
use facile::pipeline::{Pipeline, Sample, Worker};
use facile::plan::Grid;
use facile::units::Part;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};

use crate::convert::{from_json, pixels, plane, planes, to_json};
use crate::errors::{exception, heavy};
use crate::subject::Subject;

/// Memory for views of the current face, so that samples of a group may be asked for in any order.
const KEPT_BYTES: usize = 256 << 20;

/// A recipe from a path or a mapping.
fn recipe(value: &Bound<'_, PyAny>) -> PyResult<Recipe> {
    let loaded = match value.extract::<PathBuf>() {
        Ok(path) => Recipe::load(&path),
        Err(_) => Recipe::from_json(&to_json(value)?, Path::new("")),
    };
    loaded.map_err(|e| exception(&e))
}

/// A sample as a dictionary of arrays.
fn sample_dict(py: Python<'_>, sample: Sample) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    let height = sample.image.height();
    dict.set_item("record", from_json(py, &sample.record.to_json())?)?;
    let maps = &sample.maps;
    for (name, map) in [
        ("segments", &maps.segments),
        ("visibility", &maps.visibility),
        ("occlusion", &maps.occlusion),
        ("amodal", &maps.amodal),
        ("coverage", &maps.coverage),
        ("instances", &maps.instances),
        ("shadow", &sample.shadow),
    ] {
        if let Some(map) = map {
            dict.set_item(name, plane(py, map)?)?;
        }
    }
    if let Some(map) = &maps.depth_z {
        dict.set_item("depth_mm", plane(py, map)?)?;
    }
    if let (Some(segments), Some(depths)) = (&maps.layers, &maps.layer_depth_z) {
        dict.set_item("layers", planes(py, segments, height)?)?;
        dict.set_item("layer_depth_mm", planes(py, depths, height)?)?;
    }
    for (name, map) in [("normals", &maps.normals), ("albedo", &maps.albedo)] {
        if let Some(map) = map {
            dict.set_item(name, pixels(py, map.clone())?)?;
        }
    }
    if let Some(map) = &maps.reference {
        dict.set_item("reference", pixels(py, map.clone())?)?;
    }
    dict.set_item("image", pixels(py, sample.image)?)?;
    Ok(dict)
}

/// The samples of a recipe, made on demand and without files.
#[pyclass(frozen, module = "facile")]
pub(crate) struct Dataset {
    worker: Mutex<Worker>,
    /// What the dataset was made from, for pickling.
    source: Py<PyAny>,
    len: u64,
    name: String,
    recipe_hash: String,
}

#[pymethods]
impl Dataset {
    #[new]
    fn new(py: Python<'_>, recipe: &Bound<'_, PyAny>) -> PyResult<Self> {
        let source = recipe.clone().unbind();
        let recipe = self::recipe(recipe)?;
        let pipeline = heavy(py, |_| Pipeline::new(recipe), |_| Ok(()))?;
        Ok(Self {
            source,
            len: Grid::of(pipeline.recipe()).len(),
            name: pipeline.recipe().name.clone(),
            recipe_hash: pipeline.recipe_hash().to_owned(),
            worker: Mutex::new(Worker::new(Arc::new(pipeline)).keep_views(KEPT_BYTES)),
        })
    }

    fn __len__(&self) -> usize {
        self.len as usize
    }

    fn __getitem__<'py>(&self, py: Python<'py>, index: i64) -> PyResult<Bound<'py, PyDict>> {
        let len = self.len as i64;
        let i = if index < 0 { index + len } else { index };
        if !(0..len).contains(&i) {
            let message = format!("sample {index} is out of range: the dataset has {len}");
            return Err(PyIndexError::new_err(message));
        }
        let make = |_: &AtomicBool| {
            let mut worker = self.worker.lock().unwrap_or_else(PoisonError::into_inner);
            worker.sample(i as u64)
        };
        let sample = heavy(py, make, |_| Ok(()))?;
        sample_dict(py, sample)
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    #[getter]
    fn recipe_hash(&self) -> &str {
        &self.recipe_hash
    }

    /// Pickles as its recipe: worker processes make their own.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyType>, (Bound<'py, PyAny>,)) {
        let source = slf.get().source.bind(slf.py()).clone();
        (slf.get_type(), (source,))
    }

    fn __repr__(&self) -> String {
        format!("Dataset('{}', {} samples)", self.name, self.len)
    }
}

/// Counts progress for Python to look at.
struct Counter<'a> {
    done: &'a AtomicU64,
    total: &'a AtomicU64,
    stop: &'a AtomicBool,
}

impl Watch for Counter<'_> {
    fn begin(&self, total: u64, done: u64) {
        self.total.store(total, Ordering::Relaxed);
        self.done.store(done, Ordering::Relaxed);
    }

    fn advance(&self, samples: u64) {
        self.done.fetch_add(samples, Ordering::Relaxed);
    }

    fn stops(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Generates a dataset, or what is missing of it.
#[expect(
    clippy::too_many_arguments,
    reason = "keyword arguments of a Python function"
)]
#[pyfunction]
#[pyo3(signature = (recipe, *, output=None, jobs=None, limit=None, shard=None, overwrite=false, max_failures=None, report=None, progress=None))]
pub(crate) fn generate<'py>(
    py: Python<'py>,
    recipe: &Bound<'py, PyAny>,
    output: Option<PathBuf>,
    jobs: Option<usize>,
    limit: Option<u64>,
    shard: Option<&str>,
    overwrite: bool,
    max_failures: Option<u64>,
    report: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let recipe = self::recipe(recipe)?;
    let options = Options {
        output,
        jobs,
        limit,
        part: shard.map(part).transpose()?,
        overwrite,
        max_failures,
        report,
        ..Options::default()
    };
    let (done, total) = (AtomicU64::new(0), AtomicU64::new(0));
    let run = |stop: &AtomicBool| {
        let (done, total) = (&done, &total);
        facile::generate::generate(&recipe, &options, &Counter { done, total, stop })
    };
    let tell = |py: Python<'_>| match &progress {
        Some(f) => {
            let counts = (done.load(Ordering::Relaxed), total.load(Ordering::Relaxed));
            f.call1(py, counts).map(drop)
        }
        None => Ok(()),
    };
    let summary = heavy(py, run, tell)?;
    from_json(py, &summary.to_json())
}

/// A part of a run, `I/N`.
fn part(text: &str) -> PyResult<Part> {
    text.parse().map_err(PyValueError::new_err)
}

/// Puts parts of a dataset together.
#[pyfunction]
#[pyo3(signature = (parts, output, *, overwrite=false))]
pub(crate) fn merge(
    py: Python<'_>,
    parts: Vec<PathBuf>,
    output: PathBuf,
    overwrite: bool,
) -> PyResult<Bound<'_, PyAny>> {
    let run = |_: &_| facile::write::merge(&parts, &output, overwrite);
    let manifest = heavy(py, run, |_| Ok(()))?;
    from_json(py, &serde_json::json!(manifest).to_string())
}

/// Checks every file of a dataset against its hash.
#[pyfunction]
pub(crate) fn verify(py: Python<'_>, dataset: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let verdict = heavy(py, |_| facile::verify::verify(&dataset), |_| Ok(()))?;
    from_json(py, &serde_json::json!(verdict).to_string())
}

/// Renders one image of a subject.
#[expect(
    clippy::too_many_arguments,
    reason = "keyword arguments of a Python function"
)]
#[pyfunction]
#[pyo3(signature = (
    subject, *, expression=None, light=None, view=None, occluder=None, image=None, hair=None, clothes=None,
    background=None, sensor=None,
))]
pub(crate) fn render<'py>(
    py: Python<'py>,
    subject: &Subject,
    expression: Option<&Bound<'py, PyAny>>,
    light: Option<&Bound<'py, PyAny>>,
    view: Option<&Bound<'py, PyAny>>,
    occluder: Option<&Bound<'py, PyAny>>,
    image: Option<&Bound<'py, PyAny>>,
    hair: Option<&Bound<'py, PyAny>>,
    clothes: Option<&Bound<'py, PyAny>>,
    background: Option<&Bound<'py, PyAny>>,
    sensor: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let mut tables = BTreeMap::new();
    for (name, table) in [
        ("expression", expression),
        ("light", light),
        ("view", view),
        ("occluder", occluder),
        ("image", image),
        ("hair", hair),
        ("clothes", clothes),
        ("background", background),
        ("sensor", sensor),
    ] {
        if let Some(table) = table {
            tables.insert(name, to_json(table)?);
        }
    }
    let subject = subject.subject();
    let sample = heavy(
        py,
        |_| facile::pipeline::render_subject(subject, &tables),
        |_| Ok(()),
    )?;
    sample_dict(py, sample)
}

/// Renders a scene file into a folder and returns its timings.
#[pyfunction]
pub(crate) fn render_scene(
    py: Python<'_>,
    path: PathBuf,
    output: PathBuf,
) -> PyResult<Bound<'_, PyAny>> {
    let render = |_: &_| {
        let report = facile::trace::scene_file::render_scene_file(&path, &output, None)?;
        Ok(serde_json::json!(report).to_string())
    };
    let report = heavy(py, render, |_| Ok(()))?;
    from_json(py, &report)
}

/// The JSON Schema of the recipe.
#[pyfunction]
pub(crate) fn schema(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    from_json(py, &facile::recipe::schema().to_string())
}
