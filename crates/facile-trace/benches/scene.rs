//! Renders a scene file and writes its timings: `scene SCENE.toml OUT_DIR [TIMING.json]`.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, out, rest @ ..] = &arguments[..] else {
        return Ok(());
    };
    let timing = rest.first().map(Path::new);
    facile_trace::render_scene_file(Path::new(scene), Path::new(out), timing)?;
    Ok(())
}
