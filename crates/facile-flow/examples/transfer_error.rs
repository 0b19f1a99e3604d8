//! Transfer error of registrations, by part of the face and by person.
//!
//! `transfer_error DIR [--scans N] [--params FILE.json]...`, with the files that `bench/peers/ict_scans.py` writes to
//! DIR. Prints the mean, median and 95th percentile over all pairs, in mm; [`facile_flow::transfer`] says of what.

use std::error::Error;
use std::path::Path;

use facile_core::ReferenceHead;
use facile_flow::transfer::{PART_NAMES, TransferSet};
use facile_flow::{Registrar, RegistrationParams};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let dir = args
        .next()
        .ok_or("usage: transfer_error DIR [--scans N] [--params FILE]...")?;
    let mut count = usize::MAX;
    let mut variants = Vec::new();
    while let (Some(key), Some(value)) = (args.next(), args.next()) {
        match key.as_str() {
            "--scans" => count = value.parse()?,
            "--params" => {
                let params = serde_json::from_str(&std::fs::read_to_string(&value)?)?;
                variants.push((value, params));
            }
            _ => return Err(format!("unknown option {key}").into()),
        }
    }
    if variants.is_empty() {
        variants.push(("defaults".to_owned(), RegistrationParams::default()));
    }
    let set = TransferSet::load(Path::new(&dir), count)?;
    for (name, params) in variants {
        measure(&name, params, &set)?;
    }
    Ok(())
}

fn measure(
    name: &str,
    mut params: RegistrationParams,
    set: &TransferSet,
) -> Result<(), Box<dyn Error>> {
    params.texture_size = 16;
    let registrar = Registrar::new(ReferenceHead::embedded(), params)?;
    let (mut stages, mut folded) = (Vec::<(&str, f64)>::new(), 0);
    let mut placed = Vec::new();
    for scan in &set.scans {
        let found = registrar.register(scan)?;
        for (k, time) in found.times.iter().enumerate() {
            match stages.get_mut(k) {
                Some(stage) => stage.1 += time.seconds,
                None => stages.push((time.stage, time.seconds)),
            }
        }
        folded += found.report.folded_triangles;
        placed.push(found.positions_on_scan());
    }
    let errors = set.errors(placed);
    let mut all: Vec<f64> = errors.iter().map(|e| e.distance_mm).collect();
    all.sort_unstable_by(f64::total_cmp);
    let quantile = |q: f64| all[((all.len() - 1) as f64 * q) as usize];
    let n = set.scans.len() as f64;
    let seconds: f64 = stages.iter().map(|s| s.1).sum::<f64>() / n;
    eprint!(
        "{name}: mean {:.3} median {:.3} p95 {:.3} mm ({} points); folded {:.1}; {seconds:.2} s:",
        mean(all.iter().copied()),
        quantile(0.5),
        quantile(0.95),
        all.len(),
        folded as f64 / n,
    );
    for (stage, sum) in stages {
        eprint!(" {stage} {:.3}", sum / n);
    }
    for (part, name) in PART_NAMES.iter().enumerate() {
        let those = errors.iter().filter(|e| e.part == part);
        eprint!(" | {name} {:.2}", mean(those.map(|e| e.distance_mm)));
    }
    eprint!(" | scans");
    for person in 0..set.scans.len() {
        let those = errors.iter().filter(|e| e.people.contains(&person));
        eprint!(" {:.2}", mean(those.map(|e| e.distance_mm)));
    }
    eprintln!();
    Ok(())
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    sum / count
}
