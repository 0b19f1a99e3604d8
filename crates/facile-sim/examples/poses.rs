//! Solves every built-in expression and every muscle on a head, and writes the fine vertices for a look.
//!
//! `cargo run --release --example poses -- OUT [--identity N] [names]` writes `OUT/NAME.f64` (little-endian triples, mm)
//! and `OUT/poses.tsv` with certificate, time, jaw and eye rotation of each. Names: expressions, muscles with contraction
//! (`zygomatic_major=0.5`), or `muscles=0.5` for all of them. `--identity N`: a sampled person, not the mean head. `docs/build/muscles.py` makes pictures of it.

use std::error::Error;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::time::Instant;

use facile_core::ReferenceHead;
use facile_core::identity::IdentityModel;
use facile_sim::{
    ExpressionSet, FaceModel, MuscleSet, Pose, Solver, SolverKind, SolverParams, mean_subject,
};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let out = args.next().ok_or("usage: poses OUT [names]")?;
    fs::create_dir_all(&out)?;
    let reference = ReferenceHead::embedded();
    let muscles = MuscleSet::embedded();
    let start = Instant::now();
    let mut names: Vec<String> = args.collect();
    let mut subject = mean_subject(reference);
    if let Some(k) = names.iter().position(|n| n == "--identity") {
        let number = names.get(k + 1).ok_or("--identity needs a number")?;
        subject = IdentityModel::embedded().sample(reference, 7, number.parse()?)?;
        names.drain(k..k + 2);
    }
    let model = FaceModel::new(reference, muscles, &subject)?;
    eprintln!("model: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    let verlet = names.iter().any(|n| n == "--verlet");
    names.retain(|n| n != "--verlet");
    let mut solver = Solver::new();
    let mut table = String::new();
    for (name, pose) in poses(muscles, &names)? {
        let params = if verlet {
            SolverParams::verlet()
        } else {
            SolverParams::default()
        };
        let start = Instant::now();
        let result = solver.solve(&model, &pose, &params);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let face = match result {
            Ok(face) => face,
            Err(e) => {
                eprintln!("{name}: {e}");
                continue;
            }
        };
        let c = &face.certificate;
        eprintln!(
            "{name}: {ms:.1} ms, {} iterations, residual {:.1e}, penetration {:.4} mm, inverted {}, energy {:.1}",
            c.iterations, c.residual, c.max_penetration_mm, c.inverted_elements, c.energy
        );
        assert!(verlet == (c.solver == SolverKind::Verlet));
        let bytes: Vec<u8> = face
            .positions
            .iter()
            .flat_map(|p| [p.x, p.y, p.z])
            .flat_map(f64::to_le_bytes)
            .collect();
        fs::write(Path::new(&out).join(format!("{name}.f64")), bytes)?;
        write!(table, "{name}\t{ms:.1}\t{}", c.iterations)?;
        for v in face.jaw.to_matrix().iter() {
            write!(table, "\t{v}")?;
        }
        for v in face.eyes[0].to_rotation_matrix().matrix().iter() {
            write!(table, "\t{v}")?;
        }
        table.push('\n');
    }
    fs::write(Path::new(&out).join("poses.tsv"), table)?;
    Ok(())
}

fn poses(muscles: &MuscleSet, names: &[String]) -> Result<Vec<(String, Pose)>, Box<dyn Error>> {
    let expressions = ExpressionSet::embedded();
    let mut out = Vec::new();
    if names.is_empty() {
        for e in expressions.expressions() {
            out.push((e.name.clone(), e.pose(muscles)?));
        }
    }
    for name in names {
        if let Some(c) = name.strip_prefix("muscles=") {
            for m in muscles.muscles() {
                let mut pose = Pose::default();
                pose.set(muscles, &m.name, c.parse()?)?;
                out.push((format!("{}={c}", m.name), pose));
            }
        } else if let Some((key, c)) = name.split_once('=') {
            let mut pose = Pose::default();
            if key == "jaw" {
                pose.jaw.open_rad = c.parse::<f64>()?.to_radians();
            } else {
                pose.set(muscles, key, c.parse()?)?;
            }
            out.push((name.clone(), pose));
        } else {
            out.push((name.clone(), expressions.get(name)?.pose(muscles)?));
        }
    }
    Ok(out)
}
