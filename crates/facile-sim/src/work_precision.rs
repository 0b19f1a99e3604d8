//! Error against time: every solver at every tolerance, against a converged equilibrium.
//!
//! The rows are plain numbers; who asks for them writes the table. Times are wall times of this process and the one thing
//! here that differs from run to run.

use std::time::Instant;

use crate::SimError;
use crate::model::FaceModel;
use crate::pose::Pose;
use crate::solver::{Equilibrium, Solver, SolverKind, SolverParams};

/// How much smaller than the smallest asked tolerance that of the reference is.
const REFERENCE_SHARE: f64 = 0.1;

/// One solver at one tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkPrecision {
    /// The solver.
    pub solver: SolverKind,
    /// `SolverParams::tolerance`.
    pub tolerance: f64,
    /// Whether it started from a solution at 0.9 of the intensity, first order continued from 0.8.
    pub warm: bool,
    /// Median wall time of a solve, s.
    pub seconds: f64,
    /// Iterations or time steps.
    pub iterations: usize,
    /// Largest distance of a node from the converged equilibrium, mm; NaN where the solver did not converge.
    pub error_mm: f64,
}

/// Solves `pose` with each solver at each tolerance, `repeats` times, cold; the quasi-static one also warm.
///
/// # Errors
/// Those of [`Solver::solve`] for the converged equilibrium. A row's own failure is its NaN.
pub fn work_precision(
    model: &FaceModel,
    pose: &Pose,
    solvers: &[SolverKind],
    tolerances: &[f64],
    repeats: usize,
) -> Result<Vec<WorkPrecision>, SimError> {
    let mut solver = Solver::new();
    let smallest = tolerances.iter().copied().fold(f64::INFINITY, f64::min);
    let exact = SolverParams {
        tolerance: REFERENCE_SHARE * smallest,
        max_iterations: 20_000,
        ..SolverParams::default()
    };
    let truth = solver.solve(model, pose, &exact)?;
    let mut rows = Vec::new();
    for &kind in solvers {
        for &tolerance in tolerances {
            let params = SolverParams {
                tolerance,
                ..SolverParams::of(kind)
            };
            // The others take a hundred times as long; their clock matters less.
            let is_default = kind == SolverKind::QuasiStatic;
            let repeats = if is_default { repeats } else { 1 };
            rows.push(measure(&truth, kind, tolerance, false, repeats, || {
                let start = Instant::now();
                let result = solver.solve(model, pose, &params);
                (start.elapsed().as_secs_f64(), result)
            }));
            if is_default {
                rows.push(measure(&truth, kind, tolerance, true, repeats, || {
                    // The last rung alone: the ladder with it less the ladder without.
                    let mut climb = |rungs: &[f64]| {
                        let start = Instant::now();
                        let all = solver.solve_ladder(model, pose, rungs, &params);
                        (start.elapsed().as_secs_f64(), all)
                    };
                    let (below, _) = climb(&[0.8, 0.9]);
                    let (whole, mut all) = climb(&[0.8, 0.9, 1.0]);
                    ((whole - below).max(0.0), all.swap_remove(2))
                }));
            }
        }
    }
    Ok(rows)
}

fn measure(
    truth: &Equilibrium,
    solver: SolverKind,
    tolerance: f64,
    warm: bool,
    repeats: usize,
    mut run: impl FnMut() -> (f64, Result<Equilibrium, SimError>),
) -> WorkPrecision {
    let mut times = Vec::new();
    let mut row = WorkPrecision {
        solver,
        tolerance,
        warm,
        seconds: f64::NAN,
        iterations: 0,
        error_mm: f64::NAN,
    };
    for _ in 0..repeats.max(1) {
        let (seconds, result) = run();
        times.push(seconds);
        if let Ok(found) = result {
            row.iterations = found.certificate.iterations;
            row.error_mm = largest_distance(&found, truth);
        }
    }
    times.sort_by(f64::total_cmp);
    row.seconds = times[times.len() / 2];
    row
}

/// One setting of the model or of the path, and what a solve with it came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The setting's value.
    pub value: f64,
    /// Median wall time of a solve, s.
    pub seconds: f64,
    /// Iterations or time steps.
    pub iterations: usize,
    /// Largest distance of a node from the equilibrium it is compared with, mm; NaN where the solver did not converge.
    pub error_mm: f64,
    /// Prisms that are turned inside out.
    pub inverted: usize,
}

/// Solves once with these parameters and compares with `truth`.
pub fn outcome(
    model: &FaceModel,
    pose: &Pose,
    params: &SolverParams,
    value: f64,
    truth: Option<&Equilibrium>,
) -> Outcome {
    let start = Instant::now();
    let found = Solver::new().solve(model, pose, params);
    let seconds = start.elapsed().as_secs_f64();
    let certificate = found.as_ref().ok().map(|f| f.certificate.clone());
    Outcome {
        value,
        seconds,
        iterations: certificate.as_ref().map_or(0, |c| c.iterations),
        error_mm: match (&found, truth) {
            (Ok(found), Some(truth)) => largest_distance(found, truth),
            (Ok(_), None) => 0.0,
            (Err(_), _) => f64::NAN,
        },
        inverted: certificate.as_ref().map_or(0, |c| c.inverted_elements),
    }
}

/// Largest distance between the nodes of two equilibria of one model, mm.
pub fn largest_distance(a: &Equilibrium, b: &Equilibrium) -> f64 {
    let pairs = a.nodes.iter().zip(&b.nodes);
    pairs.map(|(p, q)| (p - q).norm()).fold(0.0, f64::max)
}
