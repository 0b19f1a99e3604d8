//! Error against time of the registration over its settings, on people whose truth is known.

use std::time::Instant;

use facile_core::io::Scan;
use facile_core::{IdentityModel, ReferenceHead};

use crate::synthetic::{KnownScan, Scanner, errors, face_vertices, scan_of};
use crate::transfer::TransferSet;
use crate::{FlowError, Registrar, Registration, RegistrationParams};

/// What one setting reaches.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkPrecisionRow {
    /// What is varied: `resolution`, `levels`, `warps`, `rounds` or `variant`.
    pub family: &'static str,
    /// The setting, such as `2.0 mm` or `no identity model`.
    pub setting: String,
    /// Median time of a registration on one thread, s, without reading the file: what the processor worked for it where the
    /// system tells (Linux), else a clock's.
    pub seconds: f64,
    /// Mean distance of the face's vertices to where they should be, mm.
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

/// People whose truth is known, and how far registrations of them are from it.
#[derive(Clone, Debug)]
pub enum Truth {
    /// The true place of each vertex is known.
    Places(Vec<KnownScan>),
    /// Only where a place of one person is on another.
    Transfer(TransferSet),
}

impl Truth {
    fn scans(&self) -> Vec<&Scan> {
        match self {
            Self::Places(known) => known.iter().map(|k| &k.scan).collect(),
            Self::Transfer(set) => set.scans.iter().collect(),
        }
    }

    /// Distances of the face's vertices to where they should be, mm, given the registrations of all scans.
    fn distances(&self, found: &[Registration]) -> Vec<f64> {
        match self {
            Self::Places(known) => {
                let face = face_vertices(ReferenceHead::embedded());
                let pairs = known.iter().zip(found);
                pairs.flat_map(|(k, f)| errors(k, f, &face)).collect()
            }
            Self::Transfer(set) => {
                let placed = found.iter().map(Registration::positions_on_scan);
                let errors = set.errors(placed.collect());
                errors.iter().map(|e| e.distance_mm).collect()
            }
        }
    }
}

/// Registers people with each of `settings` and compares with the truth, all on one thread. Errors do not depend on the
/// machine.
///
/// # Errors
/// [`FlowError`] of the first scan that is refused.
///
/// # Panics
/// If the system gives no thread.
pub fn work_precision(
    people: &Truth,
    settings: &[(&'static str, String, RegistrationParams)],
) -> Result<Vec<WorkPrecisionRow>, FlowError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    pool.expect("a thread").install(|| {
        let row = |(family, setting, params): &(&'static str, String, RegistrationParams)| {
            measured(people, family, setting, params)
        };
        settings.iter().map(row).collect()
    })
}

/// What one setting reaches.
fn measured(
    people: &Truth,
    family: &'static str,
    setting: &str,
    params: &RegistrationParams,
) -> Result<WorkPrecisionRow, FlowError> {
    let registrar = Registrar::new(ReferenceHead::embedded(), params.clone())?;
    let (mut found, mut times) = (Vec::new(), Vec::new());
    for scan in people.scans() {
        let start = (Instant::now(), worked_seconds());
        found.push(registrar.register(scan)?);
        let worked = worked_seconds()
            .zip(start.1)
            .map(|(end, start)| end - start);
        times.push(worked.unwrap_or(start.0.elapsed().as_secs_f64()));
    }
    let mut distances = people.distances(&found);
    distances.sort_unstable_by(f64::total_cmp);
    let quantile = |q| crate::report::quantile(distances.clone(), q);
    Ok(WorkPrecisionRow {
        family,
        setting: setting.to_owned(),
        seconds: crate::report::quantile(times, 0.5),
        mean_mm: distances.iter().sum::<f64>() / distances.len().max(1) as f64,
        median_mm: quantile(0.5),
        p95_mm: quantile(0.95),
    })
}

/// How long a processor has worked for this thread, s. `None` where the system does not tell.
fn worked_seconds() -> Option<f64> {
    let line = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(1e-9 * nanoseconds)
}
