//! A run that is killed at any instant goes on to the bytes of one that was not.

mod common;

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::files;
use facile::core::rng::RandomStream;

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

#[test]
fn six_kills_leave_no_trace() {
    survive(6);
}

#[test]
#[ignore = "takes minutes: the hundred kills of the release check"]
fn a_hundred_kills_leave_no_trace() {
    survive(100);
}
