//! Samples that are drawn: the same bytes however they are made, spread as the recipe says, constraints kept.

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use common::files;
use facile::Recipe;
use facile::generate::{Options, Unwatched, generate};
use facile::pipeline::{Pipeline, Worker};
use facile::plan::Grid;
use facile::recipe::Optics;
use facile::units::Part;
use facile::write::{Encoder, merge};

const RECIPE: &str = r#"
[dataset]
name = "drawn"
seed = 3

[image]
size = [32, 32]
samples = 1
truth = ["landmarks", "segments"]

[subjects]
sampled = 4

[[expression]]
name = "neutral"

[[light]]
name = "key"
sources = [{ kind = "point", position = [300, 250, 700] }, { kind = "ambient", intensity = 0.2 }]

[[light]]
name = "even"
sources = [{ kind = "ambient", intensity = 0.9 }]

[[occluder]]
kind = "none"

[[occluder]]
kind = "glasses"

[sampling]
count = 43
pattern = "sobol"
poses_per_subject = 2
views_per_pose = 3
lights_per_view = 2

[sampling.view]
yaw_deg = { uniform = [-60, 60] }
pitch_deg = { normal = [0, 10], within = [-25, 25] }
roll_deg = { choice = [-5, 0, 5], weights = [1, 2, 1] }
distance_mm = { uniform = [700, 1200] }

[sampling.light]
turn_deg = { uniform = [-70, 70] }
intensity = { uniform = [0.7, 1.3] }

[sampling.occluder]
weights = { none = 3 }
size = { uniform = [0.9, 1.1] }
colors = [[200, 30, 30], [20, 20, 20]]

[[sampling.constraint]]
of = ["yaw_deg", "pitch_deg"]
absolute = true
max_sum = 50
"#;

fn recipe(text: &str) -> Recipe {
    Recipe::parse(text, Path::new("drawn.toml"), Path::new("")).unwrap_or_else(|e| panic!("{e}"))
}

fn run(recipe: &Recipe, output: PathBuf, jobs: usize, part: Option<Part>, limit: Option<u64>) {
    let options = Options {
        output: Some(output),
        jobs: Some(jobs),
        part,
        limit,
        ..Options::default()
    };
    let summary = generate(recipe, &options, &Unwatched).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(summary.failures, []);
}

