//! `facile merge`

use std::path::PathBuf;

use facile::write::merge;

use super::{DONE, FAILED, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Folders that `facile gen --shard` wrote, of one recipe.
    #[arg(required = true)]
    parts: Vec<PathBuf>,
    /// Folder of the whole dataset.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace the dataset of another recipe that the folder holds.
    #[arg(long)]
    overwrite: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let manifest = merge(&arguments.parts, &arguments.output, arguments.overwrite)?;
    let failed: u64 = manifest.failures.iter().map(|f| f.samples).sum();
    output::note(&format!(
        "{} of {} samples in {}{}",
        manifest.written,
        manifest.samples,
        arguments.output.display(),
        match failed {
            0 => String::new(),
            n => format!(", {n} failed"),
        }
    ));
    if !manifest.complete {
        let missing = manifest.samples - manifest.written - failed;
        output::note(&format!(
            "{missing} samples are in none of the parts: finish them, then merge again"
        ));
    }
    Ok(if manifest.complete && failed == 0 {
        DONE
    } else {
        FAILED
    })
}
