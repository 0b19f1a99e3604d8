//! A whole run: plan, work, write; resumable, the same bytes for any number of threads and any cut into parts.
//!
//! Threads take *chunks* of consecutive samples in order ([`Units`]) and make each from equilibrium to files; the unit a
//! chunk belongs to stores its samples in order and appears as a whole. What fails is noted and the rest goes on; only a
//! folder that cannot be written ends the run.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::Error;
use crate::pipeline::{Clock, Pipeline, Skips, Work, Worker};
use crate::plan::Grid;
use crate::recipe::{ImageSettings, Recipe};
use crate::report::{Effort, write_report};
use crate::units::{Part, Units};
use crate::write::{self, Encoder, Failure, Folder, Manifest, UnitWriter};

use assembly::Assembly;
use people::{People, Prepared};

mod assembly;
mod people;

/// How to run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Folder to write; `None` takes the recipe's.
    pub output: Option<PathBuf>,
    /// Number of threads; `None` uses every processor.
    pub jobs: Option<usize>,
    /// Only the first so many samples.
    pub limit: Option<u64>,
    /// Only this part of the samples, in a folder of its own; see [`write::merge`].
    pub part: Option<Part>,
    /// Replace the dataset of another recipe.
    pub overwrite: bool,
    /// Begin nothing more once more samples than this have failed; what is in hand is finished, as on Ctrl-C.
    pub max_failures: Option<u64>,
    /// Memory that the run may take, bytes; `None` for [`MEMORY`]. With less there are fewer threads, and threads that are
    /// ahead of the writers wait earlier. One thread works in any case.
    pub memory: Option<u64>,
    /// File for a report of the run, HTML; see [`crate::report`].
    pub report: Option<PathBuf>,
    /// What is not done; all of it changes no byte.
    pub skips: Skips,
}

impl Options {
    /// The folder that is written: the given one or the recipe's, with the part's number after its name.
    pub fn folder(&self, recipe: &Recipe) -> PathBuf {
        if let Some(output) = &self.output {
            return output.clone();
        }
        let mut name = recipe.output.clone().into_os_string();
        if let Some(part) = self.part {
            name.push(format!("-{}-of-{}", part.index(), part.count()));
        }
        name.into()
    }
}

/// Memory that a run takes at most if nothing else is asked for, bytes.
pub const MEMORY: u64 = 2 << 30;
/// What a process takes before its first thread begins, what a thread takes, and what it takes for each pixel. Measured:
/// 70 MB, 30 MB, and 75 bytes with one sample a pixel, 130 with adaptive ones, hair and shirt.
const PROCESS_BYTES: u64 = 96 << 20;
const THREAD_BYTES: u64 = 48 << 20;
const PIXEL_BYTES: u64 = 150;
/// Bytes of samples that may wait for those before them, per unit: not less, and not more than is of use.
const WAITING_BYTES: std::ops::RangeInclusive<u64> = 4 << 20..=64 << 20;

/// How much of its memory a run uses for what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shares {
    threads: usize,
    /// Bytes of samples that may wait for those before them, per unit.
    waiting: u64,
}

impl Shares {
    /// For `threads` threads, or as many as there is memory for.
    fn of(memory: u64, threads: usize, image: &ImageSettings) -> Self {
        let pixels = u64::from(image.width) * u64::from(image.height);
        let thread = THREAD_BYTES + PIXEL_BYTES * pixels + WAITING_BYTES.start();
        let free = memory.saturating_sub(PROCESS_BYTES);
        let threads = threads.min((free / thread) as usize).max(1);
        // As many units are in the making as there are threads, or one more.
        let left = free.saturating_sub(threads as u64 * (thread - WAITING_BYTES.start()));
        let waiting = left / (threads as u64 + 1);
        Self {
            threads,
            waiting: waiting.clamp(*WAITING_BYTES.start(), *WAITING_BYTES.end()),
        }
    }
}

/// Hears of a run's progress, from any thread.
pub trait Watch: Sync {
    /// The run begins: `total` samples, of which `done` are there already.
    fn begin(&self, total: u64, done: u64) {
        let _ = (total, done);
    }

    /// So many samples more are finished.
    fn advance(&self, samples: u64) {
        let _ = samples;
    }

    /// Where the time went so far, and how many samples have failed. Called often.
    fn busy(&self, clock: &Clock, failed: u64) {
        let _ = (clock, failed);
    }

    /// Something the user should know.
    fn notice(&self, message: &str) {
        let _ = message;
    }

    /// Whether to stop: units in hand are finished, no others begun.
    fn stops(&self) -> bool {
        false
    }
}

/// Watches nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwatched;

impl Watch for Unwatched {}

