//! From what was drawn to a scene: who, doing what, seen and lit how.

use std::borrow::Cow;

use facile_sim::MuscleSet;
use facile_sim::pose::{MAX_LATERAL_MM, MAX_OPEN_RAD, MAX_PROTRUSION_MM};

use super::{Drawn, Quantity, Sampling, Stage};
use crate::Error;
use crate::recipe::file::{Attach, LightTable, SourceKind};
use crate::recipe::{Expression, Lighting, Occluder, Optics, Recipe, View, drawn_lighting};

/// Eyes turn no further, rad.
const MAX_GAZE: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// What one sample shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene<'a> {
    /// Number of the subject.
    pub subject: u64,
    /// What the face does.
    pub expression: Cow<'a, Expression>,
    /// What is in front of it.
    pub occluder: Cow<'a, Occluder>,
    /// From where it is seen.
    pub view: View,
    /// How it is lit.
    pub lighting: Cow<'a, Lighting>,
}

/// The scene of the draws of the three stages.
pub(super) fn scene<'a>(
    recipe: &'a Recipe,
    sampling: &Sampling,
    subject: u64,
    [pose, view, light]: [&Drawn; 3],
) -> Result<Scene<'a>, Error> {
    let named = |stage: Stage, drawn: &'_ Drawn| -> Vec<(&str, f64)> {
        let quantities: &[Quantity] = &sampling.draws[stage as usize].quantities;
        quantities
            .iter()
            .map(|q| q.name.as_str())
            .zip(drawn.values.iter().copied())
            .collect()
    };
    let view_values = named(Stage::View, view);
    // The last list of a view's draws
    let is_drawn = sampling.has_projection;
    let projection = view.picks.last().copied().filter(|_| is_drawn);
    Ok(Scene {
        subject,
        expression: expression(
            &recipe.expressions[pose.picks[0]],
            &named(Stage::Pose, pose),
        )?,
        view: seen(recipe.views[view.picks[0]], &view_values, projection),
        occluder: occluder(
            &recipe.occluders[view.picks[1]],
            &view_values,
            view.picks
                .get(2)
                .and_then(|i| sampling.occluder_colors.get(*i))
                .copied(),
        ),
        lighting: lighting(recipe, light.picks[0], &named(Stage::Light, light))?,
    })
}

/// An expression at the intensity drawn, with muscles, jaw and gaze added to it and cut to what a face can do.
fn expression<'a>(
    base: &'a Expression,
    values: &[(&str, f64)],
) -> Result<Cow<'a, Expression>, Error> {
    if values.is_empty() {
        return Ok(Cow::Borrowed(base));
    }
    let mut out = base.clone();
    let mut added = facile_sim::Pose::default();
    for (name, v) in values {
        match *name {
            "intensity" => {
                out.intensity = *v;
                out.pose = base.pose.scaled(*v);
                for unit in out.action_units.values_mut() {
                    *unit *= v;
                }
            }
            "jaw_deg" => added.jaw.open_rad = v.to_radians(),
            "jaw_protrusion_mm" => added.jaw.protrusion_mm = *v,
            "jaw_lateral_mm" => added.jaw.lateral_mm = *v,
            "gaze_yaw_deg" => added.gaze.yaw_rad = v.to_radians(),
            "gaze_pitch_deg" => added.gaze.pitch_rad = v.to_radians(),
            _ => {
                let muscle = name.strip_prefix("muscles.").unwrap_or(name);
                added.set(MuscleSet::embedded(), muscle, *v)?;
            }
        }
    }
    let mut pose = out.pose.combined(&added);
    let jaw = &mut pose.jaw;
    jaw.open_rad = jaw.open_rad.clamp(0.0, MAX_OPEN_RAD);
    jaw.protrusion_mm = jaw
        .protrusion_mm
        .clamp(-MAX_PROTRUSION_MM / 3.0, MAX_PROTRUSION_MM);
    jaw.lateral_mm = jaw.lateral_mm.clamp(-MAX_LATERAL_MM, MAX_LATERAL_MM);
    let gaze = &mut pose.gaze;
    gaze.yaw_rad = gaze.yaw_rad.clamp(-MAX_GAZE, MAX_GAZE);
    gaze.pitch_rad = gaze.pitch_rad.clamp(-MAX_GAZE, MAX_GAZE);
    out.pose = pose;
    Ok(Cow::Owned(out))
}

