//! The quasi-static solver: preconditioned L-BFGS on the energy, contact by an augmented Lagrangian.
//!
//! On each step of the path: factor the matrix with the contacts that carry now, iterate, move the multipliers to the
//! contact forces, and again until force balance and contact agree. Steps before the last are solved loosely.

use super::certificate::residual;
use super::lbfgs::{Lbfgs, Step};
use super::preconditioner::Preconditioner;
use super::{Outcome, Scratch, SolverParams};
use crate::SimError;
use crate::load::Load;
use crate::model::FaceModel;
use crate::pose::Pose;
use crate::vector::{V3, add, norm, sub};

/// How much looser than the last step the others are solved.
const PATH_LOOSENESS: f64 = 100.0;
/// Residual of the first round of multipliers.
const ROUGH: f64 = 0.02;
/// Iterations after which the matrix is made anew.
const REFACTOR_AFTER: usize = 40;
/// Rounds of multipliers before giving up.
const MAX_ROUNDS: usize = 40;

/// The equilibrium of a pose: nodes and how they were found.
pub(crate) fn solve(
    scratch: &mut Scratch,
    model: &FaceModel,
    pose: &Pose,
    params: &SolverParams,
) -> Result<(Vec<V3>, Outcome), SimError> {
    let steps = path_steps(pose, params);
    let mut x = model.rest.clone();
    let mut carried = model.rest.clone();
    let mut multipliers = vec![0.0; 0];
    let mut iterations = 0;
    let mut outcome = None;
    for step in 1..=steps {
        let last = step == steps;
        let here = if last {
            pose.clone()
        } else {
            pose.scaled(step as f64 / steps as f64)
        };
        let load = Load::new(model, &here)?;
        multipliers.resize(load.contacts.len(), 0.0);
        carry(&mut x, &carried, &load);
        carried.clone_from(&load.carried);
        let looseness = if last { 1.0 } else { PATH_LOOSENESS };
        let mut stage = Stage {
            load: &load,
            preconditioner: &mut scratch.preconditioner,
            lbfgs: &mut scratch.lbfgs,
            multipliers: &mut multipliers,
            stiffness: params.contact_stiffness,
            tolerance: params.tolerance * looseness,
            penetration: 0.5 * params.max_penetration_mm * looseness,
            budget: params.max_iterations.saturating_sub(iterations),
        };
        let result = stage.run(&mut x)?;
        iterations += result.iterations;
        outcome = Some(Outcome {
            iterations,
            ..result
        });
    }
    Ok((x, outcome.expect("at least one step")))
}

/// Number of steps of the path from neutral: the larger the motion, the more.
pub(crate) fn path_steps(pose: &Pose, params: &SolverParams) -> usize {
    let strongest = pose
        .contractions
        .values()
        .map(|s| s.left.max(s.right))
        .fold(0.0, f64::max);
    // An opening of 20 degrees counts as a full contraction.
    let jaw = (pose.jaw.open_rad.abs() / 0.35)
        .max(pose.jaw.protrusion_mm.abs() / 10.0)
        .max(pose.jaw.lateral_mm.abs() / 10.0);
    ((strongest.max(jaw) / params.continuation_step).ceil() as usize).max(1)
}

/// Moves nodes along with skull, jaw and lids from one step of the path to the next.
pub(crate) fn carry(x: &mut [V3], before: &[V3], load: &Load<'_>) {
    let moving = &load.model.template.moving;
    for (i, p) in x.iter_mut().enumerate() {
        *p = if moving[i] {
            add(*p, sub(load.carried[i], before[i]))
        } else {
            load.carried[i]
        };
    }
}

/// One step of the path.
struct Stage<'s, 'a> {
    load: &'s Load<'a>,
    preconditioner: &'s mut Preconditioner,
    lbfgs: &'s mut Lbfgs,
    multipliers: &'s mut [f64],
    stiffness: f64,
    tolerance: f64,
    penetration: f64,
    budget: usize,
}

impl Stage<'_, '_> {
    fn run(&mut self, x: &mut Vec<V3>) -> Result<Outcome, SimError> {
        let mut gradient = vec![[0.0; 3]; x.len()];
        let mut energy = self.evaluate(x, &mut gradient);
        let mut iterations = 0;
        // Multipliers first: roughly, then exactly once they push with about the right force.
        let mut inner = self.tolerance.max(ROUGH);
        let mut converged = false;
        for _ in 0..MAX_ROUNDS {
            self.refactor(x)?;
            self.lbfgs.reset();
            let mut stalled = false;
            let mut since = 0;
            while self.force(&gradient) > inner && iterations < self.budget {
                let system = &self.load.model.template.pattern;
                let preconditioner = &mut *self.preconditioner;
                let (load, multipliers, stiffness) =
                    (self.load, &*self.multipliers, self.stiffness);
                let step = self.lbfgs.step(
                    x,
                    &mut gradient,
                    &mut energy,
                    |g, out| preconditioner.descend(system, g, out),
                    |x, g| total_energy(load, multipliers, stiffness, x, g),
                );
                iterations += 1;
                since += 1;
                if step == Step::Stalled {
                    stalled = true;
                    break;
                }
                if since == REFACTOR_AFTER {
                    // Contacts that carry have changed by now.
                    self.refactor(x)?;
                    self.lbfgs.reset();
                    since = 0;
                }
            }
            let depth = self.load.contacts.penetration(x);
            if self.force(&gradient) <= self.tolerance && depth <= self.penetration {
                converged = true;
                break;
            }
            if iterations >= self.budget || (stalled && depth <= self.penetration) {
                break;
            }
            self.load
                .contacts
                .update(x, self.stiffness, self.multipliers);
            energy = self.evaluate(x, &mut gradient);
            inner = (0.05 * inner).max(self.tolerance);
        }
        let residual = residual(self.load, x, &mut gradient, 0.0);
        Ok(Outcome {
            residual,
            iterations,
            converged,
            energy,
        })
    }

    fn evaluate(&self, x: &[V3], gradient: &mut [V3]) -> f64 {
        total_energy(self.load, self.multipliers, self.stiffness, x, gradient)
    }

    /// Largest force on a moving node, contact included, over the reference force.
    fn force(&self, gradient: &[V3]) -> f64 {
        let moving = &self.load.model.template.moving;
        let largest = gradient
            .iter()
            .zip(moving)
            .filter(|(_, m)| **m)
            .map(|(g, _)| norm(*g))
            .fold(0.0, f64::max);
        largest / self.load.model.params.fascia_stiffness
    }

    fn refactor(&mut self, x: &[V3]) -> Result<(), SimError> {
        let carries: Vec<bool> = (0..self.load.contacts.len())
            .map(|c| self.multipliers[c] > self.stiffness * self.load.contacts.gap(c, x).value)
            .collect();
        self.preconditioner
            .factor(self.load, x, &carries, self.stiffness)
    }
}

/// Elastic energy and augmented Lagrangian of contact; the gradient of nodes that do not move is zero.
fn total_energy(
    load: &Load<'_>,
    multipliers: &[f64],
    stiffness: f64,
    x: &[V3],
    gradient: &mut [V3],
) -> f64 {
    let elastic = load.energy(x, gradient);
    let contact = load.contacts.energy(x, stiffness, multipliers, gradient);
    for (g, moves) in gradient.iter_mut().zip(&load.model.template.moving) {
        if !moves {
            *g = [0.0; 3];
        }
    }
    elastic + contact
}