/// What a run did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// The folder.
    pub output: PathBuf,
    /// Samples that were asked for.
    pub samples: u64,
    /// Samples that were there before.
    pub kept: u64,
    /// Samples that this run made.
    pub made: u64,
    /// What could not be made.
    pub failures: Vec<Failure>,
    /// Whether the run was stopped before its end.
    pub interrupted: bool,
    /// Whether that was because of [`Options::max_failures`].
    pub gave_up: bool,
    /// Where the time went.
    pub effort: Effort,
}

impl Summary {
    /// The summary as JSON.
    pub fn to_json(&self) -> String {
        serde_json::json!({
            "output": self.output.to_string_lossy(),
            "samples": self.samples,
            "kept": self.kept,
            "made": self.made,
            "failures": self.failures,
            "interrupted": self.interrupted,
            "gave_up": self.gave_up,
            "effort": self.effort,
        })
        .to_string()
    }
}

/// Makes a dataset, or what is missing of it.
///
/// # Errors
/// [`Error::Occupied`] and [`Error::Locked`] for a folder that cannot be used, [`Error::Io`] if it cannot be written.
/// Bad scans and faces that find no equilibrium are in [`Summary::failures`].
pub fn generate(recipe: &Recipe, options: &Options, watch: &dyn Watch) -> Result<Summary, Error> {
    let begun = Instant::now();
    let pipeline = Arc::new(Pipeline::with(recipe.clone(), options.skips)?);
    let asked = match options.jobs.unwrap_or(0) {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        n => n,
    };
    let memory = options.memory.unwrap_or(MEMORY);
    let shares = Shares::of(memory, asked, &recipe.image);
    if shares.threads < asked {
        watch.notice(&format!(
            "{} threads instead of {asked}: {} MB of memory do not hold more",
            shares.threads,
            memory >> 20
        ));
    }
    let mut summary = made(&pipeline, options, shares, watch)?;
    summary.effort = Effort::of(&pipeline, begun.elapsed(), shares.threads);
    if let Some(path) = &options.report {
        write_report(path, &pipeline, &summary)?;
    }
    Ok(summary)
}

fn made(
    pipeline: &Arc<Pipeline>,
    options: &Options,
    shares: Shares,
    watch: &dyn Watch,
) -> Result<Summary, Error> {
    let recipe = pipeline.recipe();
    let part = options.part;
    let output = options.folder(recipe);
    let all = Grid::of(recipe).len();
    let units = Units::of(recipe, options.limit.unwrap_or(all));
    if let Some(manifest) = write::finished(&output, pipeline.recipe_hash())
        && part.is_none()
        && !options.overwrite
    {
        watch.begin(manifest.samples, manifest.samples);
        return Ok(Summary {
            output,
            samples: manifest.samples,
            kept: manifest.samples,
            made: 0,
            failures: manifest.failures,
            interrupted: false,
            gave_up: false,
            effort: Effort::default(),
        });
    }
    let manifest = Manifest::new(recipe, pipeline.recipe_hash(), part);
    let folder = Folder::open(&output, manifest, options.overwrite)?;
    let max_failures = options.max_failures.unwrap_or(u64::MAX);
    Run::begin(pipeline, &folder, units, part, shares, max_failures, watch)?.work()
}

/// Runs what may only fail with an error, and makes one of a panic: a bug in one sample must not end a night's run.
fn caught<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or_else(|cause| {
        let text = cause.downcast_ref::<&str>().map(|s| (*s).to_owned());
        let text = text.or_else(|| cause.downcast_ref::<String>().cloned());
        Err(Error::Internal {
            reason: text.unwrap_or_default(),
        })
    })
}

/// Does some work on this thread, its inner loops on so many threads, this one among them.
pub(crate) fn on_threads<T>(threads: usize, work: impl FnOnce() -> T) -> Result<T, Error> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .use_current_thread()
        .build();
    let _pool = pool.map_err(|e| Error::Threads {
        threads,
        reason: e.to_string(),
    })?;
    Ok(work())
}

/// A chunk of a unit, to be made by one thread.
struct Task<'a> {
    assembly: Arc<Assembly<'a>>,
    chunk: usize,
    samples: std::ops::Range<u64>,
}

struct Run<'a> {
    pipeline: &'a Arc<Pipeline>,
    folder: &'a Folder,
    grid: Grid,
    units: Units,
    /// Number of samples that this run is for.
    samples: u64,
    kept: u64,
    people: People<'a>,
    queue: Mutex<Queue<'a>>,
    watch: &'a dyn Watch,
    made: AtomicU64,
    failed: AtomicU64,
    max_failures: u64,
    shares: Shares,
    /// Whether the folder could not be written.
    is_broken: AtomicBool,
}

