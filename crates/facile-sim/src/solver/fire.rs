//! Scaled FIRE: motion without damping that is stopped whenever it goes uphill. No matrix, no memory: a cross-check.
//!
//! Masses are the stiffness at each node, so that every node can take about the same time step. Contact is that of
//! Verlet. Source: Bitzek et al., Structural relaxation made simple, 2006, with the constants given there.

use super::certificate::residual;
use super::{Outcome, SolverParams};
use crate::elements::Volume;
use crate::load::Load;
use crate::simd::LANES;
use crate::springs::ends;
use crate::vector::{V3, ZERO, add_scaled, dot, scale};

/// Longest time step in units of the slowest scale: below the limit of stability of a spring between two nodes.
const MAX_STEP: f64 = 0.9;
/// The least that the longest step is shortened to.
const MIN_STEP: f64 = 0.02;
/// First time step.
const FIRST_STEP: f64 = 0.3;
/// Steps downhill before the time step grows.
const PATIENCE: usize = 5;
/// A prism's six nodes move against each other: its stiffness counts this many times for each.
const PAIRED: f64 = 6.0;
/// Longest way of a node in one step, mm: squeezed prisms stiffen by orders of magnitude within a millimetre.
const MAX_MOVE_MM: f64 = 0.3;
const GROW: f64 = 1.1;
const SHRINK: f64 = 0.5;
const MIX: f64 = 0.1;
const MIX_FADES: f64 = 0.99;
/// Steps between checks of the residual.
const CHECK: usize = 10;
/// Steps between weighings: prisms that are squeezed stiffen on the way.
const WEIGH: usize = 50;
/// How much looser than the last step of the path the others are solved.
const PATH_LOOSENESS: f64 = 100.0;
/// Checks without a smaller residual after which the longest step is halved: some spring is stiffer than its nodes' masses
/// allow for.
const STUCK: usize = 40;
/// Contact counts as touching within this distance, mm.
const TOUCH_MM: f64 = 1e-6;

/// Moves the nodes to rest. Steps of the path before the last are taken loosely.
pub(crate) fn relax(
    load: &Load<'_>,
    x: &mut [V3],
    params: &SolverParams,
    budget: usize,
    is_last: bool,
) -> Outcome {
    let tolerance = params.tolerance * if is_last { 1.0 } else { PATH_LOOSENESS };
    let mut mobility = Vec::new();
    let mut velocity = vec![ZERO; x.len()];
    let mut gradient = vec![ZERO; x.len()];
    let (mut dt, mut mix, mut downhill) = (FIRST_STEP, MIX, 0);
    let (mut limit, mut lowest, mut waited) = (MAX_STEP, f64::INFINITY, 0);
    let mut out = Outcome {
        residual: f64::INFINITY,
        iterations: 0,
        converged: false,
        energy: f64::INFINITY,
        smallest_pivot: 0.0,
    };
    load.contacts.project(x, &mut velocity);
    while out.iterations < budget {
        out.energy = load.energy(x, &mut gradient);
        load.contacts.balance(x, TOUCH_MM, &mut gradient);
        if out.iterations.is_multiple_of(WEIGH) {
            mobility = mobilities(load, x);
        }
        if out.iterations.is_multiple_of(CHECK) {
            out.residual = residual(load, x, &mut gradient, TOUCH_MM);
            out.converged = out.residual <= tolerance;
            if out.converged || !out.energy.is_finite() {
                break;
            }
            waited += 1;
            if out.residual < lowest {
                (lowest, waited) = (out.residual, 0);
            } else if waited >= STUCK {
                limit = (0.5 * limit).max(MIN_STEP);
                dt = dt.min(limit);
                waited = 0;
            }
        }
        out.iterations += 1;
        // Power of the force, and both lengths in the metric of the masses.
        let (mut power, mut speed, mut force) = (0.0, 0.0, 0.0);
        for ((v, g), m) in velocity.iter().zip(&gradient).zip(&mobility) {
            if *m > 0.0 {
                power -= dot(*v, *g);
                speed += dot(*v, *v) / m;
                force += dot(*g, *g) * m;
            }
        }
        if power > 0.0 {
            let turn = mix * (speed / force.max(1e-300)).sqrt();
            for ((v, g), m) in velocity.iter_mut().zip(&gradient).zip(&mobility) {
                *v = add_scaled(scale(*v, 1.0 - mix), *g, -turn * m);
            }
            downhill += 1;
            if downhill > PATIENCE {
                dt = (dt * GROW).min(limit);
                mix *= MIX_FADES;
            }
        } else if out.iterations > 1 {
            velocity.fill(ZERO);
            dt *= SHRINK;
            mix = MIX;
            downhill = 0;
        }
        let mut fastest = 0.0f64;
        for ((v, g), m) in velocity.iter_mut().zip(&gradient).zip(&mobility) {
            *v = add_scaled(*v, *g, -dt * m);
            fastest = fastest.max(dot(*v, *v));
        }
        let step = dt.min(MAX_MOVE_MM / fastest.sqrt().max(1e-300));
        for ((v, p), m) in velocity.iter().zip(x.iter_mut()).zip(&mobility) {
            *p = add_scaled(*p, *v, if *m > 0.0 { step } else { 0.0 });
        }
        load.contacts.project(x, &mut velocity);
    }
    out
}

/// One over the stiffness of everything that holds a node at `x`; 0 for nodes that do not move.
fn mobilities(load: &Load<'_>, x: &[V3]) -> Vec<f64> {
    let model = load.model;
    let n = load.attachment.len();
    let mut k = vec![0.0; 2 * n];
    for (edge, stiffness) in model.template.edges.iter().zip(&load.stiffness) {
        for ([a, b], s) in ends(*edge, n as u32).into_iter().zip(stiffness) {
            k[a as usize] += s;
            k[b as usize] += s;
        }
    }
    for (i, hold) in load.attachment.iter().enumerate() {
        k[i] += model.springs.vertical_stiffness;
        k[n + i] += model.springs.vertical_stiffness + hold;
    }
    let elements = &model.elements;
    for (e, nodes) in elements.nodes.iter().enumerate() {
        let volume = Volume::of(&nodes.map(|i| x[i as usize]));
        let kappa = elements.groups[e / LANES].stiffening(e % LANES, volume.value);
        for (&i, slope) in nodes.iter().zip(volume.gradient()) {
            k[i as usize] += elements.shape_stiffness + PAIRED * kappa * dot(slope, slope);
        }
    }
    k.iter()
        .zip(&model.template.moving)
        .map(|(k, m)| if *m { 1.0 / k.max(1e-9) } else { 0.0 })
        .collect()
}
