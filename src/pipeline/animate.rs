//! From a subject and an expression to a deformed face (paper section 4).

use std::borrow::Cow;

use facile_core::{Isometry3, Point3, UnitQuaternion, Vector3};
use facile_sim::{Certificate, Pose, Solver, SolverParams};
use facile_trace::head::Gaze;

use super::{Person, Pipeline, equilibria};
use crate::Error;

/// A face in an expression.
#[derive(Clone, Debug)]
pub struct Face {
    /// Fine vertices, mm, head frame.
    pub positions: Vec<Point3>,
    /// Motion of what the jaw carries, from closed.
    pub jaw: Isometry3,
    /// Direction of the left and the right eye.
    pub gaze: [Gaze; 2],
    /// How well the equilibrium is met; `None` for the face at rest, which is not simulated.
    pub certificate: Option<Certificate>,
}

impl Pipeline {
    /// The face of `person` in a pose, solved for or from the cache.
    ///
    /// # Errors
    /// [`Error::Sim`] if no equilibrium is found, or the face cannot carry muscles.
    pub fn face(&self, person: &Person, pose: &Pose, solver: &mut Solver) -> Result<Face, Error> {
        let (skips, is_moved) = (self.skips(), !pose.is_neutral());
        let at_rest = || Face {
            positions: person.subject.positions.clone(),
            jaw: Isometry3::identity(),
            gaze: [Gaze::default(); 2],
            certificate: None,
        };
        // A neutral face is not simulated.
        let rig = self.rig.as_ref();
        let Some(rig) = rig.filter(|_| is_moved || !skips.faces_at_rest) else {
            return Ok(at_rest());
        };
        let solver_kind = self.recipe().solver;
        let key = equilibria::key(&person.shape, pose, solver_kind);
        if skips.cached_equilibria
            && let Some(face) = self.equilibria.get(&key, person.subject.positions.len())
        {
            return Ok(face);
        }
        let model = person.model(rig, self.reference())?;
        let pose = if skips.idle_muscles {
            Cow::Borrowed(pose)
        } else {
            Cow::Owned(pose.naming_all(self.muscles()))
        };
        let solved = solver.solve(model, &pose, &SolverParams::of(solver_kind))?;
        let face = Face {
            positions: solved.positions,
            jaw: solved.jaw,
            gaze: solved.eyes.map(|turn| gaze_of(&turn)),
            certificate: is_moved.then_some(solved.certificate),
        };
        self.equilibria.put(&key, &face);
        Ok(face)
    }
}

/// The direction in which an eyeball looks after a turn.
fn gaze_of(turn: &UnitQuaternion) -> Gaze {
    let sight = turn * Vector3::z();
    Gaze {
        yaw: libm::atan2(sight.x, sight.z),
        pitch: libm::asin(sight.y.clamp(-1.0, 1.0)),
    }
}
