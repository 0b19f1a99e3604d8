//! From `[[expression]]` to poses.

use std::collections::BTreeMap;

use facile_sim::pose::{MAX_LATERAL_MM, MAX_OPEN_RAD, MAX_PROTRUSION_MM};
use facile_sim::{ExpressionSet, MuscleSet, Pose, SimError, action_units};

use super::value::in_range;
use crate::recipe::file::ExpressionTable;
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::Expression;

/// Eyes turn no further.
pub(super) const MAX_GAZE_DEG: f64 = 40.0;

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
