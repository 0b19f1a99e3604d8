//! The command line: arguments, and one file per command.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod bench;
mod r#gen;
mod merge;
mod output;
mod plan;
mod pose;
mod reference;
mod register;
mod render;
mod sheet;
mod verify;

/// Everything went well.
const DONE: u8 = 0;
/// Some samples could not be made, or a command failed at work.
const FAILED: u8 = 1;
/// Nothing was begun: a bad recipe or an output folder that cannot be used.
const REFUSED: u8 = 2;
/// Stopped by the user, as shells count it.
const INTERRUPTED: u8 = 130;

/// Labelled face datasets from 3D scans: registration, muscle simulation, ray tracing.
#[derive(Debug, Parser)]
#[command(name = "facile", version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Generate the dataset of a recipe; goes on where an interrupted run stopped.
    Gen(r#gen::Arguments),
    /// Say what a recipe makes: counts, what is shared and skipped, predicted time and disk space.
    Plan(plan::Arguments),
    /// Put the parts of a dataset together that `facile gen --shard` made.
    Merge(merge::Arguments),
    /// Check the files of a dataset against their hashes, or a sample against the recipe.
    Verify(verify::Arguments),
    /// Fit the reference head to a scan and write it as GLB.
    Register(register::Arguments),
    /// Make a reference head of one's own.
    Reference(reference::Arguments),
    /// Contract muscles of a subject, open the jaw, and write the equilibrium as GLB.
    Pose(pose::Arguments),
    /// Render a scene file: any meshes, one camera, any lights.
    Render(render::Arguments),
    /// Lay the images of a dataset out in one picture.
    Sheet(sheet::Arguments),
    /// Weigh run time against error: tables and curves.
    Bench(bench::Arguments),
    /// Print the JSON Schema of the recipe, for editors.
    Schema,
}

/// Runs the program with the process's arguments.
pub(crate) fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let result = match arguments.command {
        Command::Gen(a) => r#gen::run(&a),
        Command::Plan(a) => plan::run(&a),
        Command::Merge(a) => merge::run(&a),
        Command::Verify(a) => verify::run(&a),
        Command::Register(a) => register::run(&a),
        Command::Reference(a) => reference::run(&a),
        Command::Pose(a) => pose::run(&a),
        Command::Render(a) => render::run(&a),
        Command::Sheet(a) => sheet::run(&a),
        Command::Bench(a) => bench::run(&a),
        Command::Schema => schema(),
    };
    match result {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            output::error(&error);
            ExitCode::from(code_of(&error))
        }
    }
}

fn schema() -> anyhow::Result<u8> {
    output::line(&serde_json::to_string_pretty(&facile::recipe::schema())?);
    Ok(DONE)
}

/// The exit code of an error: a bad recipe or folder is refused before any work.
fn code_of(error: &anyhow::Error) -> u8 {
    use facile::Error;
    match error.downcast_ref::<Error>() {
        Some(Error::Recipe(_) | Error::Occupied { .. } | Error::Locked { .. }) => REFUSED,
        _ if error.is::<Refused>() => REFUSED,
        _ => FAILED,
    }
}

/// A command that cannot begin with these arguments.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Refused(String);

/// A recipe given on the command line.
#[derive(Clone, Debug, clap::Args)]
struct RecipeArgument {
    /// The recipe, a TOML file; see `facile schema`.
    recipe: PathBuf,
}

impl RecipeArgument {
    /// Reads and checks it. A recipe that cannot be read is refused like a bad one.
    fn load(&self) -> anyhow::Result<facile::Recipe> {
        match facile::Recipe::load(&self.recipe) {
            Err(facile::Error::Io { path, source }) => {
                Err(Refused(format!("{}: {source}", path.display())).into())
            }
            other => Ok(other?),
        }
    }
}
