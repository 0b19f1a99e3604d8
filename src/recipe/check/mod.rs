//! From the file's tables to checked settings: `[dataset]`, `[image]`, `[subjects]`. The other
//! tables have files of their own, named after them.

use std::ops::RangeInclusive;
use std::path::{Component, Path, PathBuf};

use facile_core::{HairStyle, builtin};
use facile_trace::Samples;

use crate::pipeline::Scheme;
use crate::recipe::file::{
    DatasetTable, Format, HairTable, ImageTable, RecipeFile, SamplesTable, SubjectsTable, Truth,
};
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::{HairSettings, ImageSettings, Recipe, Subjects};

use background::{Surroundings, backgrounds};
use expression::expressions;
use light::lightings;
use occluder::occluders;
use sampling::sampling;
use value::{in_range, matching_files};
use view::{check_lenses, jpeg_quality, sensor, views};

pub(super) mod background;
mod expression;
pub(super) mod light;
mod occluder;
mod sampling;
mod value;
mod view;

/// Limits that protect against typing errors, not against large datasets.
const MAX_IMAGES: u64 = 1_000_000_000_000;
const MAX_SAMPLED: i64 = 1_000_000_000;
const IMAGES_PER_SHARD: RangeInclusive<i64> = 1..=1_000_000;
const IMAGE_SIDE: RangeInclusive<i64> = 8..=8192;

/// Checks every value of a recipe. `base` is the folder that globs of scans are relative to.
pub(crate) fn check(file: RecipeFile, base: &Path) -> Result<Recipe, Problem> {
    let root = Place::default();
    check_dataset(&file, &root.key("dataset"))?;
    let surroundings = Surroundings::new(base);
    let mut recipe = Recipe {
        name: file.dataset.name.clone(),
        seed: file.dataset.seed,
        output: PathBuf::from(&file.dataset.output),
        formats: formats(&file.dataset),
        images_per_shard: file.dataset.images_per_shard as u64,
        coco: file.dataset.coco,
        image: image(&file.image, &root.key("image"))?,
        subjects: subjects(&file.subjects, &root.key("subjects"), base)?,
        hair: hair(&file.hair, &root.key("hair"))?,
        clothes: file.clothes.clone(),
        solver: file.simulation.solver.into(),
        sensor: sensor(&file.sensor, &root.key("sensor"))?,
        jpeg_quality: jpeg_quality(&file.sensor, &root.key("sensor"))?,
        expressions: expressions(&file.expressions, &root.key("expression"))?,
        occluders: occluders(&file.occluders, base, &root.key("occluder"))?,
        views: views(&file.views, &root.key("view"))?,
        lightings: lightings(&file.lights, &surroundings, &root.key("light"))?,
        backgrounds: backgrounds(&file.backgrounds, &surroundings, &root.key("background"))?,
        sampling: None,
        file,
    };
    check_lenses(&recipe.file.views, &recipe.image, &root.key("view"))?;
    if let Some(table) = &recipe.file.sampling {
        recipe.sampling = Some(sampling(table, &recipe, &root.key("sampling"))?);
        return Ok(recipe);
    }
    let lists = [
        recipe.expressions.len(),
        recipe.occluders.len(),
        recipe.views.len(),
        recipe.lightings.len(),
    ];
    let images = lists.iter().try_fold(recipe.subjects.len(), |product, n| {
        product.checked_mul(*n as u64)
    });
    if images.is_none_or(|n| n > MAX_IMAGES) {
        let message = format!("the grid has more than {MAX_IMAGES} images");
        return Err(root.key("subjects").problem(message));
    }
    Ok(recipe)
}

fn check_dataset(file: &RecipeFile, place: &Place) -> Result<(), Problem> {
    let table = &file.dataset;
    if table.name.trim().is_empty() {
        return Err(place.key("name").problem("the name must not be empty"));
    }
    if table.output.trim().is_empty() {
        return Err(place
            .key("output")
            .problem("the output folder must not be empty"));
    }
    let is_plain = |c| matches!(c, Component::Normal(_) | Component::CurDir);
    if !Path::new(&table.output).components().all(is_plain) {
        return Err(place
            .key("output")
            .problem("a recipe's output folder must lie in the current folder")
            .help("give any other folder with --output"));
    }
    if table.formats.is_empty() {
        return Err(place
            .key("formats")
            .problem("at least one format is needed")
            .help("allowed: folder, webdataset, parquet"));
    }
    if !IMAGES_PER_SHARD.contains(&table.images_per_shard) {
        return Err(place.key("images_per_shard").problem(format!(
            "the number of images in a shard must be from {} to {}, found {}",
            IMAGES_PER_SHARD.start(),
            IMAGES_PER_SHARD.end(),
            table.images_per_shard
        )));
    }
    let has = |t| file.image.truth.contains(&t);
    if table.coco && !(has(Truth::Landmarks) && has(Truth::Segments)) {
        return Err(place
            .key("coco")
            .problem("a COCO file needs landmarks and segments")
            .help("add \"landmarks\" and \"segments\" to image.truth"));
    }
    Ok(())
}

