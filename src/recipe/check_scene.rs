//! From the file's tables to checked settings: expressions, lights, views, occluders.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use facile_sim::pose::{MAX_LATERAL_MM, MAX_OPEN_RAD, MAX_PROTRUSION_MM};
use facile_sim::{ExpressionSet, MuscleSet, Pose, SimError, action_units};
use facile_trace::occluder::{Anchor, Glasses, Model, Prop, PropKind, RimShape};
use facile_trace::{self as trace, LightSource, Sensor};

use super::check::in_range;
use super::check_background::Surroundings;
use super::file::{
    AnchorTable, Attach, ExpressionTable, LightTable, OccluderKind, OccluderTable, RimTable,
    SensorTable, SourceKind, SourceTable, ViewTable,
};
use super::problem::{Place, Problem};
use super::settings::{Expression, Lighting, Occluder, View};

/// Eyes turn no further.
const MAX_GAZE_DEG: f64 = 40.0;
/// Viewpoints of a recipe, a protection against typing errors.
const MAX_VIEWS: usize = 1_000_000;
/// Lengths beyond this are typing errors, mm.
const MAX_LENGTH: f64 = 1e6;
/// A spot whose recipe does not say how wide it is.
const DEFAULT_SPOT_DEG: f64 = 30.0;
const DEFAULT_SPOT_SOFTNESS: f64 = 0.25;
/// Lamps of an environment whose recipe does not say how many.
const DEFAULT_ENVIRONMENT_SAMPLES: u32 = 32;
/// Points of an area source whose recipe does not say how many.
const DEFAULT_AREA_SAMPLES: u32 = 16;
/// Ground of a hemisphere whose recipe names none.
const GROUND_COLOR: [f64; 3] = [0.25, 0.2, 0.16];

pub(crate) fn expressions(
    tables: &[ExpressionTable],
    place: &Place,
) -> Result<Vec<Expression>, Problem> {
    let neutral = [ExpressionTable {
        name: "neutral".to_owned(),
        intensities: vec![1.0],
        ..ExpressionTable::default()
    }];
    let tables = if tables.is_empty() { &neutral } else { tables };
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        let place = place.index(i);
        if tables[..i].iter().any(|t| t.name == table.name) {
            let message = format!("there are two expressions of the name `{}`", table.name);
            return Err(place.key("name").problem(message));
        }
        let full = pose(table, &place)?;
        if table.intensities.is_empty() {
            let place = place.key("intensities");
            return Err(place.problem("at least one intensity is needed"));
        }
        for (k, &intensity) in table.intensities.iter().enumerate() {
            let place = place.key("intensities").index(k);
            in_range(intensity, 0.0..=1.0, "an intensity", &place)?;
            if intensity == 0.0 {
                let help = "for the face at rest add [[expression]] name = \"neutral\"";
                return Err(place.problem("an intensity must be over 0").help(help));
            }
            let units = table.action_units.iter();
            list.push(Expression {
                name: table.name.clone(),
                intensity,
                action_units: units.map(|(k, v)| (k.clone(), v * intensity)).collect(),
                pose: full.scaled(intensity),
            });
        }
    }
    Ok(list)
}

