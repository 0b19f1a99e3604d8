//! `facile bench trace`: error against time of the tracer on a scene file.

use std::path::Path;

use facile_core::io::{decode_texture, read_file};
use facile_trace::bench_scene_file;

use super::{Axis, Curve, Effort, Findings, Plot, Table};
use crate::Error;

/// Measures the ways to render a scene. `reference`: an image of the same size; without one the scene itself with 256
/// samples a pixel is taken.
///
/// # Errors
/// [`Error::Trace`] for a scene that cannot be rendered, [`Error::Core`] for a reference that cannot be read.
pub fn trace(scene: &Path, reference: Option<&Path>, effort: Effort) -> Result<Findings, Error> {
    let reference = match reference {
        Some(path) => Some(decode_texture(&read_file(path)?, path)?),
        None => None,
    };
    let rows = bench_scene_file(scene, reference.as_ref(), effort.of(1, 9))?;
    let mut table = Table::new(&[
        "variant",
        "samples",
        "instructions",
        "ms",
        "min_ms",
        "max_ms",
        "rmse",
    ]);
    let mut frames = Vec::new();
    for row in rows {
        let samples = serde_json::to_value(row.samples).unwrap_or_default();
        let samples = samples
            .as_str()
            .map_or_else(|| samples.to_string(), str::to_owned);
        if row.variant == "frame" {
            frames.push((row.ms.median, row.rmse));
        }
        table.push(vec![
            row.variant.into(),
            samples.into(),
            row.instructions.into(),
            row.ms.median.into(),
            row.ms.min.into(),
            row.ms.max.into(),
            row.rmse.into(),
        ]);
    }
    let plot = Plot {
        title: "error of an image against the time of a frame, one thread".to_owned(),
        x: Axis::logarithmic("ms a frame"),
        y: Axis::logarithmic("RMSE of 8-bit values"),
        curves: vec![Curve {
            name: "samples per pixel".to_owned(),
            points: frames,
        }],
    };
    Ok(Findings {
        tables: vec![("trace_work_precision", table)],
        plots: vec![("trace_work_precision", plot)],
    })
}