/// A view with the numbers and the projection drawn, 0 for perspective and 1 for parallel rays.
fn seen(mut view: View, values: &[(&str, f64)], projection: Option<usize>) -> View {
    view.optics = optics(view.optics, values, projection);
    for (name, v) in values {
        match *name {
            "yaw_deg" => view.yaw = v.to_radians(),
            "pitch_deg" => view.pitch = v.to_radians(),
            "roll_deg" => view.roll = v.to_radians(),
            "fov_y_deg" => view.fov_y = v.to_radians(),
            "distance_mm" => view.distance = *v,
            "shift_x" => view.shift[0] = *v,
            "shift_y" => view.shift[1] = *v,
            _ => {}
        }
    }
    view
}

fn optics(own: Optics, values: &[(&str, f64)], projection: Option<usize>) -> Optics {
    let value = |name: &str| values.iter().find(|(n, _)| *n == name).map(|(_, v)| *v);
    let is_parallel = projection.map_or(own == Optics::Orthographic, |pick| pick == 1);
    if is_parallel {
        return Optics::Orthographic;
    }
    let (own_aperture, own_focus) = match own {
        Optics::Lens { aperture, focus } => (aperture, focus),
        Optics::Pinhole | Optics::Orthographic => (0.0, None),
    };
    let aperture = value("aperture_mm").unwrap_or(own_aperture);
    if aperture <= 0.0 {
        return Optics::Pinhole;
    }
    Optics::Lens {
        aperture,
        focus: value("focus_mm").or(own_focus),
    }
}

/// An occluder with what was drawn of it, as far as its kind has it.
fn occluder<'a>(
    base: &'a Occluder,
    values: &[(&str, f64)],
    color: Option<[u8; 3]>,
) -> Cow<'a, Occluder> {
    let mut out = base.clone();
    match &mut out {
        Occluder::None => {}
        Occluder::Glasses(glasses) | Occluder::Sunglasses(glasses) => {
            for (name, v) in values {
                match *name {
                    "occluder.size" => glasses.size = *v,
                    "occluder.rim_mm" => glasses.rim_mm = *v,
                    _ => {}
                }
            }
            glasses.color = color.unwrap_or(glasses.color);
        }
        Occluder::Prop(prop) => {
            for (name, v) in values {
                let key = name.strip_prefix("occluder.").unwrap_or(name);
                let has = |key| prop.kind.places().contains(&key);
                match key {
                    "size" => prop.size = *v,
                    "x_mm" if has(key) => prop.x_mm = *v,
                    "y_mm" if has(key) => prop.y_mm = *v,
                    "turn_deg" if has(key) => prop.turn_deg = *v,
                    _ => {}
                }
            }
            prop.color = color.or(prop.color);
        }
        Occluder::Model(model) => {
            for (name, v) in values {
                match *name {
                    "occluder.x_mm" => model.offset_mm[0] = *v,
                    "occluder.y_mm" => model.offset_mm[1] = *v,
                    "occluder.turn_deg" => model.turn_deg = *v,
                    _ => {}
                }
            }
        }
    }
    Cow::Owned(out)
}

/// A lighting whose sources are turned about the head, moved, and stronger or weaker.
fn lighting<'a>(
    recipe: &'a Recipe,
    pick: usize,
    values: &[(&str, f64)],
) -> Result<Cow<'a, Lighting>, Error> {
    let Some(table) = recipe.file.lights.get(pick).filter(|_| !values.is_empty()) else {
        return Ok(Cow::Borrowed(&recipe.lightings[pick]));
    };
    let value = |name: &str, usual: f64| {
        let found = values.iter().find(|(n, _)| *n == name);
        found.map_or(usual, |(_, v)| *v)
    };
    let (sin, cos) = libm::sincos(value("light.turn_deg", 0.0).to_radians());
    let turned = |[x, y, z]: [f64; 3]| [x * cos + z * sin, y, z * cos - x * sin];
    let moved = |[x, y, z]: [f64; 3]| {
        [
            x + value("light.x_mm", 0.0),
            y + value("light.y_mm", 0.0),
            z + value("light.z_mm", 0.0),
        ]
    };
    let mut table: LightTable = table.clone();
    for source in &mut table.sources {
        source.intensity *= value("light.intensity", 1.0);
        // What is fixed to the camera stays there.
        if source.attach == Some(Attach::Camera) {
            continue;
        }
        source.position = source.position.map(|p| moved(turned(p)));
        source.direction = source.direction.map(turned);
        if matches!(
            source.kind,
            SourceKind::Environment | SourceKind::SphericalHarmonic
        ) {
            let own = source.turn_deg.unwrap_or(0.0);
            source.turn_deg = Some(own + value("light.turn_deg", 0.0));
        }
    }
    let base = &recipe.lightings[pick];
    Ok(Cow::Owned(drawn_lighting(&table, base)?))
}
