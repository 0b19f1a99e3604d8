//! Time against error on a scene file, as CSV: `scene SCENE.toml [REFERENCE.png [REPEATS]]`. Without arguments nothing runs.

use std::io::Write as _;
use std::path::Path;

use facile_core::io::{decode_texture, read_file};
use facile_trace::{Samples, bench_scene_file};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(scene) = arguments.first().filter(|a| !a.starts_with('-')) else {
        return Ok(());
    };
    let reference = match arguments.get(1).map(Path::new) {
        Some(path) => Some(decode_texture(&read_file(path)?, path)?),
        None => None,
    };
    let repeats = arguments.get(2).map_or(Ok(11), |n| n.parse())?;
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "variant,samples,instructions,ms_median,ms_min,ms_max,rmse"
    )?;
    for row in bench_scene_file(Path::new(scene), reference.as_ref(), repeats)? {
        let samples = match row.samples {
            Samples::Count(count) => count.to_string(),
            Samples::Adaptive(_) => "adaptive".to_owned(),
        };
        let (ms, rmse) = (row.ms, row.rmse);
        writeln!(
            out,
            "{},{samples},{},{:.2},{:.2},{:.2},{rmse:.3}",
            row.variant, row.instructions, ms.median, ms.min, ms.max
        )?;
    }
    Ok(())
}
