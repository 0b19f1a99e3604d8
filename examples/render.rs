//! Makes single samples of a recipe without writing a dataset: `cargo run --release --example render -- OUT_DIR`.
//!
//! A sample is a function of (recipe, index): any one can be made alone, with its record and its maps.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use facile::Recipe;
use facile::pipeline::{Pipeline, Worker};
use facile::write::Encoder;

const RECIPE: &str = r#"
[dataset]
name = "example"
seed = 11

[image]
size = [320, 320]
truth = ["landmarks", "segments"]

[subjects]
sampled = 3

[[expression]]
name = "smile"

[[view]]
yaw_deg = [-30, 0, 30]

[[occluder]]
kind = "glasses"
"#;

fn main() -> Result<(), Box<dyn Error>> {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        return Err("usage: render OUT_DIR".into());
    };
    let recipe = Recipe::parse(RECIPE, Path::new("example"), Path::new(""))?;
    let pipeline = Arc::new(Pipeline::new(recipe)?);
    let mut worker = Worker::new(pipeline.clone());
    // The middle view of each subject.
    for index in [1, 4, 7] {
        let sample = worker.sample(index)?;
        let encoded = Encoder::new(pipeline.recipe()).encode(&sample)?;
        for (name, bytes) in encoded.files() {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap_or(&folder))?;
            std::fs::write(path, bytes)?;
        }
        let chin = sample.record.landmarks["ibug68"].px[8];
        eprintln!("{}: the chin is at {chin:?}", sample.record.image);
    }
    Ok(())
}
