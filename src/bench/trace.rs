//! `facile bench trace`: error against time of the tracer on a scene file, and what a frame costs by what is in it.

use std::path::Path;

use facile_core::io::{decode_texture, read_file};
use facile_trace::{bench_scene_cost, bench_scene_file};

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
    let mut found = cost(scene, effort)?;
    found.tables.insert(0, ("trace_work_precision", table));
    found.plots.insert(0, ("trace_work_precision", plot));
    Ok(found)
}

/// What a frame costs by triangles, pixels, lights, labels, and by when rays are cut.
fn cost(scene: &Path, effort: Effort) -> Result<Findings, Error> {
    let rows = bench_scene_cost(scene, effort.of(1, 15))?;
    let mut table = Table::new(&["curve", "value", "label", "ms", "min_ms", "max_ms", "rmse"]);
    let mut plots = Vec::new();
    for (curve, name, label) in [
        ("triangles", "trace_triangles", "triangles"),
        ("pixels", "trace_pixels", "pixels along a side of the image"),
        ("lights", "trace_lights", "point lights"),
    ] {
        let own = rows.iter().filter(|r| r.curve == curve);
        let points: Vec<(f64, f64)> = own.map(|r| (r.value, r.ms.median)).collect();
        if points.is_empty() {
            continue;
        }
        let axis = if curve == "lights" {
            Axis::linear
        } else {
            Axis::logarithmic
        };
        let plot = Plot {
            title: format!("time of a frame of one sample against {label}, one thread"),
            x: axis(label),
            y: axis("ms a frame"),
            curves: vec![Curve {
                name: curve.to_owned(),
                points,
            }],
        };
        plots.push((name, plot));
    }
    for row in rows {
        table.push(vec![
            row.curve.into(),
            row.value.into(),
            row.label.into(),
            row.ms.median.into(),
            row.ms.min.into(),
            row.ms.max.into(),
            row.rmse.into(),
        ]);
    }
    Ok(Findings {
        tables: vec![("trace_cost", table)],
        plots,
    })
}
