//! `facile sheet`

use std::path::PathBuf;

use facile::sheet::{Cell, SheetSettings, sheet};

use super::{DONE, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Folder of a dataset.
    dataset: PathBuf,
    /// Picture to write; its ending says the format.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Number of columns.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    columns: Option<u16>,
    /// Width and height of each cell in pixels.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(4..=4096))]
    cell: Option<u32>,
    /// What to show of each sample, in this order, separated by commas.
    #[arg(long, value_name = "KIND", value_delimiter = ',', default_value = "image", value_parser = cell)]
    show: Vec<Cell>,
    /// Only samples whose record holds this value, such as expression.name=smile; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", value_parser = key_value)]
    only: Vec<(String, String)>,
    /// At most N samples.
    #[arg(long, value_name = "N", default_value_t = 400)]
    limit: usize,
}

fn cell(name: &str) -> Result<Cell, String> {
    let known = Cell::ALL.iter().find(|(n, _)| *n == name);
    known.map(|(_, c)| *c).ok_or_else(|| {
        let names: Vec<&str> = Cell::ALL.iter().map(|(n, _)| *n).collect();
        format!("allowed: {}", names.join(", "))
    })
}

fn key_value(text: &str) -> Result<(String, String), String> {
    let (key, value) = text.split_once('=').ok_or("expected KEY=VALUE")?;
    Ok((key.to_owned(), value.to_owned()))
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let settings = SheetSettings {
        columns: arguments.columns.map(usize::from),
        cell: arguments.cell,
        show: arguments.show.clone(),
        only: arguments.only.clone(),
        limit: arguments.limit,
    };
    let picture = sheet(&arguments.dataset, &settings)?;
    let path = arguments.output.display();
    picture
        .save(&arguments.output)
        .map_err(|e| anyhow::anyhow!("{path}: {e}"))?;
    let (width, height) = picture.dimensions();
    output::note(&format!("{path}: {width} x {height}"));
    Ok(DONE)
}
