//! What a run will do and cost: counts from the plan, time and disk space from a few samples made for measure.
//!
//! The samples are made by as many threads at once as the run will have, so that what threads take from each other is
//! in the times, and stored in a scratch folder by the run's own writers.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::generate::on_threads;
use crate::pipeline::{Pipeline, Worker};
use crate::plan::Grid;
use crate::recipe::file::Format;
use crate::recipe::{Recipe, SubjectSource};
use crate::write::{EncodedSample, Encoder, Folder, Manifest, UnitWriter};

/// Groups that each thread makes for measure, spread over the expressions, and views of each.
const MEASURED_GROUPS: u64 = 4;
const MEASURED_VIEWS: u64 = 3;
/// Poses that are looked at to tell how many are at rest, where samples are drawn.
const PROBED_POSES: u64 = 2_000;

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
    /// What it costs; `None` if the measured subjects could not be made.
    pub cost: Option<Cost>,
}

/// How often each stage runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Work {
    /// Scans to register.
    pub registrations: u64,
    /// Of these, how many are in the cache.
    pub cached_registrations: u64,
    /// People to prepare: registered, read from the cache or drawn.
    pub people: u64,
    /// Equilibria to solve, those in the cache included. Where samples are drawn, estimated from some of them.
    pub equilibria: u64,
    /// Faces at rest, which are not simulated.
    pub faces_at_rest: u64,
    /// Views to trace; each serves all lightings.
    pub traced_views: u64,
    /// Images to light and encode.
    pub lit_images: u64,
}

/// Predicted time and disk space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Number of threads that the prediction is for.
    pub threads: u64,
    /// Seconds from start to end.
    pub seconds: f64,
    /// Bytes on disk.
    pub bytes: f64,
    /// Seconds of one thread, while the others work, for registering one scan.
    pub registration_s: f64,
    /// For preparing one person who is drawn or in the cache.
    pub person_s: f64,
    /// For one equilibrium with the scene of its face.
    pub equilibrium_s: f64,
    /// For the scene of one face at rest.
    pub rest_s: f64,
    /// For putting an occluder on a face.
    pub occluder_s: f64,
    /// For tracing one view with its labels.
    pub view_s: f64,
    /// For lighting and encoding one image.
    pub image_s: f64,
    /// For storing one image with its record.
    pub write_s: f64,
    /// Once, for the card, the contact sheet and the other files of a finished dataset.
    pub end_s: f64,
}

/// Counts a recipe's work; with `measure`, makes a few samples to predict time and disk space.
///
/// # Errors
/// What [`Pipeline::new`] reports.
pub fn predict(recipe: &Recipe, threads: usize, measure: bool) -> Result<Prediction, Error> {
    let (pipeline, start_s) = timed(|| Pipeline::new(recipe.clone()));
    let pipeline = Arc::new(pipeline?);
    let grid = Grid::of(recipe);
    let work = work(&pipeline, &grid);
    let cost = if measure {
        measured(&pipeline, &grid, &work, threads).ok()
    } else {
        None
    };
    let cost = cost.map(|cost| Cost {
        seconds: cost.seconds + start_s,
        ..cost
    });
    Ok(Prediction {
        name: recipe.name.clone(),
        images: grid.len(),
        grid,
        work,
        cost,
    })
}

fn work(pipeline: &Pipeline, grid: &Grid) -> Work {
    let recipe = pipeline.recipe();
    let is_moved = |group: u64| {
        let scene = recipe.scene(grid.group_samples(group).start);
        scene.is_ok_and(|s| !s.expression.pose.is_neutral())
    };
    let groups = grid.groups();
    // A grid has the same expressions for everyone.
    let looked_at = match recipe.sampling {
        Some(_) => groups.min(PROBED_POSES),
        None => grid.expressions,
    };
    let step = (groups / looked_at.max(1)).max(1);
    let step = if recipe.sampling.is_some() { step } else { 1 };
    let moved = (0..looked_at).filter(|k| is_moved(k * step)).count() as u64;
    let share = |n: u64, of: u64, all: u64| {
        (u128::from(n) * u128::from(of) / u128::from(all.max(1))) as u64
    };
    let equilibria = share(groups, moved, looked_at);
    let scans = (recipe.subjects.scans.len() + recipe.subjects.builtin.len()) as u64;
    let people = grid.subjects;
    // Visits come to everyone once before they come to anyone again.
    let registrations = share(
        scans,
        people.min(recipe.subjects.len()),
        recipe.subjects.len(),
    );
    let cached = (0..scans).filter(|i| pipeline.is_cached(*i)).count() as u64;
    Work {
        registrations,
        cached_registrations: cached.min(registrations),
        people,
        equilibria,
        faces_at_rest: groups - equilibria,
        traced_views: grid.len().div_ceil(grid.lightings),
        lit_images: grid.len(),
    }
}