/// What is still to be done.
struct Queue<'a> {
    units: VecDeque<u64>,
    /// Chunks of the unit that was begun last.
    tasks: VecDeque<Task<'a>>,
    /// First subject of what each thread works on.
    subjects: BTreeMap<usize, u64>,
}

impl<'a> Run<'a> {
    fn begin(
        pipeline: &'a Arc<Pipeline>,
        folder: &'a Folder,
        units: Units,
        part: Option<Part>,
        shares: Shares,
        max_failures: u64,
        watch: &'a dyn Watch,
    ) -> Result<Self, Error> {
        let grid = Grid::of(pipeline.recipe());
        let share = units.of_part(part);
        let finished: BTreeMap<u64, u64> = folder.finished_units()?.into_iter().collect();
        let size = |unit: u64| units.samples(unit).count() as u64;
        let is_done = |unit: &u64| finished.get(unit).is_some_and(|n| *n >= size(*unit));
        let todo: VecDeque<u64> = share.clone().filter(|u| !is_done(u)).collect();
        let samples = units.samples(share.end).start - units.samples(share.start).start;
        let kept = samples - todo.iter().map(|u| size(*u)).sum::<u64>();
        watch.begin(samples, kept);
        let last = todo.back().map_or(0, |u| units.samples(*u).end);
        let end = last.div_ceil(grid.group_len() * grid.expressions);
        Ok(Self {
            pipeline,
            folder,
            grid,
            units,
            samples,
            kept,
            people: People::new(pipeline, shares.threads as u64, end),
            queue: Mutex::new(Queue {
                units: todo,
                tasks: VecDeque::new(),
                subjects: BTreeMap::new(),
            }),
            watch,
            made: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            max_failures,
            shares,
            is_broken: AtomicBool::new(false),
        })
    }

    fn work(&self) -> Result<Summary, Error> {
        // Where there are fewer chunks than threads the others help inside
        let threads = self.shares.threads;
        let units = self.queue().units.clone();
        let chunks = units
            .iter()
            .take(threads)
            .map(|u| self.units.chunks(*u).len());
        let workers = threads.min(chunks.sum()).max(1);
        let results: Vec<Result<(), Error>> = std::thread::scope(|scope| {
            let spawned: Vec<_> = (0..workers)
                .map(|thread| scope.spawn(move || self.thread(thread, threads / workers)))
                .collect();
            let joined = spawned.into_iter().map(std::thread::ScopedJoinHandle::join);
            joined
                .map(|r| r.unwrap_or_else(|cause| std::panic::resume_unwind(cause)))
                .collect()
        });
        results.into_iter().collect::<Result<(), Error>>()?;
        let is_left = !self.queue().units.is_empty();
        let manifest = self.folder.finish()?;
        Ok(Summary {
            output: self.folder.root().to_owned(),
            samples: self.samples,
            kept: self.kept,
            made: self.made.load(Ordering::Relaxed),
            failures: manifest.failures,
            interrupted: is_left,
            gave_up: is_left && self.gives_up(),
            effort: Effort::default(),
        })
    }

    /// Works on chunks until none is left, with inner loops on `inner` threads.
    fn thread(&self, thread: usize, inner: usize) -> Result<(), Error> {
        let mut worker = Worker::new(self.pipeline.clone());
        let mut work = || -> Result<(), Error> {
            while let Some(task) = self.next(thread)? {
                self.chunk(&task, &mut worker)?;
            }
            Ok(())
        };
        // The others end after their chunks.
        let done = on_threads(inner, &mut work).and_then(|done| done);
        done.inspect_err(|_| self.is_broken.store(true, Ordering::Relaxed))
    }

