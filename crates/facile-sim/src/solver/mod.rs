//! Three ways to the same equilibrium: quasi-static (the default), velocity Verlet (the paper's), and FIRE.
//!
//! [`Solver`] owns scratch memory only; the result is a function of model, pose and parameters. Both solvers walk the
//! same path from neutral to the pose, in steps of intensity, because strong poses have more than one equilibrium: the
//! path makes the answer unique. What no solver can certify is an error, never a silent last iterate.

mod assembly;
mod certificate;
mod fire;
mod lbfgs;
mod preconditioner;
mod quasi_static;
mod verlet;

use facile_core::{Isometry3, Point3, UnitQuaternion};
use serde::{Deserialize, Serialize};

pub(crate) use assembly::SystemPattern;
pub use certificate::Certificate;

use crate::SimError;
use crate::kinematics::eye_rotation;
use crate::load::Load;
use crate::model::FaceModel;
use crate::pose::Pose;
use crate::vector::{V3, sub, to_point};
use lbfgs::Lbfgs;
use preconditioner::Preconditioner;
use quasi_static::{Walk, carry, path_steps};

/// Share of the steps of a path that are taken where the whole steps led nowhere.
const CAREFUL: f64 = 0.3;

/// Which way to the equilibrium.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SolverKind {
    /// L-BFGS with a factored preconditioner, over the surfaces that nodes rest on.
    #[default]
    QuasiStatic,
    /// The paper's damped motion, followed until it rests, contact by projection.
    Verlet,
    /// Scaled FIRE: motion that is stopped whenever it goes uphill, contact by projection.
    Fire,
}

impl SolverKind {
    /// All solvers, the default first.
    pub const ALL: [Self; 3] = [Self::QuasiStatic, Self::Verlet, Self::Fire];

    /// The name in recipes and certificates.
    pub fn name(self) -> &'static str {
        match self {
            Self::QuasiStatic => "quasi_static",
            Self::Verlet => "verlet",
            Self::Fire => "fire",
        }
    }
}

/// Settings of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverParams {
    /// Which way.
    pub kind: SolverKind,
    /// Relative residual to reach: largest unbalanced force on a node over the force of a relaxed fascia spring that is
    /// stretched by 1 mm. At the default the largest node error is below 0.01 mm: 0.0006 mm at most on 77 solves of the
    /// built-in expressions, see `docs/physics.md`.
    pub tolerance: f64,
    /// Largest penetration of skull, eyeballs or lips to accept, mm.
    pub max_penetration_mm: f64,
    /// Longest step of intensity on the path from neutral, in `(0, 1]`.
    pub continuation_step: f64,
    /// First time step of Verlet, as a share of the limit of stability `2 / omega`, in `(0, 4]`. A step under which energy
    /// rises is halved.
    pub time_step: f64,
    /// Iterations (quasi-static: of L-BFGS; Verlet and FIRE: time steps) before giving up.
    pub max_iterations: usize,
}

impl Default for SolverParams {
    fn default() -> Self {
        Self {
            kind: SolverKind::QuasiStatic,
            tolerance: 1e-3,
            max_penetration_mm: 0.02,
            continuation_step: 0.5,
            time_step: 0.9,
            max_iterations: 4_000,
        }
    }
}

impl SolverParams {
    /// Defaults of the paper's solver. At 1e-4 one of 30 solves ends 0.0102 mm away, along a soft mode.
    pub fn verlet() -> Self {
        Self {
            kind: SolverKind::Verlet,
            tolerance: 8e-5,
            max_iterations: 100_000,
            ..Self::default()
        }
    }

    /// Defaults of a solver.
    pub fn of(kind: SolverKind) -> Self {
        match kind {
            SolverKind::QuasiStatic => Self::default(),
            SolverKind::Verlet => Self::verlet(),
            SolverKind::Fire => Self {
                kind,
                tolerance: 2e-4,
                max_iterations: 40_000,
                ..Self::default()
            },
        }
    }
}

