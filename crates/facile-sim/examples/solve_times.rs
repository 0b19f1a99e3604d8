//! Time, iterations and certificate of every built-in expression on the mean head and on sampled identities.
//!
//! `cargo run --release --example solve_times -- [--identities N] [--seed S] [--solver KIND] [--compare] [--repeat R]
//! [--intensity I]
//! [--ladder RUNGS] [--random COUNT] [--moderate] [--tolerance T] [--step S] [--nodes DIR] [--muscles FILE]
//! [--expressions FILE] [names]`, names being expressions, `MUSCLE=C` or `jaw=DEGREES`
//!
//! `--ladder` climbs to each pose over so many intensities, and solves each of them on its own. `--compare` solves with the default as well and prints the largest distance between nodes; `--nodes` writes the nodes
//! to one file a solve, mm, for comparison with another version of the solver.

use std::error::Error;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use facile_core::identity::IdentityModel;
use facile_core::{Point3, ReferenceHead, Subject, Vector3};
use facile_sim::stress::stress;
use facile_sim::work_precision::largest_distance;
use facile_sim::{
    Equilibrium, ExpressionSet, FaceModel, FaceRig, MuscleSet, Pose, Solver, SolverKind,
    SolverParams, mean_subject,
};

struct Options {
    identities: u64,
    seed: u64,
    repeat: u64,
    compare: bool,
    ladder: Option<usize>,
    random: Option<usize>,
    moderate: bool,
    intensity: f64,
    nodes: Option<PathBuf>,
    params: SolverParams,
    muscles: MuscleSet,
    expressions: ExpressionSet,
    names: Vec<String>,
}

fn options() -> Result<Options, Box<dyn Error>> {
    let mut o = Options {
        identities: 0,
        seed: 7,
        repeat: 1,
        compare: false,
        ladder: None,
        random: None,
        moderate: false,
        intensity: 1.0,
        nodes: None,
        params: SolverParams::default(),
        muscles: MuscleSet::embedded().clone(),
        expressions: ExpressionSet::embedded().clone(),
        names: Vec::new(),
    };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg} needs a value"));
        match arg.as_str() {
            "--identities" => o.identities = value()?.parse()?,
            "--seed" => o.seed = value()?.parse()?,
            "--repeat" => o.repeat = value()?.parse()?,
            "--compare" => o.compare = true,
            "--ladder" => o.ladder = Some(value()?.parse()?),
            "--random" => o.random = Some(value()?.parse()?),
            "--nodes" => o.nodes = Some(value()?.into()),
            "--intensity" => o.intensity = value()?.parse()?,
            "--moderate" => o.moderate = true,
            "--tolerance" => o.params.tolerance = value()?.parse()?,
            "--step" => o.params.continuation_step = value()?.parse()?,
            "--solver" => {
                let kind = value()?;
                let all = SolverKind::ALL.iter();
                let kind = all.copied().find(|k| k.name() == kind);
                o.params = SolverParams::of(kind.ok_or("an unknown solver")?);
            }
            "--muscles" => {
                let file = value()?;
                o.muscles = MuscleSet::parse(&std::fs::read_to_string(&file)?, &file)?;
            }
            "--expressions" => {
                let file = value()?;
                o.expressions = ExpressionSet::parse(&std::fs::read_to_string(&file)?, &file)?;
            }
            name => o.names.push(name.to_owned()),
        }
    }
    Ok(o)
}

fn poses(o: &Options) -> Result<Vec<(String, Pose)>, Box<dyn Error>> {
    let mut poses = Vec::new();
    for e in o.expressions.expressions() {
        if o.names.is_empty() || o.names.contains(&e.name) {
            poses.push((e.name.clone(), e.pose(&o.muscles)?.scaled(o.intensity)));
        }
    }
    for name in &o.names {
        if let Some((key, c)) = name.split_once('=') {
            let mut pose = Pose::default();
            match key {
                "jaw" => pose.jaw.open_rad = c.parse::<f64>()?.to_radians(),
                _ => pose.set(&o.muscles, key, c.parse()?)?,
            }
            poses.push((name.clone(), pose));
        }
    }
    Ok(poses)
}