/// What one table's face does at intensity 1.
fn pose(table: &ExpressionTable, place: &Place) -> Result<Pose, Problem> {
    let muscles = MuscleSet::embedded();
    let own = facile_sim::Expression {
        name: table.name.clone(),
        muscles: table.muscles.clone(),
        action_units: table.action_units.clone(),
        jaw_deg: table.jaw_deg,
        jaw_protrusion_mm: table.jaw_protrusion_mm,
        jaw_lateral_mm: table.jaw_lateral_mm,
        gaze_yaw_deg: table.gaze_yaw_deg,
        gaze_pitch_deg: table.gaze_pitch_deg,
    };
    // Each entry alone first, so that an error stands where it was made.
    for (name, &contraction) in &table.muscles {
        let place = place.key("muscles").key(name);
        let set = Pose::default().set(muscles, name, contraction);
        set.map_err(|e| sim_problem(&place, e))?;
    }
    for (name, &intensity) in &table.action_units {
        let place = place.key("action_units").key(name);
        let unit = BTreeMap::from([(name.clone(), intensity)]);
        action_units(muscles, &unit).map_err(|e| sim_problem(&place, e))?;
    }
    let numbers = [
        ("jaw_deg", table.jaw_deg, 0.0, MAX_OPEN_RAD.to_degrees()),
        (
            "jaw_protrusion_mm",
            table.jaw_protrusion_mm,
            -MAX_PROTRUSION_MM / 3.0,
            MAX_PROTRUSION_MM,
        ),
        (
            "jaw_lateral_mm",
            table.jaw_lateral_mm,
            -MAX_LATERAL_MM,
            MAX_LATERAL_MM,
        ),
        (
            "gaze_yaw_deg",
            table.gaze_yaw_deg,
            -MAX_GAZE_DEG,
            MAX_GAZE_DEG,
        ),
        (
            "gaze_pitch_deg",
            table.gaze_pitch_deg,
            -MAX_GAZE_DEG,
            MAX_GAZE_DEG,
        ),
    ];
    for (key, value, low, high) in numbers {
        in_range(value, low..=high.floor(), key, &place.key(key))?;
    }
    let is_empty = table.muscles.is_empty()
        && table.action_units.is_empty()
        && numbers.iter().all(|(_, value, _, _)| *value == 0.0);
    let chosen = if is_empty {
        ExpressionSet::embedded().get(&table.name).map_err(|e| {
        sim_problem(&place.key("name"), e).note(
            "an expression of your own gives at least one of muscles, action_units, jaw_deg, gaze_yaw_deg",
        )
    })?
    } else {
        &own
    };
    chosen.pose(muscles).map_err(|e| sim_problem(place, e))
}

/// An error of the physics as a problem of the recipe, with the name that was probably meant.
pub(crate) fn sim_problem(place: &Place, error: SimError) -> Problem {
    match error {
        SimError::UnknownName { kind, name, known } => {
            let known: Vec<String> = known.split(", ").map(str::to_owned).collect();
            place.unknown(kind, &name, &known)
        }
        other => place.problem(other.to_string()),
    }
}

pub(crate) fn occluders(
    tables: &[OccluderTable],
    base: &Path,
    place: &Place,
) -> Result<Vec<Occluder>, Problem> {
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        list.push(occluder(table, base, &place.index(i))?);
    }
    if list.is_empty() {
        list.push(Occluder::None);
    }
    Ok(list)
}

fn occluder(table: &OccluderTable, base: &Path, place: &Place) -> Result<Occluder, Problem> {
    let given = [
        ("color", table.color.is_some()),
        ("shape", table.shape.is_some()),
        ("tint", table.tint.is_some()),
        ("diopters", table.diopters.is_some()),
        ("rim_mm", table.rim_mm.is_some()),
        ("size", table.size.is_some()),
        ("x_mm", table.x_mm.is_some()),
        ("y_mm", table.y_mm.is_some()),
        ("z_mm", table.z_mm.is_some()),
        ("turn_deg", table.turn_deg.is_some()),
        ("file", table.file.is_some()),
        ("anchor", table.anchor.is_some()),
        ("scale", table.scale.is_some()),
        ("clear", table.clear.is_some()),
    ];
    let name = table.kind.name();
    let only = |allowed: &[&str]| {
        unused(
            place,
            &format!("an occluder of kind `{name}`"),
            &given,
            allowed,
        )
    };
    let lenses = ["color", "shape", "tint", "diopters", "rim_mm", "size"];
    let kind = match table.kind {
        OccluderKind::None => {
            only(&[])?;
            return Ok(Occluder::None);
        }
        OccluderKind::Glasses => {
            only(&lenses)?;
            return Ok(Occluder::Glasses(glasses(
                table,
                Glasses::default(),
                place,
            )?));
        }
        OccluderKind::Sunglasses => {
            only(&lenses)?;
            return Ok(Occluder::Sunglasses(glasses(
                table,
                Glasses::sunglasses(),
                place,
            )?));
        }
        OccluderKind::Model => {
            only(&[
                "x_mm", "y_mm", "z_mm", "turn_deg", "file", "anchor", "scale", "clear",
            ])?;
            return Ok(Occluder::Model(model(table, base, place)?));
        }
        OccluderKind::SurgicalMask => PropKind::SurgicalMask,
        OccluderKind::Scarf => PropKind::Scarf,
        OccluderKind::Cap => PropKind::Cap,
        OccluderKind::Hat => PropKind::Hat,
        OccluderKind::HeadBand => PropKind::HeadBand,
        OccluderKind::Headphones => PropKind::Headphones,
        OccluderKind::Hand => PropKind::Hand,
        OccluderKind::Bar => PropKind::Bar,
        OccluderKind::Fringe => PropKind::Fringe,
    };
    only(&[&["color", "size"], kind.places()].concat())?;
    let usual = Prop::new(kind);
    Ok(Occluder::Prop(Prop {
        color: table.color.unwrap_or(usual.color),
        size: in_range(
            table.size.unwrap_or(1.0),
            0.7..=1.3,
            "size",
            &place.key("size"),
        )?,
        x_mm: offset(table.x_mm, "x_mm", place)?,
        y_mm: offset(table.y_mm, "y_mm", place)?,
        turn_deg: occluder_turn(table, place)?,
        ..usual
    }))
}

