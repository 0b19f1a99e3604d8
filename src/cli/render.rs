//! `facile render`

use std::path::PathBuf;

use facile::trace::scene_file::render_scene_file;

use super::{DONE, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Scene, a TOML file: meshes, camera, lights.
    scene: PathBuf,
    /// Folder for color.png, the label maps and scene.json.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// JSON file for the milliseconds of every step.
    #[arg(long, value_name = "FILE")]
    timing: Option<PathBuf>,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let timing = arguments.timing.as_deref();
    let report = render_scene_file(&arguments.scene, &arguments.output, timing)?;
    output::note(&format!(
        "{}: {} triangles, {:.1} ms per frame",
        arguments.output.display(),
        report.triangles,
        report.frame_ms.median,
    ));
    Ok(DONE)
}