/// What one thread measured: sums of seconds and their numbers.
#[derive(Default)]
struct Times {
    registration: Mean,
    person: Mean,
    equilibrium: Mean,
    rest: Mean,
    occluder: Mean,
    view: Mean,
    image: Mean,
    view_bytes: Mean,
    image_bytes: Mean,
    samples: Vec<EncodedSample>,
}

#[derive(Clone, Copy, Default)]
struct Mean {
    sum: f64,
    n: f64,
}

impl Mean {
    fn add(&mut self, v: f64) {
        self.sum += v.max(0.0);
        self.n += 1.0;
    }

    fn value(self) -> f64 {
        self.sum / f64::max(self.n, 1.0)
    }

    fn of(all: &[Times], get: impl Fn(&Times) -> Self) -> f64 {
        let (sum, n) = all
            .iter()
            .map(get)
            .fold((0.0, 0.0), |(s, n), m| (s + m.sum, n + m.n));
        Self { sum, n }.value()
    }
}

/// Times every stage in as many threads as the run will have.
fn measured(
    pipeline: &Arc<Pipeline>,
    grid: &Grid,
    work: &Work,
    threads: usize,
) -> Result<Cost, Error> {
    let all: Vec<Result<Times, Error>> = std::thread::scope(|scope| {
        let spawned: Vec<_> = (0..threads as u64)
            .map(|thread| {
                scope.spawn(move || on_threads(1, || thread_times(pipeline, grid, thread))?)
            })
            .collect();
        let joined = spawned.into_iter().map(std::thread::ScopedJoinHandle::join);
        joined
            .map(|r| r.unwrap_or_else(|cause| std::panic::resume_unwind(cause)))
            .collect()
    });
    let all = all.into_iter().collect::<Result<Vec<Times>, Error>>()?;
    let (write_s, end_s) = write_times(pipeline, &all)?;
    let mut cost = Cost {
        threads: threads as u64,
        registration_s: Mean::of(&all, |t| t.registration),
        person_s: Mean::of(&all, |t| t.person),
        equilibrium_s: Mean::of(&all, |t| t.equilibrium),
        rest_s: Mean::of(&all, |t| t.rest),
        occluder_s: Mean::of(&all, |t| t.occluder),
        view_s: Mean::of(&all, |t| t.view),
        image_s: Mean::of(&all, |t| t.image),
        write_s,
        end_s,
        ..Cost::default()
    };
    // What was registered for measure is in the cache now.
    let registered: f64 = all.iter().map(|t| t.registration.n).sum();
    let to_register = work.registrations.saturating_sub(work.cached_registrations) as f64;
    let seconds = (to_register - registered).max(0.0) * cost.registration_s
        + work.people as f64 * cost.person_s
        + work.equilibria as f64 * cost.equilibrium_s
        + work.faces_at_rest as f64 * cost.rest_s
        + (grid.groups() * grid.occluders) as f64 * cost.occluder_s
        + work.traced_views as f64 * cost.view_s
        + work.lit_images as f64 * (cost.image_s + cost.write_s);
    // Threads that have no group of their own share nothing.
    let useful = (threads as u64).min(grid.groups().max(1));
    cost.seconds = seconds / useful as f64 + cost.end_s;
    cost.bytes = work.traced_views as f64 * Mean::of(&all, |t| t.view_bytes)
        + work.lit_images as f64 * Mean::of(&all, |t| t.image_bytes);
    Ok(cost)
}

