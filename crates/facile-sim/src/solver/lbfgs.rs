//! Limited-memory BFGS around a given inverse, with backtracking.
//!
//! Source: Nocedal and Wright, Numerical Optimization, 2006, algorithm 7.4 with the initial inverse of
//! the preconditioner. Energies never rise along an accepted step.

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

/// State of the iteration. It owns all memory that an iteration needs.
#[derive(Debug, Default)]
pub(crate) struct Lbfgs {
    /// Ring of pairs: the newest is at `(first + count - 1) % MEMORY`.
    pairs: Vec<Pair>,
    first: usize,
    count: usize,
    direction: Vec<V3>,
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

    /// One iteration. `x`, `gradient`, `energy` are replaced by those after the step.
    ///
    /// `inverse(g, out)` writes minus the preconditioned gradient; `function(x, gradient)` returns the energy.
    pub(crate) fn step(
        &mut self,
        x: &mut Vec<V3>,
        gradient: &mut Vec<V3>,
        energy: &mut f64,
        mut inverse: impl FnMut(&[V3], &mut [V3]),
        mut function: impl FnMut(&[V3], &mut [V3]) -> f64,
    ) -> Step {
        self.prepare(x.len());
        self.descend(gradient, &mut inverse);
        let mut slope = dot(&self.direction, gradient);
        if slope.is_nan() || slope >= 0.0 {
            self.reset();
            inverse(gradient, &mut self.direction);
            slope = dot(&self.direction, gradient);
        }
        let mut length = 1.0;
        for _ in 0..MAX_SHORTENINGS {
            self.trial.copy_from_slice(x);
            add_scaled(&mut self.trial, &self.direction, length);
            let value = function(&self.trial, &mut self.trial_gradient);
            let end = dot(&self.direction, &self.trial_gradient);
            if accepts(*energy, value, slope, end, length) {
                self.remember(x, gradient);
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
            self.work = zero();
            self.trial = zero();
            self.trial_gradient = zero();
        }
    }

    /// The direction of the two loops, `-H g`.
    fn descend(&mut self, gradient: &[V3], inverse: &mut impl FnMut(&[V3], &mut [V3])) {
        self.work.copy_from_slice(gradient);
        let mut shares = [0.0; MEMORY];
        for k in (0..self.count).rev() {
            let pair = &self.pairs[(self.first + k) % MEMORY];
            shares[k] = dot(&pair.step, &self.work) / pair.curvature;
            add_scaled(&mut self.work, &pair.change, -shares[k]);
        }
        inverse(&self.work, &mut self.direction);
        for (k, share) in shares.iter().enumerate().take(self.count) {
            let pair = &self.pairs[(self.first + k) % MEMORY];
            let back = dot(&pair.change, &self.direction) / pair.curvature;
            add_scaled(&mut self.direction, &pair.step, -(share + back));
        }
    }

    /// Keeps the step from `x` to the trial.
    fn remember(&mut self, x: &[V3], gradient: &[V3]) {
        let full = self.count == MEMORY;
        let slot = (self.first + self.count) % MEMORY;
        let pair = &mut self.pairs[slot];
        difference(&mut pair.step, &self.trial, x);
        difference(&mut pair.change, &self.trial_gradient, gradient);
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

/// Whether a step of this length goes far enough downhill. Where the energies differ by rounding alone, the slope at the
/// end decides: the approximate Wolfe condition of Hager and Zhang, 2005.
fn accepts(before: f64, after: f64, slope: f64, end: f64, length: f64) -> bool {
    if after <= before + ARMIJO * length * slope {
        return true;
    }
    let level = after <= before + ROUNDING * before.abs();
    level && end.abs() <= 0.9 * slope.abs()
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

fn difference(out: &mut [V3], a: &[V3], b: &[V3]) {
    let (out, a, b) = (out.as_flattened_mut(), a.as_flattened(), b.as_flattened());
    for ((o, a), b) in out.iter_mut().zip(a).zip(b) {
        *o = a - b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quartic_valley_is_followed_to_its_bottom() {
        let function = |x: &[V3], g: &mut [V3]| {
            let [a, b, c] = x[0];
            g[0] = [
                4.0 * a * a * a - 2.0 * (b - a),
                2.0 * (b - a) + 20.0 * (b - c),
                -20.0 * (b - c) + 2.0 * (c - 1.0),
            ];
            a.powi(4) + (b - a).powi(2) + 10.0 * (b - c).powi(2) + (c - 1.0).powi(2)
        };
        let mut x = vec![[3.0, -2.0, 5.0]];
        let mut gradient = vec![[0.0; 3]];
        let mut energy = function(&x, &mut gradient);
        let mut lbfgs = Lbfgs::default();
        for _ in 0..200 {
            let before = energy;
            let inverse = |g: &[V3], out: &mut [V3]| {
                out[0] = [-g[0][0] / 10.0, -g[0][1] / 22.0, -g[0][2] / 22.0];
            };
            if lbfgs.step(&mut x, &mut gradient, &mut energy, inverse, function) == Step::Stalled {
                break;
            }
            assert!(energy <= before);
        }
        assert!(dot(&gradient, &gradient).sqrt() < 1e-6, "{gradient:?}");
    }
}
