//! `facile pose`

use std::path::PathBuf;

use facile::core::ReferenceHead;
use facile::pipeline::{PosedHead, Registrations, face_model};
use facile::sim::{Expression, ExpressionSet, MuscleSet, Pose, SimError};

use super::{DONE, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// A scan, a subject that `facile register` wrote, or builtin:NAME.
    subject: String,
    /// Contraction from 0 to 1 of a muscle, of one side with .left or .right; may be repeated.
    #[arg(long = "muscle", value_name = "NAME=C", value_parser = name_value)]
    muscles: Vec<(String, f64)>,
    /// Intensity from 0 to 1 of a FACS action unit; may be repeated.
    #[arg(long = "au", value_name = "AU=I", value_parser = name_value)]
    action_units: Vec<(String, f64)>,
    /// A built-in expression; muscles, action units, jaw and gaze add to it.
    #[arg(long, value_name = "NAME")]
    expression: Option<String>,
    /// Intensity from 0 to 1 of the whole.
    #[arg(long, value_name = "I", default_value_t = 1.0, value_parser = |t: &str| number(t, 0.0, 1.0))]
    intensity: f64,
    /// Opening of the jaw in degrees, 0 to 40.
    #[arg(long = "jaw", value_name = "DEG", default_value_t = 0.0, value_parser = |t: &str| number(t, 0.0, 40.0))]
    jaw_deg: f64,
    /// Gaze in degrees, each -40 to 40: towards the subject's left, upwards.
    #[arg(long = "gaze", value_name = "YAW,PITCH", allow_hyphen_values = true, value_parser = gaze)]
    gaze_deg: Option<[f64; 2]>,
    /// GLB to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// JSON report to write: pose, certificate, muscle lengths.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

/// A number in a range.
fn number(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(format!("must be from {low} to {high}"))
    }
}

fn gaze(text: &str) -> Result<[f64; 2], String> {
    let (yaw, pitch) = text.split_once(',').ok_or("expected YAW,PITCH")?;
    Ok([number(yaw, -40.0, 40.0)?, number(pitch, -40.0, 40.0)?])
}

fn name_value(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = value.parse().map_err(|e| format!("`{value}`: {e}"))?;
    Ok((name.to_owned(), value))
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let pose = pose(arguments)?;
    let registered = Registrations::new().named(&arguments.subject)?;
    for notice in &registered.notices {
        output::note(notice);
    }
    let (subject, reference) = (&registered.subject, ReferenceHead::embedded());
    let posed = PosedHead::solve(&face_model(subject)?, &pose)?;
    posed.save(&arguments.output, subject, reference)?;
    if let Some(path) = &arguments.report {
        let text = serde_json::to_string_pretty(&posed.report(subject))? + "\n";
        facile::core::io::write_file(path, text.as_bytes())?;
    }
    let certificate = &posed.equilibrium.certificate;
    output::note(&format!(
        "{}: {} iterations, residual {:.1e}, penetration {:.3} mm, {} inverted elements",
        arguments.output.display(),
        certificate.iterations,
        certificate.residual,
        certificate.max_penetration_mm,
        certificate.inverted_elements,
    ));
    Ok(DONE)
}

fn pose(arguments: &Arguments) -> Result<Pose, SimError> {
    let muscles = MuscleSet::embedded();
    let [gaze_yaw_deg, gaze_pitch_deg] = arguments.gaze_deg.unwrap_or_default();
    let mut pose = Expression {
        name: "command line".to_owned(),
        muscles: arguments.muscles.iter().cloned().collect(),
        action_units: arguments.action_units.iter().cloned().collect(),
        jaw_deg: arguments.jaw_deg,
        gaze_yaw_deg,
        gaze_pitch_deg,
        ..Expression::default()
    }
    .pose(muscles)?;
    if let Some(name) = &arguments.expression {
        pose = pose.combined(&ExpressionSet::embedded().get(name)?.pose(muscles)?);
    }
    Ok(pose.scaled(arguments.intensity))
}
