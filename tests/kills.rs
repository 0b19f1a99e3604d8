//! A run that is killed at any instant goes on to the bytes of one that was not.

mod common;

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use common::files;
use facile::Recipe;
use facile::core::rng::RandomStream;
use facile::generate::{Options, Unwatched, Watch, generate};

const RECIPE: &str = r#"
[dataset]
name = "killed"
seed = 5
formats = ["folder", "webdataset"]
images_per_shard = 3
coco = true

[image]
size = [32, 32]
samples = 1
truth = ["landmarks", "segments", "depth"]

[subjects]
sampled = 3

[[view]]
yaw_deg = [-20, -10, 0, 10, 20, 30]

[[light]]
name = "a"
sources = [{ kind = "point", position = [300, 200, 800] }]

[[light]]
name = "b"
sources = [{ kind = "ambient", intensity = 0.7 }]
"#;

fn start(dir: &Path, output: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_facile"))
        .args([
            "gen",
            "killed.toml",
            "--quiet",
            "--jobs",
            "2",
            "--output",
            output,
        ])
        .current_dir(dir)
        .stderr(Stdio::null())
        .spawn()
        .expect("starts")
}

/// Kills runs at random instants until `kills` are done, and lets each dataset be finished after the first to the last.
fn survive(kills: usize) {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("killed.toml"), RECIPE).expect("writes");
    let begun = Instant::now();
    assert!(start(dir.path(), "clean").wait().expect("ends").success());
    let usual = begun.elapsed();
    let clean = files(&dir.path().join("clean"));
    assert!(clean.len() > 80, "{} files", clean.len());

    let mut random = RandomStream::new(9, 0);
    let mut done = 0;
    for dataset in 0.. {
        let output = format!("killed-{dataset}");
        // Up to three kills each, then to the end.
        for _ in 0..3 {
            let mut run = start(dir.path(), &output);
            std::thread::sleep(Duration::from_secs_f64(
                usual.as_secs_f64() * random.uniform(0.05, 1.0),
            ));
            run.kill().expect("kills");
            run.wait().expect("ends");
            done += 1;
        }
        assert!(start(dir.path(), &output).wait().expect("ends").success());
        let found = files(&dir.path().join(&output));
        assert!(
            found == clean,
            "dataset {dataset} has {} files, expected {}, or other bytes",
            found.len(),
            clean.len()
        );
        std::fs::remove_dir_all(dir.path().join(&output)).expect("removes");
        if done >= kills {
            break;
        }
    }
}

/// A shell's limit on the size of files stands for a full disk: writing fails in the middle of a file.
#[cfg(unix)]
#[test]
fn a_full_disk_ends_the_run_with_the_file_and_leaves_no_trace() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("killed.toml"), RECIPE).expect("writes");
    assert!(start(dir.path(), "clean").wait().expect("ends").success());
    let program = env!("CARGO_BIN_EXE_facile");
    // Blocks of 512 bytes or of 1 kB: tar files are larger, single images are not.
    let script = format!(
        "trap '' XFSZ; ulimit -f 12; exec '{program}' gen killed.toml --quiet --jobs 2 --output full"
    );
    let full = Command::new("sh")
        .args(["-c", &script])
        .current_dir(dir.path())
        .output()
        .expect("starts");
    let errors = String::from_utf8_lossy(&full.stderr);
    assert!(!full.status.success());
    assert!(
        errors.contains(".tar") && errors.contains("too large"),
        "{errors}"
    );
    assert!(!errors.contains("panicked"), "{errors}");
    // With space again it goes on.
    assert!(start(dir.path(), "full").wait().expect("ends").success());
    let (clean, full) = (
        files(&dir.path().join("clean")),
        files(&dir.path().join("full")),
    );
    assert!(
        full == clean,
        "{} files against {}",
        full.len(),
        clean.len()
    );
}

/// Removes a folder under the run after so many samples.
struct Removes {
    folder: std::path::PathBuf,
    at: u64,
    seen: std::sync::atomic::AtomicU64,
}

impl Watch for Removes {
    fn advance(&self, samples: u64) {
        let seen = self.seen.fetch_add(samples, Ordering::Relaxed);
        if seen == self.at {
            std::fs::remove_dir_all(&self.folder).expect("removes");
        }
    }
}

#[test]
fn a_folder_removed_under_the_run_is_made_again() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = Recipe::parse(RECIPE, Path::new("killed.toml"), Path::new("")).expect("valid");
    let run = |name: &str, watch: &dyn Watch| {
        let options = Options {
            output: Some(dir.path().join(name)),
            jobs: Some(1),
            ..Options::default()
        };
        generate(&recipe, &options, watch)
    };
    run("clean", &Unwatched).expect("runs");
    let clean = files(&dir.path().join("clean"));
    for removed in ["images", "webdataset", ".facile/units", ""] {
        let name = format!("removed-{}", removed.replace(['/', '.'], "_"));
        let watch = Removes {
            folder: dir.path().join(&name).join(removed),
            at: 20,
            seen: 0.into(),
        };
        // Whether the run ends with an error or finds at its end that files are missing, the next one completes it.
        drop(run(&name, &watch));
        let summary = run(&name, &Unwatched).unwrap_or_else(|e| panic!("{removed}: {e}"));
        assert!(
            summary.failures.is_empty() && !summary.interrupted,
            "{summary:?}"
        );
        assert!(
            files(&dir.path().join(&name)) == clean,
            "without {removed} the bytes differ"
        );
    }
}

#[test]
fn six_kills_leave_no_trace() {
    survive(6);
}

#[test]
#[ignore = "takes minutes: the hundred kills of the release check"]
fn a_hundred_kills_leave_no_trace() {
    survive(100);
}
