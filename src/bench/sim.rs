//! `facile bench sim`: error against time of every solver, and what random poses come to.

use facile_core::ReferenceHead;
use facile_core::identity::IdentityModel;
use facile_sim::stress::stress;
use facile_sim::work_precision::{WorkPrecision, work_precision};
use facile_sim::{ExpressionSet, FaceRig, MuscleSet, SolverKind};

use super::{Axis, Curve, Effort, Findings, Plot, Table};
use crate::Error;

/// Name and intensity of the poses, a mild and a strong one, and the name of their plots.
const POSES: [(&str, f64, &str); 2] =
    [("smile", 0.33, "sim_mild"), ("surprise", 1.0, "sim_strong")];
const SOLVERS: [(SolverKind, &str); 3] = [
    (SolverKind::QuasiStatic, "quasi_static"),
    (SolverKind::Fire, "fire"),
    (SolverKind::Verlet, "verlet"),
];

/// Measures the solvers on the first person of family 7.
///
/// # Errors
/// [`Error::Sim`] if the converged equilibrium is not found.
pub fn sim(effort: Effort) -> Result<Findings, Error> {
    let reference = ReferenceHead::embedded();
    let muscles = MuscleSet::embedded();
    let rig = FaceRig::new(reference, muscles)?;
    let subject = IdentityModel::embedded().sample(reference, 7, 0)?;
    let model = rig.model(reference, &subject)?;
    let solvers = effort.of(&SOLVERS[..1], &SOLVERS[..]);
    let tolerances = effort.of(&[1e-2, 1e-4][..], &[1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6][..]);
    let mut table = Table::new(&[
        "pose",
        "solver",
        "start",
        "tolerance",
        "ms",
        "iterations",
        "error_mm",
    ]);
    let mut plots = Vec::new();
    for (pose_name, intensity, file) in POSES {
        let pose = ExpressionSet::embedded()
            .get(pose_name)?
            .pose(muscles)?
            .scaled(intensity);
        let kinds: Vec<SolverKind> = solvers.iter().map(|s| s.0).collect();
        let rows = work_precision(&model, &pose, &kinds, tolerances, effort.of(1, 5))?;
        let mut curves: Vec<Curve> = Vec::new();
        for row in &rows {
            let name = curve_name(row);
            table.push(vec![
                format!("{pose_name} {intensity}").into(),
                name.0.into(),
                name.1.into(),
                row.tolerance.into(),
                (1e3 * row.seconds).into(),
                (row.iterations as f64).into(),
                row.error_mm.into(),
            ]);
            let name = format!("{}, {}", name.0, name.1);
            let point = (1e3 * row.seconds, row.error_mm);
            match curves.iter_mut().find(|c| c.name == name) {
                Some(curve) => curve.points.push(point),
                None => curves.push(Curve {
                    name,
                    points: vec![point],
                }),
            }
        }
        plots.push((
            file,
            Plot {
                title: format!(
                    "{pose_name} at {intensity}: largest distance of a node from the equilibrium"
                ),
                x: Axis::logarithmic("time, ms"),
                y: Axis::logarithmic("error, mm"),
                curves,
            },
        ));
    }
    Ok(Findings {
        tables: vec![
            ("sim_work_precision", table),
            ("sim_stress", stress_table(&rig, effort)?),
        ],
        plots,
    })
}

/// Solver and start of a row.
fn curve_name(row: &WorkPrecision) -> (&'static str, &'static str) {
    let solver = SOLVERS
        .iter()
        .find(|s| s.0 == row.solver)
        .map_or("?", |s| s.1);
    (solver, if row.warm { "warm" } else { "cold" })
}

/// Random poses on random people.
fn stress_table(rig: &FaceRig, effort: Effort) -> Result<Table, Error> {
    let mut table = Table::new(&[
        "contractions_up_to",
        "solves",
        "certified",
        "refused",
        "not_finite",
        "worst_penetration_mm",
        "with_inverted_prisms",
        "most_inverted_prisms",
    ]);
    for (label, is_moderate) in [("0.85", true), ("1", false)] {
        let count = effort.of(4, 200);
        let report = stress(rig, ReferenceHead::embedded(), 7, count, 4, is_moderate)?;
        table.push(vec![
            label.into(),
            (report.solves as f64).into(),
            (report.certified as f64).into(),
            (report.refused.len() as f64).into(),
            (report.not_finite as f64).into(),
            report.worst_penetration_mm.into(),
            (report.with_inversions as f64).into(),
            (report.most_inversions as f64).into(),
        ]);
    }
    Ok(table)
}
