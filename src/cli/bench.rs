//! `facile bench`

use std::path::PathBuf;

use facile::bench::{self, Effort, Findings};

use super::{DONE, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// What to measure; everything if not given.
    #[arg(value_name = "WHAT")]
    what: Vec<What>,
    /// Folder for the tables (CSV) and plots (SVG).
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Scene file for `trace`, which is left out without one.
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// Image that the scene should give; its own rendering with 256 samples if not given.
    #[arg(long, value_name = "IMAGE", requires = "scene")]
    reference: Option<PathBuf>,
    /// Folder of scans of one topology for `flow`, as `bench/peers/ict_scans.py` writes it: their transfer error is measured
    /// too.
    #[arg(long, value_name = "DIR")]
    scans: Option<PathBuf>,
    /// Only see that it runs: few repetitions, few cases.
    #[arg(long)]
    quick: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum What {
    /// Registration: error against time, on people of known truth.
    Flow,
    /// Solvers: error against time, and random poses.
    Sim,
    /// The tracer: error against time on a scene file.
    Trace,
    /// Whole runs: images a second.
    Gen,
    /// Whole runs without each saving.
    Savings,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let effort = if arguments.quick {
        Effort::Quick
    } else {
        Effort::Full
    };
    let mut what = arguments.what.clone();
    if what.is_empty() {
        what = vec![What::Flow, What::Sim, What::Trace, What::Gen, What::Savings];
    }
    for what in what {
        let findings = match what {
            What::Flow => bench::flow(arguments.scans.as_deref(), effort)?,
            What::Sim => bench::sim(effort)?,
            What::Trace => match &arguments.scene {
                Some(scene) => bench::trace(scene, arguments.reference.as_deref(), effort)?,
                None => {
                    output::note(&"trace is left out: give a scene file with --scene");
                    continue;
                }
            },
            What::Gen => bench::engine(effort)?,
            What::Savings => bench::savings(effort)?,
        };
        tell(&findings);
        findings.save(&arguments.output)?;
    }
    Ok(DONE)
}

fn tell(findings: &Findings) {
    for (name, table) in &findings.tables {
        output::line(&format!("{name}\n{}", table.to_text()));
    }
}
