//! What a run will do and cost: counts from the grid, time and disk space from a few samples made for measure.

use std::sync::Arc;
use std::time::Instant;

use facile_sim::Solver;
use serde::Serialize;

use crate::Error;
use crate::pipeline::{Person, Pipeline, Worker};
use crate::plan::Grid;
use crate::recipe::{Recipe, SubjectSource};
use crate::write::Encoder;

/// Views that are made for measure, spread over the recipe's.
const MEASURED_VIEWS: u64 = 3;

/// What a run will do and cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Prediction {
    /// The recipe's name.
    pub name: String,
    /// Number of images.
    pub images: u64,
    /// The grid.
    pub grid: Grid,
    /// What is done once for several images, and what is not done at all.
    pub work: Work,
    /// What it costs; `None` if the measured subject could not be made.
    pub cost: Option<Cost>,
}

/// How often each stage runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Work {
    /// Scans to register.
    pub registrations: u64,
    /// Of these, how many are in the cache.
    pub cached_registrations: u64,
    /// Equilibria to solve.
    pub equilibria: u64,
    /// Faces at rest, which are not simulated.
    pub faces_at_rest: u64,
    /// Views to trace; each serves all lightings.
    pub traced_views: u64,
    /// Images to light and encode.
    pub lit_images: u64,
}

/// Predicted time and disk space.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cost {
    /// Number of threads that the prediction is for.
    pub threads: u64,
    /// Seconds from start to end.
    pub seconds: f64,
    /// Bytes on disk.
    pub bytes: f64,
    /// Seconds of one thread for registering one scan.
    pub registration_s: f64,
    /// Seconds of one thread for one equilibrium.
    pub equilibrium_s: f64,
    /// Seconds of one thread for tracing one view with its labels.
    pub view_s: f64,
    /// Seconds of one thread for lighting and encoding one image.
    pub image_s: f64,
}

/// Counts a recipe's work; with `measure`, makes a few samples to predict time and disk space.
///
/// # Errors
/// What [`Pipeline::new`] reports.
pub fn predict(recipe: &Recipe, threads: usize, measure: bool) -> Result<Prediction, Error> {
    let pipeline = Arc::new(Pipeline::new(recipe.clone())?);
    let grid = Grid::of(recipe);
    let moved = recipe
        .expressions
        .iter()
        .filter(|e| !e.pose.is_neutral())
        .count() as u64;
    let scans = (recipe.subjects.scans.len() + recipe.subjects.builtin.len()) as u64;
    let cached = (0..scans).filter(|i| pipeline.is_cached(*i)).count() as u64;
    let work = Work {
        registrations: scans,
        cached_registrations: cached,
        equilibria: grid.subjects * moved,
        faces_at_rest: grid.subjects * (grid.expressions - moved),
        traced_views: grid.groups() * grid.occluders * grid.views,
        lit_images: grid.len(),
    };
    let cost = if measure {
        measured(&pipeline, &grid, &work, threads).ok()
    } else {
        None
    };
    Ok(Prediction {
        name: recipe.name.clone(),
        images: grid.len(),
        grid,
        work,
        cost,
    })
}

/// Times every stage on the subject that is quickest to make.
fn measured(
    pipeline: &Arc<Pipeline>,
    grid: &Grid,
    work: &Work,
    threads: usize,
) -> Result<Cost, Error> {
    let missing = work.registrations - work.cached_registrations;
    // A registration that has to be done anyway is done now and kept.
    let is_missing = |i: &u64| *i < work.registrations && !pipeline.is_cached(*i);
    let subject = (0..work.registrations).find(is_missing).unwrap_or(0);
    let (person, person_s) = timed(|| pipeline.person(subject));
    let person = person?;
    let equilibrium_s = equilibrium_time(pipeline, &person)?;
    let is_scan = !matches!(
        pipeline.recipe().subjects.get(subject),
        SubjectSource::Sampled { .. }
    );
    let mut worker = Worker::new(pipeline.clone());
    worker.set_person(subject, Arc::new(person));
    let start = grid.group_samples(subject * grid.expressions).start;
    worker.sample(start)?;
    let (mut view_s, mut image_s, mut view_bytes, mut image_bytes) = (0.0, 0.0, 0.0, 0.0);
    let views = grid.occluders * grid.views;
    let measured = views.min(MEASURED_VIEWS);
    for k in 0..measured {
        let first = start + k * views / measured * grid.lightings;
        worker.forget_view();
        let (sample, both) = timed(|| worker.sample(first));
        let sample = sample?;
        let (encoded, encode) = timed(|| Encoder::new(pipeline.recipe()).encode(&sample));
        let encoded = encoded?;
        let (again, shade) = timed(|| worker.sample(first));
        again?;
        view_s += (both - shade).max(0.0);
        image_s += shade + encode;
        let json = encoded.record.len() + 300;
        image_bytes += (encoded.image.len() + json) as f64;
        view_bytes += encoded.maps.iter().map(|(_, m)| m.len()).sum::<usize>() as f64;
    }
    let n = measured as f64;
    let (view_s, image_s) = (view_s / n, image_s / n);
    let registration_s = if is_scan && missing > 0 {
        person_s
    } else {
        0.0
    };
    // The measured subject is in the cache by now.
    let to_register = missing.saturating_sub(1) as f64;
    let work_s = to_register * registration_s
        + work.equilibria as f64 * equilibrium_s
        + work.traced_views as f64 * view_s
        + work.lit_images as f64 * image_s;
    Ok(Cost {
        threads: threads as u64,
        seconds: work_s / threads as f64,
        bytes: (work.traced_views as f64 * view_bytes + work.lit_images as f64 * image_bytes) / n,
        registration_s,
        equilibrium_s,
        view_s,
        image_s,
    })
}

/// Mean time of the recipe's equilibria, from its first, middle and last moved expression.
fn equilibrium_time(pipeline: &Pipeline, person: &Person) -> Result<f64, Error> {
    let expressions = &pipeline.recipe().expressions;
    let moved: Vec<usize> = (0..expressions.len())
        .filter(|i| !expressions[*i].pose.is_neutral())
        .collect();
    let mut picks = vec![0, moved.len() / 2, moved.len().saturating_sub(1)];
    picks.dedup();
    let picks: Vec<usize> = picks
        .iter()
        .filter_map(|i| moved.get(*i).copied())
        .collect();
    let mut solver = Solver::new();
    let mut total = 0.0;
    for &expression in &picks {
        let (face, time) = timed(|| pipeline.face(person, expression, &mut solver));
        face?;
        total += time;
    }
    Ok(total / picks.len().max(1) as f64)
}

fn timed<T>(f: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let value = f();
    (value, start.elapsed().as_secs_f64())
}
