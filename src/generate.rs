//! A whole run: plan, work, write; resumable, the same bytes for any number of threads.
//!
//! Subjects are taken in batches that bound the memory: the people of a batch are prepared in parallel, then the
//! groups of the batch are worked on in parallel, each by one thread from equilibrium to files. What fails is noted and
//! the rest goes on; only a folder that cannot be written ends the run.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use rayon::prelude::*;

use crate::Error;
use crate::pipeline::{Person, Pipeline, Worker};
use crate::plan::Grid;
use crate::recipe::Recipe;
use crate::write::{self, Failure, Folder, Journal, Manifest};

/// How to run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Folder to write; `None` takes the recipe's.
    pub output: Option<PathBuf>,
    /// Number of threads; `None` uses every processor.
    pub jobs: Option<usize>,
    /// Only the first so many samples.
    pub limit: Option<u64>,
    /// Replace the dataset of another recipe.
    pub overwrite: bool,
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

    /// Something the user should know.
    fn notice(&self, message: &str) {
        let _ = message;
    }

    /// Whether to stop: groups in hand are finished, no others begun.
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
    let pipeline = Arc::new(Pipeline::new(recipe.clone())?);
    let output = options.output.as_ref().unwrap_or(&recipe.output);
    let run = Run::new(&pipeline, output.clone(), options, watch);
    if !options.overwrite && run.is_finished() {
        watch.begin(run.samples, run.samples);
        return Ok(Summary {
            kept: run.samples,
            samples: run.samples,
            output: run.output,
            made: 0,
            failures: Vec::new(),
            interrupted: false,
        });
    }
    let manifest = Manifest::new(&recipe.name, pipeline.recipe_hash(), run.grid.len());
    let folder = Folder::open(output, manifest, options.overwrite)?;
    let threads = options.jobs.unwrap_or(0);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::Threads {
            threads,
            reason: e.to_string(),
        })?;
    pool.install(|| run.work(&folder))
}

struct Run<'a> {
    pipeline: &'a Arc<Pipeline>,
    grid: Grid,
    output: PathBuf,
    samples: u64,
    watch: &'a dyn Watch,
    made: AtomicU64,
    failures: Mutex<Vec<Failure>>,
}

impl<'a> Run<'a> {
    fn new(
        pipeline: &'a Arc<Pipeline>,
        output: PathBuf,
        options: &Options,
        watch: &'a dyn Watch,
    ) -> Self {
        let grid = Grid::of(pipeline.recipe());
        Self {
            pipeline,
            grid,
            output,
            samples: options.limit.unwrap_or(u64::MAX).min(grid.len()),
            watch,
            made: AtomicU64::new(0),
            failures: Mutex::new(Vec::new()),
        }
    }

    fn is_finished(&self) -> bool {
        write::finished(&self.output, self.pipeline.recipe_hash()).is_some()
    }

    /// Samples of a group within the run's limit.
    fn samples_of(&self, group: u64) -> std::ops::Range<u64> {
        let samples = self.grid.group_samples(group);
        samples.start..samples.end.min(self.samples)
    }

    fn work(&self, folder: &Folder) -> Result<Summary, Error> {
        let groups = self.samples.div_ceil(self.grid.group_len());
        let size = |group: u64| self.samples_of(group).count() as u64;
        let is_done = |group: u64| {
            folder
                .finished_group(group)
                .is_some_and(|journal| journal.records.len() as u64 >= size(group))
        };
        let todo: Vec<u64> = (0..groups)
            .into_par_iter()
            .filter(|g| !is_done(*g))
            .collect();
        let missing: u64 = todo.iter().map(|g| size(*g)).sum();
        let kept = self.samples - missing;
        self.watch.begin(self.samples, kept);
        let by_subject: Vec<&[u64]> = todo
            .chunk_by(|a, b| self.grid.group_factors(*a).0 == self.grid.group_factors(*b).0)
            .collect();
        let batch = 2 * rayon::current_num_threads();
        for subjects in by_subject.chunks(batch) {
            if self.watch.stops() {
                break;
            }
            self.batch(folder, subjects)?;
        }
        let mut failures = self
            .failures
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        failures.sort();
        let records = folder.finish(groups, failures.clone())?;
        let failed: u64 = failures.iter().map(|f| f.samples).sum();
        Ok(Summary {
            output: self.output.clone(),
            samples: self.samples,
            kept,
            made: self.made.load(Ordering::Relaxed),
            failures,
            interrupted: records + failed < self.samples,
        })
    }

