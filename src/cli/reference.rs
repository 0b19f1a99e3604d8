//! `facile reference`

use std::path::{Path, PathBuf};

use facile::core::{ReferenceHead, io};
use facile::flow::{PopulationParams, RegistrationParams, Round, build_reference};

use super::{DONE, FAILED, Refused, output};

/// Files that are taken for scans.
const SCANS: [&str; 4] = ["glb", "gltf", "obj", "ply"];

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Make the mean head of a population of scans: register, average, and again until the mean stays.
    Build(Build),
}

#[derive(Debug, clap::Args)]
struct Build {
    /// Folder of scans of neutral faces: OBJ, PLY, GLB or glTF.
    #[arg(long, value_name = "DIR")]
    population: PathBuf,
    /// Folder to write the head to: `facile register --reference` reads it.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Head to begin from, with the topology and the annotations: the program's own if not given.
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// Least number of faces that must be registered.
    #[arg(long, value_name = "N", default_value_t = PopulationParams::default().at_least)]
    at_least: usize,
    /// The mean is there when a round moves it by less than this, RMS over the face.
    #[arg(long, value_name = "MM", default_value_t = PopulationParams::default().tolerance_mm)]
    tolerance_mm: f64,
    /// Most rounds.
    #[arg(long, value_name = "N", default_value_t = PopulationParams::default().max_rounds)]
    rounds: usize,
    /// Keep the first head's skin instead of the mean of the population's.
    #[arg(long)]
    keep_skin: bool,
}

/// What `population.json` says of a round.
#[derive(serde::Serialize)]
struct RoundRecord<'a> {
    faces: usize,
    moved_mm: f64,
    slid_mm: f64,
    spread_mm: f64,
    failed: Vec<Failure<'a>>,
}

#[derive(serde::Serialize)]
struct Failure<'a> {
    file: String,
    reason: &'a str,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    match &arguments.command {
        Command::Build(arguments) => build(arguments),
    }
}

fn build(arguments: &Build) -> anyhow::Result<u8> {
    let files = scans_in(&arguments.population)?;
    if files.len() < arguments.at_least {
        return Err(Refused(format!(
            "{}: {} scans ({}), at least {} are needed; --at-least takes fewer",
            arguments.population.display(),
            files.len(),
            SCANS.join(", "),
            arguments.at_least,
        ))
        .into());
    }
    let start = match &arguments.reference {
        Some(dir) => reference_in(dir)?,
        None => ReferenceHead::embedded().clone(),
    };
    let params = RegistrationParams {
        texture_size: start.texture.width(),
        ..RegistrationParams::default()
    };
    let stop = PopulationParams {
        at_least: arguments.at_least,
        tolerance_mm: arguments.tolerance_mm,
        max_rounds: arguments.rounds,
    };
    let mut number = 0;
    let mut mean = build_reference(
        &start,
        files.len(),
        |i| io::load_scan(&files[i], None),
        &params,
        stop,
        |round| {
            number += 1;
            tell(number, round, &files);
        },
    )?;
    if arguments.keep_skin {
        mean.head.texture = start.texture;
    }
    let faces = mean.rounds.last().map_or(0, |r| r.faces);
    let note = format!(
        "Facile reference head, mm, head frame: mean of {faces} faces, built by `facile reference build`."
    );
    mean.head.save(&arguments.output, &note)?;
    let records: Vec<_> = mean.rounds.iter().map(|r| record(r, &files)).collect();
    let text = serde_json::to_string_pretty(&records)? + "\n";
    io::write_file(&arguments.output.join("population.json"), text.as_bytes())?;
    if mean.converged {
        return Ok(DONE);
    }
    output::note(&format!(
        "the mean still moves by more than {} mm after {} rounds; --rounds allows more",
        arguments.tolerance_mm, arguments.rounds
    ));
    Ok(FAILED)
}

/// The reference head in a folder.
pub(super) fn reference_in(dir: &Path) -> anyhow::Result<ReferenceHead> {
    ReferenceHead::load(dir)
        .map_err(|e| anyhow::anyhow!("{} holds no reference head: {e}", dir.display()))
}

/// The scans of a folder by name.
fn scans_in(dir: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).map_err(|e| Refused(format!("{}: {e}", dir.display())))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry?.path();
        let extension = path.extension().and_then(|e| e.to_str());
        if extension.is_some_and(|e| SCANS.iter().any(|s| s.eq_ignore_ascii_case(e))) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn tell(number: usize, round: &Round, files: &[PathBuf]) {
    output::note(&format!(
        "round {number}: {} faces, the mean moved {:.3} mm (and slid {:.3} mm), the population lies {:.2} mm about it",
        round.faces, round.moved_mm, round.slid_mm, round.spread_mm
    ));
    for (i, reason) in &round.failed {
        output::note(&format!("  without {}: {reason}", files[*i].display()));
    }
}

fn record<'a>(round: &'a Round, files: &[PathBuf]) -> RoundRecord<'a> {
    let name = |i: usize| files[i].file_name().unwrap_or_default().to_string_lossy();
    let failed = round.failed.iter();
    RoundRecord {
        faces: round.faces,
        moved_mm: round.moved_mm,
        slid_mm: round.slid_mm,
        spread_mm: round.spread_mm,
        failed: (failed.map(|(i, reason)| Failure {
            file: name(*i).into_owned(),
            reason,
        }))
        .collect(),
    }
}
