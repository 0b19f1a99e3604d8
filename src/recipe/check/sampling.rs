//! From the file's tables to checked settings: `[sampling]`.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use facile_sim::pose::{MAX_LATERAL_MM, MAX_OPEN_RAD, MAX_PROTRUSION_MM};
use facile_sim::{MuscleSet, Pose};
use facile_trace::Samples;

use super::expression::{MAX_GAZE_DEG, sim_problem};
use super::value::in_range;
use super::view::lens_problem;
use crate::Error;
use crate::recipe::file::sampling::{
    ConstraintTable, DistributionTable, PatternWord, SampledViewTable, SamplingTable,
};
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::{Optics, Recipe, View};
use crate::sampling::{
    Constraint, Distribution, Draws, Pattern, Quantity, Sampling, Stage, Weights,
};

const MAX_COUNT: i64 = 1_000_000_000_000;
const MAX_PER_GROUP: i64 = 1_000_000;
const MAX_TRIES: i64 = 1_000_000;
/// Standard deviations beyond which nothing of a normal distribution is left to cut.
const FARTHEST: f64 = 30.0;
/// Draws that are tried before any work, to find constraints that nothing meets.
const PROBES: u64 = 64;

/// Checks the table. `recipe` is whole but for its sampling.
pub(crate) fn sampling(
    table: &SamplingTable,
    recipe: &Recipe,
    place: &Place,
) -> Result<Sampling, Problem> {
    let per_group = 1..=MAX_PER_GROUP;
    let count = whole(table.count, 1..=MAX_COUNT, "count", place)?;
    let views_per_pose = whole(
        table.views_per_pose,
        per_group.clone(),
        "views_per_pose",
        place,
    )?;
    let lights_per_view = whole(
        table.lights_per_view,
        per_group.clone(),
        "lights_per_view",
        place,
    )?;
    let poses = count.div_ceil(views_per_pose * lights_per_view);
    let poses_per_subject = match table.poses_per_subject {
        Some(n) => whole(n, per_group, "poses_per_subject", place)?,
        None => poses.div_ceil(recipe.subjects.len()),
    };
    let draws = [
        poses_drawn(table, recipe, &place.key("expression"))?,
        views_drawn(table, recipe, place)?,
        lights_drawn(table, recipe, &place.key("light"))?,
    ];
    let mut sampling = Sampling {
        count,
        pattern: match table.pattern {
            PatternWord::Random => Pattern::Random,
            PatternWord::Stratified => Pattern::Stratified,
            PatternWord::Sobol => Pattern::Sobol,
        },
        poses_per_subject,
        views_per_pose,
        lights_per_view,
        max_tries: whole(table.max_tries, 1..=MAX_TRIES, "max_tries", place)? as u32,
        has_intensity: table.expression.intensity.is_some(),
        draws,
        constraints: Vec::new(),
        occluder_colors: table.occluder.colors.clone(),
        has_projection: table.view.projection.is_some(),
    };
    let names = Names::of(recipe);
    for (i, constraint) in table.constraints.iter().enumerate() {
        let place = place.key("constraint").index(i);
        let checked = self::constraint(constraint, &sampling, &names, &place)?;
        sampling.constraints.push(checked);
    }
    for probe in 0..PROBES.min(count) {
        let index = probe * (count / PROBES).max(1);
        match sampling.scene(recipe, index.min(count - 1)) {
            Err(Error::Draw {
                constraint, tries, ..
            }) => {
                let message = format!(
                    "{tries} tries find no draw of sample {index} that meets this constraint"
                );
                let help = "widen it, or narrow the distributions it is about";
                return Err(place
                    .key("constraint")
                    .index(constraint)
                    .problem(message)
                    .help(help));
            }
            Err(e) => return Err(place.problem(e.to_string())),
            Ok(_) => {}
        }
    }
    Ok(sampling)
}

