//! `facile bench sim`: error against time of every solver, and what random poses come to.

use facile_core::ReferenceHead;
use facile_core::identity::IdentityModel;
use facile_sim::stress::stress;
use facile_sim::work_precision::{Outcome, WorkPrecision, outcome, work_precision};
use facile_sim::{
    ExpressionSet, FaceModel, FaceRig, MuscleSet, PaperParams, Pose, Solver, SolverKind,
    SolverParams, mean_subject,
};

use super::{Axis, Curve, Effort, Findings, Plot, Plots, Table};
use crate::Error;

/// Contraction of every muscle in the extreme pose, and opening of its jaw, rad.
const EXTREME: (f64, f64) = (0.85, 0.436);
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
    let tolerances = effort.of(&[1e-2, 1e-4][..], &[1e-1, 1e-2, 1e-3, 1e-4][..]);
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
    let (mild, strong) = (expression("smile")?.scaled(0.33), expression("surprise")?);
    let mut poses = vec![
        ("smile 0.33", mild, "sim_mild"),
        ("surprise 1", strong, "sim_strong"),
    ];
    if effort == Effort::Full {
        poses.push((
            "every muscle 0.85, jaw 25",
            extreme(muscles)?,
            "sim_extreme",
        ));
    }
    for (pose_name, pose, file) in &poses {
        let kinds: Vec<SolverKind> = solvers.iter().map(|s| s.0).collect();
        let rows = work_precision(&model, pose, &kinds, tolerances, effort.of(1, 3))?;
        let mut curves: Vec<Curve> = Vec::new();
        for row in &rows {
            let name = curve_name(row);
            table.push(vec![
                (*pose_name).into(),
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
            *file,
            Plot {
                title: format!("{pose_name}: largest distance of a node from the equilibrium"),
                x: Axis::logarithmic("time, ms"),
                y: Axis::logarithmic("error, mm"),
                curves,
            },
        ));
    }
    let (path, path_plot) = path_table(&model, effort)?;
    let (stability, stability_plots) = stability_table(&rig, effort)?;
    let of_resolution: Vec<(String, Pose)> = poses
        .iter()
        .take(2)
        .map(|(name, pose, _)| ((*name).to_owned(), pose.clone()))
        .collect();
    let (resolution, resolution_plots) = super::resolution::resolution(&of_resolution, effort)?;
    plots.push(("sim_path", path_plot));
    plots.extend(stability_plots);
    plots.extend(resolution_plots);
    Ok(Findings {
        tables: vec![
            ("sim_work_precision", table),
            ("sim_path", path),
            ("sim_stability", stability),
            ("sim_resolution", resolution),
            ("sim_stress", stress_table(&rig, effort)?),
        ],
        plots,
    })
}

/// Every muscle contracted at once.
fn extreme(muscles: &MuscleSet) -> Result<Pose, Error> {
    let mut pose = Pose::default();
    for muscle in muscles.muscles() {
        pose.set(muscles, &muscle.name, EXTREME.0)?;
    }
    pose.jaw.open_rad = EXTREME.1;
    Ok(pose)
}

/// The default solver on longer and shorter steps of the path: does the path matter?
fn path_table(model: &FaceModel, effort: Effort) -> Result<(Table, Plot), Error> {
    let mut table = Table::new(&["pose", "step", "ms", "iterations", "error_mm"]);
    let names = effort.of(
        &["smile"][..],
        &["smile", "anger", "surprise", "kiss", "wink"][..],
    );
    let mut curves = Vec::new();
    for name in names {
        let pose = expression(name)?;
        let mut points = Vec::new();
        let at = |step: f64, tolerance: f64| SolverParams {
            continuation_step: step,
            tolerance,
            ..SolverParams::default()
        };
        let truth = Solver::new().solve(model, &pose, &at(0.05, 1e-6))?;
        for step in effort.of(&[0.5][..], &[1.0, 0.5, 0.25, 0.1][..]) {
            let tolerance = SolverParams::default().tolerance;
            let found = outcome(model, &pose, &at(*step, tolerance), *step, Some(&truth));
            table.push(vec![
                (*name).into(),
                (*step).into(),
                (1e3 * found.seconds).into(),
                (found.iterations as f64).into(),
                found.error_mm.into(),
            ]);
            points.push((1.0 / step, found.error_mm));
        }
        curves.push(Curve {
            name: (*name).to_owned(),
            points,
        });
    }
    let plot = Plot {
        title: "distance from the path of 20 steps".to_owned(),
        x: Axis::logarithmic("steps of the path for a full contraction"),
        y: Axis::logarithmic("largest distance of a node, mm"),
        curves,
    };
    Ok((table, plot))
}

fn expression(name: &str) -> Result<Pose, Error> {
    Ok(ExpressionSet::embedded()
        .get(name)?
        .pose(MuscleSet::embedded())?)
}

