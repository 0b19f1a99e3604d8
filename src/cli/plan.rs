//! `facile plan`

use facile::predict::{Prediction, predict};
use facile::recipe::Recipe;

use super::{DONE, RecipeArgument, output};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    recipe: RecipeArgument,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Predict for this number of threads; every processor if not given.
    #[arg(short, long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Count only: make no samples to measure time and disk space.
    #[arg(long)]
    counts: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<u8> {
    let recipe = arguments.recipe.load()?;
    let threads = match arguments.jobs {
        Some(n) => usize::from(n),
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    let prediction = predict(&recipe, threads, !arguments.counts)?;
    if arguments.json {
        output::line(&serde_json::to_string_pretty(&prediction)?);
    } else {
        print(&recipe, &prediction);
    }
    Ok(DONE)
}

fn print(recipe: &Recipe, p: &Prediction) {
    let image = &recipe.image;
    let (grid, work) = (&p.grid, &p.work);
    let s = &recipe.subjects;
    output::line(&format!(
        "{}: {} images of {} x {} to {}",
        p.name,
        p.images,
        image.width,
        image.height,
        recipe.output.display()
    ));
    output::line(&format!(
        "  {} of {} subjects ({} scans, {} built-in, {} sampled) x {} {} x {} occluders x {} views x {} lights",
        grid.subjects.min(s.len()),
        s.len(),
        s.scans.len(),
        s.builtin.len(),
        s.sampled,
        grid.expressions,
        if recipe.sampling.is_some() {
            "poses"
        } else {
            "expressions"
        },
        grid.occluders,
        grid.views,
        grid.lightings
    ));
    output::line(&format!(
        "  register {} scans, {} of them in the cache",
        work.registrations, work.cached_registrations
    ));
    output::line(&format!(
        "  solve {} equilibria; {} faces at rest are not simulated",
        work.equilibria, work.faces_at_rest
    ));
    output::line(&format!(
        "  trace {} views, each for {} lights; light {} images",
        work.traced_views, grid.lightings, work.lit_images
    ));
    if let Some(cost) = &p.cost {
        output::line(&format!(
            "  predicted: {} on {} threads, {}",
            time(cost.seconds),
            cost.threads,
            size(cost.bytes)
        ));
    }
}

fn time(seconds: f64) -> String {
    match seconds {
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 6_000.0 => format!("{:.0} min", s / 60.0),
        s if s < 360_000.0 => format!("{:.1} h", s / 3_600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

fn size(bytes: f64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB", "PB"];
    let mut value = bytes;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1_000.0;
        unit += 1;
    }
    format!("{value:.0} {}", units[unit])
}
