//! From the file's tables to checked settings: expressions, lights, views, occluders.

use std::collections::BTreeMap;

use facile_sim::pose::{MAX_LATERAL_MM, MAX_OPEN_RAD, MAX_PROTRUSION_MM};
use facile_sim::{ExpressionSet, MuscleSet, Pose, SimError, action_units};
use facile_trace::occluder::{Drape, DrapeKind, Glasses, RimShape};
use facile_trace::{self as trace, LightSource, Sensor};

use super::check::in_range;
use super::file::{
    Attach, ExpressionTable, LightTable, OccluderKind, OccluderTable, RimTable, SensorTable,
    SourceKind, SourceTable, ViewTable,
};
use super::problem::{Place, Problem};
use super::settings::{Expression, Lighting, Occluder, View};

/// Eyes turn no further.
const MAX_GAZE_DEG: f64 = 40.0;
/// Viewpoints of a recipe, a protection against typing errors.
const MAX_VIEWS: usize = 1_000_000;
/// Lengths beyond this are typing errors, mm.
const MAX_LENGTH: f64 = 1e6;
/// sRGB colours of cloth whose recipe names none.
const MASK_COLOR: [u8; 3] = [150, 190, 214];
const SCARF_COLOR: [u8; 3] = [122, 52, 48];
const CAP_COLOR: [u8; 3] = [40, 52, 84];
/// A spot whose recipe does not say how wide it is.
const DEFAULT_SPOT_DEG: f64 = 30.0;
const DEFAULT_SPOT_SOFTNESS: f64 = 0.25;
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

pub(crate) fn occluders(tables: &[OccluderTable], place: &Place) -> Result<Vec<Occluder>, Problem> {
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        let place = place.index(i);
        let given = [
            ("color", table.color.is_some()),
            ("shape", table.shape.is_some()),
            ("tint", table.tint.is_some()),
            ("rim_mm", table.rim_mm.is_some()),
            ("size", table.size.is_some()),
        ];
        let cloth = |kind, color| {
            unused(&place, "an occluder of cloth", &given, &["color"])?;
            let color = table.color.unwrap_or(color);
            Ok(Occluder::Cloth(Drape { kind, color }))
        };
        list.push(match table.kind {
            OccluderKind::None => {
                unused(&place, "an occluder of kind `none`", &given, &[])?;
                Occluder::None
            }
            OccluderKind::Glasses => Occluder::Glasses(glasses(table, Glasses::default(), &place)?),
            OccluderKind::Sunglasses => {
                Occluder::Sunglasses(glasses(table, Glasses::sunglasses(), &place)?)
            }
            OccluderKind::SurgicalMask => cloth(DrapeKind::SurgicalMask, MASK_COLOR)?,
            OccluderKind::Scarf => cloth(DrapeKind::Scarf, SCARF_COLOR)?,
            OccluderKind::Cap => cloth(DrapeKind::Cap, CAP_COLOR)?,
        });
    }
    if list.is_empty() {
        list.push(Occluder::None);
    }
    Ok(list)
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
                    });
                }
            }
        }
    }
    Ok(list)
}

pub(crate) fn lightings(tables: &[LightTable], place: &Place) -> Result<Vec<Lighting>, Problem> {
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
            .map(|(k, s)| source(s, &sources_place.index(k)))
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

fn source(table: &SourceTable, place: &Place) -> Result<LightSource, Problem> {
    let allowed: &[&str] = match table.kind {
        SourceKind::Point => &["position", "attach"],
        SourceKind::Directional => &["direction", "attach"],
        SourceKind::Ambient => &[],
        SourceKind::Spot => &["position", "target", "angle_deg", "softness", "attach"],
        SourceKind::Area => &["position", "target", "size", "samples", "attach"],
        SourceKind::Hemisphere => &["ground"],
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
fn unused(
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