fn offset(value: Option<f64>, key: &str, place: &Place) -> Result<f64, Problem> {
    in_range(value.unwrap_or(0.0), -150.0..=150.0, key, &place.key(key))
}

fn occluder_turn(table: &OccluderTable, place: &Place) -> Result<f64, Problem> {
    let turn = table.turn_deg.unwrap_or(0.0);
    in_range(turn, -180.0..=180.0, "turn_deg", &place.key("turn_deg"))
}

fn model(table: &OccluderTable, base: &Path, place: &Place) -> Result<Model, Problem> {
    let file_place = place.key("file");
    let message = "an occluder of kind `model` needs the key `file`";
    let file = table
        .file
        .clone()
        .ok_or_else(|| file_place.problem(message))?;
    let mesh = facile_core::io::load_scan(&base.join(&file), None)
        .map_err(|e| file_place.problem(e.to_string()))?;
    let is_metres = [".glb", ".gltf"]
        .iter()
        .any(|e| file.to_lowercase().ends_with(e));
    let scale = table.scale.unwrap_or(if is_metres { 1000.0 } else { 1.0 });
    Ok(Model {
        file,
        anchor: match table.anchor {
            None | Some(AnchorTable::Nose) => Anchor::Nose,
            Some(AnchorTable::Eyes) => Anchor::Eyes,
            Some(AnchorTable::Mouth) => Anchor::Mouth,
            Some(AnchorTable::Chin) => Anchor::Chin,
            Some(AnchorTable::Forehead) => Anchor::Forehead,
            Some(AnchorTable::LeftEar) => Anchor::LeftEar,
            Some(AnchorTable::RightEar) => Anchor::RightEar,
            Some(AnchorTable::Head) => Anchor::Head,
        },
        scale: in_range(scale, 1e-3..=1e4, "scale", &place.key("scale"))?,
        offset_mm: [
            offset(table.x_mm, "x_mm", place)?,
            offset(table.y_mm, "y_mm", place)?,
            offset(table.z_mm, "z_mm", place)?,
        ],
        turn_deg: occluder_turn(table, place)?,
        clear: table.clear.unwrap_or(true),
        mesh: Arc::new(mesh),
    })
}

fn glasses(table: &OccluderTable, style: Glasses, place: &Place) -> Result<Glasses, Problem> {
    let mut tint = style.tint;
    for (i, (to, from)) in tint.iter_mut().zip(table.tint.iter().flatten()).enumerate() {
        let place = place.key("tint").index(i);
        *to = in_range(*from, 0.0..=1.0, "a share of light", &place)? as f32;
    }
    let rim_mm = table.rim_mm.unwrap_or(style.rim_mm);
    let size = table.size.unwrap_or(style.size);
    Ok(Glasses {
        shape: match table.shape {
            Some(RimTable::Round) => RimShape::Round,
            Some(RimTable::Rectangular) => RimShape::Rectangular,
            None => style.shape,
        },
        color: table.color.unwrap_or(style.color),
        tint,
        diopters: in_range(
            table.diopters.unwrap_or(style.diopters),
            -8.0..=8.0,
            "diopters",
            &place.key("diopters"),
        )?,
        rim_mm: in_range(rim_mm, 0.5..=8.0, "rim_mm", &place.key("rim_mm"))?,
        size: in_range(size, 0.7..=1.3, "size", &place.key("size"))?,
    })
}

