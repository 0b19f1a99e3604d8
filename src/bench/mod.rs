//! Benchmarks that weigh run time against error, as tables (CSV) and curves (SVG): `facile bench`.
//!
//! One file per crate that is measured. Times are medians; they and nothing else differ from run to run.

use std::path::Path;

use crate::Error;

mod curve;
mod engine;
mod flow;
mod resolution;
mod sim;
mod table;
mod trace;

pub use curve::{Axis, Curve};
pub use engine::{engine, savings};
pub use flow::flow;
pub use sim::sim;
pub use table::{Field, Table};
pub use trace::trace;

/// How long a benchmark may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// Seconds: does it run at all?
    Quick,
    /// Minutes: the figures of the docs.
    Full,
}

impl Effort {
    /// `quick` or `full`, by this effort.
    fn of<T>(self, quick: T, full: T) -> T {
        match self {
            Self::Quick => quick,
            Self::Full => full,
        }
    }
}

/// What a benchmark found.
#[derive(Clone, Debug)]
pub struct Findings {
    /// Tables, by the name of their file without its ending.
    pub tables: Vec<(&'static str, Table)>,
    /// Plots likewise: title, axes, curves.
    pub plots: Vec<(&'static str, Plot)>,
}

/// Curves over common axes.
#[derive(Clone, Debug)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// Plots by the name of their file.
type Plots = Vec<(&'static str, Plot)>;

impl Findings {
    /// Writes `NAME.csv` and `NAME.svg` into a folder, which is made if need be.
    ///
    /// # Errors
    /// [`Error::Io`] with the file.
    pub fn save(&self, folder: &Path) -> Result<(), Error> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        for (name, table) in &self.tables {
            let path = folder.join(format!("{name}.csv"));
            std::fs::write(&path, table.to_csv()).map_err(|e| Error::io(&path, e))?;
        }
        for (name, plot) in &self.plots {
            let path = folder.join(format!("{name}.svg"));
            let text = curve::plot(plot);
            std::fs::write(&path, text).map_err(|e| Error::io(&path, e))?;
        }
        Ok(())
    }
}

/// Milliseconds of wall time that `work` takes, and what it gives.
fn clock<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = std::time::Instant::now();
    let done = work();
    (1e3 * start.elapsed().as_secs_f64(), done)
}

/// The middle value of some times.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