fn assert_same(a: &Path, b: &Path) {
    let (a, b) = (files(a), files(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    assert!(a == b, "files differ");
}

#[test]
fn threads_parts_and_interruptions_leave_no_trace_in_drawn_samples() {
    let dir = tempfile::tempdir().expect("makes");
    let place = |name: &str| dir.path().join(name);
    let recipe = recipe(RECIPE);
    run(&recipe, place("one"), 1, None, None);
    run(&recipe, place("three"), 3, None, None);
    assert_same(&place("one"), &place("three"));
    run(&recipe, place("resumed"), 2, None, Some(20));
    run(&recipe, place("resumed"), 2, None, None);
    assert_same(&place("one"), &place("resumed"));
    let parts: Vec<PathBuf> = (1..=3)
        .map(|i| {
            let folder = place(&format!("part-{i}"));
            run(&recipe, folder.clone(), 1, Part::new(i, 3), None);
            folder
        })
        .collect();
    merge(&parts, &place("merged"), false).unwrap_or_else(|e| panic!("{e}"));
    assert_same(&place("one"), &place("merged"));
}

#[test]
fn any_sample_alone_is_that_of_the_run() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(RECIPE);
    run(&recipe, dir.path().join("out"), 2, None, None);
    let pipeline = Arc::new(Pipeline::new(recipe).unwrap_or_else(|e| panic!("{e}")));
    for index in [42, 0, 17] {
        let sample = Worker::new(pipeline.clone()).sample(index).expect("makes");
        let encoded = Encoder::new(pipeline.recipe())
            .encode(&sample)
            .expect("encodes");
        let stored = std::fs::read(dir.path().join(format!("out/images/{index:06}.png")));
        assert_eq!(encoded.image, stored.expect("there"), "sample {index}");
    }
}

#[test]
fn draws_fill_their_ranges_and_keep_constraints() {
    for pattern in ["sobol", "stratified", "random"] {
        let text = RECIPE
            .replace("count = 43", "count = 1200")
            .replace("\"sobol\"", &format!("{pattern:?}"));
        let recipe = recipe(&text);
        let grid = Grid::of(&recipe);
        assert_eq!((grid.len(), grid.groups(), grid.subjects), (1200, 200, 100));
        let mut subjects = BTreeMap::new();
        let (mut glasses, mut even, mut left) = (0, 0, 0);
        let (mut nearest, mut farthest) = (f64::MAX, f64::MIN);
        for index in 0..grid.len() {
            let scene = recipe.scene(index).expect("draws");
            let [yaw, pitch] = [scene.view.yaw, scene.view.pitch].map(|v| v.to_degrees().abs());
            assert!(yaw + pitch <= 50.0 + 1e-9 && pitch <= 25.0, "{yaw} {pitch}");
            assert!(
                scene.view.roll == 0.0 || (scene.view.roll.to_degrees().abs() - 5.0).abs() < 1e-9
            );
            nearest = nearest.min(scene.view.distance);
            farthest = farthest.max(scene.view.distance);
            left += u64::from(scene.view.yaw > 0.0);
            glasses += u64::from(*scene.occluder != facile::recipe::Occluder::None);
            even += u64::from(scene.lighting.name == "even");
            *subjects.entry(scene.subject).or_insert(0) += 1;
            // Samples of one view share all but the light, views of one pose the face.
            let first = recipe.scene(index - index % 2).expect("draws");
            assert_eq!((first.view, &first.occluder), (scene.view, &scene.occluder));
        }
        assert!(nearest < 710.0 && farthest > 1190.0, "{nearest} {farthest}");
        assert!(
            (540..=660).contains(&left),
            "{pattern}: {left} from the left"
        );
        assert!(
            (240..=360).contains(&glasses),
            "{pattern}: {glasses} with glasses"
        );
        assert!((510..=690).contains(&even), "{pattern}: {even} evenly lit");
        // A hundred visits to four people.
        assert_eq!(subjects.into_values().collect::<Vec<u64>>(), [300; 4]);
    }
}

#[test]
fn stratified_draws_are_even_to_one() {
    let text = RECIPE
        .replace("\"sobol\"", "\"stratified\"")
        .replace("count = 43", "count = 1200")
        .replace("max_sum = 50", "max_sum = 500");
    let recipe = recipe(&text);
    let mut views = [0; 400];
    for index in (0..1200).step_by(2) {
        let yaw = recipe.scene(index).expect("draws").view.yaw.to_degrees();
        views[((yaw + 60.0) / 120.0 * 400.0) as usize] += 1;
    }
    // 600 views in 400 intervals: one or two in each, as a stratum is two thirds of an interval.
    assert!(views.iter().all(|n| (1..=2).contains(n)), "{views:?}");
}

#[test]
fn ten_billion_draws_are_planned_at_once_and_any_is_made() {
    let text = RECIPE.replace("count = 43", "count = 10000000000");
    for pattern in ["sobol", "stratified", "random"] {
        let recipe = recipe(&text.replace("\"sobol\"", &format!("{pattern:?}")));
        let last = recipe.scene(9_999_999_999).expect("draws");
        assert_ne!(last, recipe.scene(4_999_999_999).expect("draws"));
        assert!(recipe.scene(10_000_000_000).is_err());
    }
}

#[test]
fn errors_point_at_what_is_wrong_in_the_sampling() {
    let cases = [
        ("count = 43", "count = 0", "count must be from 1"),
        ("\"sobol\"", "\"sobel\"", "unknown value `sobel`"),
        (
            "uniform = [-60, 60]",
            "uniform = [-60, 200]",
            "yaw_deg must be from -180 to 180",
        ),
        (
            "uniform = [-60, 60]",
            "uniform = [60, -60]",
            "over the largest",
        ),
        (
            "uniform = [-60, 60]",
            "uniform = [0, 1], choice = [2]",
            "exactly one of",
        ),
        (
            "uniform = [-60, 60]",
            "uniform = [0, 1], within = [2, 3]",
            "goes with `normal`",
        ),
        (
            "normal = [0, 10]",
            "normal = [0, 0]",
            "a standard deviation must be",
        ),
        (
            "weights = [1, 2, 1]",
            "weights = [1, 2]",
            "3 weights are needed",
        ),
        (
            "weights = { none = 3 }",
            "weights = { cap = 3 }",
            "unknown occluder `cap`",
        ),
        (
            "weights = { none = 3 }",
            "weights = { none = 0, glasses = 0 }",
            "over 0",
        ),
        (
            "\"pitch_deg\"]",
            "\"pich_deg\"]",
            "unknown number that is drawn `pich_deg`",
        ),
        ("max_sum = 50", "max_sum = -1", "find no draw of sample 0"),
        (
            "absolute = true\nmax_sum = 50",
            "",
            "at least one of min_sum and max_sum",
        ),
        (
            "[sampling.view]",
            "[sampling.expression]\nmuscles = { risorus = { choice = [1] } }\n[sampling.view]",
            "risorus",
        ),
        ("[sampling.view]", "[sampling.vew]", "unknown key `vew`"),
    ];
    for (from, to, expected) in cases {
        let text = RECIPE.replace(from, to);
        assert_ne!(text, RECIPE, "{from}");
        let error = Recipe::parse(&text, Path::new("r.toml"), Path::new("")).expect_err(to);
        let message = error.to_string();
        assert!(message.contains(expected), "{to}: {message}");
        assert!(message.starts_with("r.toml:"), "no place: {message}");
    }
}

#[test]
fn what_is_drawn_is_added_to_the_expression_within_what_a_face_can_do() {
    let text = RECIPE.replace("name = \"neutral\"", "name = \"smile\"").replace(
        "[sampling.view]",
        "[sampling.expression]\nintensity = { uniform = [0.2, 0.9] }\njaw_deg = { uniform = [39, 40] }\n\
         gaze_yaw_deg = { normal = [0, 15] }\nmuscles = { zygomatic_major = { uniform = [0.9, 1] } }\n\n[sampling.view]",
    );
    let recipe = recipe(&text);
    let mut gazes = Vec::new();
    for index in (0..43).step_by(6) {
        let scene = recipe.scene(index).expect("draws");
        let pose = &scene.expression.pose;
        assert!((0.2..=0.9).contains(&scene.expression.intensity));
        pose.check(facile::sim::MuscleSet::embedded())
            .expect("a pose of this face");
        assert!(pose.contractions["zygomatic_major"].left >= 0.9);
        gazes.push(pose.gaze.yaw_rad);
    }
    gazes.dedup();
    assert!(gazes.len() > 5, "{gazes:?}");
}

#[test]
fn lenses_and_projections_are_drawn() {
    let text = RECIPE
        .replace("count = 43", "count = 1200")
        .replace("samples = 1", "samples = 4")
        .replace(
            "[sampling.light]",
            "projection = { perspective = 3, orthographic = 1 }\naperture_mm = { choice = [0, 30] }\n\
             focus_mm = { uniform = [500, 900] }\n\n[sampling.light]",
        );
    let recipe = recipe(&text);
    let (mut parallel, mut open) = (Vec::new(), Vec::new());
    let mut nearest = f64::MAX;
    // Two lightings share a view
    for index in (0..1200).step_by(2) {
        match recipe.scene(index).expect("draws").view.optics {
            Optics::Pinhole => {}
            Optics::Orthographic => parallel.push(index),
            Optics::Lens { aperture, focus } => {
                let focus = focus.expect("drawn");
                assert!(aperture == 30.0 && (500.0..=900.0).contains(&focus));
                nearest = nearest.min(focus);
                open.push(index);
            }
        }
    }
    assert!((120..=180).contains(&parallel.len()), "{}", parallel.len());
    assert!((190..=260).contains(&open.len()), "{}", open.len());
    assert!(nearest < 520.0, "{nearest}");
    // What is drawn is what is rendered and recorded
    let (parallel, open) = (parallel[0], open[0]);
    let pipeline = Arc::new(Pipeline::new(recipe).unwrap_or_else(|e| panic!("{e}")));
    let camera = |index: u64| {
        let sample = Worker::new(pipeline.clone()).sample(index);
        sample.unwrap_or_else(|e| panic!("{e}")).record.camera
    };
    let of = camera(parallel);
    assert_eq!(
        (of.projection, of.aperture_mm),
        (Some("orthographic"), None)
    );
    let of = camera(open);
    assert_eq!((of.projection, of.aperture_mm), (None, Some(30.0)));
    assert!(of.focus_mm.is_some_and(|mm| (500.0..=900.0).contains(&mm)));
}

#[test]
fn errors_point_at_what_is_wrong_in_a_drawn_lens() {
    let parallel = "[[view]]\nprojection = \"orthographic\"\n\n[sampling]";
    for (from, to, expected) in [
        ("", "aperture_mm = { uniform = [0, 20] }", "from 2 on"),
        (
            "samples = 4",
            "focus_mm = { uniform = [500, 900] }",
            "everything is in focus",
        ),
        (
            parallel,
            "aperture_mm = { uniform = [0, 20] }",
            "an orthographic view has no lens",
        ),
        (
            "samples = 4",
            "aperture_mm = { uniform = [0, 200] }",
            "aperture_mm must be from 0 to 100",
        ),
        (
            "samples = 4",
            "projection = { perspective = 0 }",
            "at least one weight must be over 0",
        ),
        (
            "samples = 4",
            "projection = { parallel = 1 }",
            "unknown key `parallel`",
        ),
    ] {
        let mut text = RECIPE.replace("[sampling.light]", &format!("{to}\n\n[sampling.light]"));
        if from == parallel {
            text = text.replace("[sampling]", parallel);
        } else if !from.is_empty() {
            text = text.replace("samples = 1", from);
        }
        let error = Recipe::parse(&text, Path::new("r.toml"), Path::new("")).expect_err(to);
        let message = error.to_string();
        assert!(message.contains(expected), "{to}: {message}");
        assert!(message.starts_with("r.toml:"), "no place: {message}");
    }
}
