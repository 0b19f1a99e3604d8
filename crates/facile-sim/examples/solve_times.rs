//! Time, iterations and certificate of every built-in expression on the mean head and on sampled identities.
//!
//! `cargo run --release --example solve_times -- [--identities N] [--seed S] [--solver KIND] [--compare] [--repeat R]
//! [--random COUNT] [--moderate] [--muscles FILE] [--expressions FILE] [names]`, names being expressions, `MUSCLE=C` or `jaw=DEGREES`
//!
//! `--compare` solves with the default as well and prints the largest distance between nodes.

use std::error::Error;
use std::time::Instant;

use facile_core::ReferenceHead;
use facile_core::identity::IdentityModel;
use facile_sim::{
    ExpressionSet, FaceRig, MuscleSet, Pose, Solver, SolverKind, SolverParams, mean_subject,
};

fn main() -> Result<(), Box<dyn Error>> {
    let mut identities = 0;
    let mut seed = 7;
    let mut repeat = 1;
    let mut muscles = MuscleSet::embedded().clone();
    let mut expressions = ExpressionSet::embedded().clone();
    let mut compare = false;
    let mut random = None;
    let mut moderate = false;
    let mut params = SolverParams::default();
    let mut names = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || {
            args.next()
                .ok_or("a number is missing")?
                .parse::<u64>()
                .map_err(Box::<dyn Error>::from)
        };
        match arg.as_str() {
            "--identities" => identities = number()?,
            "--seed" => seed = number()?,
            "--repeat" => repeat = number()?,
            "--compare" => compare = true,
            "--random" => random = Some(number()?),
            "--moderate" => moderate = true,
            "--muscles" => {
                let file = args.next().ok_or("a file is missing")?;
                muscles = MuscleSet::parse(&std::fs::read_to_string(&file)?, &file)?;
            }
            "--expressions" => {
                let file = args.next().ok_or("a file is missing")?;
                expressions = ExpressionSet::parse(&std::fs::read_to_string(&file)?, &file)?;
            }
            "--solver" => {
                let kind = args.next().ok_or("a solver is missing")?;
                let all = SolverKind::ALL;
                let kind = all
                    .iter()
                    .find(|k| k.name() == kind)
                    .ok_or("an unknown solver")?;
                params = SolverParams::of(*kind);
            }
            "--tolerance" => {
                params.tolerance = args.next().ok_or("a number is missing")?.parse()?
            }
            "--step" => {
                params.continuation_step = args.next().ok_or("a number is missing")?.parse()?
            }
            name => names.push(name.to_owned()),
        }
    }
    let reference = ReferenceHead::embedded();
    if let Some(count) = random {
        let rig = FaceRig::new(reference, &muscles)?;
        eprintln!(
            "{:#?}",
            facile_sim::stress::stress(&rig, reference, seed, count as usize, 3, moderate)?
        );
        return Ok(());
    }
    let start = Instant::now();
    let rig = FaceRig::new(reference, &muscles)?;
    eprintln!(
        "rig: {:.1} ms, {} free nodes",
        ms(start),
        rig.template().free_count()
    );
    let mut subjects = vec![mean_subject(reference)];
    for number in 0..identities {
        subjects.push(IdentityModel::embedded().sample(reference, seed, number)?);
    }
    let mut poses: Vec<(String, Pose)> = Vec::new();
    for e in expressions.expressions() {
        if names.is_empty() || names.contains(&e.name) {
            poses.push((e.name.clone(), e.pose(&muscles)?));
        }
    }
    for name in &names {
        if let Some((key, c)) = name.split_once('=') {
            let mut pose = Pose::default();
            match key {
                "jaw" => pose.jaw.open_rad = c.parse::<f64>()?.to_radians(),
                _ => pose.set(&muscles, key, c.parse()?)?,
            }
            poses.push((name.clone(), pose));
        }
    }
    let mut solver = Solver::new();
    let mut failed = 0;
    for subject in &subjects {
        let start = Instant::now();
        let model = rig.model(reference, subject)?;
        eprintln!("{}: model {:.1} ms", subject.id, ms(start));
        for (name, pose) in &poses {
            let mut times = Vec::new();
            let mut result = None;
            for _ in 0..repeat {
                let start = Instant::now();
                result = Some(solver.solve(&model, pose, &params));
                times.push(ms(start));
            }
            times.sort_by(f64::total_cmp);
            let time = times[times.len() / 2];
            match result {
                Some(Ok(face)) => {
                    let mut away = String::new();
                    if compare {
                        let other = solver.solve(&model, pose, &SolverParams::default())?;
                        let pairs = face.nodes.iter().zip(&other.nodes);
                        let far = pairs.map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
                        away = format!(", {far:.5} mm from the default");
                    }
                    let mark = |p: &[facile_core::Point3], k: usize| {
                        let scheme = reference.scheme("ibug68").expect("built in");
                        scheme.points[k].position(p, &reference.mesh.triangles)
                    };
                    let moved = |k| mark(&face.positions, k) - mark(&subject.positions, k);
                    let (corner, brow) = (moved(54), moved(22));
                    eprintln!(
                        "  {name:12} {time:8.1} ms  {}{away}; corner {:.1} {:.1} {:.1}, inner brow {:.1} {:.1}",
                        show(&face.certificate),
                        corner.x,
                        corner.y,
                        corner.z,
                        brow.x,
                        brow.y
                    );
                }
                Some(Err(e)) => {
                    failed += 1;
                    eprintln!("  {name:12} {time:8.1} ms  FAILED {e}");
                }
                None => {}
            }
        }
    }
    eprintln!("{failed} failed");
    Ok(())
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
