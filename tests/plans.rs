//! What a plan predicts is what a run does.

mod common;

use std::path::Path;

use common::files;
use facile::Recipe;
use facile::generate::{Options, Unwatched, generate};
use facile::predict::predict;

const RECIPE: &str = r#"
[dataset]
name = "plan"
seed = 4
FORMATS

[image]
size = [64, 64]
samples = 1
truth = ["landmarks", "segments", "depth"]

[subjects]
sampled = 2

[[expression]]
name = "neutral"

[[light]]
name = "front"
sources = [{ kind = "point", position = [100, 200, 800] }]

[[light]]
name = "even"
sources = [{ kind = "ambient", intensity = 0.8 }]

[[view]]
yaw_deg = [-40, -20, 0, 20, 40]

[[occluder]]
kind = "none"

[[occluder]]
kind = "glasses"
"#;

#[test]
fn disk_space_is_predicted_to_a_quarter_in_every_format() {
    for format in ["folder", "webdataset", "parquet"] {
        let dir = tempfile::tempdir().expect("makes");
        let text = RECIPE.replace("FORMATS", &format!("formats = [\"{format}\"]"));
        let recipe = Recipe::parse(&text, Path::new("plan.toml"), Path::new("")).expect("valid");
        let plan = predict(&recipe, 1, true).expect("predicts");
        let cost = plan.cost.expect("measured");
        let options = Options {
            output: Some(dir.path().join("out")),
            jobs: Some(1),
            ..Options::default()
        };
        let summary = generate(&recipe, &options, &Unwatched).expect("runs");
        assert_eq!((plan.images, summary.made), (40, 40));
        let effort = &summary.effort.stages;
        assert_eq!(
            (
                plan.work.traced_views,
                plan.work.lit_images,
                plan.work.people
            ),
            (effort["tracing"], effort["shading"], effort["people"])
        );
        // The card, its picture of 24 images and the descriptions are no part of what grows.
        let fixed = [
            "dataset_card.md",
            "contact_sheet.png",
            "croissant.json",
            "labels.schema.json",
            "manifest.json",
        ];
        let bytes: usize = files(&dir.path().join("out"))
            .iter()
            .filter(|(name, _)| !fixed.iter().any(|f| name.ends_with(f)))
            .map(|(_, bytes)| bytes.len())
            .sum();
        let ratio = cost.bytes / bytes as f64;
        assert!(
            (0.8..1.25).contains(&ratio),
            "{format}: {} against {bytes}",
            cost.bytes
        );
        // A view's time is a difference, nothing where the clock is coarse or another program takes the processor.
        assert!(
            cost.seconds > 0.0 && cost.view_s >= 0.0 && cost.image_s > 0.0,
            "{cost:?}"
        );
    }
}
