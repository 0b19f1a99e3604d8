//! Maps and cameras that a recipe asks for, against what they must be.

use std::path::Path;
use std::sync::Arc;

use facile::Recipe;
use facile::core::{ReferenceHead, Segment};
use facile::generate::{Options, Unwatched, generate};
use facile::pipeline::{Pipeline, Sample, Skips, Worker};
use facile::sheet::{Cell, SheetSettings, sheet};

const RECIPE: &str = r#"
[dataset]
name = "labels"
seed = 5

[image]
size = [160, 160]
samples = 1
landmarks = ["dense", "ibug68"]
truth = ["landmarks", "segments", "depth", "instances", "reference", "albedo", "shadow"]

[subjects]
sampled = 1

[hair]
on = []

[[light]]
name = "even"
sources = [{ kind = "ambient", intensity = 0.9 }]

[[light]]
name = "side"
sources = [{ kind = "directional", direction = [-1, -0.8, -0.5], intensity = 0.9 }]

[[view]]
yaw_deg = [20]
"#;

fn samples(recipe: &str) -> Vec<Sample> {
    let recipe = Recipe::parse(recipe, Path::new("labels.toml"), Path::new("")).expect("valid");
    let count = recipe.views.len() * recipe.lightings.len() * recipe.occluders.len();
    let mut worker = Worker::new(Arc::new(Pipeline::new(recipe).expect("valid")));
    let count = count as u64;
    (0..count)
        .map(|i| worker.sample(i).expect("makes"))
        .collect()
}

#[test]
fn reference_coordinates_are_those_of_the_vertices_that_are_seen() {
    let sample = &samples(RECIPE)[0];
    let map = sample.maps.reference.as_ref().expect("asked for");
    let dense = &sample.record.landmarks["dense"];
    let vertices = &ReferenceHead::embedded().mesh.positions;
    assert_eq!(dense.px.len(), vertices.len());
    let (mut checked, mut folded, mut sum) = (0, 0, 0.0);
    for ((px, visibility), vertex) in dense.px.iter().zip(&dense.visibility).zip(vertices) {
        if *visibility != "visible" {
            continue;
        }
        // Between the centres of four pixels of skin the map is even, unless it crosses an outline
        let [x, y] = px.map(|v| (v - 0.5).floor());
        if !(0.0..159.0).contains(&x) || !(0.0..159.0).contains(&y) {
            continue;
        }
        let (fx, fy) = (px[0] - 0.5 - x, px[1] - 0.5 - y);
        let at = |dx: usize, dy: usize| map[(x as usize + dx, y as usize + dy)].map(f64::from);
        let corners = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let weights = [
            (1.0 - fx) * (1.0 - fy),
            fx * (1.0 - fy),
            (1.0 - fx) * fy,
            fx * fy,
        ];
        let span = |k: usize| {
            let values = corners.map(|c| c[k]);
            values.into_iter().fold(f64::MIN, f64::max)
                - values.into_iter().fold(f64::MAX, f64::min)
        };
        if corners.iter().flatten().any(|v| v.is_nan()) || span(0) > 6.0 || span(1) > 0.1 {
            continue;
        }
        let mixed = |k: usize| {
            corners
                .iter()
                .zip(weights)
                .map(|(c, w)| c[k] * w)
                .sum::<f64>()
        };
        let phi = vertex.x.atan2(vertex.z);
        let radius = vertex.x.hypot(vertex.z);
        let (h_off, phi_off) = ((mixed(0) - vertex.y).abs(), (mixed(1) - phi).abs());
        // Landmarks count as seen up to 1 mm behind the skin, as in folds of lids
        folded += i32::from(h_off > span(0) + 0.05 || phi_off > span(1) + 1e-3);
        sum += h_off.hypot(phi_off * radius);
        checked += 1;
    }
    assert!(
        checked > 1_500 && folded < checked / 100,
        "{folded} of {checked}"
    );
    let mean = sum / f64::from(checked);
    assert!(mean < 0.2, "{mean} mm");
}

#[test]
fn shadows_are_each_images_own_and_other_maps_are_shared() {
    let samples = samples(RECIPE);
    let shadow = |i: usize| samples[i].shadow.as_ref().expect("asked for").as_slice();
    // Nothing that ambient light could be kept from arrives all over
    assert!(shadow(0).iter().all(|v| *v == 255));
    let segments = samples[1].maps.segments.as_ref().expect("asked for");
    let dark = shadow(1).iter().filter(|v| **v < 2).count();
    assert!(dark > 150, "nose and chin throw shadows: {dark}");
    // Where nothing of a light from one side arrives, the image is black
    let image = samples[1].image.as_slice().iter().zip(shadow(1));
    let mut in_shadow = image
        .zip(segments.as_slice())
        .filter(|((_, v), s)| **v == 0 && **s == Segment::Clothes.id());
    assert!(in_shadow.all(|((rgb, _), _)| *rgb == [0; 3]));
    let file = |i: usize, kind: &str| samples[i].record.maps[kind].file.clone();
    assert_eq!(
        [file(0, "shadow"), file(1, "shadow")],
        ["shadow/000000.png", "shadow/000001.png"]
    );
    assert_eq!(
        [file(0, "albedo"), file(1, "albedo")],
        ["albedo/000000.png"; 2]
    );
    assert!(Arc::ptr_eq(&samples[0].maps, &samples[1].maps));
}

