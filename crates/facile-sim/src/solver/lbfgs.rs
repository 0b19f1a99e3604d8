//! Limited-memory BFGS around a given inverse, with backtracking along a path that keeps to surfaces.
//!
//! Nodes that rest on a surface move along it: the direction has no part along their normals, and a trial is put back
//! onto the surfaces before it is judged. Nothing stiff is in the function then. Energies never rise along an accepted
//! step by more than rounding. Sources: Nocedal and Wright, Numerical Optimization, 2006, algorithm 7.4 with the initial inverse of the
//! preconditioner; Bertsekas, Projected Newton methods for optimization problems with simple constraints, 1982.

use crate::simd::{Kernel, add_to, dispatch, inner};
use crate::vector::V3;

/// Pairs of steps and gradient changes that are kept.
const MEMORY: usize = 8;
/// Smallest accepted share of the decrease that the slope promises.
const ARMIJO: f64 = 1e-4;
/// Shortenings before a step counts as failed.
const MAX_SHORTENINGS: usize = 30;
/// Energies nearer than this share of their size are equal: differences below it are rounding.
const ROUNDING: f64 = 1e-13;

/// What is minimised.
pub(crate) trait Problem {
    /// Puts `x` back onto the surfaces it has to keep to, writes the gradient there and returns the energy.
    fn evaluate(&mut self, x: &mut [V3], gradient: &mut [V3]) -> f64;
    /// Takes the part along the surfaces' normals at `x` out of `gradient`, for nodes that rest by `normals`.
    fn reduce(&self, x: &[V3], normals: &[V3], gradient: &mut [V3]);
    /// Writes minus the preconditioned `gradient`.
    fn inverse(&mut self, gradient: &[V3], out: &mut [V3]);
}

/// State of the iteration. It owns all memory that an iteration needs.
#[derive(Debug, Default)]
pub(crate) struct Lbfgs {
    /// Ring of pairs: the newest is at `(first + count - 1) % MEMORY`.
    pairs: Vec<Pair>,
    first: usize,
    count: usize,
    direction: Vec<V3>,
    reduced: Vec<V3>,
    work: Vec<V3>,
    trial: Vec<V3>,
    trial_gradient: Vec<V3>,
}

#[derive(Debug)]
struct Pair {
    step: Vec<V3>,
    change: Vec<V3>,
    curvature: f64,
}

/// Result of one iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// `x` moved downhill.
    Accepted,
    /// No shorter step lowers the energy.
    Stalled,
}

impl Lbfgs {
    /// Forgets what was learned: needed when the function changes.
    pub(crate) fn reset(&mut self) {
        self.count = 0;
        self.first = 0;
    }

    /// One iteration. `x`, `gradient`, `energy` are replaced by those after the step. `normals`: unit normals of nodes
    /// that rest on a surface, zero for the others.
    pub(crate) fn step(
        &mut self,
        x: &mut Vec<V3>,
        gradient: &mut Vec<V3>,
        energy: &mut f64,
        normals: &[V3],
        problem: &mut impl Problem,
    ) -> Step {
        self.prepare(x.len());
        self.reduced.copy_from_slice(gradient);
        slide(&mut self.reduced, normals);
        self.descend(normals, problem);
        let mut slope = dot(&self.direction, &self.reduced);
        if slope.is_nan() || slope >= 0.0 {
            self.reset();
            self.descend(normals, problem);
            slope = dot(&self.direction, &self.reduced);
        }
        let mut length = 1.0;
        for _ in 0..MAX_SHORTENINGS {
            self.trial.copy_from_slice(x);
            add_scaled(&mut self.trial, &self.direction, length);
            let value = problem.evaluate(&mut self.trial, &mut self.trial_gradient);
            difference(&mut self.work, &self.trial, x);
            let way = dot(&self.work, gradient).min(0.0).max(length * slope);
            let end = dot(&self.direction, &self.trial_gradient);
            if accepts(*energy, value, way, slope, end) {
                self.remember(normals, problem);
                std::mem::swap(x, &mut self.trial);
                std::mem::swap(gradient, &mut self.trial_gradient);
                *energy = value;
                return Step::Accepted;
            }
            // The minimum of the parabola through both energies and the slope, within bounds.
            let rise = value - *energy - length * slope;
            let best = -0.5 * slope * length * length / rise;
            length = if best.is_finite() {
                best.clamp(0.1 * length, 0.5 * length)
            } else {
                0.1 * length
            };
        }
        Step::Stalled
    }

    fn prepare(&mut self, n: usize) {
        if self.direction.len() != n {
            *self = Self::default();
            let zero = || vec![[0.0; 3]; n];
            self.pairs = (0..MEMORY)
                .map(|_| Pair {
                    step: zero(),
                    change: zero(),
                    curvature: 0.0,
                })
                .collect();
            self.direction = zero();
            self.reduced = zero();
            self.work = zero();
            self.trial = zero();
            self.trial_gradient = zero();
        }
    }

    /// The direction of the two loops, `-H g`.
    fn descend(&mut self, normals: &[V3], problem: &mut impl Problem) {
        self.work.copy_from_slice(&self.reduced);
        let mut shares = [0.0; MEMORY];
        for k in (0..self.count).rev() {
            let pair = &self.pairs[(self.first + k) % MEMORY];
            shares[k] = dot(&pair.step, &self.work) / pair.curvature;
            add_scaled(&mut self.work, &pair.change, -shares[k]);
        }
        slide(&mut self.work, normals);
        problem.inverse(&self.work, &mut self.direction);
        slide(&mut self.direction, normals);
        for (k, share) in shares.iter().enumerate().take(self.count) {
            let pair = &self.pairs[(self.first + k) % MEMORY];
            let back = dot(&pair.change, &self.direction) / pair.curvature;
            add_scaled(&mut self.direction, &pair.step, -(share + back));
        }
        slide(&mut self.direction, normals);
    }

