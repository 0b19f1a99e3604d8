//! Error and time against the number of nodes, for `facile bench sim`.

use facile_core::identity::IdentityModel;
use facile_core::reference::Role;
use facile_core::{ReferenceHead, Subject, Vector3};
use facile_sim::resolution::{Cut, Resolution};
use facile_sim::{Equilibrium, FaceRig, MuscleSet, Pose, Solver, SolverParams};

use super::{Axis, Curve, Effort, Plot, Plots, Table, median};
use crate::Error;

/// Nodes a layer of the coarse meshes.
const COARSE: [usize; 2] = [500, 1000];

/// One mesh: how it was made, the subject on it.
struct Level {
    /// The mesh and the level it was made from; the usual one was not made.
    made: Option<(Resolution, usize)>,
    subject: Subject,
}

impl Level {
    fn head(&self) -> &ReferenceHead {
        self.made
            .as_ref()
            .map_or(ReferenceHead::embedded(), |(r, _)| &r.head)
    }
}

/// What solves on a mesh came to, one for each pose.
struct Solved {
    nodes: usize,
    /// NaN where no model can be built.
    model_ms: f64,
    /// Milliseconds, and the face or nothing.
    faces: Vec<(f64, Option<Equilibrium>)>,
}

/// Solves poses on the mesh as it is, on coarser ones down to a quarter of the nodes, and on finer ones up to eight times
/// the nodes; all are compared with the finest.
///
/// What is compared is the motion of the drawn skin at all free vertices of the usual mesh. A coarser mesh has no node at
/// most of them: there its motion is that of the nearest place on its faces, linear between their corners
/// ([`Resolution::carry`]), so that what a coarse mesh cannot follow counts as error. Finer meshes have all those vertices.
///
/// A mesh on which no model can be built, and a solve without a certificate, give a row without numbers.
///
/// # Errors
/// [`Error::Sim`] if a mesh cannot be made.
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
            let skin = on_usual_mesh(&levels, l, solved[l].faces[k].1.as_ref()?);
            Some(shared.iter().map(|&v| skin[v]).collect::<Vec<Vector3>>())
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

/// How the skin moves at the cage vertices of the usual mesh.
fn on_usual_mesh(levels: &[Level], level: usize, face: &Equilibrium) -> Vec<Vector3> {
    let rest = &levels[level].subject.positions;
    let pairs = face.positions.iter().zip(rest);
    let mut moved: Vec<Vector3> = pairs.map(|(p, q)| p - q).collect();
    let mut made = &levels[level].made;
    while let Some((resolution, from)) = made {
        moved = resolution.carry(&moved);
        made = &levels[*from].made;
    }
    moved
}

/// The meshes by their numbers of nodes, and the poses on each.
fn levels(poses: &[(String, Pose)], effort: Effort) -> Result<(Vec<Level>, Vec<Solved>), Error> {
    let reference = ReferenceHead::embedded();
    let subject = IdentityModel::embedded().sample(reference, 7, 0)?;
    let usual = FaceRig::new(reference, MuscleSet::embedded())?;
    let usual = usual.template().free_count();
    let middle = COARSE.len();
    let mut levels = Vec::new();
    for nodes in COARSE {
        let resolution = Resolution::coarser(reference, nodes)?;
        levels.push(Level {
            subject: resolution.subject(&subject),
            made: Some((resolution, middle)),
        });
    }
    levels.push(Level {
        made: None,
        subject,
    });
    let mut finer = |from: usize, cut: Cut| {
        let resolution = Resolution::finer(levels[from].head(), cut);
        levels.push(Level {
            subject: resolution.subject(&levels[from].subject),
            made: Some((resolution, from)),
        });
    };
    finer(middle, Cut::Centres);
    if effort == Effort::Full {
        finer(middle, Cut::Quarters);
        finer(middle + 2, Cut::Centres);
    }
    let solved = levels
        .iter()
        .map(|level| solve(level, usual, poses, effort))
        .collect();
    Ok((levels, solved))
}

fn solve(level: &Level, usual: usize, poses: &[(String, Pose)], effort: Effort) -> Solved {
    let head = level.head();
    let free = |r: &&Role| **r == Role::Free;
    let nodes = head.cage.roles.iter().filter(free).count();
    let Ok(rig) = FaceRig::new(head, MuscleSet::embedded()) else {
        return nothing(nodes, poses);
    };
    let params = Resolution::params(usual, nodes);
    let timed = || super::clock(|| rig.model_with(head, &level.subject, params));
    let models: Vec<f64> = (0..3).map(|_| timed().0).collect();
    let Ok(model) = timed().1 else {
        return nothing(nodes, poses);
    };
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
    Solved {
        nodes,
        model_ms: median(models),
        faces,
    }
}

/// A mesh on which no model can be built.
fn nothing(nodes: usize, poses: &[(String, Pose)]) -> Solved {
    Solved {
        nodes,
        model_ms: f64::NAN,
        faces: poses.iter().map(|_| (f64::NAN, None)).collect(),
    }
}
