//! Error against time of the registration over its settings, on people whose truth is known.

use std::time::Instant;

use facile_core::{IdentityModel, ReferenceHead};

use crate::synthetic::{KnownScan, Scanner, errors, face_vertices, scan_of};
use crate::{FlowError, Registrar, RegistrationParams};

/// What one setting reaches.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkPrecisionRow {
    /// What is varied: `resolution`, `levels`, `warps`, `rounds` or `variant`.
    pub family: &'static str,
    /// The setting, such as `2.0 mm` or `no identity model`.
    pub setting: String,
    /// Median wall time of a registration, s, without reading the file.
    pub seconds: f64,
    /// Mean distance of the face's vertices to their true places, mm.
    pub mean_mm: f64,
    /// Median distance, mm.
    pub median_mm: f64,
    /// 95th percentile of the distances, mm.
    pub p95_mm: f64,
}

/// People of the identity model, scanned with some 40,000 triangles and 0.1 mm of noise.
///
/// # Errors
/// [`facile_core::CoreError`] if the model's skins are damaged.
pub fn known_people(count: u64) -> Result<Vec<KnownScan>, facile_core::CoreError> {
    let (reference, model) = (ReferenceHead::embedded(), IdentityModel::embedded());
    (0..count)
        .map(|k| {
            let subject = model.sample(reference, 77, k)?;
            let scanner = Scanner {
                cell_mm: 1.9,
                noise_mm: 0.1,
                seed: k,
                ..Scanner::default()
            };
            Ok(scan_of(reference, &subject, &scanner))
        })
        .collect()
}

/// The settings that [`work_precision`] measures: `(family, setting, parameters)`.
pub fn settings() -> Vec<(&'static str, String, RegistrationParams)> {
    let base = RegistrationParams {
        texture_size: 256,
        // They are faces, also for settings that do not look at curvature.
        min_curvature_correlation: -1.0,
        ..RegistrationParams::default()
    };
    let mut all = Vec::new();
    for cell_mm in [4.0, 3.0, 2.0, 1.5, 1.0] {
        let params = RegistrationParams {
            cell_mm,
            ..base.clone()
        };
        all.push(("resolution", format!("{cell_mm} mm"), params));
    }
    for levels in [1, 2, 3, 4, 5] {
        let mut params = base.clone();
        params.flow.levels = levels;
        all.push(("levels", levels.to_string(), params));
    }
    for warps in [1, 2, 3, 5] {
        let mut params = base.clone();
        params.flow.warps = warps;
        all.push(("warps", warps.to_string(), params));
    }
    for rounds in 1..=base.smoothing_mm.len() {
        let mut params = base.clone();
        params.smoothing_mm.truncate(rounds);
        all.push(("rounds", rounds.to_string(), params));
    }
    let mut variant = |name: &str, change: &dyn Fn(&mut RegistrationParams)| {
        let mut params = base.clone();
        change(&mut params);
        all.push(("variant", name.to_owned(), params));
    };
    variant("all", &|_| {});
    variant("coarse", &|p| *p = RegistrationParams::coarse());
    variant("nearest points and modes only", &|p| p.smoothing_mm.clear());
    variant("no identity model", &|p| p.use_identity = false);
    variant("eq. 3 in each cell alone", &|p| p.flow.smoothness = 0.0);
    variant("no colour", &|p| p.weights.color = 0.0);
    variant("no curvature", &|p| {
        p.weights.mean_curvature = 0.0;
        p.weights.gaussian_curvature = 0.0;
    });
    variant("no normals", &|p| p.weights.normal = 0.0);
    variant("no step onto the surface", &|p| {
        p.surface_smoothing_mm.clear();
    });
    all
}

/// Registers `scans` with each of `settings` and compares with the truth. Errors do not depend on the machine.
///
/// # Errors
/// [`FlowError`] of the first scan that is refused.
pub fn work_precision(
    scans: &[KnownScan],
    settings: &[(&'static str, String, RegistrationParams)],
) -> Result<Vec<WorkPrecisionRow>, FlowError> {
    let reference = ReferenceHead::embedded();
    let face = face_vertices(reference);
    let mut rows = Vec::new();
    for (family, setting, params) in settings {
        let registrar = Registrar::new(reference, params.clone())?;
        let (mut distances, mut times) = (Vec::new(), Vec::new());
        for known in scans {
            let start = Instant::now();
            let found = registrar.register(&known.scan)?;
            times.push(start.elapsed().as_secs_f64());
            distances.extend(errors(known, &found, &face));
        }
        distances.sort_unstable_by(f64::total_cmp);
        let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
        let quantile = |q| crate::report::quantile(distances.clone(), q);
        rows.push(WorkPrecisionRow {
            family,
            setting: setting.clone(),
            seconds: crate::report::quantile(times, 0.5),
            mean_mm: mean,
            median_mm: quantile(0.5),
            p95_mm: quantile(0.95),
        });
    }
    Ok(rows)
}
