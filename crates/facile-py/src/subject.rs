//! People and their faces from Python: `Subject`, `Face`.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use facile::core::{ReferenceHead, builtin};
use facile::pipeline::{PosedHead, Registered, Registrations, face_model};
use facile::sim::{Expression, ExpressionSet, FaceModel, MuscleSet, Pose, SimError};
use numpy::{IntoPyArray as _, PyArray2, PyArray3, PyArrayMethods as _};
use pyo3::prelude::*;

use crate::convert::{from_json, points, triangles};
use crate::errors::{exception, heavy};

/// A person: own shape and texture on the reference topology, at rest.
#[pyclass(frozen, module = "facile")]
pub(crate) struct Subject {
    registered: Arc<Registered>,
    /// Made with the first pose.
    model: Mutex<Option<Arc<FaceModel>>>,
}

impl Subject {
    fn new(registered: Registered) -> Self {
        Self {
            registered: Arc::new(registered),
            model: Mutex::new(None),
        }
    }

    pub(crate) fn subject(&self) -> &facile::core::Subject {
        &self.registered.subject
    }

    fn model(&self) -> Result<Arc<FaceModel>, facile::Error> {
        let mut model = self.model.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(model) = &*model {
            return Ok(model.clone());
        }
        let made = Arc::new(face_model(self.subject())?);
        *model = Some(made.clone());
        Ok(made)
    }
}

#[pymethods]
impl Subject {
    #[staticmethod]
    #[pyo3(signature = (path, *, texture=None))]
    fn load(py: Python<'_>, path: PathBuf, texture: Option<PathBuf>) -> PyResult<Self> {
        let read = |_: &_| Registrations::new().scan(&path, texture.as_deref(), None);
        heavy(py, read, |_| Ok(())).map(Self::new)
    }

    #[staticmethod]
    fn builtin(py: Python<'_>, name: &str) -> PyResult<Self> {
        heavy(py, |_| Registrations::new().builtin(name), |_| Ok(())).map(Self::new)
    }

    #[staticmethod]
    fn builtin_names() -> Vec<&'static str> {
        builtin::names()
    }

    #[staticmethod]
    #[pyo3(signature = (number, *, seed=0))]
    fn sample(py: Python<'_>, number: u64, seed: u64) -> PyResult<Self> {
        heavy(py, |_| Registered::sampled(seed, number), |_| Ok(())).map(Self::new)
    }

    #[getter]
    fn id(&self) -> &str {
        &self.subject().id
    }

    #[getter]
    fn attributes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_json(
            py,
            &serde_json::json!(self.subject().attributes).to_string(),
        )
    }

    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, &self.subject().positions)
    }

    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        triangles(py, &ReferenceHead::embedded().mesh.triangles)
    }

    #[getter]
    fn texture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let texture = &self.subject().texture;
        let texels = texture.texels().as_flattened().to_vec();
        texels
            .into_pyarray(py)
            .reshape([texture.height(), texture.width(), 3])
    }

    #[getter]
    fn notices(&self) -> Vec<String> {
        self.registered.notices.clone()
    }

    #[pyo3(signature = (*, expression=None, intensity=1.0, muscles=None, action_units=None, jaw_deg=None, gaze_deg=None))]
    #[expect(
        clippy::too_many_arguments,
        reason = "one keyword for each part of a pose"
    )]
    fn pose(
        &self,
        py: Python<'_>,
        expression: Option<&str>,
        intensity: f64,
        muscles: Option<BTreeMap<String, f64>>,
        action_units: Option<BTreeMap<String, f64>>,
        jaw_deg: Option<f64>,
        gaze_deg: Option<[f64; 2]>,
    ) -> PyResult<Face> {
        let [gaze_yaw_deg, gaze_pitch_deg] = gaze_deg.unwrap_or_default();
        let own = Expression {
            muscles: muscles.unwrap_or_default(),
            action_units: action_units.unwrap_or_default(),
            jaw_deg: jaw_deg.unwrap_or_default(),
            gaze_yaw_deg,
            gaze_pitch_deg,
            ..Expression::default()
        };
        let pose = whole_pose(&own, expression, intensity).map_err(|e| exception(&e.into()))?;
        let solve = |_: &_| PosedHead::solve(&*self.model()?, &pose);
        let head = heavy(py, solve, |_| Ok(()))?;
        Ok(Face {
            registered: self.registered.clone(),
            head,
        })
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let write = |_: &_| Ok(self.subject().save(&path, ReferenceHead::embedded())?);
        heavy(py, write, |_| Ok(()))
    }

    fn __repr__(&self) -> String {
        format!("Subject('{}')", self.subject().id)
    }
}

/// A built-in expression and what is added to it, at an intensity.
fn whole_pose(own: &Expression, name: Option<&str>, intensity: f64) -> Result<Pose, SimError> {
    let muscles = MuscleSet::embedded();
    let mut pose = own.pose(muscles)?;
    if let Some(name) = name {
        pose = pose.combined(&ExpressionSet::embedded().get(name)?.pose(muscles)?);
    }
    Ok(pose.scaled(intensity))
}

/// A subject in a pose.
#[pyclass(frozen, module = "facile")]
pub(crate) struct Face {
    registered: Arc<Registered>,
    head: PosedHead,
}

#[pymethods]
impl Face {
    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        points(py, &self.head.equilibrium.positions)
    }

    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        triangles(py, &ReferenceHead::embedded().mesh.triangles)
    }

    #[getter]
    fn certificate<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let certificate = serde_json::json!(self.head.equilibrium.certificate);
        from_json(py, &certificate.to_string())
    }

    #[pyo3(signature = (scheme="ibug68"))]
    fn landmarks<'py>(&self, py: Python<'py>, scheme: &str) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let reference = ReferenceHead::embedded();
        let scheme = reference.scheme(scheme).map_err(|e| exception(&e.into()))?;
        let positions = &self.head.equilibrium.positions;
        points(py, &scheme.positions(positions, &reference.mesh.triangles))
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let subject = &self.registered.subject;
        let write = |_: &_| self.head.save(&path, subject, ReferenceHead::embedded());
        heavy(py, write, |_| Ok(()))
    }
}
