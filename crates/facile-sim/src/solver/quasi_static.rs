//! The quasi-static solver: preconditioned L-BFGS on the energy, over the surfaces of skull and eyeballs.
//!
//! Contact is a bound, not a penalty: a node that is pushed onto a surface slides on it and is let go when the force
//! turns. A penalty or an augmented Lagrangian stiff enough for 0.02 mm costs three to ten times the iterations, because
//! the set of nodes that touch changes all the time. Near the end all second derivatives are in the matrix, those of the
//! surfaces that nodes slide on as well, so that what is left falls quadratically. Steps of the path before the last are
//! solved loosely.

use super::assembly::Hessian;
use super::lbfgs::{Lbfgs, Problem, Step};
use super::preconditioner::Preconditioner;
use super::{Outcome, Scratch, SolverParams};
use crate::SimError;
use crate::contact::Measured;
use crate::load::Load;
use crate::model::FaceModel;
use crate::pose::Pose;
use crate::vector::{V3, add, add_scaled, dot, norm, sub};

/// Iterations after which the matrix is made anew. At the end of the path it is also made anew after the first one, which
/// goes farthest.
const REFACTOR_AFTER: usize = 10;
/// Relative residual below which all second derivatives are in the matrix.
const EXACT_BELOW: f64 = 1.0;
/// Relative residual to which steps of the path before the last are solved.
const PATH_RESIDUAL: f64 = 10.0;

/// A walk along the path of a pose, from neutral to full intensity and beyond.
pub(crate) struct Walk<'a> {
    model: &'a FaceModel,
    pose: &'a Pose,
    pub(crate) x: Vec<V3>,
    /// Where skull, jaw and lids carry the nodes.
    carried: Vec<V3>,
    /// Intensity.
    at: f64,
    /// The place before: motion since then, apart from what carried the nodes, and by how much the intensity grew.
    last: Option<(Vec<V3>, f64)>,
    iterations: usize,
}

impl<'a> Walk<'a> {
    /// At the neutral face.
    pub(crate) fn new(model: &'a FaceModel, pose: &'a Pose) -> Self {
        Self {
            model,
            pose,
            x: model.rest.clone(),
            carried: model.rest.clone(),
            at: 0.0,
            last: None,
            iterations: 0,
        }
    }

    /// Goes on to a higher intensity, in steps no longer than the parameters allow, and solves there. The first guess of
    /// each step goes on in the direction of the one before.
    pub(crate) fn go(
        &mut self,
        scratch: &mut Scratch,
        intensity: f64,
        params: &SolverParams,
    ) -> Result<(Load<'a>, Outcome), SimError> {
        let before = self.iterations;
        let steps = path_steps(&self.pose.scaled(intensity - self.at), params);
        let start = self.at;
        for step in 1..=steps {
            let last = step == steps;
            let share = step as f64 / steps as f64;
            let to = start + share * (intensity - start);
            let load = Load::new(self.model, &self.pose.scaled(to))?;
            let from = self.x.clone();
            carry(&mut self.x, &self.carried, &load);
            if let Some((way, grown)) = &self.last {
                let growth = (to - self.at) / grown;
                for ((p, w), moves) in self.x.iter_mut().zip(way).zip(&self.model.template.moving) {
                    *p = add_scaled(*p, *w, if *moves { growth } else { 0.0 });
                }
            }
            let tolerance = if last {
                params.tolerance
            } else {
                params.tolerance.max(PATH_RESIDUAL)
            };
            let mut stage = Stage {
                load: &load,
                preconditioner: &mut scratch.preconditioner,
                lbfgs: &mut scratch.lbfgs,
                tolerance,
                is_last: last,
                budget: params
                    .max_iterations
                    .saturating_sub(self.iterations - before),
            };
            let result = stage.run(&mut self.x)?;
            self.iterations += result.iterations;
            let way = (0..from.len())
                .map(|i| {
                    let own = sub(self.x[i], from[i]);
                    sub(own, sub(load.carried[i], self.carried[i]))
                })
                .collect();
            self.last = Some((way, to - self.at));
            self.carried.clone_from(&load.carried);
            self.at = to;
            if last {
                let outcome = Outcome {
                    iterations: self.iterations - before,
                    ..result
                };
                return Ok((load, outcome));
            }
        }
        unreachable!("a path has at least one step")
    }
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
    tolerance: f64,
    /// Whether this is the end of the path.
    is_last: bool,
    budget: usize,
}

/// The energy over the surfaces that nodes rest on.
struct Resting<'s, 'a> {
    load: &'s Load<'a>,
    preconditioner: &'s mut Preconditioner,
    normals: Vec<V3>,
    measured: Measured,
}

impl Problem for Resting<'_, '_> {
    fn evaluate(&mut self, x: &mut [V3], gradient: &mut [V3]) -> f64 {
        self.load
            .contacts
            .settle(x, &self.normals, &mut self.measured);
        let energy = self.load.energy(x, gradient);
        for (g, moves) in gradient.iter_mut().zip(&self.load.model.template.moving) {
            if !moves {
                *g = [0.0; 3];
            }
        }
        energy
    }

    fn reduce(&self, x: &[V3], normals: &[V3], gradient: &mut [V3]) {
        let contacts = &self.load.contacts;
        contacts.reduce(x, normals, &self.measured, gradient);
    }