/// Makes some groups of one subject and times each stage.
fn thread_times(pipeline: &Arc<Pipeline>, grid: &Grid, thread: u64) -> Result<Times, Error> {
    let recipe = pipeline.recipe();
    let mut times = Times::default();
    let visit = thread * grid.subjects.saturating_sub(1) / 8;
    let subject = recipe.subject_of_visit(visit);
    let is_scan = !matches!(recipe.subjects.get(subject), SubjectSource::Sampled { .. });
    if is_scan && !pipeline.is_cached(subject) {
        let (person, time) = timed(|| pipeline.person(subject));
        person?;
        times.registration.add(time);
    }
    let (person, person_s) = timed(|| {
        let person = pipeline.person(subject)?;
        pipeline.make_model(&person)?;
        Ok::<_, Error>(Arc::new(person))
    });
    let person = person?;
    let mut worker = Worker::new(pipeline.clone());
    worker.set_person(subject, person.clone());
    let samples = grid.subject_samples(visit);
    let groups = (samples.end - samples.start).div_ceil(grid.group_len());
    let picks = groups.min(MEASURED_GROUPS);
    // The first face of a person costs a scene of its own, which the others share; trees are built once in a run.
    let (first, built_s) = timed(|| pipeline.head_scene(&person, None));
    let first = first?;
    let (scene, time) = timed(|| pipeline.head_scene(&person, Some(&first)));
    scene?;
    times.person.add(person_s + time);
    let mut head_s = built_s;
    for pick in 0..picks {
        let group = samples.start + (2 * pick + 1) * groups / (2 * picks) * grid.group_len();
        let is_moved = !recipe.scene(group)?.expression.pose.is_neutral();
        worker.forget_face();
        let (sample, whole) = timed(|| worker.sample(put_on(grid, group, pick)));
        sample?;
        // As in a run: an occluder is put on once for all its views, of which each has its own light here.
        let dressed = put_on(grid, group, pick + 1);
        worker.forget_view();
        let (sample, dressing) = timed(|| worker.sample(dressed));
        sample?;
        let mut encoder = Encoder::new(recipe);
        let (mut view, mut shading) = (Mean::default(), Mean::default());
        let views = grid.views.min(MEASURED_VIEWS);
        for k in 0..views {
            let light = (pick + k) % grid.lightings;
            let first = dressed + k * grid.views / views * grid.lightings + light;
            if first >= samples.end {
                break;
            }
            worker.forget_view();
            let (sample, both) = timed(|| worker.sample(first));
            sample?;
            let (again, shade) = timed(|| worker.sample(first));
            let (encoded, encode) = timed(|| encoder.encode(&again?));
            let encoded = encoded?;
            view.add(both - shade);
            shading.add(shade);
            times.image.add(shade + encode);
            let [by_view, by_image] = sizes(&encoded, recipe);
            times.view_bytes.add(by_view);
            times.image_bytes.add(by_image);
            times.samples.push(encoded);
        }
        let lit_view_s = view.value() + shading.value();
        let occluder_s = (dressing - lit_view_s).max(0.0);
        times.occluder.add(occluder_s);
        times.view.sum += view.sum;
        times.view.n += view.n;
        let face_s = whole - occluder_s - lit_view_s - head_s;
        head_s = 0.0;
        if is_moved {
            times.equilibrium.add(face_s);
        } else {
            times.rest.add(face_s);
        }
    }
    Ok(times)
}

/// The first sample of a group with its `nth` occluder; the group's first one where the last group ends before.
fn put_on(grid: &Grid, group: u64, nth: u64) -> u64 {
    let sample = group + nth % grid.occluders * grid.views * grid.lightings;
    if sample < grid.len() { sample } else { group }
}

/// Bytes on disk of a sample: those that a view has once, and those of every image.
fn sizes(sample: &EncodedSample, recipe: &Recipe) -> [f64; 2] {
    /// A line in the list of hashes.
    const LINE: usize = 85;
    /// Tar files are made of blocks, one of them before each member.
    const BLOCK: usize = 512;
    let record = sample.record.len();
    let sum = |maps: &[(&str, Vec<u8>)]| maps.iter().map(|(_, map)| map.len()).sum::<usize>();
    let (maps, lit_maps) = (sum(&sample.maps), sum(&sample.lit_maps));
    let (mut by_view, mut by_image) = (0, record);
    for format in &recipe.formats {
        match format {
            Format::Folder => {
                by_view += maps + LINE * sample.maps.len();
                let files = 1 + sample.lit_maps.len();
                by_image += sample.image.len() + lit_maps + LINE * files;
            }
            Format::Webdataset => {
                let member =
                    |(_, bytes): (String, &[u8])| bytes.len().next_multiple_of(BLOCK) + BLOCK;
                by_image += sample.members().map(member).sum::<usize>();
            }
            // Landmarks as numbers take about half of what they take as text.
            Format::Parquet => {
                by_image += sample.image.len() + maps + lit_maps + record + record / 2;
            }
        }
    }
    [by_view as f64, by_image as f64]
}

/// Seconds for storing one of the samples, and for what is written once at the end.
fn write_times(pipeline: &Pipeline, all: &[Times]) -> Result<(f64, f64), Error> {
    let scratch = tempfile::tempdir().map_err(|e| Error::io(Path::new("scratch folder"), e))?;
    let manifest = Manifest::new(pipeline.recipe(), pipeline.recipe_hash(), None);
    let folder = Folder::open(&scratch.path().join("out"), manifest, false)?;
    let samples: Vec<EncodedSample> = all.iter().flat_map(|t| t.samples.clone()).collect();
    let n = samples.len().max(1) as f64;
    let (stored, time) = timed(|| {
        let mut writer = UnitWriter::new(&folder, 0)?;
        for sample in samples {
            writer.append(sample)?;
        }
        writer.finish()
    });
    stored?;
    let (finished, end) = timed(|| folder.finish());
    finished?;
    Ok((time / n, end))
}

fn timed<T>(f: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let value = f();
    (value, start.elapsed().as_secs_f64())
}
