//! A dataset is a function of its recipe: the same bytes for any number of threads and after any interruption.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

mod common;

use common::files;
use facile::Recipe;
use facile::generate::{Options, Summary, Unwatched, Watch, generate};
use facile::units::Part;
use facile::verify::{sample_of_row, verify, verify_sample};
use facile::write::merge;

const RECIPE: &str = r#"
[dataset]
name = "small"
seed = 3

[image]
size = [48, 40]
samples = 1
truth = [
    "landmarks", "segments", "depth", "normals", "visibility", "occlusion", "amodal", "layers", "coverage", "instances",
    "reference", "albedo", "shadow",
]

[subjects]
sampled = 3

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
    run_part(recipe, output, jobs, None, watch)
}

fn run_part(
    recipe: &Recipe,
    output: PathBuf,
    jobs: usize,
    part: Option<Part>,
    watch: &dyn Watch,
) -> Summary {
    let options = Options {
        output: Some(output),
        jobs: Some(jobs),
        part,
        ..Options::default()
    };
    generate(recipe, &options, watch).unwrap_or_else(|e| panic!("{e}"))
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
    assert_eq!((one.samples, one.made, one.failures.len()), (24, 24, 0));
    for jobs in [2, 8] {
        run(&recipe, place(&format!("by-{jobs}")), jobs, &Unwatched);
        assert_same(&place("one"), &place(&format!("by-{jobs}")));
    }

    let stopped = run(&recipe, place("three"), 1, &StopsEarly(AtomicU64::new(0)));
    assert!(stopped.interrupted && stopped.made < 24, "{stopped:?}");
    let resumed = run(&recipe, place("three"), 2, &Unwatched);
    assert_eq!(resumed.kept + resumed.made, 24);
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
    assert_eq!(records.len(), 24);
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
    let text = RECIPE.replace("sampled = 3", "scans = [\"bad.obj\"]\nsampled = 1");
    let recipe = recipe(dir.path(), &text);
    let summary = run(&recipe, dir.path().join("out"), 2, &Unwatched);
    assert_eq!((summary.samples, summary.made), (16, 8));
    let failures = serde_json::to_string(&summary.failures).expect("JSON");
    assert!(
        failures.contains("line 1") && failures.contains("nan"),
        "{failures}"
    );
}

/// The recipe in every format, in files of a few images.
fn in_every_format() -> String {
    RECIPE.replace(
        "seed = 3",
        "seed = 3\nformats = [\"webdataset\", \"folder\", \"parquet\"]\nimages_per_shard = 5\ncoco = true",
    )
}

#[test]
fn parts_merge_into_the_bytes_of_one_run() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), &in_every_format());
    let place = |name: &str| dir.path().join(name);
    run(&recipe, place("whole"), 2, &Unwatched);
    for count in [1, 3, 7] {
        let parts: Vec<PathBuf> = (1..=count)
            .map(|index| {
                let folder = place(&format!("part-{index}-of-{count}"));
                let part = Part::new(index, count);
                // Every other part is stopped early and gone on with, by another number of threads.
                if index % 2 == 0 {
                    let early = StopsEarly(AtomicU64::new(0));
                    run_part(&recipe, folder.clone(), 1, part, &early);
                }
                let jobs = 1 + (index as usize) % 2;
                run_part(&recipe, folder.clone(), jobs, part, &Unwatched);
                folder
            })
            .collect();
        let merged = place(&format!("merged-{count}"));
        // A part that is missing leaves the rest, and can be added later.
        let first = merge(&parts[..1], &merged, false).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(first.complete, count == 1);
        let manifest = merge(&parts, &merged, false).unwrap_or_else(|e| panic!("{e}"));
        assert!(manifest.complete);
        assert_same(&place("whole"), &merged);
    }
    let error = merge(&[dir.path().join("nothing")], &place("x"), false).expect_err("no part");
    assert!(error.to_string().contains("nothing"), "{error}");
}