    /// Works on all groups of some subjects.
    fn batch(&self, folder: &Folder, subjects: &[&[u64]]) -> Result<(), Error> {
        let people: Vec<Option<Arc<Person>>> = subjects
            .par_iter()
            .map(|groups| self.person(groups))
            .collect();
        let tasks: Vec<(&Arc<Person>, u64)> = people
            .iter()
            .zip(subjects)
            .filter_map(|(person, groups)| person.as_ref().map(|p| (p, groups)))
            .flat_map(|(person, groups)| groups.iter().map(move |g| (person, *g)))
            .collect();
        tasks
            .par_iter()
            .with_max_len(1)
            .try_for_each(|(person, group)| self.group(folder, person, *group))
    }

    /// Prepares the subject of some groups, or notes why it cannot be.
    fn person(&self, groups: &[u64]) -> Option<Arc<Person>> {
        let (subject, _) = self.grid.group_factors(*groups.first()?);
        if self.watch.stops() {
            return None;
        }
        match self.pipeline.person(subject) {
            Ok(person) => {
                for notice in &person.notices {
                    self.watch.notice(notice);
                }
                Some(Arc::new(person))
            }
            Err(e) => {
                let id = self.pipeline.subject_id(subject);
                self.watch
                    .notice(&format!("subject `{id}` is left out: {e}"));
                let first = self.samples_of(groups[0]).start;
                let samples = groups
                    .iter()
                    .map(|g| self.samples_of(*g).count() as u64)
                    .sum();
                self.fail(Failure {
                    first,
                    samples,
                    subject: id,
                    expression: None,
                    reason: e.to_string(),
                });
                None
            }
        }
    }

    /// Makes and writes the samples of one group. Only a folder that cannot be written is an error.
    fn group(&self, folder: &Folder, person: &Arc<Person>, group: u64) -> Result<(), Error> {
        if self.watch.stops() {
            return Ok(());
        }
        let samples = self.samples_of(group);
        let mut worker = Worker::new(self.pipeline.clone());
        worker.set_person(self.grid.group_factors(group).0, person.clone());
        let mut journal = Journal::default();
        for index in samples.clone() {
            let sample = match worker.sample(index) {
                Ok(sample) => sample,
                Err(e) => {
                    let expression = self.grid.group_factors(group).1;
                    let failure = Failure {
                        first: samples.start,
                        samples: samples.end - samples.start,
                        subject: person.subject.id.clone(),
                        expression: Some(self.pipeline.expression_label(expression)),
                        reason: e.to_string(),
                    };
                    self.watch.notice(&format!(
                        "subject `{}`, expression {}: {e}",
                        failure.subject,
                        failure.expression.as_deref().unwrap_or_default()
                    ));
                    self.fail(failure);
                    return Ok(());
                }
            };
            for file in write::encode_sample(&sample, &self.pipeline.recipe().image)? {
                journal.files.push(folder.write(&file.name, &file.bytes)?);
            }
            journal.records.push(sample.record.to_json());
            self.watch.advance(1);
        }
        folder.finish_group(group, &journal)?;
        self.made
            .fetch_add(samples.end - samples.start, Ordering::Relaxed);
        Ok(())
    }

    fn fail(&self, failure: Failure) {
        self.failures
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(failure);
    }
}
