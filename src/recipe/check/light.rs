//! From `[[light]]` to sources.

use facile_trace::{self as trace, LightSource};

use super::background::Surroundings;
use super::value::{in_range, length, unused};
use crate::recipe::file::{Attach, LightTable, SourceKind, SourceTable};
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::Lighting;

/// A spot whose recipe does not say how wide it is.
const DEFAULT_SPOT_DEG: f64 = 30.0;
const DEFAULT_SPOT_SOFTNESS: f64 = 0.25;
/// Lamps of an environment whose recipe does not say how many.
const DEFAULT_ENVIRONMENT_SAMPLES: u32 = 32;
/// Points of an area source whose recipe does not say how many.
const DEFAULT_AREA_SAMPLES: u32 = 16;
/// Ground of a hemisphere whose recipe names none.
const GROUND_COLOR: [f64; 3] = [0.25, 0.2, 0.16];

pub(crate) fn lightings(
    tables: &[LightTable],
    surroundings: &Surroundings<'_>,
    place: &Place,
) -> Result<Vec<Lighting>, Problem> {
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        let place = place.index(i);
        if tables[..i].iter().any(|t| t.name == table.name) {
            let message = format!("there are two lights of the name `{}`", table.name);
            return Err(place.key("name").problem(message));
        }
        let sources_place = place.key("sources");
        if table.sources.is_empty() {
            return Err(sources_place.problem("a light needs at least one source"));
        }
        let sources = table
            .sources
            .iter()
            .enumerate()
            .map(|(k, s)| source(s, surroundings, &sources_place.index(k)))
            .collect::<Result<_, _>>()?;
        list.push(Lighting {
            name: table.name.clone(),
            sources,
        });
    }
    if list.is_empty() {
        list.push(studio());
    }
    Ok(list)
}

/// The lighting of a recipe without lights: a key light from the upper left and an even fill.
fn studio() -> Lighting {
    Lighting {
        name: "studio".to_owned(),
        sources: vec![
            LightSource::Point {
                position: [350.0, 420.0, 800.0],
                intensity: 0.75,
                color: [1.0; 3],
                attach: trace::Attach::Head,
            },
            LightSource::Ambient {
                intensity: 0.35,
                color: [1.0; 3],
            },
        ],
    }
}

fn source(
    table: &SourceTable,
    surroundings: &Surroundings<'_>,
    place: &Place,
) -> Result<LightSource, Problem> {
    let allowed: &[&str] = match table.kind {
        SourceKind::Point => &["position", "attach"],
        SourceKind::Directional => &["direction", "attach"],
        SourceKind::Ambient => &[],
        SourceKind::Spot => &["position", "target", "angle_deg", "softness", "attach"],
        SourceKind::Area => &["position", "target", "size", "samples", "attach"],
        SourceKind::Hemisphere => &["ground"],
        SourceKind::SphericalHarmonic => &["coefficients", "turn_deg"],
        SourceKind::Environment => &["file", "turn_deg", "samples"],
    };
    let name = table.kind.name();
    let given = [
        ("position", table.position.is_some()),
        ("target", table.target.is_some()),
        ("direction", table.direction.is_some()),
        ("angle_deg", table.angle_deg.is_some()),
        ("softness", table.softness.is_some()),
        ("size", table.size.is_some()),
        ("samples", table.samples.is_some()),
        ("ground", table.ground.is_some()),
        ("coefficients", table.coefficients.is_some()),
        ("file", table.file.is_some()),
        ("turn_deg", table.turn_deg.is_some()),
        ("attach", table.attach.is_some()),
    ];
    unused(
        place,
        &format!("a source of kind `{name}`"),
        &given,
        allowed,
    )?;
    let triple = |key: &str, value: Option<[f64; 3]>| {
        let place = place.key(key);
        let value = value.ok_or_else(|| {
            place.problem(format!("a source of kind `{name}` needs the key `{key}`"))
        })?;
        length(value, &place).map(|v| v.map(|c| c as f32))
    };
    let strength_place = place.key("intensity");
    let intensity = in_range(table.intensity, 0.0..=1e6, "an intensity", &strength_place)? as f32;
    let color = linear_color(table.color, &place.key("color"))?;
    let attach = match table.attach {
        Some(Attach::Camera) => trace::Attach::Camera,
        Some(Attach::Head) | None => trace::Attach::Head,
    };
    Ok(match table.kind {
        SourceKind::Point => LightSource::Point {
            position: triple("position", table.position)?,
            intensity,
            color,
            attach,
        },
        SourceKind::Directional => {
            let direction = triple("direction", table.direction)?;
            if direction == [0.0; 3] {
                let place = place.key("direction");
                return Err(place.problem("a direction must not be zero"));
            }
            LightSource::Directional {
                direction,
                intensity,
                color,
                attach,
            }
        }
        SourceKind::Ambient => LightSource::Ambient { intensity, color },
        SourceKind::Hemisphere => LightSource::Hemisphere {
            intensity,
            color,
            ground: linear_color(table.ground.unwrap_or(GROUND_COLOR), &place.key("ground"))?,
        },
        SourceKind::Area => area(table, place, intensity, color, attach)?,
        SourceKind::SphericalHarmonic => harmonic(table, intensity, place)?,
        SourceKind::Environment => environment(table, surroundings, intensity, color, place)?,
        SourceKind::Spot => {
            let position = triple("position", table.position)?;
            let target = triple("target", table.target)?;
            if position == target {
                let place = place.key("target");
                return Err(place.problem("a spot's target must not be its position"));
            }
            let angle = table.angle_deg.unwrap_or(DEFAULT_SPOT_DEG);
            let softness = table.softness.unwrap_or(DEFAULT_SPOT_SOFTNESS);
            let angle_place = place.key("angle_deg");
            LightSource::Spot {
                position,
                target,
                intensity,
                angle_deg: in_range(angle, 0.1..=90.0, "angle_deg", &angle_place)? as f32,
                softness: in_range(softness, 0.0..=1.0, "softness", &place.key("softness"))? as f32,
                color,
                attach,
            }
        }
    })
}