fn whole(value: i64, range: RangeInclusive<i64>, key: &str, place: &Place) -> Result<u64, Problem> {
    if range.contains(&value) {
        return Ok(value as u64);
    }
    let (low, high) = (range.start(), range.end());
    Err(place
        .key(key)
        .problem(format!("{key} must be from {low} to {high}, found {value}")))
}

/// Names of the entries of the lists, in their order.
struct Names {
    expressions: Vec<String>,
    lights: Vec<String>,
    occluders: Vec<String>,
}

impl Names {
    fn of(recipe: &Recipe) -> Self {
        Self {
            expressions: recipe.expressions.iter().map(|e| e.name.clone()).collect(),
            lights: recipe.lightings.iter().map(|l| l.name.clone()).collect(),
            occluders: recipe
                .occluders
                .iter()
                .map(crate::recipe::settings::Occluder::kind)
                .collect(),
        }
    }
}

/// Weights of a list's entries, given by name. Entries of one name share its weight.
fn weights(
    given: &BTreeMap<String, f64>,
    names: &[String],
    what: &str,
    place: &Place,
) -> Result<Weights, Problem> {
    let place = place.key("weights");
    for (name, weight) in given {
        if !names.contains(name) {
            return Err(place.key(name).unknown(what, name, names));
        }
        in_range(*weight, 0.0..=1e9, "a weight", &place.key(name))?;
    }
    let weight = |name: &String| {
        let same = names.iter().filter(|n| *n == name).count();
        given.get(name).copied().unwrap_or(1.0) / same as f64
    };
    let all: Vec<f64> = names.iter().map(weight).collect();
    Weights::new(&all).ok_or_else(|| place.problem("at least one weight must be over 0"))
}

/// Collects the numbers of a stage.
struct Quantities<'a> {
    place: &'a Place,
    /// What comes before the key in constraints.
    prefix: &'static str,
    list: Vec<Quantity>,
}

impl Quantities<'_> {
    fn add(
        &mut self,
        key: &str,
        table: Option<&DistributionTable>,
        range: RangeInclusive<f64>,
    ) -> Result<(), Problem> {
        if let Some(table) = table {
            let distribution = distribution(table, range, key, &self.place.key(key))?;
            let name = format!("{}{key}", self.prefix);
            self.list.push(Quantity { name, distribution });
        }
        Ok(())
    }
}

fn poses_drawn(table: &SamplingTable, recipe: &Recipe, place: &Place) -> Result<Draws, Problem> {
    let drawn = &table.expression;
    if drawn.intensity.is_some()
        && let Some(i) = recipe
            .file
            .expressions
            .iter()
            .position(|e| e.intensities != [1.0])
    {
        let place = Place::default()
            .key("expression")
            .index(i)
            .key("intensities");
        let problem = place.problem("intensities are given, and drawn as well");
        return Err(problem.help("leave out either these or sampling.expression.intensity"));
    }
    let mut quantities = Quantities {
        place,
        prefix: "",
        list: Vec::new(),
    };
    quantities.add("intensity", drawn.intensity.as_ref(), 0.0..=1.0)?;
    let open = 0.0..=MAX_OPEN_RAD.to_degrees().floor();
    quantities.add("jaw_deg", drawn.jaw_deg.as_ref(), open)?;
    let forward = -MAX_PROTRUSION_MM / 3.0..=MAX_PROTRUSION_MM;
    quantities.add(
        "jaw_protrusion_mm",
        drawn.jaw_protrusion_mm.as_ref(),
        forward,
    )?;
    let lateral = -MAX_LATERAL_MM..=MAX_LATERAL_MM;
    quantities.add("jaw_lateral_mm", drawn.jaw_lateral_mm.as_ref(), lateral)?;
    let gaze = -MAX_GAZE_DEG..=MAX_GAZE_DEG;
    quantities.add("gaze_yaw_deg", drawn.gaze_yaw_deg.as_ref(), gaze.clone())?;
    quantities.add("gaze_pitch_deg", drawn.gaze_pitch_deg.as_ref(), gaze)?;
    let mut list = quantities.list;
    let muscles_place = place.key("muscles");
    let mut muscles = Quantities {
        place: &muscles_place,
        prefix: "muscles.",
        list: Vec::new(),
    };
    for (name, table) in &drawn.muscles {
        let set = Pose::default().set(MuscleSet::embedded(), name, 0.5);
        set.map_err(|e| sim_problem(&muscles_place.key(name), e))?;
        muscles.add(name, Some(table), 0.0..=1.0)?;
    }
    list.append(&mut muscles.list);
    let names = Names::of(recipe).expressions;
    Ok(Draws {
        picks: vec![weights(&drawn.weights, &names, "expression", place)?],
        quantities: list,
    })
}