    fn inverse(&mut self, gradient: &[V3], out: &mut [V3]) {
        let system = &self.load.model.template.pattern;
        self.preconditioner.descend(system, gradient, out);
    }
}

impl Resting<'_, '_> {
    /// Makes the matrix anew; returns which it is.
    fn refactor(&mut self, x: &[V3], gradient: &[V3], residual: f64) -> Result<Hessian, SimError> {
        let is_near = residual < EXACT_BELOW;
        if is_near && self.factor(x, gradient, Hessian::Exact).is_ok() {
            return Ok(Hessian::Exact);
        }
        self.factor(x, gradient, Hessian::Positive)?;
        Ok(Hessian::Positive)
    }

    /// Factors the matrix over the nodes that rest or are about to land.
    fn factor(&mut self, x: &[V3], gradient: &[V3], hessian: Hessian) -> Result<(), SimError> {
        let system = &self.load.model.template.pattern;
        self.preconditioner.assemble(self.load, x, hessian);
        if hessian == Hessian::Exact {
            self.preconditioner
                .bend(self.load, x, gradient, &self.normals);
        }
        let own = &self.preconditioner.own;
        let contacts = &self.load.contacts;
        contacts.landing(x, gradient, own, &self.measured, &mut self.normals);
        self.preconditioner.factor(system, &self.normals)
    }

    /// Largest force on a moving node that nothing balances, over the reference force.
    fn force(&self, gradient: &[V3]) -> f64 {
        let mut largest = 0.0f64;
        for (g, n) in gradient.iter().zip(&self.normals) {
            let part = dot(*g, *n);
            largest = largest.max(norm(add_scaled(*g, *n, -part)));
        }
        largest / self.load.model.params.fascia_stiffness
    }
}

impl Stage<'_, '_> {
    fn run(&mut self, x: &mut Vec<V3>) -> Result<Outcome, SimError> {
        let mut gradient = vec![[0.0; 3]; x.len()];
        let mut problem = Resting {
            load: self.load,
            preconditioner: &mut *self.preconditioner,
            normals: vec![[0.0; 3]; x.len()],
            measured: Measured::default(),
        };
        let mut energy = problem.evaluate(x, &mut gradient);
        let contacts = &self.load.contacts;
        let mut iterations = 0;
        let mut since = usize::MAX;
        let mut smallest_pivot = 0.0;
        let mut normals = Vec::new();
        self.lbfgs.reset();
        let (converged, residual) = loop {
            contacts.resting(x, &gradient, &problem.measured, &mut problem.normals);
            let residual = problem.force(&gradient);
            if residual <= self.tolerance {
                break (true, residual);
            }
            if iterations >= self.budget {
                break (false, residual);
            }
            let is_settling = iterations == 1 && self.is_last;
            if iterations == 0 || is_settling || since >= REFACTOR_AFTER {
                // What was learned of a matrix is worth less than all second derivatives.
                if problem.refactor(x, &gradient, residual)? == Hessian::Exact {
                    self.lbfgs.reset();
                }
                smallest_pivot = problem.preconditioner.smallest_pivot();
                since = 0;
            } else {
                let own = &problem.preconditioner.own;
                contacts.landing(x, &gradient, own, &problem.measured, &mut problem.normals);
            }
            normals.clone_from(&problem.normals);
            let step = self
                .lbfgs
                .step(x, &mut gradient, &mut energy, &normals, &mut problem);
            iterations += 1;
            since += 1;
            if step == Step::Stalled {
                // Once more with a fresh matrix and nothing remembered, then it is over.
                if since == 1 {
                    break (false, residual);
                }
                self.lbfgs.reset();
                since = usize::MAX;
            }
        };
        Ok(Outcome {
            residual,
            iterations,
            converged,
            energy,
            smallest_pivot,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::Solver;
    use super::*;
    use crate::{ExpressionSet, FaceModel, MuscleSet, mean_subject};
    use facile_core::ReferenceHead;

    /// Energies after each iteration of the last step of the path, from where nodes are carried to.
    fn energies(model: &FaceModel, pose: &Pose) -> Vec<f64> {
        let load = Load::new(model, pose).expect("valid");
        let mut scratch = Solver::new().scratch(model);
        let mut after = |budget: usize| {
            let mut x = load.carried.clone();
            let mut stage = Stage {
                load: &load,
                preconditioner: &mut scratch.preconditioner,
                lbfgs: &mut scratch.lbfgs,
                tolerance: SolverParams::default().tolerance,
                is_last: true,
                budget,
            };
            stage.run(&mut x).expect("factors")
        };
        let all = after(usize::MAX);
        assert!(all.converged);
        (0..=all.iterations).map(|k| after(k).energy).collect()
    }

    #[test]
    fn the_energy_never_rises_along_a_step() {
        let reference = ReferenceHead::embedded();
        let muscles = MuscleSet::embedded();
        let model = FaceModel::new(reference, muscles, &mean_subject(reference)).expect("built");
        for name in ["smile", "surprise", "kiss", "blink"] {
            let expression = ExpressionSet::embedded().get(name).expect("built in");
            let energies = energies(&model, &expression.pose(muscles).expect("valid"));
            assert!(energies.len() > 5, "{name}");
            for (k, pair) in energies.windows(2).enumerate() {
                let rise = pair[1] - pair[0];
                assert!(rise <= 1e-12 * pair[0].abs(), "{name}, {k}: {rise}");
            }
        }
    }
}
