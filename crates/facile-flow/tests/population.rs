//! The mean of a population is a reference head that scans register to.

use facile_core::io::Scan;
use facile_core::{IdentityModel, ReferenceHead};
use facile_flow::synthetic::{Scanner, scan_of};
use facile_flow::{FlowError, PopulationParams, RegistrationParams, build_reference};

const FACES: usize = 6;

fn scan(number: usize) -> Result<Scan, String> {
    let reference = ReferenceHead::embedded();
    let subject = IdentityModel::embedded()
        .sample(reference, 11, number as u64)
        .map_err(|e| e.to_string())?;
    Ok(scan_of(reference, &subject, &Scanner::default()).scan)
}

fn params() -> RegistrationParams {
    RegistrationParams {
        texture_size: 64,
        cell_mm: 3.0,
        ..RegistrationParams::default()
    }
}

#[test]
#[ignore = "registers a population several times: half a minute in the dev profile"]
fn a_population_has_a_symmetric_mean_on_the_same_topology() {
    let start = ReferenceHead::embedded();
    let stop = PopulationParams {
        at_least: FACES,
        // Six faces on a coarse grid: their mean is known no better.
        tolerance_mm: 0.3,
        ..PopulationParams::default()
    };
    let mean = build_reference(start, FACES, scan, &params(), stop, |_| ()).expect("a mean");
    assert!(mean.converged, "{:?}", mean.rounds);
    assert_eq!(mean.head.topology_digest(), start.topology_digest());
    let cage = &mean.head.cage;
    for (p, m) in cage.positions.iter().zip(&cage.mirror) {
        let q = cage.positions[*m as usize];
        assert!((p.x + q.x).abs() < 1e-9 && (p.y - q.y).abs() < 1e-9);
    }
    // The mean of these six lies within the spread of the population.
    let last = mean.rounds.last().expect("rounds");
    assert!(last.spread_mm > 1.0 && last.spread_mm < 10.0, "{last:?}");
}

#[test]
fn too_small_a_population_is_refused_with_the_numbers() {
    let stop = PopulationParams {
        at_least: 3,
        ..PopulationParams::default()
    };
    let broken = |_| Err::<Scan, _>("torn file");
    let error = build_reference(
        ReferenceHead::embedded(),
        2,
        broken,
        &params(),
        stop,
        |_| (),
    )
    .expect_err("no faces");
    assert!(matches!(
        error,
        FlowError::Population {
            registered: 0,
            given: 2,
            needed: 3,
            ..
        }
    ));
    assert!(error.to_string().contains("torn file"), "{error}");
}

#[test]
fn a_mean_that_could_never_be_reached_is_refused() {
    let never = |_| Err::<Scan, _>("not read");
    let good = PopulationParams::default();
    for stop in [
        PopulationParams {
            tolerance_mm: f64::NAN,
            ..good
        },
        PopulationParams {
            max_rounds: 0,
            ..good
        },
    ] {
        let error = build_reference(ReferenceHead::embedded(), 2, never, &params(), stop, |_| ())
            .expect_err("out of range");
        assert!(matches!(error, FlowError::Parameter { .. }), "{error}");
    }
}