#[test]
fn albedo_is_the_colour_that_was_given_whatever_the_light() {
    let recipe = RECIPE.replace("[[view]]", "[clothes]\ncolors = [[180, 60, 30]]\n[[view]]");
    let sample = &samples(&recipe)[1];
    let albedo = sample.maps.albedo.as_ref().expect("asked for").as_slice();
    let segments = sample.maps.segments.as_ref().expect("asked for").as_slice();
    let shirt = [180, 60, 30].map(|c: u8| facile::core::color::LINEAR_FROM_SRGB8[usize::from(c)]);
    let mut seen = [0; 2];
    for (albedo, segment) in albedo.iter().zip(segments) {
        if *segment == Segment::Clothes.id() {
            assert_eq!(albedo.map(f32::to_bits), shirt.map(f32::to_bits));
            seen[0] += 1;
        } else if *segment == 0 {
            assert_eq!(*albedo, [0.0; 3]);
            seen[1] += 1;
        }
    }
    assert!(seen[0] > 500 && seen[1] > 500, "{seen:?}");
}

#[test]
fn bodies_of_occluders_are_numbered_and_classed() {
    let kinds = [
        "none",
        "glasses",
        "surgical_mask",
        "hand",
        "bar",
        "cap",
        "fringe",
    ];
    let tables = kinds
        .map(|k| format!("[[occluder]]\nkind = \"{k}\"\n"))
        .concat();
    let recipe = format!("{RECIPE}\n{tables}").replace("on = []", "styles = [\"short03\"]");
    let samples = samples(&recipe);
    for (i, kind) in kinds.into_iter().enumerate() {
        let maps = &samples[2 * i].maps;
        let bodies = maps.instances.as_ref().expect("asked for").as_slice();
        let segments = maps.segments.as_ref().expect("asked for").as_slice();
        let mut seen = [0; 3];
        for (body, segment) in bodies.iter().zip(segments) {
            let class = Segment::from_id(*segment).expect("a class");
            let expected = match class {
                Segment::GlassesLens => 2,
                _ if class.is_occluder() => 1,
                _ => 0,
            };
            assert_eq!(*body, expected, "{kind}: {class:?}");
            seen[usize::from(*body)] += 1;
            if *body == 1 && kind != "glasses" {
                assert_eq!(class.name(), kind);
            }
        }
        assert_eq!(
            [seen[1] > 20, seen[2] > 20],
            [kind != "none", kind == "glasses"],
            "{kind}"
        );
    }
}

#[test]
fn an_orthographic_view_has_the_scale_of_its_target_everywhere() {
    let recipe = RECIPE.replace("[[view]]", "[[view]]\nprojection = \"orthographic\"");
    let sample = &samples(&recipe)[0];
    let camera = &sample.record.camera;
    assert_eq!(camera.projection, Some("orthographic"));
    let image_height = 2.0 * 900.0 * 9.0_f64.to_radians().tan();
    let scale = 160.0 / image_height;
    assert!((camera.K[0][0] - scale).abs() < 1e-9 && (camera.K[1][1] - scale).abs() < 1e-9);
    let depth = sample.maps.depth_z.as_ref().expect("asked for");
    let mut on_skin = 0;
    let marks = &sample.record.landmarks["ibug68"];
    for ((px, mm), seen) in marks.px.iter().zip(&marks.mm).zip(&marks.visibility) {
        let v: [f64; 3] = std::array::from_fn(|i| {
            (0..3).map(|j| camera.R[i][j] * mm[j]).sum::<f64>() + camera.t_mm[i]
        });
        for axis in 0..2 {
            let k = camera.K[axis];
            let found = k[0] * v[0] + k[1] * v[1] + k[2];
            assert!(
                (found - px[axis]).abs() < 0.01,
                "{found} against {}",
                px[axis]
            );
        }
        // The map's depth is that of the landmark
        if *seen == "visible" {
            let [x, y] = px.map(|p| p.floor() as usize);
            let near =
                (x.saturating_sub(1)..=x + 1).flat_map(|x| [y - 1, y, y + 1].map(|y| (x, y)));
            let off = near.map(|at| (f64::from(depth[at]) - v[2]).abs());
            on_skin += i32::from(off.fold(f64::INFINITY, f64::min) < 1.5);
        }
    }
    assert!(on_skin > 40, "{on_skin}");
}

