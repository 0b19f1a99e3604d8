//! Fit of pose, size and identity model together: which mixture of the modes, and where, comes nearest to the goals.
//!
//! One Gauss-Newton step minimises, over a rigid motion, the size `s` and the modes' coefficients `a`,
//! `sum_i (x_i - g_i)^T W_i (x_i - g_i) + |a|^2 + (ln s / sigma)^2`, where `W_i` weighs the distance along the normal
//! fully and the distance along the surface by how far it is known. Together, because the modes hold shifts and growth
//! of the face themselves: fitted in turns, pose and modes drift against each other. What the population never shows
//! is left to the smooth deformation. Source: [BPV06]; Blanz and Vetter 1999.

use facile_core::subdivision::Stencils;
use facile_core::{IdentityModel, Isometry3, Point3, UnitQuaternion, Vector3};
use nalgebra::{DMatrix, DVector, Translation3};

use crate::fit::Goal;
use crate::template::Template;

/// Error of one independent goal that the fit reckons with, mm.
const GOAL_ERROR: f64 = 1.5;
/// Area of skin whose goals err together, mm^2: as many goals as fit in there count as one.
const INDEPENDENT_AREA: f64 = 500.0;
/// Largest coefficient, in standard deviations of the population.
const LARGEST: f64 = 3.0;
/// Standard deviation of the logarithm of a head's size that is not in the modes.
const SIZE_DEVIATION: f64 = 0.04;
/// About how many goals a fit uses: it has far more than it needs.
const USED_GOALS: usize = 1500;
/// Unknowns before the coefficients: rotation, translation, logarithm of the size.
const POSE: usize = 7;

/// Displacements of the fine vertices per standard deviation of each mode.
pub(crate) struct FineModes {
    /// The model, or none: then every fit gives the mean.
    model: Option<&'static IdentityModel>,
    /// By fine vertex, by mode, mm.
    modes: Vec<Vector3>,
    count: usize,
}

/// A mixture of the modes and its size.
#[derive(Clone, Debug)]
pub(crate) struct Identity {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) size: f64,
}

impl FineModes {
    /// Subdivides the modes of the cage.
    pub(crate) fn new(model: Option<&'static IdentityModel>, stencils: &Stencils) -> Self {
        let count = model.map_or(0, IdentityModel::len);
        let mut modes = vec![Vector3::zeros(); count * stencils.len()];
        if let Some(m) = model {
            for k in 0..count {
                let fine = stencils.apply(m.cage_mode(k), Vector3::zeros());
                for (v, d) in fine.into_iter().enumerate() {
                    modes[v * count + k] = d;
                }
            }
        }
        Self {
            model,
            modes,
            count,
        }
    }

    /// The mean face at a size.
    pub(crate) fn mean(&self, size: f64) -> Identity {
        Identity {
            coefficients: vec![0.0; self.count],
            size,
        }
    }

    /// The cage with modes added: `(rest + sum of modes) * size`.
    pub(crate) fn cage(&self, rest: &[Point3], identity: &Identity) -> Vec<Vector3> {
        let mut cage: Vec<Vector3> = rest.iter().map(|p| p.coords).collect();
        for (k, a) in identity.coefficients.iter().enumerate() {
            let mode = self.model.map_or(&[] as &[Vector3], |m| m.cage_mode(k));
            for (p, d) in cage.iter_mut().zip(mode) {
                *p += d * *a;
            }
        }
        for p in &mut cage {
            *p *= identity.size;
        }
        cage
    }

    /// One step: improves `identity` and returns the rigid motion of the face that brings it nearest to the goals.
    /// `positions` are those of the identity's fine vertices, `normals` the current ones.
    pub(crate) fn step(
        &self,
        template: &Template<'_>,
        positions: &[Point3],
        normals: &[Vector3],
        goals: &[Goal],
        identity: &mut Identity,
    ) -> Isometry3 {
        let n = POSE + self.count;
        let stride = (goals.len() / USED_GOALS).max(1);
        let unit = 1.0 / (INDEPENDENT_AREA * GOAL_ERROR * GOAL_ERROR);
        let mut matrix = vec![0.0_f64; n * n];
        let mut right = vec![0.0_f64; n];
        let mut rows = [vec![0.0_f64; n], vec![0.0; n], vec![0.0; n]];
        for (i, goal) in goals.iter().enumerate() {
            // Landmarks come one by one and count each; of the rest one in `stride` stands for its neighbours.
            let count = if goal.is_landmark { 1 } else { stride };
            if i % count != 0 {
                continue;
            }
            let v = goal.vertex as usize;
            let (x, normal) = (positions[v].coords, normals[v]);
            let weight = (goal.weight * template.areas[v] * unit * count as f64).sqrt();
            let across = goal.slide.sqrt();
            // The square root of W: along the surface times `across`, along the normal as it is.
            let weigh =
                |d: Vector3| (d * across + normal * (normal.dot(&d) * (1.0 - across))) * weight;
            let residual = weigh(goal.at - positions[v]);
            let mut put = |i: usize, d: Vector3| {
                for axis in 0..3 {
                    rows[axis][i] = d[axis];
                }
            };
            for axis in 0..3 {
                let e = Vector3::ith(axis, 1.0);
                put(axis, weigh(e.cross(&x)));
                put(3 + axis, weigh(e));
            }
            put(6, weigh(x));
            let modes = &self.modes[v * self.count..(v + 1) * self.count];
            for (k, mode) in modes.iter().enumerate() {
                put(POSE + k, weigh(mode * identity.size));
            }
            for axis in 0..3 {
                let row = &rows[axis];
                for i in 0..n {
                    let r = row[i];
                    right[i] += r * residual[axis];
                    for (m, value) in matrix[i * n..=i * n + i].iter_mut().zip(row) {
                        *m += r * value;
                    }
                }
            }
        }
        let prior = 1.0 / (SIZE_DEVIATION * SIZE_DEVIATION);
        matrix[6 * n + 6] += prior;
        right[6] -= prior * libm::log(identity.size);
        for (k, a) in identity.coefficients.iter().enumerate() {
            let i = POSE + k;
            matrix[i * n + i] += 1.0;
            right[i] -= a;
        }
        let full = DMatrix::from_fn(n, n, |i, j| matrix[i.max(j) * n + i.min(j)]);
        let Some(factor) = full.cholesky() else {
            return Isometry3::identity();
        };
        let step = factor.solve(&DVector::from_vec(right));
        for (k, a) in identity.coefficients.iter_mut().enumerate() {
            *a = (*a + step[POSE + k]).clamp(-LARGEST, LARGEST);
        }
        identity.size *= libm::exp(step[6].clamp(-0.1, 0.1));
        Isometry3::from_parts(
            Translation3::new(step[3], step[4], step[5]),
            UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2])),
        )
    }
}