    /// Keeps the step to the trial, which `work` holds.
    fn remember(&mut self, normals: &[V3], problem: &impl Problem) {
        let full = self.count == MEMORY;
        let slot = (self.first + self.count) % MEMORY;
        let pair = &mut self.pairs[slot];
        pair.step.copy_from_slice(&self.work);
        // Both gradients along the surfaces where they were taken: what is left is their curvature.
        pair.change.copy_from_slice(&self.trial_gradient);
        problem.reduce(&self.trial, normals, &mut pair.change);
        subtract(&mut pair.change, &self.reduced);
        slide(&mut pair.step, normals);
        slide(&mut pair.change, normals);
        pair.curvature = dot(&pair.step, &pair.change);
        let size = (dot(&pair.change, &pair.change) * dot(&pair.step, &pair.step)).sqrt();
        // Steps without positive curvature would make the inverse indefinite. A full ring has lost its oldest pair here.
        if full {
            self.first = (self.first + 1) % MEMORY;
            self.count -= 1;
        }
        if pair.curvature > 1e-10 * size && size > 0.0 {
            self.count += 1;
        }
    }
}

/// Whether a step goes far enough downhill: by its share of `way`, the change that the gradient promises. Where the
/// energies differ by rounding alone, the slope at the end decides: the approximate Wolfe condition of Hager and Zhang,
/// 2005.
fn accepts(before: f64, after: f64, way: f64, slope: f64, end: f64) -> bool {
    if after <= before + ARMIJO * way {
        return true;
    }
    let level = after <= before + ROUNDING * before.abs();
    level && end.abs() <= 0.9 * slope.abs()
}

/// Takes the part along each node's normal out of `a`.
pub(crate) fn slide(a: &mut [V3], normals: &[V3]) {
    for (a, n) in a.iter_mut().zip(normals) {
        let part = a[0] * n[0] + a[1] * n[1] + a[2] * n[2];
        for k in 0..3 {
            a[k] -= part * n[k];
        }
    }
}

struct Dot<'a>(&'a [V3], &'a [V3]);

impl Kernel for Dot<'_> {
    type Output = f64;
    #[inline(always)]
    fn run(self) -> f64 {
        inner(self.0.as_flattened(), self.1.as_flattened())
    }
}

fn dot(a: &[V3], b: &[V3]) -> f64 {
    dispatch(Dot(a, b))
}

struct AddScaled<'a>(&'a mut [V3], &'a [V3], f64);

impl Kernel for AddScaled<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        add_to(self.0.as_flattened_mut(), self.1.as_flattened(), self.2);
    }
}

fn add_scaled(a: &mut [V3], b: &[V3], s: f64) {
    dispatch(AddScaled(a, b, s));
}

fn subtract(a: &mut [V3], b: &[V3]) {
    for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
        *a -= b;
    }
}

fn difference(out: &mut [V3], a: &[V3], b: &[V3]) {
    let (out, a, b) = (out.as_flattened_mut(), a.as_flattened(), b.as_flattened());
    for ((o, a), b) in out.iter_mut().zip(a).zip(b) {
        *o = a - b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quartic valley, over the half-space `c >= floor`.
    struct Valley {
        floor: f64,
    }

    impl Problem for Valley {
        fn evaluate(&mut self, x: &mut [V3], g: &mut [V3]) -> f64 {
            x[0][2] = x[0][2].max(self.floor);
            let [a, b, c] = x[0];
            g[0] = [
                4.0 * a * a * a - 2.0 * (b - a),
                2.0 * (b - a) + 20.0 * (b - c),
                -20.0 * (b - c) + 2.0 * (c - 1.0),
            ];
            a.powi(4) + (b - a).powi(2) + 10.0 * (b - c).powi(2) + (c - 1.0).powi(2)
        }

        fn reduce(&self, _: &[V3], normals: &[V3], g: &mut [V3]) {
            slide(g, normals);
        }

        fn inverse(&mut self, g: &[V3], out: &mut [V3]) {
            out[0] = [-g[0][0] / 10.0, -g[0][1] / 22.0, -g[0][2] / 22.0];
        }
    }

    fn descend(floor: f64) -> (V3, V3) {
        let mut valley = Valley { floor };
        let mut x = vec![[3.0, -2.0, 5.0]];
        let mut gradient = vec![[0.0; 3]];
        let mut energy = valley.evaluate(&mut x, &mut gradient);
        let mut lbfgs = Lbfgs::default();
        for _ in 0..200 {
            let before = energy;
            let rests = x[0][2] <= floor && gradient[0][2] > 0.0;
            let normals = [if rests { [0.0, 0.0, 1.0] } else { [0.0; 3] }];
            let step = lbfgs.step(&mut x, &mut gradient, &mut energy, &normals, &mut valley);
            assert!(energy <= before + ROUNDING * before.abs());
            if step == Step::Stalled {
                break;
            }
        }
        (x[0], gradient[0])
    }

    #[test]
    fn a_quartic_valley_is_followed_to_its_bottom() {
        let (_, gradient) = descend(-10.0);
        assert!(dot(&[gradient], &[gradient]).sqrt() < 1e-6, "{gradient:?}");
    }

    #[test]
    fn a_floor_above_the_bottom_carries() {
        let (x, gradient) = descend(2.0);
        assert_eq!(x[2], 2.0);
        assert!(gradient[0].abs() < 1e-6 && gradient[1].abs() < 1e-6 && gradient[2] > 0.1);
    }
}
