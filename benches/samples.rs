//! Time of a sample by what it shares with the one before, one thread: `cargo bench --bench samples`.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use facile::Recipe;
use facile::pipeline::{Pipeline, Worker};
use facile::write::Encoder;

const RECIPE: &str = r#"
[dataset]
name = "bench"
[image]
samples = 1
truth = ["landmarks", "segments", "depth"]
[subjects]
sampled = 2
[[expression]]
name = "smile"
intensities = [0.5, 1.0]
[[light]]
name = "left"
sources = [{ kind = "point", position = [500, 300, 800] }]
[[light]]
name = "right"
sources = [{ kind = "point", position = [-500, 300, 800] }]
[[view]]
yaw_deg = [-10, 10]
"#;

/// Alternates between two samples, so that everything between them is made anew each time.
fn alternate(c: &mut Criterion, name: &str, indices: [u64; 2]) {
    let recipe = Recipe::parse(RECIPE, Path::new("bench"), Path::new("")).expect("valid");
    let pipeline = Arc::new(Pipeline::new(recipe).expect("valid"));
    let mut worker = Worker::new(pipeline.clone());
    let mut turn = 0;
    let mut group = c.benchmark_group("samples");
    group.sample_size(10).throughput(Throughput::Elements(1));
    group.bench_function(name, |b| {
        b.iter(|| {
            turn ^= 1;
            let sample = worker.sample(indices[turn]).expect("a sample");
            black_box(
                Encoder::new(pipeline.recipe())
                    .encode(&sample)
                    .expect("encodes"),
            )
        });
    });
    group.finish();
}

fn samples(c: &mut Criterion) {
    // Mixed radix: subject, expression, view, lighting.
    alternate(c, "other_light", [0, 1]);
    alternate(c, "other_view", [0, 2]);
    alternate(c, "other_expression", [0, 4]);
    alternate(c, "other_subject", [0, 8]);
}

criterion_group!(benches, samples);
criterion_main!(benches);
