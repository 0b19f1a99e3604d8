//! `facile gen`

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use facile::generate::{Options, Summary, Watch, generate};
use facile::units::Part;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::{DONE, FAILED, INTERRUPTED, RecipeArgument, Refused, output};

/// Time between two lines of progress where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    recipe: RecipeArgument,
    /// Folder to write instead of the recipe's.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Number of threads; every processor if not given.
    #[arg(short, long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Only the first N samples.
    #[arg(long, value_name = "N")]
    limit: Option<u64>,
    /// Make only part I of N, in a folder of its own; `facile merge` puts parts together.
    #[arg(long, value_name = "I/N")]
    shard: Option<Part>,
    /// Replace the dataset of another recipe that the folder holds.
    #[arg(long)]
    overwrite: bool,
    /// Begin nothing more once more than N samples have failed.
    #[arg(long, value_name = "N")]
    max_failures: Option<u64>,
    /// Write a report of the run: times, caches, failures, histograms, pictures, in one HTML file.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Tell of progress and events as lines of JSON on standard error.
    #[arg(long, conflicts_with = "quiet")]
    log_json: bool,
    /// Say nothing but errors.
    #[arg(short, long)]
    quiet: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let recipe = arguments.recipe.load()?;
    let options = Options {
        output: arguments.output.clone(),
        jobs: arguments.jobs.map(usize::from),
        limit: arguments.limit,
        part: arguments.shard,
        overwrite: arguments.overwrite,
        max_failures: arguments.max_failures,
        report: arguments.report.clone(),
        ..Options::default()
    };
    let folder = options.folder(&recipe);
    if let Err(e) = std::fs::create_dir_all(&folder) {
        return Err(Refused(format!("{}: {e}", folder.display())).into());
    }
    stop_on_ctrl_c()?;
    let voice = match (arguments.quiet, arguments.log_json) {
        (true, _) => Voice::Quiet,
        (_, true) => Voice::Json,
        _ => Voice::Person,
    };
    let progress = Progress::new(voice);
    let summary = generate(&recipe, &options, &progress)?;
    progress.bar.finish_and_clear();
    if voice == Voice::Json {
        let summary: serde_json::Value = serde_json::from_str(&summary.to_json())?;
        event("end", &serde_json::json!({ "summary": summary }));
    }
    Ok(report(&summary, voice, progress.begun.elapsed()))
}

fn report(summary: &Summary, voice: Voice, time: Duration) -> u8 {
    let failed: u64 = summary.failures.iter().map(|f| f.samples).sum();
    let failures = summary.failures.iter().filter(|_| voice != Voice::Json);
    for failure in failures {
        let what = match &failure.expression {
            Some(expression) => format!("{}, {expression}", failure.subject),
            None => failure.subject.clone(),
        };
        let Failure {
            samples, reason, ..
        } = failure;
        output::note(&format!("failed: {what} ({samples} samples): {reason}"));
    }
    if voice == Voice::Person {
        let rate = summary.made as f64 / time.as_secs_f64().max(1e-3);
        let kept = match summary.kept {
            0 => String::new(),
            n => format!(", {n} were there"),
        };
        output::note(&format!(
            "{} of {} samples in {}: {} made in {:.1} s ({rate:.1}/s){kept}",
            summary.made + summary.kept,
            summary.samples,
            summary.output.display(),
            summary.made,
            time.as_secs_f64(),
        ));
    }
    if summary.gave_up {
        if voice != Voice::Json {
            output::note(&"stopped: more samples failed than --max-failures allows");
        }
        FAILED
    } else if summary.interrupted {
        output::note(&"stopped; run the same command again to go on");
        INTERRUPTED
    } else if failed > 0 {
        FAILED
    } else {
        DONE
    }
}

use facile::write::Failure;

static STOP: AtomicBool = AtomicBool::new(false);

/// The first Ctrl-C lets the units in hand finish, the second ends the process at once; both can be resumed.
fn stop_on_ctrl_c() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(INTERRUPTED));
        }
        output::note(&"\nfinishing the files in hand; Ctrl-C again stops at once");
    })?;
    Ok(())
}

/// How the user is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Voice {
    /// Errors alone.
    Quiet,
    /// A bar on a terminal, plain lines elsewhere.
    Person,
    /// Lines of JSON.
    Json,
}

/// Writes one line of JSON: what happened, and more of it.
fn event(name: &str, more: &serde_json::Value) {
    let mut line = serde_json::json!({ "event": name });
    if let (Some(line), Some(more)) = (line.as_object_mut(), more.as_object()) {
        line.extend(more.clone());
    }
    output::note(&line);
}

/// Progress as a bar on a terminal and as lines elsewhere.
struct Progress {
    bar: ProgressBar,
    voice: Voice,
    begun: Instant,
    done: AtomicU64,
    total: AtomicU64,
    last_line: Mutex<Instant>,
}

impl Progress {
    fn new(voice: Voice) -> Self {
        let target = if voice == Voice::Person {
            ProgressDrawTarget::stderr_with_hz(8)
        } else {
            ProgressDrawTarget::hidden()
        };
        Self {
            bar: ProgressBar::with_draw_target(None, target),
            voice,
            begun: Instant::now(),
            done: AtomicU64::new(0),
            total: AtomicU64::new(0),
            last_line: Mutex::new(Instant::now()),
        }
    }

    fn is_plain(&self) -> bool {
        self.voice != Voice::Quiet && self.bar.is_hidden()
    }
}

impl Watch for Progress {
    fn begin(&self, total: u64, done: u64) {
        self.total.store(total, Ordering::Relaxed);
        self.done.store(done, Ordering::Relaxed);
        let style = "{wide_bar} {human_pos}/{human_len} images, {per_sec}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(style) {
            self.bar.set_style(style);
        }
        self.bar.set_length(total);
        self.bar.set_position(done);
        self.bar.reset_eta();
        if self.voice == Voice::Json {
            event(
                "begin",
                &serde_json::json!({ "samples": total, "done": done }),
            );
        } else if self.is_plain() {
            output::note(&format!("{total} images, {done} are there already"));
        }
    }

    fn advance(&self, samples: u64) {
        self.bar.inc(samples);
        let done = self.done.fetch_add(samples, Ordering::Relaxed) + samples;
        if !self.is_plain() {
            return;
        }
        let mut last = self
            .last_line
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if last.elapsed() >= LINE_INTERVAL {
            *last = Instant::now();
            let total = self.total.load(Ordering::Relaxed);
            let rate = done as f64 / self.begun.elapsed().as_secs_f64().max(1e-3);
            let left = total.saturating_sub(done) as f64 / rate.max(1e-9);
            if self.voice == Voice::Json {
                let numbers = serde_json::json!({
                    "done": done, "samples": total, "rate_per_s": rate, "left_s": left,
                });
                event("progress", &numbers);
            } else {
                output::note(&format!(
                    "{done}/{total} images, {rate:.1}/s, {left:.0} s left"
                ));
            }
        }
    }

    fn notice(&self, message: &str) {
        match self.voice {
            Voice::Quiet => {}
            Voice::Person => self.bar.suspend(|| output::note(&message)),
            Voice::Json => event("notice", &serde_json::json!({ "message": message })),
        }
    }

    fn stops(&self) -> bool {
        STOP.load(Ordering::Relaxed)
    }
}