fn views_drawn(table: &SamplingTable, recipe: &Recipe, place: &Place) -> Result<Draws, Problem> {
    let (view_place, occluder_place) = (place.key("view"), place.key("occluder"));
    let drawn = &table.view;
    let mut quantities = Quantities {
        place: &view_place,
        prefix: "",
        list: Vec::new(),
    };
    quantities.add("yaw_deg", drawn.yaw_deg.as_ref(), -180.0..=180.0)?;
    quantities.add("pitch_deg", drawn.pitch_deg.as_ref(), -89.0..=89.0)?;
    quantities.add("roll_deg", drawn.roll_deg.as_ref(), -180.0..=180.0)?;
    quantities.add("fov_y_deg", drawn.fov_y_deg.as_ref(), 1.0..=120.0)?;
    quantities.add("distance_mm", drawn.distance_mm.as_ref(), 150.0..=1e5)?;
    quantities.add("shift_x", drawn.shift_x.as_ref(), -1.0..=1.0)?;
    quantities.add("shift_y", drawn.shift_y.as_ref(), -1.0..=1.0)?;
    quantities.add("aperture_mm", drawn.aperture_mm.as_ref(), 0.0..=100.0)?;
    quantities.add("focus_mm", drawn.focus_mm.as_ref(), 10.0..=1e5)?;
    let projections = projections(drawn, recipe, &view_place)?;
    check_drawn_lens(&quantities.list, recipe, &view_place)?;
    let mut list = quantities.list;
    let drawn = &table.occluder;
    let mut quantities = Quantities {
        place: &occluder_place,
        prefix: "occluder.",
        list: Vec::new(),
    };
    quantities.add("size", drawn.size.as_ref(), 0.7..=1.3)?;
    quantities.add("rim_mm", drawn.rim_mm.as_ref(), 0.5..=8.0)?;
    quantities.add("x_mm", drawn.x_mm.as_ref(), -150.0..=150.0)?;
    quantities.add("y_mm", drawn.y_mm.as_ref(), -150.0..=150.0)?;
    quantities.add("turn_deg", drawn.turn_deg.as_ref(), -180.0..=180.0)?;
    list.append(&mut quantities.list);
    let kinds = Names::of(recipe).occluders;
    let mut picks = vec![
        Weights::equal(recipe.views.len()),
        weights(&drawn.weights, &kinds, "occluder", &occluder_place)?,
    ];
    if !drawn.colors.is_empty() {
        picks.push(Weights::equal(drawn.colors.len()));
    }
    picks.extend(projections);
    Ok(Draws {
        picks,
        quantities: list,
    })
}

