//! The paper's solver (section 4.3): velocity Verlet with variable steps, until the face rests.
//!
//! Eq. 11 with mass and damping of Table 1. Contact is explicit: a node that falls below a surface is put back and
//! loses its inward velocity. The pose is taken in steps along the same path as in the quasi-static solver, so that both
//! end in the same equilibrium where there are several. The step follows the stiffest motion, measured again and again on
//! the way, and halves when the energy jumps or the motion does not die down.

use super::certificate::residual;
use super::{Outcome, SolverParams};
use crate::load::Load;
use crate::vector::{V3, ZERO, add, add_scaled, dot, norm, scale};

/// Steps between checks of the residual.
const CHECK: usize = 25;
/// Time steps on each step of the path before the last: enough to come near its equilibrium.
const PATH_STEPS: usize = 150;
/// Checks between measurements of the stiffest motion. Prisms that are squeezed stiffen on the way.
const MEASURE: usize = 20;
/// Checks, of steps of full length, in which the residual has to fall by a tenth; a step near its limit can feed a swing
/// that damping just balances. Shorter steps have more of them: slow motion must not shorten its steps for being slow.
const PATIENCE: f64 = 60.0;
/// Times in a row that the residual falls by a tenth before a step that was halved is doubled: what shook the face, nodes that
/// bounce off the skull on the way, is over.
const CALM: usize = 10;
/// Contact counts as touching within this distance, mm.
const TOUCH_MM: f64 = 1e-6;

/// Moves the nodes to rest. On each step of the path before the last a few time steps are enough.
pub(crate) fn relax(
    load: &Load<'_>,
    x: &mut [V3],
    params: &SolverParams,
    budget: usize,
    is_last: bool,
) -> Outcome {
    let budget = if is_last { budget } else { PATH_STEPS };
    let n = x.len();
    let mut state = State {
        x: x.to_vec(),
        velocity: vec![ZERO; n],
        acceleration: vec![ZERO; n],
        gradient: vec![ZERO; n],
    };
    let outcome = state.run(load, params, budget);
    x.copy_from_slice(&state.x);
    outcome
}

struct State {
    x: Vec<V3>,
    velocity: Vec<V3>,
    acceleration: Vec<V3>,
    gradient: Vec<V3>,
}

impl State {
    fn run(&mut self, load: &Load<'_>, settings: &SolverParams, budget: usize) -> Outcome {
        let params = &load.model.params;
        let tolerance = settings.tolerance;
        let longest =
            |x: &[V3]| settings.time_step * 2.0 / (largest_stiffness(load, x) / params.mass).sqrt();
        let mut share = 1.0;
        let mut dt = longest(&self.x);
        let (mut best, mut waited, mut calm, mut checks) = (f64::INFINITY, 0.0, 0, 0);
        let mut energy = self.forces(load);
        let mut residual_now = f64::INFINITY;
        let mut iterations = 0;
        let mut converged = false;
        while iterations < budget {
            let before = (self.x.clone(), self.velocity.clone(), energy);
            for _ in 0..CHECK {
                energy = self.step(load, dt);
            }
            iterations += CHECK;
            // Damped motion loses energy: a rise over many steps is an unstable step. Go back and halve it.
            let kinetic = |v: &[V3]| 0.5 * params.mass * v.iter().map(|u| dot(*u, *u)).sum::<f64>();
            let total_before = before.2 + kinetic(&before.1);
            let total = energy + kinetic(&self.velocity);
            if !total.is_finite() || total > total_before * (1.0 + 1e-6) + 1e-3 {
                (self.x, self.velocity, _) = before;
                energy = self.forces(load);
                share *= 0.5;
                dt *= 0.5;
                calm = 0;
                if dt < 1e-7 {
                    break;
                }
                continue;
            }
            let mut gradient = self.gradient.clone();
            residual_now = residual(load, &self.x, &mut gradient, TOUCH_MM);
            if residual_now <= tolerance {
                converged = true;
                break;
            }
            waited += share;
            if residual_now < 0.9 * best {
                (best, waited) = (residual_now, 0.0);
                calm += 1;
                if calm >= CALM && share < 1.0 {
                    (share, calm) = (2.0 * share, 0);
                }
            } else if waited >= PATIENCE {
                share *= 0.5;
                (best, waited, calm) = (residual_now, 0.0, 0);
            }
            checks += 1;
            if checks % MEASURE == 0 {
                dt = share * longest(&self.x);
            }
        }
        Outcome {
            residual: residual_now,
            iterations,
            converged,
            energy,
            smallest_pivot: 0.0,
        }
    }