/// The formats, sorted, each once.
fn formats(table: &DatasetTable) -> Vec<Format> {
    let mut formats = table.formats.clone();
    formats.sort_unstable();
    formats.dedup();
    formats
}

fn image(table: &ImageTable, place: &Place) -> Result<ImageSettings, Problem> {
    for (i, side) in table.size.iter().enumerate() {
        if !IMAGE_SIDE.contains(side) {
            return Err(place.key("size").index(i).problem(format!(
                "width and height must be from {} to {} pixels, found {side}",
                IMAGE_SIDE.start(),
                IMAGE_SIDE.end()
            )));
        }
    }
    let quality = u8::try_from(table.quality)
        .ok()
        .filter(|q| (1..=100).contains(q));
    let Some(quality) = quality else {
        return Err(place.key("quality").problem(format!(
            "quality must be from 1 to 100, found {}",
            table.quality
        )));
    };
    let samples = match &table.samples {
        SamplesTable::Count(n) if (1..=256).contains(n) => Samples::Count(*n as u32),
        SamplesTable::Word(word) if word == "adaptive" => Samples::ADAPTIVE,
        SamplesTable::Count(n) => {
            let message = format!("the number of samples must be from 1 to 256, found {n}");
            return Err(place.key("samples").problem(message));
        }
        SamplesTable::Word(word) => {
            let place = place.key("samples");
            return Err(place.unknown("value", word, &["adaptive".to_owned()]));
        }
    };
    let known = Scheme::names();
    for (i, scheme) in table.landmarks.iter().enumerate() {
        if !known.contains(scheme) {
            let place = place.key("landmarks").index(i);
            return Err(place.unknown("landmark scheme", scheme, &known));
        }
    }
    let mut truth = table.truth.clone();
    truth.sort_unstable();
    truth.dedup();
    Ok(ImageSettings {
        width: table.size[0] as u32,
        height: table.size[1] as u32,
        encoding: table.encoding,
        quality,
        truth,
        landmarks: table.landmarks.clone(),
        samples,
        background: table.background,
        box_margin: in_range(
            table.box_margin,
            0.0..=2.0,
            "box_margin",
            &place.key("box_margin"),
        )?,
    })
}

fn subjects(table: &SubjectsTable, place: &Place, base: &Path) -> Result<Subjects, Problem> {
    let mut scans = Vec::new();
    for (i, pattern) in table.scans.iter().enumerate() {
        let place = place.key("scans").index(i);
        for path in matching_files(pattern, base, &place)? {
            if !scans.contains(&path) {
                scans.push(path);
            }
        }
    }
    let known: Vec<String> = builtin::names().into_iter().map(str::to_owned).collect();
    let mut names: Vec<String> = Vec::new();
    for (i, name) in table.builtin.iter().enumerate() {
        let chosen = match name.as_str() {
            "all" => &known[..],
            _ if known.contains(name) => std::slice::from_ref(name),
            _ => {
                let allowed = [&["all".to_owned()], &known[..]].concat();
                let place = place.key("builtin").index(i);
                return Err(place.unknown("built-in subject", name, &allowed));
            }
        };
        for name in chosen {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
    }
    if !(0..=MAX_SAMPLED).contains(&table.sampled) {
        return Err(place.key("sampled").problem(format!(
            "the number of sampled subjects must be from 0 to {MAX_SAMPLED}, found {}",
            table.sampled
        )));
    }
    let subjects = Subjects {
        scans,
        builtin: names,
        sampled: table.sampled as u64,
        delight: table.delight,
    };
    if subjects.is_empty() {
        return Err(place
            .problem("the recipe names no subjects")
            .help("give at least one of scans = [\"*.obj\"], builtin = [\"all\"], sampled = 10"));
    }
    Ok(subjects)
}

fn hair(table: &HairTable, place: &Place) -> Result<HairSettings, Problem> {
    let known: Vec<String> = std::iter::once("none")
        .chain(HairStyle::names())
        .map(str::to_owned)
        .collect();
    for (i, style) in table.styles.iter().enumerate() {
        if !known.contains(style) {
            let place = place.key("styles").index(i);
            return Err(place.unknown("hair style", style, &known));
        }
    }
    Ok(HairSettings::from(table))
}