fn main() -> Result<(), Box<dyn Error>> {
    let o = options()?;
    let reference = ReferenceHead::embedded();
    let start = Instant::now();
    let rig = FaceRig::new(reference, &o.muscles)?;
    let nodes = rig.template().free_count();
    eprintln!("rig: {:.1} ms, {nodes} free nodes", ms(start));
    if let Some(count) = o.random {
        let report = stress(&rig, reference, o.seed, count, 3, o.moderate)?;
        eprintln!("{report:#?}");
        return Ok(());
    }
    let mut subjects = vec![mean_subject(reference)];
    for number in 0..o.identities {
        subjects.push(IdentityModel::embedded().sample(reference, o.seed, number)?);
    }
    let poses = poses(&o)?;
    let mut solver = Solver::new();
    let mut failed = 0;
    for subject in &subjects {
        let start = Instant::now();
        let model = rig.model(reference, subject)?;
        eprintln!("{}: model {:.1} ms", subject.id, ms(start));
        for (name, pose) in &poses {
            if let Some(rungs) = o.ladder {
                climb(&mut solver, &model, name, pose, rungs, &o.params)?;
                continue;
            }
            let mut times = Vec::new();
            let mut result = Err("no repeats".to_owned());
            for _ in 0..o.repeat {
                let start = Instant::now();
                let found = solver.solve(&model, pose, &o.params);
                times.push(ms(start));
                result = found.map_err(|e| e.to_string());
            }
            times.sort_by(f64::total_cmp);
            let time = times.get(times.len() / 2).copied().unwrap_or(0.0);
            if let (Some(dir), Ok(face)) = (&o.nodes, &result) {
                let mut text = String::new();
                for p in &face.nodes {
                    writeln!(text, "{:e} {:e} {:e}", p.x, p.y, p.z)?;
                }
                std::fs::write(
                    dir.join(format!("{}-{name}.txt", subject.id.replace('/', "-"))),
                    text,
                )?;
            }
            let text = match result {
                Err(e) => {
                    failed += 1;
                    format!("FAILED {e}")
                }
                Ok(face) if o.compare => {
                    let other = solver.solve(&model, pose, &SolverParams::default())?;
                    let far = largest_distance(&face, &other);
                    format!("{}, {far:.5} mm from the default", show(&face.certificate))
                }
                Ok(face) => {
                    let (corner, brow) = (moved(&face, subject, 54), moved(&face, subject, 22));
                    let shown = show(&face.certificate);
                    format!(
                        "{shown}; corner {:.1} {:.1} {:.1}, inner brow {:.1} {:.1}",
                        corner.x, corner.y, corner.z, brow.x, brow.y
                    )
                }
            };
            eprintln!("  {name:12} {time:8.1} ms  {text}");
        }
    }
    eprintln!("{failed} failed");
    Ok(())
}

/// Solves a pose at `rungs` intensities up to 1, one after the other and each on its own.
fn climb(
    solver: &mut Solver,
    model: &FaceModel,
    name: &str,
    pose: &Pose,
    rungs: usize,
    params: &SolverParams,
) -> Result<(), Box<dyn Error>> {
    if pose.is_neutral() {
        return Ok(());
    }
    let intensities: Vec<f64> = (1..=rungs).map(|k| k as f64 / rungs as f64).collect();
    let start = Instant::now();
    let climbed = solver.solve_ladder(model, pose, &intensities, params);
    let warm = ms(start);
    let start = Instant::now();
    let mut farthest = 0.0f64;
    let mut iterations = [0, 0];
    for (intensity, climbed) in intensities.iter().zip(climbed) {
        let (climbed, alone) = (
            climbed?,
            solver.solve(model, &pose.scaled(*intensity), params)?,
        );
        farthest = farthest.max(largest_distance(&climbed, &alone));
        iterations[0] += climbed.certificate.iterations;
        iterations[1] += alone.certificate.iterations;
    }
    let cold = ms(start);
    let [up, alone] = iterations;
    eprintln!(
        "  {name:12} {rungs} intensities: {warm:.0} ms, {up} iterations climbed, {cold:.0} ms, {alone} on their own, \
         {farthest:.5} mm apart"
    );
    Ok(())
}

/// Motion of an ibug-68 landmark, mm.
fn moved(face: &Equilibrium, subject: &Subject, mark: usize) -> Vector3 {
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    let at = |p: &[Point3]| scheme.points[mark].position(p, &reference.mesh.triangles);
    at(&face.positions) - at(&subject.positions)
}

fn show(c: &facile_sim::Certificate) -> String {
    format!(
        "{:5} iterations, residual {:.1e}, energy {:.6e}, penetration {:.4} mm, {} inverted",
        c.iterations, c.residual, c.energy, c.max_penetration_mm, c.inverted_elements
    )
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}