#[test]
fn a_part_cannot_place_files_outside_of_the_merged_dataset() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), RECIPE);
    let part = dir.path().join("part");
    run_part(&recipe, part.clone(), 1, Part::new(1, 2), &Unwatched);
    let journal = part.join(".facile/units/00000000.jsonl");
    let text = std::fs::read_to_string(&journal).expect("reads");
    for name in ["../stolen.png", "/tmp/stolen.png"] {
        std::fs::write(&journal, text.replace("images/000000.png", name)).expect("writes");
        let error = merge(
            std::slice::from_ref(&part),
            &dir.path().join("merged"),
            true,
        )
        .expect_err(name);
        assert!(error.to_string().contains("outside"), "{error}");
        assert!(!dir.path().join("stolen.png").exists());
    }
}

#[test]
fn tar_files_hold_what_the_folder_holds() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), &in_every_format());
    let output = dir.path().join("out");
    run(&recipe, output.clone(), 2, &Unwatched);
    let text = std::fs::read_to_string(output.join("annotations.jsonl")).expect("reads");
    let records: Vec<&str> = text.lines().collect();
    let mut samples = 0;
    for shard in 0..5 {
        let path = output.join(format!("webdataset/{shard:06}.tar"));
        let mut archive = tar::Archive::new(std::fs::File::open(path).expect("opens"));
        for entry in archive.entries().expect("a tar file") {
            let mut entry = entry.expect("a member");
            let name = entry.path().expect("a path").display().to_string();
            let mut bytes = Vec::new();
            std::io::Read::read_to_end(&mut entry, &mut bytes).expect("reads");
            let (stem, ending) = name.split_once('.').expect("an ending");
            let index: usize = stem.parse().expect("a number");
            match ending {
                "json" => {
                    assert_eq!(bytes, records[index].as_bytes());
                    assert_eq!(index / 5, shard);
                    samples += 1;
                }
                "png" => {
                    let file = output.join(format!("images/{stem}.png"));
                    assert_eq!(bytes, std::fs::read(file).expect("reads"));
                }
                _ => {
                    // Both lightings of a view have the map of the first, unless it shows light.
                    let kind = ending.strip_suffix(".png").expect("a map");
                    let first = if kind == "shadow" {
                        index
                    } else {
                        index / 2 * 2
                    };
                    let file = output.join(format!("{kind}/{first:06}.png"));
                    assert_eq!(bytes, std::fs::read(file).expect("reads"), "{name}");
                }
            }
        }
    }
    assert_eq!(samples, 24);
}

#[test]
fn coco_boxes_keypoints_and_masks_agree_with_the_records() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), &in_every_format());
    let output = dir.path().join("out");
    run(&recipe, output.clone(), 2, &Unwatched);
    let read = |name: &str| std::fs::read_to_string(output.join(name)).expect("reads");
    let coco: serde_json::Value = serde_json::from_str(&read("coco.json")).expect("JSON");
    let lists = |key: &str| coco[key].as_array().expect("a list").clone();
    let (images, annotations) = (lists("images"), lists("annotations"));
    let records: Vec<serde_json::Value> = read("annotations.jsonl")
        .lines()
        .map(|l| serde_json::from_str(l).expect("JSON"))
        .collect();
    assert_eq!((images.len(), annotations.len()), (24, 24));
    for ((record, image), annotation) in records.iter().zip(&images).zip(&annotations) {
        assert_eq!(image["file_name"], record["image"]);
        assert_eq!(annotation["image_id"], image["id"]);
        assert_eq!(
            annotation["keypoints"].as_array().expect("a list").len(),
            3 * 68
        );
        let px = &record["landmarks"]["ibug68"]["px"][30];
        assert_eq!(annotation["keypoints"][90], px[0]);
        let counts = annotation["segmentation"]["counts"]
            .as_array()
            .expect("a list");
        let runs: Vec<u64> = counts
            .iter()
            .map(|c| c.as_u64().expect("a number"))
            .collect();
        assert_eq!(runs.iter().sum::<u64>(), 48 * 40);
        let area: u64 = runs.iter().skip(1).step_by(2).sum();
        assert_eq!(annotation["area"], area);
        assert!(area > 100, "{area} pixels of face");
    }
}