    /// The next chunk in order. Begins units, unless the run is to stop.
    fn next(&self, thread: usize) -> Result<Option<Task<'a>>, Error> {
        if self.is_broken.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let mut queue = self.queue();
        while queue.tasks.is_empty() {
            if self.watch.stops() || self.gives_up() {
                return Ok(None);
            }
            let Some(unit) = queue.units.pop_front() else {
                return Ok(None);
            };
            let chunks = self.units.chunks(unit);
            let writer = UnitWriter::new(self.folder, unit)?;
            let assembly = Arc::new(Assembly::new(
                writer,
                chunks.len(),
                self.shares.waiting as usize,
            ));
            let tasks = chunks.into_iter().enumerate().map(|(chunk, samples)| Task {
                assembly: assembly.clone(),
                chunk,
                samples,
            });
            queue.tasks = tasks.collect();
        }
        let task = queue.tasks.pop_front();
        if let Some(task) = &task {
            let subject = self.grid.factors(task.samples.start).map(|f| f.subject);
            queue.subjects.insert(thread, subject.unwrap_or(0));
            let first = queue.subjects.values().min().copied().unwrap_or(0);
            self.people.forget_before(first);
        }
        Ok(task)
    }

    /// Makes and stores the samples of one chunk. Only a folder that cannot be written is an error.
    fn chunk(&self, task: &Task<'a>, worker: &mut Worker) -> Result<(), Error> {
        let mut encoder = Encoder::new(self.pipeline.recipe());
        let mut index = task.samples.start;
        while let Some(factors) = self
            .grid
            .factors(index)
            .filter(|_| index < task.samples.end)
        {
            let group = index / self.grid.group_len();
            let person = self.people.get(factors.subject, |s, p| self.heard(s, p));
            let person = match person {
                Ok(person) => person,
                Err(reason) => {
                    let end = self.grid.subject_samples(factors.subject).end;
                    let end = end.min(task.samples.end);
                    self.fail(task, index..end, false, &reason);
                    index = end;
                    continue;
                }
            };
            let subject = self.pipeline.recipe().subject_of_visit(factors.subject);
            worker.meet(subject, &person);
            let clock = self.pipeline.clock();
            let made = caught(|| {
                let sample = worker.sample(index)?;
                clock.time(Work::Encoding, || encoder.encode(&sample))
            });
            match made {
                Ok(sample) => {
                    clock.time(Work::Writing, || task.assembly.push(task.chunk, sample))?;
                    self.made.fetch_add(1, Ordering::Relaxed);
                    self.watch.advance(1);
                    self.watch.busy(clock, self.failed.load(Ordering::Relaxed));
                    index += 1;
                }
                Err(e) => {
                    // A face without equilibrium fails in all views.
                    let end = match e {
                        Error::Sim(_) => self.grid.group_samples(group).end.min(task.samples.end),
                        _ => index + 1,
                    };
                    *worker = Worker::new(self.pipeline.clone());
                    self.fail(task, index..end, true, &e.to_string());
                    index = end;
                }
            }
        }
        let clock = self.pipeline.clock();
        clock.time(Work::Writing, || task.assembly.close(task.chunk))
    }

    /// Whether more samples have failed than may.
    fn gives_up(&self) -> bool {
        self.failed.load(Ordering::Relaxed) > self.max_failures
    }

    /// Tells of a person who was prepared.
    fn heard(&self, subject: u64, person: &Prepared) {
        match person {
            Ok(person) => {
                for notice in &person.notices {
                    self.watch.notice(notice);
                }
            }
            Err(reason) => {
                let id = self.pipeline.subject_id(subject);
                let message = format!("subject `{id}` is left out: {reason}");
                self.watch.notice(&message);
            }
        }
    }

    fn fail(&self, task: &Task<'_>, samples: std::ops::Range<u64>, is_posed: bool, reason: &str) {
        let recipe = self.pipeline.recipe();
        let visit = self.grid.factors(samples.start).map_or(0, |f| f.subject);
        let subject = self.pipeline.subject_id(recipe.subject_of_visit(visit));
        // A subject that could not be made fails whatever its expression.
        let scene = recipe.scene(samples.start).ok().filter(|_| is_posed);
        let expression =
            scene.map(|s| format!("{} at {}", s.expression.name, s.expression.intensity));
        if let Some(expression) = &expression {
            let message = format!("subject `{subject}`, expression {expression}: {reason}");
            self.watch.notice(&message);
        }
        let count = samples.end - samples.start;
        self.failed.fetch_add(count, Ordering::Relaxed);
        self.watch.advance(count);
        task.assembly.fail(Failure {
            first: samples.start,
            samples: count,
            subject,
            expression,
            reason: reason.to_owned(),
        });
    }

    fn queue(&self) -> MutexGuard<'_, Queue<'a>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_decides_on_threads_and_on_what_may_wait() {
        let text = "[dataset]\nname = \"m\"\n[image]\nsize = [256, 256]\n[subjects]\nsampled = 1\n";
        let mut image = Recipe::parse(text, "m.toml".as_ref(), "".as_ref())
            .expect("valid")
            .image;
        let usual = Shares::of(MEMORY, 8, &image);
        assert_eq!((usual.threads, usual.waiting), (8, 64 << 20));
        let little = Shares::of(256 << 20, 8, &image);
        assert!(
            little.threads < 4 && little.waiting < 64 << 20,
            "{little:?}"
        );
        assert_eq!(Shares::of(0, 8, &image).threads, 1);
        (image.width, image.height) = (4096, 4096);
        assert_eq!(Shares::of(MEMORY, 8, &image).threads, 1);
    }
}
