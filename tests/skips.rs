//! What is skipped changes no byte.

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use common::files;
use facile::Recipe;
use facile::generate::{Options, Unwatched, generate};
use facile::pipeline::{Pipeline, Sample, Skips, Work, Worker};

const RECIPE: &str = r#"
[dataset]
name = "skips"
seed = 4

[image]
size = [64, 64]
samples = "adaptive"
truth = ["landmarks", "segments"]

[subjects]
builtin = ["emi"]
sampled = 1

[[expression]]
name = "neutral"

[[expression]]
name = "smile"

[[expression]]
name = "blink"

[[light]]
name = "front"
sources = [{ kind = "point", position = [100, 200, 800] }]

[[light]]
name = "even"
sources = [{ kind = "ambient", intensity = 0.8 }]

[[view]]
yaw_deg = [0, 50]
pitch_deg = [-15]
"#;

/// Pixels of images that differ, in all images together.
fn differing_pixels(a: &BTreeMap<PathBuf, Vec<u8>>, b: &BTreeMap<PathBuf, Vec<u8>>) -> usize {
    let images = a.keys().filter(|name| name.starts_with("images"));
    let decode = |bytes: &[u8]| image::load_from_memory(bytes).expect("decodes").into_rgb8();
    let count = |name: &PathBuf| {
        let (a, b) = (decode(&a[name]), decode(&b[name]));
        a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count()
    };
    images.map(count).sum()
}

#[test]
fn every_saving_can_be_switched_off_without_changing_a_byte() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = Recipe::parse(RECIPE, Path::new("skips.toml"), Path::new("")).expect("valid");
    let run = |name: &str, skips: Skips| {
        let output = dir.path().join(name);
        let options = Options {
            output: Some(output.clone()),
            skips,
            ..Options::default()
        };
        let summary = generate(&recipe, &options, &Unwatched).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((summary.made, summary.failures.len()), (24, 0));
        (files(&output), summary.effort)
    };
    let (all, effort) = run("all", Skips::default());
    let times = |effort: &facile::report::Effort, stage: &str| effort.stages[stage];
    assert_eq!(effort.registrations.iter().sum::<u64>(), 1);
    assert_eq!(
        (times(&effort, "equilibria"), times(&effort, "tracing")),
        (6, 12)
    );
    for (name, skips) in Skips::each_off() {
        let (found, without) = run(name, skips);
        if ["closed_mouths", "closed_eyes"].contains(&name) {
            // Closed lips and lids let a few rays through, where they meet.
            let pixels = differing_pixels(&all, &found);
            assert!(pixels <= 16, "{pixels} pixels differ without {name}");
            continue;
        }
        for (file, bytes) in &all {
            assert!(
                bytes == &found[file],
                "without {name}: {} differs",
                file.display()
            );
        }
        assert_eq!(found.len(), all.len(), "without {name}");
        // The switch does what it says.
        match name {
            "shared_faces" => assert_eq!(times(&without, "equilibria"), 24),
            "shared_views" => assert_eq!(times(&without, "tracing"), 24),
            "cached_registrations" => assert_eq!(without.registrations, [1, 0]),
            "cached_equilibria" | "idle_muscles" => assert_eq!(without.equilibria, [4, 0]),
            "faces_at_rest" => assert_eq!(without.equilibria.iter().sum::<u64>(), 6),
            _ => {}
        }
    }
}

#[test]
fn samples_out_of_order_are_the_samples_in_order() {
    let recipe = RECIPE.replace(
        "[[view]]",
        "[[occluder]]\nkind = \"none\"\n[[occluder]]\nkind = \"glasses\"\n[[view]]",
    );
    let recipe = Recipe::parse(&recipe, Path::new("order.toml"), Path::new("")).expect("valid");
    let pipeline = Arc::new(Pipeline::new(recipe).expect("valid"));
    let mut ordered = Worker::new(pipeline.clone());
    let samples: Vec<Sample> = (0..8).map(|i| ordered.sample(i).expect("makes")).collect();
    // Keeping one view, two, and all.
    for bytes in [0, 2 * 80 * 64 * 64, 1 << 30] {
        let before = pipeline.clock().get(Work::Tracing)[1];
        let mut worker = Worker::new(pipeline.clone()).keep_views(bytes);
        for k in 0..8 {
            let i = (k * 3 + 1) % 8;
            let (found, expected) = (worker.sample(i).expect("makes"), &samples[i as usize]);
            assert_eq!(found.image, expected.image, "sample {i}, {bytes} bytes");
            assert_eq!(found.record, expected.record, "sample {i}, {bytes} bytes");
            assert_eq!(found.maps.segments, expected.maps.segments, "sample {i}");
        }
        // Four views, each of them once if all are kept.
        let traced = pipeline.clock().get(Work::Tracing)[1] - before;
        assert_eq!(traced == 4, bytes == 1 << 30, "{traced} views traced");
    }
}