    /// One step of velocity Verlet with damping; returns the elastic energy.
    fn step(&mut self, load: &Load<'_>, dt: f64) -> f64 {
        let moving = &load.model.template.moving;
        for (i, moves) in moving.iter().enumerate() {
            if *moves {
                let half = add_scaled(self.velocity[i], self.acceleration[i], 0.5 * dt);
                self.velocity[i] = half;
                self.x[i] = add_scaled(self.x[i], half, dt);
            }
        }
        load.contacts.project(&mut self.x, &mut self.velocity);
        let energy = self.gradient_at(load);
        // Second half of the kick, damping taken implicitly: v = (v_half - dt g / 2m) / (1 + dt gamma / 2m).
        let params = &load.model.params;
        let drag = 0.5 * dt * params.damping / params.mass;
        for (i, moves) in moving.iter().enumerate() {
            if *moves {
                let pull = scale(self.gradient[i], -1.0 / params.mass);
                let v = add_scaled(self.velocity[i], pull, 0.5 * dt);
                self.velocity[i] = scale(v, 1.0 / (1.0 + drag));
                let damping = scale(self.velocity[i], -params.damping / params.mass);
                self.acceleration[i] = add(pull, damping);
            }
        }
        energy
    }

    /// Gradient without the part that contact balances, and accelerations from it.
    fn forces(&mut self, load: &Load<'_>) -> f64 {
        let energy = self.gradient_at(load);
        let params = &load.model.params;
        for i in 0..self.x.len() {
            let pull = scale(self.gradient[i], -1.0 / params.mass);
            let damping = scale(self.velocity[i], -params.damping / params.mass);
            self.acceleration[i] = add(pull, damping);
        }
        energy
    }

    fn gradient_at(&mut self, load: &Load<'_>) -> f64 {
        let energy = load.energy(&self.x, &mut self.gradient);
        load.contacts.balance(&self.x, TOUCH_MM, &mut self.gradient);
        energy
    }
}

/// Largest eigenvalue of the energy's Hessian at `x`, by power iteration on gradient differences.
fn largest_stiffness(load: &Load<'_>, x: &[V3]) -> f64 {
    let moving = &load.model.template.moving;
    let mut direction: Vec<V3> = (0..x.len())
        .map(|i| {
            let t = i as f64;
            [
                libm::sin(12.9 * t),
                libm::sin(78.2 * t),
                libm::sin(37.7 * t),
            ]
        })
        .collect();
    let mut base = vec![ZERO; x.len()];
    let mut shifted = base.clone();
    load.energy(x, &mut base);
    let mut largest = 1.0;
    for _ in 0..30 {
        for (d, m) in direction.iter_mut().zip(moving) {
            if !m {
                *d = ZERO;
            }
        }
        let size = direction.iter().map(|d| dot(*d, *d)).sum::<f64>().sqrt();
        let small = 1e-4 / size.max(1e-300);
        let y: Vec<V3> = x
            .iter()
            .zip(&direction)
            .map(|(p, d)| add_scaled(*p, *d, small))
            .collect();
        load.energy(&y, &mut shifted);
        for (d, (s, b)) in direction.iter_mut().zip(shifted.iter().zip(&base)) {
            *d = scale(add_scaled(*s, *b, -1.0), 1.0 / 1e-4);
        }
        for (d, m) in direction.iter_mut().zip(moving) {
            if !m {
                *d = ZERO;
            }
        }
        largest = norm_of(&direction).max(1.0);
    }
    // Power iteration approaches from below.
    1.1 * largest
}

fn norm_of(v: &[V3]) -> f64 {
    v.iter().map(|d| norm(*d) * norm(*d)).sum::<f64>().sqrt()
}
