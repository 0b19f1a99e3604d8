//! `facile register`

use std::path::{Path, PathBuf};

use facile::flow::RegistrationParams;
use facile::pipeline::Registrations;

use super::reference::reference_in;
use super::{DONE, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Scan of a neutral face, roughly upright and facing +z: OBJ, PLY, GLB or glTF, in mm, cm or m.
    scan: PathBuf,
    /// GLB to write: the reference topology in the scan's shape and texture.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// JSON report to write: pose, unit, coverage, distances.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Image to take as the scan's texture instead of what the file names.
    #[arg(long, value_name = "FILE")]
    texture: Option<PathBuf>,
    /// Points of the face in the scan's coordinates: 5 (eyes, nose tip, corners of the mouth; the person's right first)
    /// or the 68 of ibug, as JSON lists or lines of three numbers. They give the pose, from any direction.
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
    /// Reference head to fit, a folder as `facile reference build` writes it, instead of the program's own.
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// Even out the light that is baked into the scan's colours.
    #[arg(long)]
    delight: bool,
    /// Quick look: coarse maps and fewer rounds, half of the time, half as much error again.
    #[arg(long)]
    coarse: bool,
}

/// Names the scan in errors that do not.
fn about(scan: &Path, error: facile::Error) -> anyhow::Error {
    match error {
        facile::Error::Flow(e) => anyhow::anyhow!("{}: {e}", scan.display()),
        other => other.into(),
    }
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let texture = arguments.texture.as_deref();
    let params = RegistrationParams {
        delight: arguments.delight,
        ..if arguments.coarse {
            RegistrationParams::coarse()
        } else {
            RegistrationParams::default()
        }
    };
    let registrations = match &arguments.reference {
        Some(dir) => Registrations::to(reference_in(dir)?, params),
        None => Registrations::with(params),
    };
    let registered = registrations
        .scan(&arguments.scan, texture, arguments.landmarks.as_deref())
        .map_err(|e| about(&arguments.scan, e))?;
    for notice in &registered.notices {
        output::note(notice);
    }
    registered
        .subject
        .save(&arguments.output, registrations.reference())?;
    if let Some(path) = &arguments.report {
        let text = serde_json::to_string_pretty(&registered.report)? + "\n";
        facile::core::io::write_file(path, text.as_bytes())?;
    }
    match &registered.report {
        Some(r) => output::note(&format!(
            "{}: {:.0} % of the face seen, {:.2} mm mean distance to the scan, {:.1} mm expected error",
            arguments.output.display(),
            100.0 * r.face_coverage,
            r.surface_distance_mean_mm,
            r.expected_error_mm,
        )),
        None => output::note(&format!(
            "{}: was a subject already",
            arguments.scan.display()
        )),
    }
    Ok(DONE)
}
