//! `facile bench flow`: error against time of the registration, on people whose truth is known.

use std::path::Path;

use facile_flow::transfer::TransferSet;
use facile_flow::work_precision::{
    Truth, WorkPrecisionRow, known_people, settings, work_precision,
};

use super::{Axis, Curve, Effort, Findings, Plot, Table};
use crate::Error;

/// Measures the registration over its settings: distance to true places on people of the identity model, and, if a folder
/// as [`TransferSet::load`] reads it is given, the transfer error between its people.
///
/// # Errors
/// [`Error::Core`] for a folder that cannot be read, [`Error::Flow`] if a setting finds no face on a known person.
pub fn flow(scans: Option<&Path>, effort: Effort) -> Result<Findings, Error> {
    // Read first: a wrong folder is told before minutes have gone.
    let scans = scans.map(|s| TransferSet::load(s, effort.of(2, 5)));
    let transfer = scans.transpose()?.map(Truth::Transfer);
    let mut all = settings();
    if effort == Effort::Quick {
        all.truncate(2);
    }
    let mut findings = Findings {
        tables: Vec::new(),
        plots: Vec::new(),
    };
    let mut measure = |name, title: &str, people: &Truth| {
        let rows = work_precision(people, &all)?;
        findings.tables.push((name, table(&rows)));
        findings.plots.push((name, plot(&rows, title)));
        Ok::<_, Error>(())
    };
    let known = Truth::Places(known_people(effort.of(1, 4))?);
    let title = "registration: mean distance of the face's vertices to their true places";
    measure("flow_work_precision", title, &known)?;
    if let Some(transfer) = transfer {
        let title = "registration: mean transfer error between people of another model";
        measure("flow_transfer", title, &transfer)?;
    }
    Ok(findings)
}

fn table(rows: &[WorkPrecisionRow]) -> Table {
    let mut table = Table::new(&[
        "family",
        "setting",
        "seconds",
        "mean_mm",
        "median_mm",
        "p95_mm",
    ]);
    for row in rows {
        table.push(vec![
            row.family.into(),
            row.setting.clone().into(),
            row.seconds.into(),
            row.mean_mm.into(),
            row.median_mm.into(),
            row.p95_mm.into(),
        ]);
    }
    table
}

fn plot(rows: &[WorkPrecisionRow], title: &str) -> Plot {
    let mut curves: Vec<Curve> = Vec::new();
    // Variants are no curve: they are in the table.
    for row in rows.iter().filter(|row| row.family != "variant") {
        let point = (row.seconds, row.mean_mm);
        match curves.iter_mut().find(|c| c.name == row.family) {
            Some(curve) => curve.points.push(point),
            None => curves.push(Curve {
                name: row.family.to_owned(),
                points: vec![point],
            }),
        }
    }
    Plot {
        title: title.to_owned(),
        x: Axis::linear("seconds a scan"),
        y: Axis::linear("error, mm"),
        curves,
    }
}