/// A face at rest in a pose.
#[derive(Clone, Debug)]
pub struct Equilibrium {
    /// Fine vertices, mm, head frame.
    pub positions: Vec<Point3>,
    /// Nodes of the simulation, mm, head frame: the skin's, then the fascia's.
    pub nodes: Vec<Point3>,
    /// Motion of the jaw from closed, head frame: what lower teeth and tongue follow.
    pub jaw: Isometry3,
    /// Rotation of each eyeball about its centre, left and right.
    pub eyes: [UnitQuaternion; 2],
    /// How well the equilibrium is met.
    pub certificate: Certificate,
}

/// Solves for equilibria; holds memory that solves reuse.
#[derive(Debug, Default)]
pub struct Solver {
    scratch: Option<Scratch>,
}

/// Memory for one topology.
#[derive(Debug)]
struct Scratch {
    preconditioner: Preconditioner,
    lbfgs: Lbfgs,
    nodes: usize,
}

/// What a solver hands back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome {
    pub(crate) residual: f64,
    pub(crate) iterations: usize,
    pub(crate) converged: bool,
    pub(crate) energy: f64,
    /// Smallest pivot of the last factor, 0 without one.
    pub(crate) smallest_pivot: f64,
}

impl Solver {
    /// A solver with nothing allocated yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The equilibrium of a pose.
    ///
    /// # Errors
    /// [`SimError::OutOfRange`] and [`SimError::UnknownName`] for a pose the model cannot take,
    /// [`SimError::NotConverged`] if tolerance or penetration are not met.
    pub fn solve(
        &mut self,
        model: &FaceModel,
        pose: &Pose,
        params: &SolverParams,
    ) -> Result<Equilibrium, SimError> {
        pose.check(&model.template.muscles)?;
        let mut scratch = self.scratch(model);
        let result = solve(&mut scratch, model, pose, params);
        self.scratch = Some(scratch);
        result
    }

    /// The equilibria of one motion at several intensities: each starts from the one before, its first guess continued
    /// to first order. `intensities` in `(0, 1]`, ascending; one result for each. Only for the quasi-static solver; the
    /// others solve each intensity from neutral.
    ///
    /// Each equilibrium is that of [`Self::solve`] to the tolerance (0.01 mm at the default), but not to the last bit.
    ///
    /// # Errors
    /// Those of [`Self::solve`], for each intensity on its own.
    pub fn solve_ladder(
        &mut self,
        model: &FaceModel,
        pose: &Pose,
        intensities: &[f64],
        params: &SolverParams,
    ) -> Vec<Result<Equilibrium, SimError>> {
        let mut out = Vec::with_capacity(intensities.len());
        if let Err(e) = pose.check(&model.template.muscles) {
            return intensities.iter().map(|_| Err(e.clone())).collect();
        }
        let mut scratch = self.scratch(model);
        let mut walk: Option<Walk<'_>> = None;
        let mut at = 0.0;
        for &intensity in intensities {
            let here = pose.scaled(intensity);
            let climbs = params.kind == SolverKind::QuasiStatic && intensity > at;
            if !climbs || here.is_neutral() {
                out.push(solve(&mut scratch, model, &here, params));
                continue;
            }
            let mut current = walk.take().unwrap_or_else(|| Walk::new(model, pose));
            let result = current
                .go(&mut scratch, intensity, params)
                .and_then(|(load, outcome)| certify(&load, &current.x, &here, params, &outcome));
            // After a failure the next one starts from neutral.
            if result.is_ok() {
                walk = Some(current);
                at = intensity;
            } else {
                at = 0.0;
            }
            out.push(result);
        }
        self.scratch = Some(scratch);
        out
    }

    fn scratch(&mut self, model: &FaceModel) -> Scratch {
        match self.scratch.take() {
            Some(s) if s.nodes == model.rest.len() => s,
            _ => Scratch {
                preconditioner: Preconditioner::new(&model.template.pattern),
                lbfgs: Lbfgs::default(),
                nodes: model.rest.len(),
            },
        }
    }
}

