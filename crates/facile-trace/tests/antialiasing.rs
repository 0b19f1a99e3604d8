//! Many samples per pixel, and few where few suffice.

mod common;

use common::{camera_at, icosphere, light, scene_of, settings, wall};
use facile_core::Plane;
use facile_trace::{Normals, Samples, Truth, trace_view};

#[test]
fn sampling_does_not_change_what_is_even() {
    let scene = scene_of(&wall(0.0, 900.0), Normals::Flat, [0.3, 0.5, 0.7]);
    let camera = camera_at(600.0, 24, 0.5);
    let lights = [light(
        "kind = 'directional'\ndirection = [0, 0, -1]\nintensity = 0.9",
    )];
    let shade = |samples| {
        let view =
            trace_view(&scene, &camera, &settings(samples, Truth::default())).expect("valid");
        view.shade(&scene, &lights).expect("valid").to_srgb8()
    };
    let single = shade(Samples::Count(1));
    assert_eq!(single, shade(Samples::Count(4)));
    assert_eq!(single, shade(Samples::Count(13)));
    assert_eq!(single, shade(Samples::ADAPTIVE));
}

#[test]
fn adaptive_sampling_smooths_edges_as_full_sampling_does() {
    let scene = scene_of(&icosphere(80.0, 4), Normals::Smooth, [0.9; 3]);
    let camera = camera_at(600.0, 48, 0.32);
    let lights = [light(
        "kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4",
    )];
    let shade = |samples| {
        let view =
            trace_view(&scene, &camera, &settings(samples, Truth::default())).expect("valid");
        (
            view.shade(&scene, &lights).expect("valid").to_srgb8(),
            view.primary_rays(),
        )
    };
    let rms = |a: &Plane<[u8; 3]>, b: &Plane<[u8; 3]>| {
        let pairs = a
            .as_slice()
            .as_flattened()
            .iter()
            .zip(b.as_slice().as_flattened());
        let sum: f64 = pairs.map(|(p, q)| f64::from(p.abs_diff(*q)).powi(2)).sum();
        (sum / a.as_slice().len() as f64 / 3.0).sqrt()
    };
    let (exact, _) = shade(Samples::Count(256));
    let (single, _) = shade(Samples::Count(1));
    let (adaptive, rays) = shade(Samples::ADAPTIVE);
    let (full, full_rays) = shade(Samples::Count(16));
    assert!(rms(&adaptive, &exact) < 0.3 * rms(&single, &exact));
    assert!(rms(&adaptive, &exact) < 1.3 * rms(&full, &exact) + 0.1);
    assert!(rays * 3 < full_rays, "{rays} {full_rays}");
}
