//! One head in one pose, outside any recipe: what `facile pose` writes and Python's `Subject.pose` returns.

use std::path::Path;

use facile_core::{Mesh, Point3, ReferenceHead, Segment, Subject, io};
use facile_sim::{Equilibrium, FaceModel, MuscleSet, Pose, Solver, SolverParams};
use serde_json::{Map, Value, json};

use crate::Error;

/// A subject at rest under some contractions.
#[derive(Clone, Debug)]
pub struct PosedHead {
    /// What the face was asked to do.
    pub pose: Pose,
    /// Fine vertices, jaw, eyes, certificate.
    pub equilibrium: Equilibrium,
}

impl PosedHead {
    /// Solves for the equilibrium of a pose.
    ///
    /// # Errors
    /// [`Error::Sim`] if there is none, or the pose is not one of this face.
    pub fn solve(model: &FaceModel, pose: &Pose) -> Result<Self, Error> {
        let equilibrium = Solver::new().solve(model, pose, &SolverParams::default())?;
        Ok(Self {
            pose: pose.clone(),
            equilibrium,
        })
    }

    /// The head with eyes, teeth and tongue in their places, by the names of their classes.
    pub fn meshes(
        &self,
        subject: &Subject,
        reference: &ReferenceHead,
    ) -> Vec<(&'static str, Mesh)> {
        let head = Mesh {
            positions: self.equilibrium.positions.clone(),
            ..reference.mesh.clone()
        };
        let mut meshes = vec![("head", head)];
        for (name, mut mesh) in subject.part_meshes(reference) {
            for p in &mut mesh.positions {
                *p = self.moved(subject, name, p);
            }
            meshes.push((name, mesh));
        }
        meshes
    }

    /// Where the jaw or the gaze takes a point of a rigid part.
    fn moved(&self, subject: &Subject, part: &str, p: &Point3) -> Point3 {
        let eye = |side: usize| {
            let center = subject.eyes[side].center;
            center + self.equilibrium.eyes[side] * (p - center)
        };
        match Segment::from_name(part) {
            Ok(Segment::LeftEye) => eye(0),
            Ok(Segment::RightEye) => eye(1),
            Ok(Segment::LowerTeeth | Segment::Tongue) => self.equilibrium.jaw * p,
            _ => *p,
        }
    }

    /// Writes the head as GLB, the pose and its certificate in `asset.extras.facile`.
    ///
    /// # Errors
    /// [`Error::Core`] if the file cannot be written.
    pub fn save(
        &self,
        path: &Path,
        subject: &Subject,
        reference: &ReferenceHead,
    ) -> Result<(), Error> {
        let meshes = self.meshes(subject, reference);
        let mut extras = Map::new();
        extras.insert("kind".to_owned(), Value::from("pose"));
        extras.insert("report".to_owned(), self.report(subject));
        Ok(io::head_glb(&meshes, subject, reference, extras).write(path)?)
    }

    /// Pose and certificate.
    pub fn report(&self, subject: &Subject) -> Value {
        json!({
            "subject": subject.id,
            "contractions": self.pose.contractions,
            "jaw": self.pose.jaw,
            "gaze": self.pose.gaze,
            "equilibrium": self.equilibrium.certificate,
        })
    }
}

/// The face model of a subject outside any recipe, with the built-in muscles.
///
/// # Errors
/// [`Error::Sim`] for a face that cannot carry muscles.
pub fn face_model(subject: &Subject) -> Result<FaceModel, Error> {
    Ok(FaceModel::new(
        ReferenceHead::embedded(),
        MuscleSet::embedded(),
        subject,
    )?)
}
