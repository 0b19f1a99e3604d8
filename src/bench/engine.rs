//! `facile bench gen`: images a second by size, threads and what neighbours share; `facile bench savings`: what is not done.

use std::path::Path;
use std::time::Instant;

use super::{Axis, Curve, Effort, Findings, Plot, Table, median};
use crate::Error;
use crate::generate::{Options, Unwatched, generate};
use crate::pipeline::Skips;
use crate::recipe::Recipe;
use crate::verify::verify;

/// A recipe whose factors share what the paper's example shares: sampled subjects, moved faces, several views and lights.
fn recipe(case: &Case) -> Result<Recipe, Error> {
    let yaws: Vec<String> = (0..case.views)
        .map(|k| {
            format!(
                "{}",
                -40.0 + 80.0 * (f64::from(k) + 0.5) / f64::from(case.views)
            )
        })
        .collect();
    let lights: Vec<String> = (0..case.lights)
        .map(|k| {
            let x = -500 + 200 * i64::from(k);
            format!(
                "[[light]]\nname = \"l{k}\"\nsources = [{{ kind = \"point\", position = [{x}, 250, 700] }}, \
                 {{ kind = \"ambient\", intensity = 0.2 }}]\n"
            )
        })
        .collect();
    let lights = lights.concat();
    let (subjects, blink) = match case.people {
        People::Sampled => (format!("sampled = {}", case.subjects), ""),
        People::ScannedAndBlinking => (
            "builtin = [\"emi\"]".to_owned(),
            "[[expression]]\nname = \"blink\"\n",
        ),
    };
    let text = format!(
        "[dataset]\nname = \"bench\"\nseed = 1\n[image]\nsize = [{0}, {0}]\nsamples = 1\n\
         truth = [\"landmarks\", \"segments\", \"depth\"]\n[subjects]\n{1}\n\
         [[expression]]\nname = \"neutral\"\n[[expression]]\nname = \"smile\"\nintensities = [0.5, 1.0]\n\
         {blink}{lights}[[view]]\nyaw_deg = [{2}]\n[[occluder]]\nkind = \"none\"\n[[occluder]]\nkind = \"glasses\"\n",
        case.size,
        subjects,
        yaws.join(", "),
    );
    Recipe::parse(&text, Path::new("bench"), Path::new(""))
}

/// Whom a run shows.
#[derive(Clone, Copy)]
enum People {
    /// As many drawn identities as the case says.
    Sampled,
    /// One scan, whose face also blinks: every saving has something to save.
    ScannedAndBlinking,
}

/// One run.
#[derive(Clone, Copy)]
struct Case {
    size: u32,
    threads: usize,
    people: People,
    subjects: u32,
    views: u32,
    lights: u32,
}

const BASE: Case = Case {
    size: 256,
    threads: 1,
    people: People::Sampled,
    subjects: 2,
    views: 9,
    lights: 5,
};

/// Measures whole runs, verified, in a scratch folder.
///
/// # Errors
/// [`Error::Io`] if the scratch folder cannot be written.
pub fn engine(effort: Effort) -> Result<Findings, Error> {
    let mut table = Table::new(&[
        "size_px",
        "threads",
        "subjects",
        "views",
        "lights",
        "images",
        "seconds",
        "images_per_s",
    ]);
    let all = std::thread::available_parallelism().map_or(1, usize::from);
    let small = Case {
        subjects: 1,
        views: 3,
        lights: 2,
        ..BASE
    };
    let mut cases: Vec<Case> = effort.of(vec![small], vec![BASE]);
    if effort == Effort::Full {
        cases.extend([24, 64, 128, 512].map(|size| Case { size, ..BASE }));
        cases.extend([2, all].map(|threads| Case { threads, ..BASE }));
        // Ten times as many of each
        cases.push(Case {
            subjects: 10 * BASE.subjects,
            ..BASE
        });
        cases.push(Case {
            views: 10 * BASE.views,
            ..BASE
        });
        cases.push(Case {
            lights: 10 * BASE.lights,
            ..BASE
        });
        cases.push(Case { lights: 1, ..BASE });
    }
    let mut by_size = Vec::new();
    for case in cases {
        let (images, seconds) = measure(&case, effort.of(1, 3), Skips::default())?;
        let rate = images as f64 / seconds;
        table.push(vec![
            f64::from(case.size).into(),
            (case.threads as f64).into(),
            f64::from(case.subjects).into(),
            f64::from(case.views).into(),
            f64::from(case.lights).into(),
            (images as f64).into(),
            seconds.into(),
            rate.into(),
        ]);
        let rest = (case.threads, case.subjects, case.views, case.lights);
        if rest == (1, BASE.subjects, BASE.views, BASE.lights) {
            by_size.push((f64::from(case.size), rate));
        }
    }
    by_size.sort_by(|a, b| a.0.total_cmp(&b.0));
    let plot = Plot {
        title: "images a second, one thread, start to verified end".to_owned(),
        x: Axis::logarithmic("width and height, px"),
        y: Axis::logarithmic("images a second"),
        curves: vec![Curve {
            name: "1 sample, landmarks, segments, depth".to_owned(),
            points: by_size,
        }],
    };
    Ok(Findings {
        tables: vec![("gen_rate", table)],
        plots: vec![("gen_rate", plot)],
    })
}

/// What each saving saves: the same run with all of them, and without one.
///
/// # Errors
/// As [`engine`].
pub fn savings(effort: Effort) -> Result<Findings, Error> {
    let mut table = Table::new(&[
        "saving",
        "images",
        "seconds_with",
        "seconds_without",
        "ratio",
    ]);
    let case = Case {
        size: effort.of(64, 256),
        people: People::ScannedAndBlinking,
        subjects: 1,
        views: effort.of(1, 3),
        lights: effort.of(2, 5),
        ..BASE
    };
    for (name, without) in Skips::each_off() {
        // Side by side, so that what else the machine does touches both.
        let (mut with, mut less) = (Vec::new(), Vec::new());
        let mut images = 0;
        for _ in 0..effort.of(1, 3) {
            let (n, seconds) = measure(&case, 1, without.with(name))?;
            with.push(seconds);
            less.push(measure(&case, 1, without)?.1);
            images = n;
        }
        let (with, less) = (median(with), median(less));
        table.push(vec![
            name.into(),
            (images as f64).into(),
            with.into(),
            less.into(),
            (less / with).into(),
        ]);
    }
    Ok(Findings {
        tables: vec![("gen_savings", table)],
        plots: Vec::new(),
    })
}

/// Number of images, and the median time from start to verified end.
fn measure(case: &Case, repeats: usize, skips: Skips) -> Result<(u64, f64), Error> {
    let recipe = recipe(case)?;
    let mut times = Vec::new();
    let mut images = 0;
    for _ in 0..repeats {
        let scratch = tempfile::tempdir().map_err(|e| Error::io(Path::new("scratch folder"), e))?;
        let output = scratch.path().join("out");
        let options = Options {
            output: Some(output.clone()),
            jobs: Some(case.threads),
            skips,
            ..Options::default()
        };
        let start = Instant::now();
        let summary = generate(&recipe, &options, &Unwatched)?;
        let verdict = verify(&output)?;
        times.push(start.elapsed().as_secs_f64());
        images = summary.made;
        if let Some(bad) = verdict.bad.into_iter().next() {
            let (path, reason) = (bad.path, bad.reason);
            return Err(Error::Dataset { path, reason });
        }
    }
    Ok((images, median(times)))
}
