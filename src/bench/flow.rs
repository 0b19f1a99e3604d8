//! `facile bench flow`: error against time of the registration, on people whose truth is known.

use facile_flow::work_precision::{known_people, settings, work_precision};

use super::{Axis, Curve, Effort, Findings, Plot, Table};
use crate::Error;

/// Measures the registration over its settings.
///
/// # Errors
/// [`Error::Flow`] if a setting finds no face on a known person.
pub fn flow(effort: Effort) -> Result<Findings, Error> {
    let people = known_people(effort.of(1, 4))?;
    let mut all = settings();
    if effort == Effort::Quick {
        all.truncate(2);
    }
    let rows = work_precision(&people, &all)?;
    let mut table = Table::new(&[
        "family",
        "setting",
        "seconds",
        "mean_mm",
        "median_mm",
        "p95_mm",
    ]);
    let mut curves: Vec<Curve> = Vec::new();
    for row in rows {
        let point = (row.seconds, row.mean_mm);
        match curves.iter_mut().find(|c| c.name == row.family) {
            Some(curve) => curve.points.push(point),
            None => curves.push(Curve {
                name: row.family.to_owned(),
                points: vec![point],
            }),
        }
        table.push(vec![
            row.family.into(),
            row.setting.into(),
            row.seconds.into(),
            row.mean_mm.into(),
            row.median_mm.into(),
            row.p95_mm.into(),
        ]);
    }
    // Variants are no curve: they are in the table.
    curves.retain(|c| c.name != "variant");
    let plot = Plot {
        title: "registration: mean distance of the face's vertices to their true places".to_owned(),
        x: Axis::linear("seconds a scan"),
        y: Axis::linear("error, mm"),
        curves,
    };
    Ok(Findings {
        tables: vec![("flow_work_precision", table)],
        plots: vec![("flow_work_precision", plot)],
    })
}
