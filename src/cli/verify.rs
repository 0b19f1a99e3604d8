//! `facile verify`

use std::path::PathBuf;

use facile::Recipe;
use facile::verify::{sample_of_row, verify, verify_sample};

use super::{DONE, FAILED, Refused, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Folder of a dataset.
    dataset: PathBuf,
    /// Make this sample again from the recipe and compare its bytes, instead of checking the hashes of all files.
    #[arg(long, value_name = "N", requires = "recipe")]
    sample: Option<u64>,
    /// The same for the sample in this line of annotations.jsonl, counted from 0.
    #[arg(long, value_name = "K", requires = "recipe", conflicts_with = "sample")]
    row: Option<u64>,
    /// The recipe of the dataset.
    #[arg(long, value_name = "FILE")]
    recipe: Option<PathBuf>,
    /// Remove the files that are damaged, so that `facile gen` makes them again.
    #[arg(long, conflicts_with_all = ["sample", "row"])]
    remove_damaged: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let root = &arguments.dataset;
    let sample = match arguments.row {
        Some(row) => Some(sample_of_row(root, row)?),
        None => arguments.sample,
    };
    let verdict = match (sample, &arguments.recipe) {
        (Some(sample), Some(path)) => {
            let recipe = Recipe::load(path).map_err(|e| Refused(e.to_string()))?;
            verify_sample(root, recipe, sample)?
        }
        _ => verify(root)?,
    };
    for bad in &verdict.bad {
        output::note(&format!("{}: {}", bad.path.display(), bad.reason));
        if arguments.remove_damaged && bad.path.exists() {
            std::fs::remove_file(&bad.path)?;
        }
    }
    let manifest = &verdict.manifest;
    let failed: u64 = manifest.failures.iter().map(|f| f.samples).sum();
    let what = match sample {
        Some(n) => format!("sample {n}, made again"),
        None => format!(
            "{} of {} samples, {failed} failed",
            manifest.written, manifest.samples
        ),
    };
    output::note(&format!(
        "{}: {what}; {} files checked, {} bad",
        root.display(),
        verdict.files,
        verdict.bad.len(),
    ));
    let is_whole = sample.is_some() || manifest.complete;
    if !is_whole {
        output::note(&"the dataset is not finished: run `facile gen` again");
    }
    Ok(if verdict.bad.is_empty() && is_whole {
        DONE
    } else {
        FAILED
    })
}