/// Where the solvers find rest: all stiffness scaled, tissue thinner and thicker, damping and time step of Verlet. `distance_mm`: from
/// the default's equilibrium of the usual face, which neither stiffness nor damping may change; for another thickness from
/// that face's own converged equilibrium.
fn stability_table(rig: &FaceRig, effort: Effort) -> Result<(Table, Plots), Error> {
    let mut table = Table::new(&[
        "setting",
        "value",
        "solver",
        "ms",
        "iterations",
        "distance_mm",
        "inverted_prisms",
    ]);
    let mut curves: [Vec<Curve>; 2] = Default::default();
    let mut push = |setting: &str, usual: f64, kind: SolverKind, found: Outcome| {
        // A solve that failed has no place on the map.
        let iterations = found.iterations as f64 + 0.0 * found.error_mm;
        for (curves, y) in curves.iter_mut().zip([found.error_mm, iterations]) {
            let point = (found.value / usual, y);
            match curves.iter_mut().find(|c| c.name == setting) {
                Some(curve) => curve.points.push(point),
                None => curves.push(Curve {
                    name: setting.to_owned(),
                    points: vec![point],
                }),
            }
        }
        table.push(vec![
            setting.into(),
            found.value.into(),
            kind.name().into(),
            (1e3 * found.seconds).into(),
            (found.iterations as f64).into(),
            found.error_mm.into(),
            (found.inverted as f64).into(),
        ]);
    };
    let reference = ReferenceHead::embedded();
    let subject = mean_subject(reference);
    let pose = expression("surprise")?;
    let usual = Solver::new().solve(
        &rig.model(reference, &subject)?,
        &pose,
        &SolverParams::default(),
    )?;
    for value in effort.of(&[1e3][..], &[1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3][..]) {
        let model = rig.model_with(reference, &subject, scaled(*value))?;
        let params = SolverParams::default();
        let found = outcome(&model, &pose, &params, *value, Some(&usual));
        push("stiffness", 1.0, params.kind, found);
    }
    for value in effort.of(&[1.0][..], &[1.0, 2.0, 3.0, 5.0, 8.0, 12.0][..]) {
        let mut other = reference.clone();
        for t in &mut other.cage.thickness {
            *t *= value / 5.0;
        }
        let model = FaceModel::new(&other, MuscleSet::embedded(), &subject)?;
        let params = SolverParams::default();
        // Another thickness is another face, with its fascia elsewhere: it is compared with its own converged equilibrium.
        let exact = SolverParams {
            continuation_step: 0.1,
            tolerance: 1e-6,
            ..params
        };
        let truth = Solver::new().solve(&model, &pose, &exact).ok();
        let mut found = outcome(&model, &pose, &params, *value, truth.as_ref());
        if truth.is_none() {
            found.error_mm = f64::NAN;
        }
        push("thickness_mm", 5.0, params.kind, found);
    }
    // Verlet's own settings, on an expression that it solves in seconds.
    let pose = expression("anger")?;
    let model = rig.model(reference, &subject)?;
    let usual = Solver::new().solve(&model, &pose, &SolverParams::default())?;
    for value in effort.of(&[][..], &[2.5, 5.0, 12.5, 25.0, 50.0, 100.0][..]) {
        let params = PaperParams {
            damping: *value,
            ..PaperParams::default()
        };
        let model = rig.model_with(reference, &subject, params)?;
        let params = SolverParams::verlet();
        let found = outcome(&model, &pose, &params, *value, Some(&usual));
        push("damping", 25.0, params.kind, found);
    }
    for value in effort.of(&[][..], &[0.1, 0.3, 0.6, 0.9, 1.1, 1.5, 3.0][..]) {
        let params = SolverParams {
            time_step: *value,
            ..SolverParams::verlet()
        };
        let found = outcome(&model, &pose, &params, *value, Some(&usual));
        push("time_step", 0.9, params.kind, found);
    }
    Ok((table, stability_plots(curves)))
}

fn stability_plots([distance, cost]: [Vec<Curve>; 2]) -> Plots {
    let plot = |title: &str, y: &str, curves| Plot {
        title: title.to_owned(),
        x: Axis::logarithmic("value over the usual one"),
        y: Axis::logarithmic(y),
        curves,
    };
    let far = "largest distance of a node, mm";
    vec![
        (
            "sim_stability",
            plot("distance from the equilibrium", far, distance),
        ),
        (
            "sim_stability_cost",
            plot("iterations, or time steps of Verlet", "iterations", cost),
        ),
    ]
}

/// Table 1 with all stiffness times `factor`.
fn scaled(factor: f64) -> PaperParams {
    let p = PaperParams::default();
    PaperParams {
        skin_stiffness: factor * p.skin_stiffness,
        skin_fascia_stiffness: factor * p.skin_fascia_stiffness,
        fascia_stiffness: factor * p.fascia_stiffness,
        fascia_skull_stiffness: factor * p.fascia_skull_stiffness,
        shape_stiffness: factor * p.shape_stiffness,
        volume_stiffness: factor * p.volume_stiffness,
        ..p
    }
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
            (report.inverted.len() as f64).into(),
            (report.inverted.iter().map(|i| i.1).max().unwrap_or(0) as f64).into(),
        ]);
    }
    Ok(table)
}