pub(crate) fn views(tables: &[ViewTable], place: &Place) -> Result<Vec<View>, Problem> {
    let frontal = [ViewTable::default()];
    let tables = if tables.is_empty() { &frontal } else { tables };
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        let place = place.index(i);
        let angles = [
            ("yaw_deg", &table.yaw_deg, 180.0),
            ("pitch_deg", &table.pitch_deg, 89.0),
            ("roll_deg", &table.roll_deg, 180.0),
        ];
        for (key, values, limit) in angles {
            let place = place.key(key);
            if values.is_empty() {
                return Err(place.problem("at least one angle is needed"));
            }
            for (k, &v) in values.iter().enumerate() {
                in_range(v, -limit..=limit, key, &place.index(k))?;
            }
        }
        // Counted before there is memory for them.
        let count = angles
            .iter()
            .try_fold(1, |n: usize, (_, values, _)| n.checked_mul(values.len()));
        if count.is_none_or(|n| n + list.len() > MAX_VIEWS) {
            let message = format!("the angles have more than {MAX_VIEWS} combinations");
            return Err(place.problem(message));
        }
        let fov_y = in_range(
            table.fov_y_deg,
            1.0..=120.0,
            "fov_y_deg",
            &place.key("fov_y_deg"),
        )?;
        let distance_place = place.key("distance_mm");
        let distance = in_range(
            table.distance_mm,
            150.0..=1e5,
            "distance_mm",
            &distance_place,
        )?;
        length(table.target_mm, &place.key("target_mm"))?;
        for (k, v) in table.shift.into_iter().enumerate() {
            in_range(v, -1.0..=1.0, "shift", &place.key("shift").index(k))?;
        }
        for &yaw in &table.yaw_deg {
            for &pitch in &table.pitch_deg {
                for &roll in &table.roll_deg {
                    list.push(View {
                        yaw: yaw.to_radians(),
                        pitch: pitch.to_radians(),
                        roll: roll.to_radians(),
                        fov_y: fov_y.to_radians(),
                        distance,
                        target: table.target_mm,
                        shift: table.shift,
                    });
                }
            }
        }
    }
    Ok(list)
}

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

pub(crate) fn jpeg_quality(table: &SensorTable, place: &Place) -> Result<Option<u8>, Problem> {
    let quality = table.jpeg_quality;
    match u8::try_from(quality).ok().filter(|q| *q <= 100) {
        Some(quality) => Ok((quality > 0).then_some(quality)),
        None => {
            let message = format!("jpeg_quality must be from 0 to 100, found {quality}");
            Err(place.key("jpeg_quality").problem(message))
        }
    }
}

pub(crate) fn sensor(table: &SensorTable, place: &Place) -> Result<Sensor, Problem> {
    let number = |key: &str, value: f64, low: f64, high: f64| {
        in_range(value, low..=high, key, &place.key(key)).map(|v| v as f32)
    };
    let mut white_balance = [1.0; 3];
    for (i, (to, from)) in white_balance
        .iter_mut()
        .zip(table.white_balance)
        .enumerate()
    {
        let place = place.key("white_balance").index(i);
        *to = in_range(from, 0.0..=10.0, "a gain", &place)? as f32;
    }
    Ok(Sensor {
        exposure_stops: number("exposure_stops", table.exposure_stops, -10.0, 10.0)?,
        white_balance,
        blur_px: number("blur_px", table.blur_px, 0.0, 20.0)?,
        photon_noise: number("photon_noise", table.photon_noise, 0.0, 1.0)?,
        read_noise: number("read_noise", table.read_noise, 0.0, 1.0)?,
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

fn length(v: [f64; 3], place: &Place) -> Result<[f64; 3], Problem> {
    for (i, c) in v.into_iter().enumerate() {
        in_range(c, -MAX_LENGTH..=MAX_LENGTH, "a coordinate", &place.index(i))?;
    }
    Ok(v)
}

/// Refuses keys that have no meaning for what they were given to.
pub(crate) fn unused(
    place: &Place,
    owner: &str,
    keys: &[(&str, bool)],
    allowed: &[&str],
) -> Result<(), Problem> {
    let surplus = |(key, given): &&(&str, bool)| *given && !allowed.contains(key);
    match keys.iter().find(surplus) {
        Some((key, _)) => Err(place
            .key(key)
            .problem(format!("{owner} has no key `{key}`"))),
        None => Ok(()),
    }
}