#[test]
fn a_lens_blurs_the_image_and_leaves_the_labels_alone() {
    let dense = RECIPE.replace("samples = 1", "samples = 8");
    let soft = dense.replace("[[view]]", "[[view]]\naperture_mm = 40");
    let (sharp, soft) = (samples(&dense), samples(&soft));
    for (a, b) in sharp.iter().zip(&soft) {
        assert_ne!(a.image, b.image);
        assert_eq!(a.maps.segments, b.maps.segments);
        assert_eq!(a.maps.depth_z, b.maps.depth_z);
        assert_eq!(a.shadow, b.shadow);
        assert_eq!(a.record.landmarks, b.record.landmarks);
        assert_eq!(
            (b.record.camera.aperture_mm, a.record.camera.aperture_mm),
            (Some(40.0), None)
        );
        assert!(
            b.record
                .camera
                .focus_mm
                .is_some_and(|f| (700.0..900.0).contains(&f))
        );
    }
    let wrong = [
        (
            "samples = 1",
            "samples = 1",
            "aperture_mm = 40",
            "number of samples",
        ),
        (
            "samples = 1",
            "samples = \"adaptive\"",
            "aperture_mm = 40",
            "number of samples",
        ),
        (
            "samples = 1",
            "samples = 8",
            "aperture_mm = 40\nprojection = \"orthographic\"",
            "has no lens",
        ),
        ("samples = 1", "samples = 8", "focus_mm = 700", "in focus"),
        (
            "samples = 1",
            "samples = 8",
            "aperture_mm = 400",
            "aperture_mm must be from",
        ),
    ];
    for (from, to, view, message) in wrong {
        let text = RECIPE
            .replace(from, to)
            .replace("[[view]]", &format!("[[view]]\n{view}"));
        let error = Recipe::parse(&text, Path::new("labels.toml"), Path::new("")).expect_err(view);
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn shut_lids_hide_the_eye_from_every_side() {
    let recipe = RECIPE
        .replace("[160, 160]", "[320, 320]")
        .replace("sampled = 1", "builtin = [\"amara\"]\nsampled = 2")
        .replace(
            "[hair]",
            "[[expression]]\nname = \"blink\"\n\n[hair]\nlashes = false",
        )
        .replace(
            "yaw_deg = [20]",
            "yaw_deg = [-60, 0, 30, 60]\npitch_deg = [-30, 0, 30]",
        );
    let recipe = Recipe::parse(&recipe, Path::new("blink.toml"), Path::new("")).expect("valid");
    // Eyes behind shut lids are left out; here they are there, so that a gap shows.
    let skips = Skips {
        closed_eyes: false,
        ..Skips::default()
    };
    let pipeline = Pipeline::with(recipe, skips).expect("valid");
    let (mut worker, images) = (Worker::new(Arc::new(pipeline)), 3 * 12);
    let eye = [
        Segment::LeftEye,
        Segment::RightEye,
        Segment::LeftIris,
        Segment::RightIris,
    ]
    .map(|s| s as u8);
    let mut pixels = 0;
    for i in 0..images {
        // One of the two lights is enough.
        let sample = worker.sample(2 * i).expect("makes");
        let segments = sample.maps.segments.as_ref().expect("asked for");
        let seen = segments
            .as_slice()
            .iter()
            .filter(|s| eye.contains(s))
            .count();
        assert!(seen <= 2, "sample {i}: {seen} pixels of an eye");
        pixels += seen;
    }
    assert!(pixels <= 4, "{pixels} pixels of eyes in {images} images");
}

#[test]
fn a_sheet_shows_every_map() {
    let all = "[\"landmarks\", \"segments\", \"depth\", \"normals\", \"visibility\", \"occlusion\", \"amodal\", \
        \"layers\", \"coverage\", \"instances\", \"reference\", \"albedo\", \"shadow\"]";
    let asked = RECIPE
        .lines()
        .find(|l| l.starts_with("truth"))
        .expect("asked");
    let recipe =
        RECIPE.replace(asked, &format!("truth = {all}")) + "\n[[occluder]]\nkind = \"glasses\"\n";
    let recipe = Recipe::parse(&recipe, Path::new("sheet.toml"), Path::new("")).expect("valid");
    let dir = tempfile::tempdir().expect("makes");
    let options = Options {
        output: Some(dir.path().join("out")),
        ..Options::default()
    };
    generate(&recipe, &options, &Unwatched).expect("makes");
    let mut seen = Vec::new();
    for (name, cell) in Cell::ALL {
        let settings = SheetSettings {
            show: vec![cell],
            only: vec![("light.name".to_owned(), "side".to_owned())],
            ..SheetSettings::default()
        };
        let picture =
            sheet(&dir.path().join("out"), &settings).unwrap_or_else(|e| panic!("{name}: {e}"));
        let first = picture.get_pixel(0, 0);
        assert!(picture.pixels().any(|p| p != first), "{name} shows nothing");
        assert!(!seen.contains(&picture), "{name} shows what another shows");
        seen.push(picture);
    }
}
