//! A dataset is a function of its recipe: the same bytes for any number of threads and after any interruption.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use facile::Recipe;
use facile::generate::{Options, Summary, Unwatched, Watch, generate};

const RECIPE: &str = r#"
[dataset]
name = "small"
seed = 3

[image]
size = [48, 40]
samples = 1
truth = ["landmarks", "segments", "depth", "normals", "visibility", "occlusion"]

[subjects]
sampled = 2

[[expression]]
name = "neutral"

[[light]]
name = "front"
sources = [{ kind = "point", position = [100, 200, 800], intensity = 0.8 }, { kind = "ambient", intensity = 0.3 }]

[[light]]
name = "side"
sources = [{ kind = "directional", direction = [-1, 0, -0.2], intensity = 0.9 }]

[[view]]
yaw_deg = [0, 25]

[[occluder]]
kind = "none"

[[occluder]]
kind = "glasses"
"#;

fn recipe(dir: &Path, text: &str) -> Recipe {
    let path = dir.join("dataset.toml");
    std::fs::write(&path, text).expect("writes");
    Recipe::load(&path).unwrap_or_else(|e| panic!("{e}"))
}

fn run(recipe: &Recipe, output: PathBuf, jobs: usize, watch: &dyn Watch) -> Summary {
    let options = Options {
        output: Some(output),
        jobs: Some(jobs),
        ..Options::default()
    };
    generate(recipe, &options, watch).unwrap_or_else(|e| panic!("{e}"))
}

/// Every file of a folder by its path in it.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("reads") {
            let path = entry.expect("reads").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(dir).expect("inside").to_owned();
                found.insert(name, std::fs::read(&path).expect("reads"));
            }
        }
    }
    found
}

fn assert_same(a: &Path, b: &Path) {
    let (a, b) = (files(a), files(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(bytes == &b[name], "{} differs", name.display());
    }
}

/// Asks to stop as soon as one sample is done.
struct StopsEarly(AtomicU64);

impl Watch for StopsEarly {
    fn advance(&self, samples: u64) {
        self.0.fetch_add(samples, Ordering::Relaxed);
    }

    fn stops(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

#[test]
fn threads_and_interruptions_leave_no_trace_in_the_bytes() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), RECIPE);
    let place = |name: &str| dir.path().join(name);

    let one = run(&recipe, place("one"), 1, &Unwatched);
    assert_eq!((one.samples, one.made, one.failures.len()), (16, 16, 0));
    run(&recipe, place("two"), 2, &Unwatched);
    assert_same(&place("one"), &place("two"));

    let stopped = run(&recipe, place("three"), 1, &StopsEarly(AtomicU64::new(0)));
    assert!(stopped.interrupted && stopped.made < 16, "{stopped:?}");
    let resumed = run(&recipe, place("three"), 2, &Unwatched);
    assert_eq!(resumed.kept + resumed.made, 16);
    assert!(resumed.kept > 0, "{resumed:?}");
    assert_same(&place("one"), &place("three"));
}

#[test]
fn records_hold_what_the_images_show() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), RECIPE);
    let output = dir.path().join("out");
    run(&recipe, output.clone(), 2, &Unwatched);
    let text = std::fs::read_to_string(output.join("annotations.jsonl")).expect("reads");
    let records: Vec<serde_json::Value> = text
        .lines()
        .map(|l| serde_json::from_str(l).expect("JSON"))
        .collect();
    assert_eq!(records.len(), 16);
    for (i, record) in records.iter().enumerate() {
        assert_eq!(record["index"], i);
        let image =
            image::open(output.join(record["image"].as_str().expect("a path"))).expect("opens");
        assert_eq!((image.width(), image.height()), (48, 40));
        assert_projections(record);
    }
    // The glasses' frame is in the segments of the images that name it, and in no others.
    let frame = facile::core::Segment::GlassesFrame.id();
    for (i, record) in records.iter().enumerate() {
        let file = record["maps"]["segments"]["file"].as_str().expect("a path");
        let has_frame = image::open(output.join(file))
            .expect("opens")
            .into_luma8()
            .as_raw()
            .contains(&frame);
        assert_eq!(
            has_frame,
            record["occluder"]["kind"] == "glasses",
            "image {i}"
        );
    }
}

/// Landmarks in mm, through the record's own K, R and t, land on the landmarks in px.
fn assert_projections(record: &serde_json::Value) {
    let numbers = |v: &serde_json::Value| -> Vec<f64> {
        v.as_array()
            .into_iter()
            .flatten()
            .filter_map(serde_json::Value::as_f64)
            .collect()
    };
    let camera = &record["camera"];
    let rows = |m: &serde_json::Value| -> Vec<Vec<f64>> {
        m.as_array().into_iter().flatten().map(numbers).collect()
    };
    let (k, r, t) = (
        rows(&camera["K"]),
        rows(&camera["R"]),
        numbers(&camera["t_mm"]),
    );
    assert_eq!((k.len(), r.len(), t.len()), (3, 3, 3), "{camera}");
    let landmarks = &record["landmarks"]["ibug68"];
    let (px, mm) = (rows(&landmarks["px"]), rows(&landmarks["mm"]));
    assert_eq!((px.len(), mm.len()), (68, 68));
    for (px, mm) in px.iter().zip(&mm) {
        let camera: Vec<f64> = (0..3)
            .map(|i| (0..3).map(|j| r[i][j] * mm[j]).sum::<f64>() + t[i])
            .collect();
        for axis in 0..2 {
            let image: f64 = (0..3).map(|j| k[axis][j] * camera[j]).sum::<f64>() / camera[2];
            assert!(
                (image - px[axis]).abs() < 0.01,
                "{image} against {}",
                px[axis]
            );
        }
    }
}

#[test]
fn a_bad_scan_among_good_subjects_is_reported_and_the_rest_is_made() {
    let dir = tempfile::tempdir().expect("makes");
    std::fs::write(dir.path().join("bad.obj"), "v 0 0 nan\n").expect("writes");
    let text = RECIPE.replace("sampled = 2", "scans = [\"bad.obj\"]\nsampled = 1");
    let recipe = recipe(dir.path(), &text);
    let summary = run(&recipe, dir.path().join("out"), 2, &Unwatched);
    assert_eq!((summary.samples, summary.made), (16, 8));
    let failures = serde_json::to_string(&summary.failures).expect("JSON");
    assert!(
        failures.contains("line 1") && failures.contains("nan"),
        "{failures}"
    );
}