/// Weights of perspective and parallel rays, if they are drawn.
fn projections(
    table: &SampledViewTable,
    recipe: &Recipe,
    place: &Place,
) -> Result<Option<Weights>, Problem> {
    let has_lens = |view: &View| matches!(view.optics, Optics::Lens { .. });
    let is_parallel = |view: &View| view.optics == Optics::Orthographic;
    if let Some(given) = &table.projection {
        let place = place.key("projection");
        let list = [given.perspective, given.orthographic];
        for (key, weight) in ["perspective", "orthographic"].into_iter().zip(list) {
            in_range(weight, 0.0..=1e9, "a weight", &place.key(key))?;
        }
        let weights = Weights::new(&list);
        return weights
            .map(Some)
            .ok_or_else(|| place.problem("at least one weight must be over 0"));
    }
    if table.aperture_mm.is_some() && recipe.views.iter().all(is_parallel) {
        return Err(place
            .key("aperture_mm")
            .problem("an orthographic view has no lens"));
    }
    if table.focus_mm.is_some() && table.aperture_mm.is_none() && !recipe.views.iter().any(has_lens)
    {
        return Err(place
            .key("focus_mm")
            .problem("without aperture_mm everything is in focus"));
    }
    Ok(None)
}

/// As [`super::view::check_lenses`] for openings that are drawn.
fn check_drawn_lens(drawn: &[Quantity], recipe: &Recipe, place: &Place) -> Result<(), Problem> {
    let aperture = drawn.iter().find(|q| q.name == "aperture_mm");
    let is_open = aperture.is_some_and(|q| q.distribution.largest() > 0.0);
    if !is_open || matches!(recipe.image.samples, Samples::Count(2..)) {
        return Ok(());
    }
    Err(lens_problem(&place.key("aperture_mm")))
}

fn lights_drawn(table: &SamplingTable, recipe: &Recipe, place: &Place) -> Result<Draws, Problem> {
    let drawn = &table.light;
    let mut quantities = Quantities {
        place,
        prefix: "light.",
        list: Vec::new(),
    };
    quantities.add("intensity", drawn.intensity.as_ref(), 0.0..=1000.0)?;
    quantities.add("turn_deg", drawn.turn_deg.as_ref(), -180.0..=180.0)?;
    for (key, table) in [
        ("x_mm", &drawn.x_mm),
        ("y_mm", &drawn.y_mm),
        ("z_mm", &drawn.z_mm),
    ] {
        quantities.add(key, table.as_ref(), -1e5..=1e5)?;
    }
    let quantities = quantities.list;
    if !quantities.is_empty() && recipe.file.lights.is_empty() {
        let help = "add [[light]] with a name and sources";
        return Err(place.problem("there is no light to vary").help(help));
    }
    let names = Names::of(recipe).lights;
    Ok(Draws {
        picks: vec![weights(&drawn.weights, &names, "light", place)?],
        quantities,
    })
}

