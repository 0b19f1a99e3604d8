//! Error and time against the number of nodes, for `facile bench sim`.

use facile_core::identity::IdentityModel;
use facile_core::reference::Role;
use facile_core::{ReferenceHead, Subject, Vector3};
use facile_sim::resolution::{Cut, Resolution};
use facile_sim::{Equilibrium, FaceRig, MuscleSet, Pose, Solver, SolverParams};

use super::{Axis, Curve, Effort, Plot, Plots, Table, median};
use crate::Error;

/// One mesh: the head, the subject on it.
struct Level {
    head: ReferenceHead,
    subject: Subject,
}

/// What solves on a mesh came to, one for each pose.
struct Solved {
    nodes: usize,
    model_ms: f64,
    /// Milliseconds, and the face or nothing.
    faces: Vec<(f64, Option<Equilibrium>)>,
}

/// Solves poses on the mesh as it is and on finer ones, up to eight times the nodes; all are compared with the finest, at
/// the skin that all share.
///
/// # Errors
/// [`Error::Sim`] if a mesh cannot be built.
pub(super) fn resolution(
    poses: &[(String, Pose)],
    effort: Effort,
) -> Result<(Table, Plots), Error> {
    let (levels, solved) = levels(poses, effort)?;
    let reference = ReferenceHead::embedded();
    let shared: Vec<usize> = (0..reference.cage.positions.len())
        .filter(|&v| reference.cage.roles[v] == Role::Free)
        .collect();
    let mut table = Table::new(&[
        "pose",
        "nodes_a_layer",
        "model_ms",
        "ms",
        "iterations",
        "largest_mm",
        "mean_mm",
        "motion_mm",
    ]);
    let (mut errors, mut times) = (Vec::new(), Vec::new());
    for (k, (name, _)) in poses.iter().enumerate() {
        let way = |l: usize| {
            let (face, rest) = (solved[l].faces[k].1.as_ref()?, &levels[l].subject);
            let moved = |v: &usize| face.positions[*v] - rest.positions[*v];
            Some(shared.iter().map(moved).collect::<Vec<Vector3>>())
        };
        let finest = way(levels.len() - 1);
        let (mut error, mut time) = (Vec::new(), Vec::new());
        for (l, level) in solved.iter().enumerate() {
            let (ms, face) = &level.faces[k];
            let apart = |a: &[Vector3], b: &[Vector3]| -> Vec<f64> {
                a.iter().zip(b).map(|(p, q)| (p - q).norm()).collect()
            };
            let away = way(l).zip(finest.as_ref()).map(|(a, b)| apart(&a, b));
            let mean = |d: &[f64]| d.iter().sum::<f64>() / d.len() as f64;
            let largest = away
                .as_ref()
                .map_or(f64::NAN, |d| d.iter().copied().fold(0.0, f64::max));
            let middle = away.as_deref().map_or(f64::NAN, mean);
            let motion: Option<Vec<f64>> = way(l).map(|w| w.iter().map(Vector3::norm).collect());
            let iterations = face
                .as_ref()
                .map_or(f64::NAN, |f| f.certificate.iterations as f64);
            table.push(vec![
                name.clone().into(),
                (level.nodes as f64).into(),
                level.model_ms.into(),
                (*ms).into(),
                iterations.into(),
                largest.into(),
                middle.into(),
                motion.as_deref().map_or(f64::NAN, mean).into(),
            ]);
            error.push((level.nodes as f64, middle));
            time.push((level.nodes as f64, *ms));
        }
        errors.push(Curve {
            name: name.clone(),
            points: error,
        });
        times.push(Curve {
            name: name.clone(),
            points: time,
        });
    }
    let plot = |title: &str, y: &str, curves: Vec<Curve>| Plot {
        title: title.to_owned(),
        x: Axis::logarithmic("nodes a layer"),
        y: Axis::logarithmic(y),
        curves,
    };
    Ok((
        table,
        vec![
            (
                "sim_resolution",
                plot(
                    "mean distance of the skin from that of the finest mesh",
                    "mm",
                    errors,
                ),
            ),
            (
                "sim_resolution_time",
                plot("time of a solve, cold", "ms", times),
            ),
        ],
    ))
}

/// The meshes, and the poses on each.
fn levels(poses: &[(String, Pose)], effort: Effort) -> Result<(Vec<Level>, Vec<Solved>), Error> {
    let reference = ReferenceHead::embedded();
    let subject = IdentityModel::embedded().sample(reference, 7, 0)?;
    let usual = FaceRig::new(reference, MuscleSet::embedded())?;
    let usual = usual.template().free_count();
    let mut levels = vec![Level {
        head: reference.clone(),
        subject,
    }];
    let finer = |level: &Level, cut: Cut| {
        let resolution = Resolution::finer(&level.head, cut);
        let subject = resolution.subject(&level.subject);
        Level {
            head: resolution.head,
            subject,
        }
    };
    levels.push(finer(&levels[0], Cut::Centres));
    if effort == Effort::Full {
        levels.push(finer(&levels[0], Cut::Quarters));
        levels.push(finer(&levels[2], Cut::Centres));
    }
    let mut solved = Vec::new();
    for level in &levels {
        solved.push(solve(level, usual, poses, effort)?);
    }
    Ok((levels, solved))
}

fn solve(
    level: &Level,
    usual: usize,
    poses: &[(String, Pose)],
    effort: Effort,
) -> Result<Solved, Error> {
    let rig = FaceRig::new(&level.head, MuscleSet::embedded())?;
    let nodes = rig.template().free_count();
    let params = Resolution::params(usual, nodes);
    let timed = || super::clock(|| rig.model_with(&level.head, &level.subject, params));
    let models: Vec<f64> = (0..3).map(|_| timed().0).collect();
    let model = timed().1?;
    let mut solver = Solver::new();
    let faces = poses
        .iter()
        .map(|(_, pose)| {
            let mut times = Vec::new();
            let mut face = None;
            for _ in 0..effort.of(1, 3) {
                let (ms, found) =
                    super::clock(|| solver.solve(&model, pose, &SolverParams::default()));
                times.push(ms);
                face = found.ok();
            }
            (median(times), face)
        })
        .collect();
    Ok(Solved {
        nodes,
        model_ms: median(models),
        faces,
    })
}
