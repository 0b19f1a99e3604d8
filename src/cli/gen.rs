//! `facile gen`

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use facile::generate::{MEMORY, Options, Summary, Watch, generate};
use facile::pipeline::{Clock, Work};
use facile::units::Part;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::{DONE, FAILED, INTERRUPTED, RecipeArgument, Refused, output};

/// Time between two drawings of the stages' bars.
const BARS_INTERVAL: Duration = Duration::from_millis(250);
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
    /// Memory that the run may take, megabytes: with less there are fewer threads.
    #[arg(long, value_name = "MB", default_value_t = MEMORY >> 20, value_parser = clap::value_parser!(u64).range(1..=1 << 24))]
    memory: u64,
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
        memory: Some(arguments.memory << 20),
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

/// A bar for the share of each stage in the time so far, one a line.
fn bars(clock: &Clock, failed: u64) -> String {
    const LONGEST: f64 = 40.0;
    let spent = Work::ALL.map(|(work, name)| (name, clock.get(work)));
    let all: u64 = spent.iter().map(|(_, [time, _])| time).sum();
    let mut text = String::new();
    for (name, [time, times]) in spent.into_iter().filter(|(_, [_, times])| *times > 0) {
        let share = time as f64 / all.max(1) as f64;
        let bar = "█".repeat((share * LONGEST).round() as usize);
        let _ = write!(
            text,
            "\n{name:>11} {bar:<40} {:>3.0} %  {times}",
            100.0 * share
        );
    }
    if failed > 0 {
        let _ = write!(text, "\n{failed} samples failed");
    }
    text
}

/// Progress as a bar on a terminal and as lines elsewhere.
struct Progress {
    bar: ProgressBar,
    voice: Voice,
    begun: Instant,
    done: AtomicU64,
    total: AtomicU64,
    failed: AtomicU64,
    last_line: Mutex<Instant>,
    /// When the bars of the stages were drawn last.
    last_bars: Mutex<Instant>,
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
            failed: AtomicU64::new(0),
            last_line: Mutex::new(Instant::now()),
            last_bars: Mutex::new(Instant::now()),
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
        let style = "{wide_bar} {human_pos}/{human_len} images, {per_sec}, {eta} left{msg}";
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
                    "failed": self.failed.load(Ordering::Relaxed),
                });
                event("progress", &numbers);
            } else {
                output::note(&format!(
                    "{done}/{total} images, {rate:.1}/s, {left:.0} s left"
                ));
            }
        }
    }

    fn busy(&self, clock: &Clock, failed: u64) {
        self.failed.store(failed, Ordering::Relaxed);
        if self.bar.is_hidden() {
            return;
        }
        let mut last = self
            .last_bars
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if last.elapsed() >= BARS_INTERVAL {
            *last = Instant::now();
            self.bar.set_message(bars(clock, failed));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_have_bars_of_their_shares() {
        let clock = Clock::default();
        clock.time(Work::Shading, || {
            std::thread::sleep(Duration::from_millis(3));
        });
        let text = bars(&clock, 2);
        let lines: Vec<&str> = text.trim_start().lines().collect();
        assert_eq!(lines.len(), 2, "{text}");
        assert!(
            lines[0].contains("shading")
                && lines[0].contains(&"█".repeat(40))
                && lines[0].contains("100 %  1")
        );
        assert_eq!(lines[1], "2 samples failed");
    }
}
