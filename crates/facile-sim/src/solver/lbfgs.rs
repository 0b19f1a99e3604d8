//! Limited-memory BFGS around a given inverse, with backtracking.
//!
//! Source: Nocedal and Wright, Numerical Optimization, 2006, algorithm 7.4 with the initial inverse of
//! the preconditioner. Energies never rise along an accepted step.

use std::collections::VecDeque;

use crate::vector::{V3, add_scaled, dot};

/// Pairs of steps and gradient changes that are kept.
const MEMORY: usize = 8;
/// Smallest accepted share of the decrease that the slope promises.
const ARMIJO: f64 = 1e-4;
/// Halvings before a step counts as failed.
const MAX_HALVINGS: usize = 30;

/// State of the iteration.
#[derive(Debug, Default)]
pub(crate) struct Lbfgs {
    pairs: VecDeque<Pair>,
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
    /// No shorter step lowers the energy: rounding is reached.
    Stalled,
}

impl Lbfgs {
    /// Forgets what was learned: needed when the function changes.
    pub(crate) fn reset(&mut self) {
        self.pairs.clear();
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
        let mut direction = self.direction(gradient, &mut inverse);
        let mut slope = inner(&direction, gradient);
        if slope >= 0.0 {
            self.reset();
            inverse(gradient, &mut direction);
            slope = inner(&direction, gradient);
        }
        let mut trial = x.clone();
        let mut trial_gradient = gradient.clone();
        let mut length = 1.0;
        for _ in 0..MAX_HALVINGS {
            for ((t, p), d) in trial.iter_mut().zip(x.iter()).zip(&direction) {
                *t = add_scaled(*p, *d, length);
            }
            let value = function(&trial, &mut trial_gradient);
            if value <= *energy + ARMIJO * length * slope {
                self.remember(x, gradient, &trial, &trial_gradient);
                std::mem::swap(x, &mut trial);
                std::mem::swap(gradient, &mut trial_gradient);
                *energy = value;
                return Step::Accepted;
            }
            length *= 0.5;
        }
        Step::Stalled
    }

    fn direction(&self, gradient: &[V3], inverse: &mut impl FnMut(&[V3], &mut [V3])) -> Vec<V3> {
        let mut q = gradient.to_vec();
        let mut shares = vec![0.0; self.pairs.len()];
        for (share, pair) in shares.iter_mut().zip(&self.pairs).rev() {
            *share = inner(&pair.step, &q) / pair.curvature;
            add_to(&mut q, &pair.change, -*share);
        }
        let mut out = vec![[0.0; 3]; q.len()];
        inverse(&q, &mut out);
        for (share, pair) in shares.iter().zip(&self.pairs) {
            let back = inner(&pair.change, &out) / pair.curvature;
            add_to(&mut out, &pair.step, -(share + back));
        }
        out
    }

    fn remember(&mut self, x: &[V3], gradient: &[V3], next: &[V3], next_gradient: &[V3]) {
        let change = |a: &[V3], b: &[V3]| -> Vec<V3> {
            a.iter()
                .zip(b)
                .map(|(p, q)| add_scaled(*p, *q, -1.0))
                .collect()
        };
        let step = change(next, x);
        let change = change(next_gradient, gradient);
        let curvature = inner(&step, &change);
        let size = inner(&change, &change).sqrt() * inner(&step, &step).sqrt();
        // Steps without positive curvature would make the inverse indefinite.
        if curvature > 1e-10 * size && size > 0.0 {
            if self.pairs.len() == MEMORY {
                self.pairs.pop_front();
            }
            self.pairs.push_back(Pair {
                step,
                change,
                curvature,
            });
        }
    }
}

fn inner(a: &[V3], b: &[V3]) -> f64 {
    a.iter().zip(b).map(|(p, q)| dot(*p, *q)).sum()
}

fn add_to(a: &mut [V3], b: &[V3], s: f64) {
    for (p, q) in a.iter_mut().zip(b) {
        *p = add_scaled(*p, *q, s);
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
        assert!(dot(gradient[0], gradient[0]).sqrt() < 1e-6, "{gradient:?}");
    }
}