fn solve(
    scratch: &mut Scratch,
    model: &FaceModel,
    pose: &Pose,
    params: &SolverParams,
) -> Result<Equilibrium, SimError> {
    let (load, x, outcome) = if pose.is_neutral() {
        // The rest state is the equilibrium by construction: nothing to iterate, nothing to round.
        let load = Load::new(model, pose)?;
        let outcome = certificate::assess(&load, &model.rest);
        (load, model.rest.clone(), outcome)
    } else {
        match params.kind {
            SolverKind::QuasiStatic => {
                let mut walk = Walk::new(model, pose);
                let (load, outcome) = walk.go(scratch, 1.0, params)?;
                if outcome.converged {
                    (load, walk.x, outcome)
                } else {
                    // Once more along a path of shorter steps.
                    let careful = SolverParams {
                        continuation_step: CAREFUL * params.continuation_step,
                        ..*params
                    };
                    let mut walk = Walk::new(model, pose);
                    let (load, outcome) = walk.go(scratch, 1.0, &careful)?;
                    (load, walk.x, outcome)
                }
            }
            SolverKind::Verlet | SolverKind::Fire => {
                let relax: Relax = if params.kind == SolverKind::Verlet {
                    verlet::relax
                } else {
                    fire::relax
                };
                relax_along_path(model, pose, params, relax)?
            }
        }
    };
    certify(&load, &x, pose, params, &outcome)
}

/// Moves nodes to rest in a load, within a number of steps; whether this is the end of the path.
type Relax = fn(&Load<'_>, &mut [V3], &SolverParams, budget: usize, is_last: bool) -> Outcome;

/// Takes a pose in the same steps as the quasi-static solver, so that all solvers end in the same equilibrium where
/// there are several.
fn relax_along_path<'a>(
    model: &'a FaceModel,
    pose: &Pose,
    params: &SolverParams,
    relax: Relax,
) -> Result<(Load<'a>, Vec<V3>, Outcome), SimError> {
    let steps = path_steps(pose, params);
    let mut x = model.rest.clone();
    let mut carried = model.rest.clone();
    let mut iterations = 0;
    for step in 1..steps {
        let load = Load::new(model, &pose.scaled(step as f64 / steps as f64))?;
        carry(&mut x, &carried, &load);
        let budget = params.max_iterations.saturating_sub(iterations);
        iterations += relax(&load, &mut x, params, budget, false).iterations;
        carried = load.carried;
    }
    let load = Load::new(model, pose)?;
    carry(&mut x, &carried, &load);
    let budget = params.max_iterations.saturating_sub(iterations);
    let mut outcome = relax(&load, &mut x, params, budget, true);
    outcome.iterations += iterations;
    Ok((load, x, outcome))
}

/// The equilibrium of nodes that a solver handed back, or what is wrong with them.
fn certify(
    load: &Load<'_>,
    x: &[V3],
    pose: &Pose,
    params: &SolverParams,
    outcome: &Outcome,
) -> Result<Equilibrium, SimError> {
    let certificate = Certificate::new(load, x, params.kind, outcome);
    let within = certificate.max_penetration_mm <= params.max_penetration_mm;
    if !outcome.converged || !within || !outcome.energy.is_finite() {
        return Err(SimError::NotConverged {
            solver: params.kind.name(),
            iterations: outcome.iterations,
            residual: outcome.residual,
            tolerance: params.tolerance,
            penetration_mm: certificate.max_penetration_mm,
        });
    }
    Ok(finish(load, x, pose, certificate))
}

/// From nodes to fine vertices, in the head's frame.
fn finish(load: &Load<'_>, x: &[V3], pose: &Pose, certificate: Certificate) -> Equilibrium {
    let model = load.model;
    let carried: Vec<V3> = model
        .cage
        .iter()
        .zip(&load.motion)
        .map(|(p, m)| sub(m.apply(*p), *p))
        .collect();
    let mut displacement = carried.clone();
    for (i, &v) in model.template.cage_of_node.iter().enumerate() {
        displacement[v as usize] = sub(x[i], model.rest[i]);
    }
    model.follow.complete(&mut displacement, &carried);
    let head = &model.head_from_skull;
    let turned: Vec<V3> = displacement
        .iter()
        .map(|d| (head.rotation * crate::vector::to_vector(*d)).into())
        .collect();
    let jaw = model.hinges.mandible.motion(&pose.jaw).isometry();
    let eye = head.rotation * eye_rotation(&pose.gaze) * head.rotation.inverse();
    Equilibrium {
        positions: model.follow.fine(&model.fine, &turned),
        nodes: x.iter().map(|p| head * to_point(*p)).collect(),
        jaw: head * jaw * head.inverse(),
        eyes: [eye; 2],
        certificate,
    }
}