#[test]
fn damage_is_found_and_only_what_is_missing_is_made_again() {
    let dir = tempfile::tempdir().expect("makes");
    let recipe = recipe(dir.path(), &in_every_format());
    let (good, hurt) = (dir.path().join("good"), dir.path().join("hurt"));
    run(&recipe, good.clone(), 2, &Unwatched);
    run(&recipe, hurt.clone(), 2, &Unwatched);
    assert_eq!(verify(&hurt).expect("reads").bad, []);

    let image = hurt.join("images/000007.png");
    let mut bytes = std::fs::read(&image).expect("reads");
    bytes[60] ^= 1;
    std::fs::write(&image, &bytes).expect("writes");
    let bad = verify(&hurt).expect("reads").bad;
    assert_eq!(bad.len(), 1);
    assert_eq!(bad[0].path, image);
    let sample = |n| verify_sample(&hurt, recipe.clone(), n).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(sample(6).bad, []);
    assert!(
        sample(7).bad[0].reason.contains("byte 60"),
        "{:?}",
        sample(7).bad
    );
    assert_eq!(sample_of_row(&hurt, 23).expect("there"), 23);
    assert!(sample_of_row(&hurt, 24).is_err());

    std::fs::remove_file(&image).expect("removes");
    let again = run(&recipe, hurt.clone(), 2, &Unwatched);
    // One file of five images.
    assert_eq!((again.kept, again.made), (19, 5));
    assert_same(&good, &hurt);
    let nothing = run(&recipe, hurt.clone(), 2, &Unwatched);
    assert_eq!((nothing.kept, nothing.made), (24, 0));
}

/// Checks that a schema names and describes every part of a value; objects of free keys are not looked into.
fn assert_described(schema: &serde_json::Value, value: &serde_json::Value, place: &str) {
    assert!(
        schema["description"].is_string(),
        "{place} is not described"
    );
    if let (Some(object), Some(known)) = (value.as_object(), schema["properties"].as_object()) {
        for (key, value) in object {
            let place = format!("{place}.{key}");
            // Occluders have numbers of their own kind.
            match known.get(key) {
                Some(schema) => assert_described(schema, value, &place),
                None => assert!(
                    place.starts_with("record.occluder") || key == "steps_per_mm",
                    "{place}"
                ),
            }
        }
        for key in schema["required"].as_array().into_iter().flatten() {
            let key = key.as_str().expect("a name");
            assert!(object.contains_key(key), "{place} lacks {key}");
        }
    }
    if let (Some(object), true) = (
        value.as_object(),
        schema["additionalProperties"].is_object(),
    ) {
        for (key, value) in object {
            assert_described(
                &schema["additionalProperties"],
                value,
                &format!("{place}.{key}"),
            );
        }
    }
    if let (Some(list), Some(n)) = (value.as_array(), schema["minItems"].as_u64()) {
        assert_eq!(list.len() as u64, n, "{place}");
    }
}

#[test]
fn the_schema_of_labels_describes_every_field_of_the_records() {
    let dir = tempfile::tempdir().expect("makes");
    let text = RECIPE.replace(
        "samples = 1",
        "samples = 4\nlandmarks = [\"ibug68\", \"wflw98\"]",
    );
    let lens = "[[view]]\naperture_mm = 20\n[[view]]\nprojection = \"orthographic\"\n[[view]]";
    let text = text.replace("[[view]]", lens);
    let recipe = recipe(dir.path(), &text);
    let output = dir.path().join("out");
    run(&recipe, output.clone(), 2, &Unwatched);
    let read = |name: &str| std::fs::read_to_string(output.join(name)).expect("reads");
    let schema: serde_json::Value =
        serde_json::from_str(&read("labels.schema.json")).expect("JSON");
    for line in read("annotations.jsonl").lines() {
        let record = serde_json::from_str(line).expect("JSON");
        assert_described(&schema, &record, "record");
    }
    let classes = schema["properties"]["maps"]["properties"]["segments"]["classes"].clone();
    assert_eq!(classes["7"], "nose");
}