fn turn_deg(table: &SourceTable, place: &Place) -> Result<f32, Problem> {
    let turn = table.turn_deg.unwrap_or(0.0);
    // Turns add up where lights are drawn
    in_range(turn, -720.0..=720.0, "turn_deg", &place.key("turn_deg")).map(|v| v as f32)
}

fn harmonic(table: &SourceTable, intensity: f32, place: &Place) -> Result<LightSource, Problem> {
    let place_of = place.key("coefficients");
    let given = table.coefficients.as_deref().unwrap_or_default();
    let coefficients: [[f64; 3]; 9] = given.try_into().map_err(|_| {
        let found = given.len();
        place_of.problem(format!(
            "nine coefficients of three numbers are needed, found {found}"
        ))
    })?;
    for (i, v) in coefficients.iter().flatten().enumerate() {
        in_range(*v, -1e6..=1e6, "a coefficient", &place_of.index(i / 3))?;
    }
    Ok(LightSource::SphericalHarmonic {
        intensity,
        coefficients: coefficients.map(|c| c.map(|v| v as f32)),
        turn_deg: turn_deg(table, place)?,
    })
}

fn environment(
    table: &SourceTable,
    surroundings: &Surroundings<'_>,
    intensity: f32,
    color: [f32; 3],
    place: &Place,
) -> Result<LightSource, Problem> {
    let file_place = place.key("file");
    let message = "a source of kind `environment` needs the key `file`";
    let file = table
        .file
        .clone()
        .ok_or_else(|| file_place.problem(message))?;
    let samples = table.samples.unwrap_or(DEFAULT_ENVIRONMENT_SAMPLES);
    let limit = f64::from(trace::light::MAX_ENVIRONMENT_SAMPLES);
    in_range(
        f64::from(samples),
        0.0..=limit,
        "samples",
        &place.key("samples"),
    )?;
    Ok(LightSource::Environment {
        map: Some(surroundings.map(&file, &file_place)?),
        file,
        intensity,
        color,
        turn_deg: turn_deg(table, place)?,
        samples,
    })
}

/// An area source whose strength, colour and frame are checked already.
fn area(
    table: &SourceTable,
    place: &Place,
    intensity: f32,
    color: [f32; 3],
    attach: trace::Attach,
) -> Result<LightSource, Problem> {
    let needed =
        |key: &str| place.problem(format!("a source of kind `area` needs the key `{key}`"));
    let position = table.position.ok_or_else(|| needed("position"))?;
    let target = table.target.ok_or_else(|| needed("target"))?;
    let [width, height] = table.size.ok_or_else(|| needed("size"))?;
    if position == target {
        let place = place.key("target");
        return Err(place.problem("an area source's target must not be its position"));
    }
    for (i, v) in [width, height].into_iter().enumerate() {
        in_range(v, 0.0..=1e5, "a length", &place.key("size").index(i))?;
    }
    let samples = table.samples.unwrap_or(DEFAULT_AREA_SAMPLES);
    let limit = f64::from(trace::light::MAX_AREA_SAMPLES);
    in_range(
        f64::from(samples),
        1.0..=limit,
        "samples",
        &place.key("samples"),
    )?;
    Ok(LightSource::Area {
        position: length(position, &place.key("position"))?.map(|c| c as f32),
        target: length(target, &place.key("target"))?.map(|c| c as f32),
        size: [width as f32, height as f32],
        intensity,
        color,
        samples,
        attach,
    })
}

fn linear_color(color: [f64; 3], place: &Place) -> Result<[f32; 3], Problem> {
    let mut checked = [1.0; 3];
    for (i, (to, from)) in checked.iter_mut().zip(color).enumerate() {
        *to = in_range(from, 0.0..=1.0, "a colour's component", &place.index(i))? as f32;
    }
    Ok(checked)
}
