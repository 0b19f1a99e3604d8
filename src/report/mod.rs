//! The report of a run: one HTML file that needs nothing else, for people who ask where the time went and what failed.
//!
//! It holds times, so it is no part of the dataset, whose bytes are the same in every run.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::time::Duration;

use serde::Serialize;

use crate::Error;
use crate::generate::Summary;
use crate::pipeline::{Pipeline, Work, render_subject};
use crate::plan::Grid;
use crate::sheet::{SheetSettings, sheet};
use crate::write::{ANNOTATIONS, Tally, encode_rgb8};
use html::{Page, bars, data_uri};

mod html;

/// Failures that are shown with a picture of the subject.
const PICTURES: usize = 12;
/// Images on the report, and their width.
const SHOWN: usize = 48;
const SHOWN_PX: u32 = 96;

/// Where a run's time went, and what it did not have to do.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Effort {
    /// Wall time, milliseconds.
    pub wall_ms: u64,
    /// Number of threads.
    pub threads: u64,
    /// Milliseconds of all threads by stage.
    pub stages_ms: BTreeMap<&'static str, u64>,
    /// How often each stage was done.
    pub stages: BTreeMap<&'static str, u64>,
    /// Equilibria solved for, and taken from the cache.
    pub equilibria: [u64; 2],
    /// Scans registered, and taken from the cache.
    pub registrations: [u64; 2],
}

impl Effort {
    /// What a pipeline counted.
    pub(crate) fn of(pipeline: &Pipeline, wall: Duration, threads: usize) -> Self {
        let clock = pipeline.clock();
        let each = |i: usize, unit: u64| {
            let all = Work::ALL.iter();
            all.map(|(work, name)| (*name, clock.get(*work)[i] / unit))
                .collect()
        };
        Self {
            wall_ms: wall.as_millis() as u64,
            threads: threads as u64,
            stages_ms: each(0, 1_000_000),
            stages: each(1, 1),
            equilibria: pipeline.equilibrium_counts().get(),
            registrations: pipeline.registration_counts().get(),
        }
    }
}

/// Writes the report of a run.
///
/// # Errors
/// [`Error::Io`] if it cannot be written.
pub fn write_report(path: &Path, pipeline: &Pipeline, summary: &Summary) -> Result<(), Error> {
    let mut page = Page::new(&format!("Run of {}", pipeline.recipe().name));
    page.section("summary", "Summary", &overview(pipeline, summary));
    page.section("stages", "Time by stage", &stages(&summary.effort));
    page.section("caches", "Caches", &caches(&summary.effort));
    page.section("skips", "Not done", &skips(pipeline, summary));
    page.section("failures", "Failures", &failures(pipeline, summary));
    let tally = tally(&summary.output);
    let mut factors = String::new();
    for (name, counts) in tally.factors() {
        factors += &bars(&name, "images", &counts);
    }
    page.section("factors", "What the images show", &factors);
    let mut certificates = String::new();
    for (name, counts) in tally.certificates() {
        certificates += &bars(&name, "images", &counts);
    }
    if certificates.is_empty() {
        "<p>No face was simulated.</p>".clone_into(&mut certificates);
    }
    page.section("certificates", "How well equilibria are met", &certificates);
    page.section("images", "Images", &images(&summary.output));
    std::fs::write(path, page.end()).map_err(|e| Error::io(path, e))
}

fn table(rows: &[(&str, String)]) -> String {
    let row = |(name, value): &(&str, String)| {
        format!(
            "<tr><th>{}</th><td>{}</td></tr>",
            html::escaped(name),
            html::escaped(value)
        )
    };
    format!(
        "<table>{}</table>",
        rows.iter().map(row).collect::<String>()
    )
}

fn overview(pipeline: &Pipeline, summary: &Summary) -> String {
    let effort = &summary.effort;
    let failed: u64 = summary.failures.iter().map(|f| f.samples).sum();
    let seconds = effort.wall_ms as f64 / 1e3;
    table(&[
        ("program", format!("facile {}", env!("CARGO_PKG_VERSION"))),
        ("recipe", pipeline.recipe_hash().to_owned()),
        ("folder", summary.output.display().to_string()),
        ("samples", summary.samples.to_string()),
        ("there before", summary.kept.to_string()),
        ("made", summary.made.to_string()),
        ("failed", failed.to_string()),
        (
            "state",
            if summary.interrupted {
                "stopped before the end"
            } else {
                "done"
            }
            .to_owned(),
        ),
        (
            "wall time",
            format!("{seconds:.1} s on {} threads", effort.threads),
        ),
        (
            "rate",
            format!(
                "{:.1} images a second",
                summary.made as f64 / seconds.max(1e-3)
            ),
        ),
    ])
}

