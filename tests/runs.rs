//! What a run tells and keeps: caches, failures, the log, the report.

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use common::files;
use serde_json::Value;

const RECIPE: &str = r#"
[dataset]
name = "runs"
seed = 11

[image]
size = [32, 32]
samples = 1
truth = ["landmarks", "segments"]

[subjects]
sampled = 1

[[expression]]
name = "smile"
intensities = [0.5, 1.0]

[[expression]]
name = "neutral"

[[view]]
yaw_deg = [0, 20]
"#;

fn facile(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_facile"))
        .args(arguments)
        .env("FACILE_CACHE", dir.join("cache"))
        .current_dir(dir)
        .output()
        .expect("starts")
}

/// The events of a run that logs JSON.
fn events(output: &Output) -> Vec<Value> {
    let text = String::from_utf8_lossy(&output.stderr);
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}")))
        .collect()
}

/// Equilibria solved for and taken from the cache by a run into `output`.
fn equilibria(dir: &Path, output: &str) -> Value {
    let run = facile(
        dir,
        &[
            "gen",
            "runs.toml",
            "--log-json",
            "--jobs",
            "1",
            "-o",
            output,
        ],
    );
    assert!(run.status.success(), "{run:?}");
    let events = events(&run);
    assert_eq!(events[0]["event"], "begin");
    let end = events.last().expect("an end");
    assert_eq!(end["event"], "end");
    end["summary"]["effort"]["equilibria"].clone()
}

/// Files of the cache.
fn entries(dir: &Path) -> Vec<PathBuf> {
    files(&dir.join("cache")).into_keys().collect()
}

#[test]
fn equilibria_are_kept_and_damaged_ones_made_again_to_the_same_bytes() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("runs.toml"), RECIPE).expect("writes");
    assert_eq!(equilibria(dir.path(), "fresh"), serde_json::json!([2, 0]));
    assert_eq!(equilibria(dir.path(), "cached"), serde_json::json!([0, 2]));
    let entries = entries(dir.path());
    assert_eq!(entries.len(), 2, "{entries:?}");
    let damaged = dir.path().join("cache").join(&entries[0]);
    let mut bytes = std::fs::read(&damaged).expect("reads");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&damaged, bytes).expect("writes");
    assert_eq!(
        equilibria(dir.path(), "repaired"),
        serde_json::json!([1, 1])
    );
    assert_eq!(equilibria(dir.path(), "again"), serde_json::json!([0, 2]));
    let fresh = files(&dir.path().join("fresh"));
    for other in ["cached", "repaired", "again"] {
        assert!(files(&dir.path().join(other)) == fresh, "{other} differs");
    }
}

#[test]
fn a_cache_of_no_size_keeps_nothing() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("runs.toml"), RECIPE).expect("writes");
    let run = Command::new(env!("CARGO_BIN_EXE_facile"))
        .args(["gen", "runs.toml", "--quiet", "-o", "out", "--limit", "2"])
        .env("FACILE_CACHE", dir.path().join("cache"))
        .env("FACILE_CACHE_MB", "0")
        .current_dir(dir.path())
        .status()
        .expect("starts");
    assert!(run.success());
    assert!(!dir.path().join("cache").exists());
}

#[test]
fn a_run_gives_up_after_too_many_failures_and_can_go_on() {
    let dir = tempfile::tempdir().expect("makes");
    let bad: Vec<String> = (0..6).map(|i| format!("bad_{i}.obj")).collect();
    for name in &bad {
        std::fs::write(dir.path().join(name), "v 0 0 nan\n").expect("writes");
    }
    let text = RECIPE.replace("sampled = 1", "scans = [\"bad_*.obj\"]\nsampled = 1");
    std::fs::write(dir.path().join("runs.toml"), text).expect("writes");
    let start = |more: &[&str]| {
        let arguments = [
            &["gen", "runs.toml", "--jobs", "1", "-o", "out", "--log-json"],
            more,
        ];
        let run = facile(dir.path(), &arguments.concat());
        let summary = events(&run).pop().expect("an end")["summary"].clone();
        (run.status.code(), summary)
    };
    // Six images each: units of two subjects and a little more.
    let (code, summary) = start(&["--max-failures", "5", "--report", "report.html"]);
    assert_eq!((code, &summary["gave_up"]), (Some(1), &Value::Bool(true)));
    assert_eq!(summary["made"], 0, "{summary}");
    let report = std::fs::read_to_string(dir.path().join("report.html")).expect("there");
    assert!(
        report.contains("bad_0") && report.contains("nan"),
        "{report}"
    );
    let (code, summary) = start(&["--max-failures", "36"]);
    assert_eq!((code, &summary["gave_up"]), (Some(1), &Value::Bool(false)));
    assert_eq!(summary["made"], 6, "{summary}");
}

/// Checks that tags are closed in order, and returns their names.
fn tags(page: &str) -> Vec<String> {
    let mut open: Vec<&str> = Vec::new();
    let mut seen = Vec::new();
    for tag in page.split('<').skip(1) {
        let tag = tag.split('>').next().expect("closed");
        let name = tag
            .split([' ', '/', '>'])
            .find(|n| !n.is_empty())
            .expect("a name");
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "{tag}");
        } else if !tag.starts_with('!') {
            seen.push(name.to_owned());
            if !tag.ends_with('/') {
                open.push(name);
            }
        }
    }
    assert!(open.is_empty(), "{open:?}");
    seen
}

#[test]
fn the_report_holds_times_caches_histograms_and_pictures_in_one_file() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("runs.toml"), RECIPE).expect("writes");
    let run = facile(
        dir.path(),
        &["gen", "runs.toml", "-o", "out", "--report", "report.html"],
    );
    assert!(run.status.success());
    let page = std::fs::read_to_string(dir.path().join("report.html")).expect("there");
    let tags = tags(&page);
    let count = |name: &str| tags.iter().filter(|t| *t == name).count();
    assert!(
        count("svg") >= 8 && count("rect") > 20 && count("section") == 8,
        "{tags:?}"
    );
    assert_eq!(count("script") + count("link"), 0);
    assert!(
        !page
            .replace("http://www.w3.org/2000/svg", "")
            .contains("http")
    );
    for word in [
        "tracing",
        "2 made, 0 taken",
        "relative residual",
        "data:image/png;base64,",
        "smile",
    ] {
        assert!(page.contains(word), "{word}");
    }
    // The report is no part of the dataset, which says nothing of times.
    assert!(!dir.path().join("out/report.html").exists());
}
