//! Registration error on people of the identity model, whose truth is known at every vertex.
//!
//! `known_scans [--people N] [--color true|false] [--noise MM] [--holes SHARE] [--coarse true|false] [--files DIR]
//! [--params FILE.json]...` prints the mean, median and 95th percentile of
//! the distance between registered and true vertices of the face, the rank correlation of expected and true error,
//! and the time of each stage on one thread. With `--files` the scans are written to `DIR/person_K.obj` and read from there, which is
//! a stage as well.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use facile_core::color::srgb_from_linear;
use facile_core::io::{Scan, load_scan};
use facile_core::{IdentityModel, ReferenceHead};
use facile_flow::synthetic::{Scanner, errors, face_vertices, scan_of, skin_vertices};
use facile_flow::{Registrar, RegistrationParams};

/// What the command line asks for.
#[derive(Default)]
struct Options {
    scanner: Scanner,
    folder: Option<PathBuf>,
    variants: Vec<(String, RegistrationParams)>,
}

impl Options {
    /// The options, and the number of people.
    fn parse(mut args: impl Iterator<Item = String>) -> Result<(Self, u64), Box<dyn Error>> {
        let (mut options, mut people) = (Self::default(), 6);
        while let (Some(key), Some(value)) = (args.next(), args.next()) {
            let scanner = &mut options.scanner;
            match key.as_str() {
                "--people" => people = value.parse()?,
                "--color" => scanner.with_color = value.parse()?,
                "--noise" => scanner.noise_mm = value.parse()?,
                "--holes" => scanner.holes = value.parse()?,
                "--cell" => scanner.cell_mm = value.parse()?,
                "--files" => options.folder = Some(value.into()),
                "--coarse" if value.parse()? => {
                    let coarse = ("coarse".to_owned(), RegistrationParams::coarse());
                    options.variants.push(coarse);
                }
                "--coarse" => {}
                "--params" => {
                    let params = serde_json::from_str(&std::fs::read_to_string(&value)?)?;
                    options.variants.push((value, params));
                }
                _ => return Err(format!("unknown option {key}").into()),
            }
        }
        if options.variants.is_empty() {
            let defaults = ("defaults".to_owned(), RegistrationParams::default());
            options.variants.push(defaults);
        }
        Ok((options, people))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let (options, people) = Options::parse(std::env::args().skip(1))?;
    let Options {
        scanner,
        folder,
        variants,
    } = options;
    let (reference, model) = (ReferenceHead::embedded(), IdentityModel::embedded());
    let mut scans = Vec::new();
    for k in 0..people {
        let subject = model.sample(reference, 77, k)?;
        let scanner = Scanner { seed: k, ..scanner };
        scans.push(scan_of(reference, &subject, &scanner));
    }
    let (face, skin) = (face_vertices(reference), skin_vertices(reference));
    for (name, params) in variants {
        let registrar = Registrar::new(reference, params)?;
        let (mut true_errors, mut expected, mut folded) = (Vec::new(), Vec::new(), 0);
        let (mut true_skin, mut expected_skin) = (Vec::new(), Vec::new());
        let mut stages = Vec::<(&str, f64)>::new();
        let mut add = |stage, seconds| match stages.iter_mut().find(|s| s.0 == stage) {
            Some(known) => known.1 += seconds,
            None => stages.push((stage, seconds)),
        };
        for (k, known) in scans.iter().enumerate() {
            let read;
            let scan = match &folder {
                Some(folder) => {
                    let path = folder.join(format!("person_{k}.obj"));
                    write_obj(&path, &known.scan)?;
                    let start = Instant::now();
                    read = load_scan(&path, None)?;
                    add("read", start.elapsed().as_secs_f64());
                    &read
                }
                None => &known.scan,
            };
            let found = registrar.register(scan)?;
            for time in &found.times {
                add(time.stage, time.seconds);
            }
            folded += found.report.folded_triangles;
            let all = errors(known, &found, &face);
            let r = &found.report;
            eprintln!(
                "  {}: mean {:.3} mm, size {:.3}, rigid {:.2} mm, curvature {:.2}",
                known.scan.name,
                all.iter().sum::<f64>() / all.len() as f64,
                r.size,
                r.rigid_distance_mm,
                r.curvature_correlation
            );
            let guess = |v: &usize| f64::from(found.subject.expected_error[*v]);
            true_errors.extend(all);
            expected.extend(face.iter().map(guess));
            true_skin.extend(errors(known, &found, &skin));
            expected_skin.extend(skin.iter().map(guess));
        }
        let n = scans.len() as f64;
        let mut sorted = true_errors.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let quantile = |q: f64| sorted[((sorted.len() - 1) as f64 * q) as usize];
        eprint!(
            "{name}: {} triangles; mean {:.3} median {:.3} p95 {:.3} max {:.2} mm; expected {:.3}, rank correlation {:.2}; all skin {:.2} mm, expected {:.2}, rank correlation {:.2}; folded {:.1}; {:.2} s:",
            scans[0].scan.mesh.triangles.len(),
            mean(&sorted),
            quantile(0.5),
            quantile(0.95),
            quantile(1.0),
            mean(&expected),
            spearman(&true_errors, &expected),
            mean(&true_skin),
            mean(&expected_skin),
            spearman(&true_skin, &expected_skin),
            folded as f64 / n,
            stages.iter().map(|s| s.1).sum::<f64>() / n
        );
        for (stage, sum) in stages {
            eprint!(" {stage} {:.3}", sum / n);
        }
        eprintln!();
    }
    Ok(())
}

fn write_obj(path: &Path, scan: &Scan) -> Result<(), Box<dyn Error>> {
    let mut text = String::new();
    for (k, p) in scan.mesh.positions.iter().enumerate() {
        write!(text, "v {:.4} {:.4} {:.4}", p.x, p.y, p.z)?;
        if let Some(color) = scan.mesh.colors.get(k) {
            let [r, g, b] = color.map(|c| srgb_from_linear(f64::from(c)));
            write!(text, " {r:.4} {g:.4} {b:.4}")?;
        }
        text.push('\n');
    }
    for [a, b, c] in &scan.mesh.triangles {
        writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1)?;
    }
    Ok(std::fs::write(path, text)?)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Rank correlation.
fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let ranks = |values: &[f64]| {
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|i, j| values[*i].total_cmp(&values[*j]));
        let mut rank = vec![0.0; values.len()];
        for (r, i) in order.into_iter().enumerate() {
            rank[i] = r as f64;
        }
        rank
    };
    let (x, y) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let covariance: f64 = x.iter().zip(&y).map(|(p, q)| (p - mean) * (q - mean)).sum();
    let variance: f64 = x.iter().map(|p| (p - mean).powi(2)).sum();
    covariance / variance
}