fn stages(effort: &Effort) -> String {
    let rows: Vec<(String, u64)> = Work::ALL
        .iter()
        .map(|(_, name)| {
            let times = effort.stages.get(name).copied().unwrap_or(0);
            (
                format!("{name} ({times})"),
                effort.stages_ms.get(name).copied().unwrap_or(0),
            )
        })
        .collect();
    bars("all threads together", "ms", &rows)
}

fn caches(effort: &Effort) -> String {
    let row = |[made, hits]: [u64; 2]| format!("{made} made, {hits} taken from the cache");
    table(&[
        ("equilibria", row(effort.equilibria)),
        ("registrations", row(effort.registrations)),
    ])
}

/// What was shared, and what nobody needed.
fn skips(pipeline: &Pipeline, summary: &Summary) -> String {
    let grid = Grid::of(pipeline.recipe());
    let [solved, cached] = summary.effort.equilibria;
    let times = |name| summary.effort.stages.get(name).copied().unwrap_or(0);
    let faces = times("equilibria");
    table(&[
        (
            "faces at rest, not simulated",
            faces.saturating_sub(solved + cached).to_string(),
        ),
        (
            "images that share the face of another",
            summary.made.saturating_sub(faces).to_string(),
        ),
        (
            "images that share the rays of another",
            summary.made.saturating_sub(times("tracing")).to_string(),
        ),
        (
            "samples of a group, a view",
            format!("{}, {}", grid.group_len(), grid.lightings),
        ),
    ])
}

fn failures(pipeline: &Pipeline, summary: &Summary) -> String {
    if summary.failures.is_empty() {
        return "<p>None.</p>".to_owned();
    }
    let mut rows = String::new();
    for (i, failure) in summary.failures.iter().enumerate() {
        // Whoever could be made at all is shown at rest.
        let picture = (i < PICTURES && failure.expression.is_some())
            .then(|| portrait(pipeline, failure.first))
            .flatten();
        let cells = [
            failure.first.to_string(),
            failure.samples.to_string(),
            failure.subject.clone(),
            failure.expression.clone().unwrap_or_default(),
            failure.reason.clone(),
        ];
        let mut row = String::new();
        for cell in cells {
            let _ = write!(row, "<td>{}</td>", html::escaped(&cell));
        }
        let picture = picture.map_or(String::new(), |png| {
            html::picture(&png, "the subject at rest")
        });
        let _ = write!(rows, "<tr><td>{picture}</td>{row}</tr>");
    }
    let heads = "<th></th><th>first sample</th><th>samples</th><th>subject</th><th>expression</th><th>reason</th>";
    format!("<table><tr>{heads}</tr>{rows}</table>")
}

/// The subject of a sample at rest, seen from the front, as PNG.
fn portrait(pipeline: &Pipeline, index: u64) -> Option<Vec<u8>> {
    let scene = pipeline.recipe().scene(index).ok()?;
    let person = pipeline.person(scene.subject).ok()?;
    let image = serde_json::json!({ "size": [SHOWN_PX, SHOWN_PX], "truth": [], "samples": 1 });
    let tables = BTreeMap::from([("image", image)]);
    encode_rgb8(&render_subject(&person.subject, &tables).ok()?.image).ok()
}

/// Counts of the records; empty if there are none yet.
fn tally(output: &Path) -> Tally {
    let mut tally = Tally::default();
    if let Ok(file) = File::open(output.join(ANNOTATIONS)) {
        for line in BufReader::new(file).lines().map_while(Result::ok) {
            tally.add(&line);
        }
    }
    tally
}

/// The first images of a dataset that stores them as files.
fn images(output: &Path) -> String {
    let settings = SheetSettings {
        columns: Some(12),
        cell: Some(SHOWN_PX),
        limit: SHOWN,
        ..SheetSettings::default()
    };
    let Ok(picture) = sheet(output, &settings) else {
        return "<p>The images are not stored as files of their own.</p>".to_owned();
    };
    let mut png = std::io::Cursor::new(Vec::new());
    match picture.write_to(&mut png, image::ImageFormat::Png) {
        Ok(()) => format!(
            "<img alt=\"first images\" src=\"{}\"/>",
            data_uri(&png.into_inner())
        ),
        Err(e) => format!("<p>{}</p>", html::escaped(&e.to_string())),
    }
}