#[test]
fn schemes_and_boxes_agree_with_each_other() {
    let dir = tempfile::tempdir().expect("makes");
    let text = RECIPE.replace("yaw_deg = [0, 25]", "yaw_deg = [0, 50]").replace(
        "samples = 1",
        "samples = 1\nbox_margin = 0.1\n\
         landmarks = [\"ibug68\", \"ibug51\", \"five\", \"wflw98\", \"ibug68_contour\", \"wflw98_contour\"]",
    );
    let recipe = recipe(dir.path(), &text);
    let output = dir.path().join("out");
    run(&recipe, output.clone(), 2, &Unwatched);
    let text = std::fs::read_to_string(output.join("annotations.jsonl")).expect("reads");
    for line in text.lines() {
        let record: serde_json::Value = serde_json::from_str(line).expect("JSON");
        let px = |scheme: &str| -> Vec<[f64; 2]> {
            serde_json::from_value(record["landmarks"][scheme]["px"].clone()).expect("points")
        };
        let (ibug, wflw) = (px("ibug68"), px("wflw98"));
        assert_eq!(px("ibug51"), ibug[17..]);
        for (a, b) in [
            (0, 0),
            (8, 16),
            (16, 32),
            (30, 54),
            (36, 60),
            (39, 64),
            (45, 72),
            (48, 76),
            (66, 94),
        ] {
            assert_eq!(ibug[a], wflw[b]);
        }
        // Pupils lie between the corners of their eyes.
        for (pupil, corners) in [(96, [60, 64]), (97, [68, 72])] {
            let x = wflw[pupil][0];
            assert!(
                x > wflw[corners[0]][0] - 1.0 && x < wflw[corners[1]][0] + 1.0,
                "{x}"
            );
        }
        let (contour, yaw) = (
            px("ibug68_contour"),
            record["head_pose"]["yaw_deg"].as_f64(),
        );
        assert_eq!(contour[17..], ibug[17..]);
        let moved = |i: usize| contour[i][0] - ibug[i][0];
        if yaw == Some(0.0) {
            // From the front the jaw is its contour, nearly.
            assert!(
                (0..17).all(|i| moved(i).abs() < 1.5),
                "{:?}",
                (0..17).map(moved).collect::<Vec<_>>()
            );
        } else {
            // The camera sees the subject's left side: its own jaw stays, the other one's contour lies further out.
            assert!(
                (0..8).all(|i| moved(i) <= 0.0) && moved(3) < -1.0,
                "{:?}",
                (0..17).map(moved).collect::<Vec<_>>()
            );
        }
        let corners =
            |key: &str| -> [f64; 4] { serde_json::from_value(record[key].clone()).expect("a box") };
        let (tight, square, margin) = (
            corners("face_box_px"),
            corners("face_square_px"),
            corners("face_margin_px"),
        );
        let side = (tight[2] - tight[0]).max(tight[3] - tight[1]);
        assert!(
            (square[2] - square[0] - side).abs() < 1e-3
                && (square[3] - square[1] - side).abs() < 1e-3
        );
        assert!((margin[0] - (square[0] - 0.1 * side)).abs() < 1e-3);
    }
}

#[test]
fn samples_and_contact_sheets_are_read_back_from_every_format() {
    let dir = tempfile::tempdir().expect("makes");
    let mut sheets = Vec::new();
    for format in ["folder", "webdataset", "parquet"] {
        let formats = format!("seed = 3\nformats = [\"{format}\"]\nimages_per_shard = 5");
        let recipe = recipe(dir.path(), &RECIPE.replace("seed = 3", &formats));
        let output = dir.path().join(format);
        run(&recipe, output.clone(), 2, &Unwatched);
        for index in [0, 7, 23] {
            let verdict = verify_sample(&output, recipe.clone(), index);
            let verdict = verdict.unwrap_or_else(|e| panic!("{format}: {e}"));
            assert!(verdict.bad.is_empty(), "{format}: {:?}", verdict.bad);
            assert!(verdict.files >= 2, "{format}: {} files", verdict.files);
        }
        let sheet = image::open(output.join("contact_sheet.png")).expect("opens");
        sheets.push(sheet.into_rgb8());
        // Every cell shows an image: none is grey all over.
        let sheet = &sheets[sheets.len() - 1];
        assert_eq!(sheet.dimensions(), (6 * 48, 4 * 48));
        for cell in 0..24 {
            let (x, y) = (cell % 6 * 48 + 24, cell / 6 * 48 + 24);
            assert_ne!(sheet.get_pixel(x, y).0, [128; 3], "{format}, cell {cell}");
        }
    }
    assert!(sheets.iter().all(|s| *s == sheets[0]));
}