fn distribution(
    table: &DistributionTable,
    range: RangeInclusive<f64>,
    key: &str,
    place: &Place,
) -> Result<Distribution, Problem> {
    let given = [
        ("uniform", table.uniform.is_some()),
        ("normal", table.normal.is_some()),
        ("choice", table.choice.is_some()),
    ];
    if given.iter().filter(|(_, is_given)| *is_given).count() != 1 {
        return Err(place
            .problem(format!("{key} needs exactly one of uniform, normal and choice"))
            .help("such as { uniform = [0, 1] }, { normal = [0.5, 0.2], within = [0, 1] }, { choice = [0, 1] }"));
    }
    for (other, is_given, owner) in [
        ("within", table.within.is_some(), table.normal.is_some()),
        ("weights", table.weights.is_some(), table.choice.is_some()),
    ] {
        if is_given && !owner {
            let with = if other == "within" {
                "normal"
            } else {
                "choice"
            };
            return Err(place
                .key(other)
                .problem(format!("`{other}` goes with `{with}` alone")));
        }
    }
    let pair = |name: &str, [low, high]: [f64; 2]| {
        let place = place.key(name);
        in_range(low, range.clone(), key, &place.index(0))?;
        in_range(high, range.clone(), key, &place.index(1))?;
        if low > high {
            return Err(place.problem(format!(
                "the smallest value, {low}, is over the largest, {high}"
            )));
        }
        Ok((low, high))
    };
    if let Some(bounds) = table.uniform {
        let (low, high) = pair("uniform", bounds)?;
        return Ok(Distribution::Uniform { low, high });
    }
    if let Some([mean, deviation]) = table.normal {
        let place = place.key("normal");
        in_range(mean, -1e9..=1e9, "a mean", &place.index(0))?;
        in_range(
            deviation,
            1e-9..=1e9,
            "a standard deviation",
            &place.index(1),
        )?;
        let (low, high) = pair(
            "within",
            table.within.unwrap_or([*range.start(), *range.end()]),
        )?;
        if low > mean + FARTHEST * deviation || high < mean - FARTHEST * deviation {
            let message = format!(
                "no value from {low} to {high} is within {FARTHEST} standard deviations of {mean}"
            );
            return Err(place.problem(message));
        }
        return Ok(Distribution::Normal {
            mean,
            deviation,
            low,
            high,
        });
    }
    let values = table.choice.clone().unwrap_or_default();
    for (i, v) in values.iter().enumerate() {
        in_range(*v, range.clone(), key, &place.key("choice").index(i))?;
    }
    if values.is_empty() {
        return Err(place.key("choice").problem("at least one value is needed"));
    }
    let weights = match &table.weights {
        None => Weights::equal(values.len()),
        Some(list) if list.len() != values.len() => {
            let message = format!(
                "{} weights are needed, one for each value, found {}",
                values.len(),
                list.len()
            );
            return Err(place.key("weights").problem(message));
        }
        Some(list) => Weights::new(list).ok_or_else(|| {
            place
                .key("weights")
                .problem("weights must not be negative, and one must be over 0")
        })?,
    };
    Ok(Distribution::Choice { values, weights })
}

fn constraint(
    table: &ConstraintTable,
    sampling: &Sampling,
    names: &Names,
    place: &Place,
) -> Result<Constraint, Problem> {
    const STAGES: [Stage; 3] = [Stage::Pose, Stage::View, Stage::Light];
    let drawn = || {
        STAGES.into_iter().flat_map(|stage| {
            let quantities = sampling.draws[stage as usize].quantities.iter().enumerate();
            quantities.map(move |(i, q)| ((stage, i), q.name.clone()))
        })
    };
    let mut of = Vec::new();
    for (i, name) in table.of.iter().enumerate() {
        let Some((found, _)) = drawn().find(|(_, n)| n == name) else {
            let known: Vec<String> = drawn().map(|(_, n)| n).collect();
            return Err(place
                .key("of")
                .index(i)
                .unknown("number that is drawn", name, &known));
        };
        of.push(found);
    }
    if of.is_empty() {
        return Err(place.problem("a constraint needs `of`, the numbers that it is about"));
    }
    if table.min_sum.is_none() && table.max_sum.is_none() {
        return Err(place.problem("a constraint needs at least one of min_sum and max_sum"));
    }
    let mut when = Vec::new();
    for (list, wanted) in &table.when {
        let place = place.key("when").key(list);
        let (stage, pick, known) = match list.as_str() {
            "expression" => (Stage::Pose, 0, &names.expressions),
            "occluder" => (Stage::View, 1, &names.occluders),
            "light" => (Stage::Light, 0, &names.lights),
            _ => {
                let known = ["expression", "light", "occluder"].map(str::to_owned);
                return Err(place.unknown("list", list, &known));
            }
        };
        for (i, name) in wanted.iter().enumerate() {
            if !known.contains(name) {
                return Err(place.index(i).unknown(list, name, known));
            }
        }
        let entries = (0..known.len())
            .filter(|i| wanted.contains(&known[*i]))
            .collect();
        when.push((stage, pick, entries));
    }
    Ok(Constraint {
        of,
        absolute: table.absolute,
        min_sum: table.min_sum.unwrap_or(f64::NEG_INFINITY),
        max_sum: table.max_sum.unwrap_or(f64::INFINITY),
        when,
    })
}
