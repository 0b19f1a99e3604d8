//! Fit of the identity model: which mixture of its modes comes nearest to the goals.
//!
//! Minimises, over the modes' coefficients `a`, `sum_i (x_i(a) - g_i)^T W_i (x_i(a) - g_i) / s^2 + |a|^2`, where `W_i`
//! weighs the distance along the normal fully and the distance along the surface by how far the flow knows it. What
//! the population never shows is left to the smooth deformation. Source: [BPV06]; Blanz and Vetter 1999.

use facile_core::subdivision::Stencils;
use facile_core::{IdentityModel, Point3, Vector3};
use nalgebra::{DMatrix, DVector};

use crate::fit::Goal;
use crate::template::Template;

/// Error of one independent goal that the fit reckons with, mm.
const GOAL_ERROR: f64 = 1.5;
/// Area of skin whose goals err together, mm^2: as many goals as fit in there count as one.
const INDEPENDENT_AREA: f64 = 150.0;
/// Largest coefficient, in standard deviations of the population.
const LARGEST: f64 = 3.5;
/// Every how many goals are used: the fit has far more than it needs.
const STRIDE: usize = 3;

/// Displacements of the fine vertices per standard deviation of each mode.
pub(crate) struct FineModes {
    /// The model, or none: then every fit gives the mean.
    model: Option<&'static IdentityModel>,
    /// By mode, by fine vertex, mm.
    modes: Vec<Vec<Vector3>>,
}

impl FineModes {
    /// Subdivides the modes of the cage.
    pub(crate) fn new(model: Option<&'static IdentityModel>, stencils: &Stencils) -> Self {
        let modes = model.map_or_else(Vec::new, |m| {
            (0..m.len())
                .map(|k| stencils.apply(m.cage_mode(k), Vector3::zeros()))
                .collect()
        });
        Self { model, modes }
    }

    /// The cage with modes added: `(rest + sum of modes) * size`.
    pub(crate) fn cage(&self, rest: &[Point3], coefficients: &[f64], size: f64) -> Vec<Vector3> {
        let mut cage: Vec<Vector3> = rest.iter().map(|p| p.coords).collect();
        for (k, a) in coefficients.iter().enumerate() {
            let mode = self.model.map_or(&[] as &[Vector3], |m| m.cage_mode(k));
            for (p, d) in cage.iter_mut().zip(mode) {
                *p += d * *a;
            }
        }
        for p in &mut cage {
            *p *= size;
        }
        cage
    }

    /// Coefficients of the modes that bring the mean (fine positions `rest`, times `size`) nearest to the goals.
    /// `normals` are those of the current shape.
    pub(crate) fn fit(
        &self,
        template: &Template<'_>,
        rest: &[Point3],
        normals: &[Vector3],
        goals: &[Goal],
        size: f64,
    ) -> Vec<f64> {
        let k = self.modes.len();
        let mut matrix = DMatrix::<f64>::identity(k, k);
        let mut right = DVector::<f64>::zeros(k);
        let unit = STRIDE as f64 / (INDEPENDENT_AREA * GOAL_ERROR * GOAL_ERROR);
        let mut rows = vec![Vector3::zeros(); k];
        for goal in goals.iter().step_by(STRIDE) {
            let v = goal.vertex as usize;
            let n = normals[v];
            let weight = goal.weight * template.areas[v] * unit;
            let across = goal.slide.sqrt();
            // The square root of W: along the surface times `across`, along the normal as it is.
            let shape = |d: Vector3| d * across + n * (n.dot(&d) * (1.0 - across));
            let wanted = shape(goal.at - rest[v] * size);
            for (row, mode) in rows.iter_mut().zip(&self.modes) {
                *row = shape(mode[v] * size);
            }
            for i in 0..k {
                let scaled = rows[i] * weight;
                right[i] += scaled.dot(&wanted);
                for j in 0..=i {
                    matrix[(i, j)] += scaled.dot(&rows[j]);
                }
            }
        }
        for i in 0..k {
            for j in 0..i {
                matrix[(j, i)] = matrix[(i, j)];
            }
        }
        match matrix.cholesky() {
            Some(factor) => factor
                .solve(&right)
                .iter()
                .map(|a| a.clamp(-LARGEST, LARGEST))
                .collect(),
            None => vec![0.0; k],
        }
    }
}
