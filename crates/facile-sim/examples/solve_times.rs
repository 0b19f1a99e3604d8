//! Time, iterations and certificate of every built-in expression on the mean head and on sampled identities.
//!
//! `cargo run --release --example solve_times -- [--identities N] [--seed S] [--verlet] [--repeat R] [names]`

use std::error::Error;
use std::time::Instant;

use facile_core::identity::IdentityModel;
use facile_core::{Attributes, ReferenceHead, Similarity3, Subject};
use facile_sim::{ExpressionSet, FaceRig, MuscleSet, Pose, Solver, SolverParams};

fn main() -> Result<(), Box<dyn Error>> {
    let mut identities = 0;
    let mut seed = 7;
    let mut repeat = 1;
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
            "--verlet" => params = SolverParams::verlet(),
            name => names.push(name.to_owned()),
        }
    }
    let reference = ReferenceHead::embedded();
    let muscles = MuscleSet::embedded();
    let start = Instant::now();
    let rig = FaceRig::new(reference, muscles)?;
    eprintln!(
        "rig: {:.1} ms, {} free nodes",
        ms(start),
        rig.template().free_count()
    );
    let mut subjects = vec![mean_subject(reference)];
    for number in 0..identities {
        subjects.push(IdentityModel::embedded().sample(reference, seed, number)?);
    }
    let poses: Vec<(String, Pose)> = ExpressionSet::embedded()
        .expressions()
        .iter()
        .filter(|e| names.is_empty() || names.contains(&e.name))
        .map(|e| Ok((e.name.clone(), e.pose(muscles)?)))
        .collect::<Result<_, facile_sim::SimError>>()?;
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
                    eprintln!("  {name:12} {time:8.1} ms  {}", show(&face.certificate))
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
        "{:5} iterations, residual {:.1e}, penetration {:.4} mm, {} inverted",
        c.iterations, c.residual, c.max_penetration_mm, c.inverted_elements
    )
}

fn ms(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

fn mean_subject(reference: &ReferenceHead) -> Subject {
    Subject {
        id: "mean".to_owned(),
        attributes: Attributes::default(),
        positions: reference.mesh.positions.clone(),
        expected_error: vec![0.0; reference.mesh.positions.len()],
        texture: reference.texture.clone(),
        eyes: reference.eyes,
        eye_color: "brown".to_owned(),
        skull_from_reference: Similarity3::identity(),
    }
}
