//! Orthographic cameras and lenses against geometry.

mod common;

use common::{ambient, camera_at, icosphere, light, render, scene_of, settings, wall};
use facile_core::Point3;
use facile_trace::math::Rgb;
use facile_trace::{Camera, Layer, Lens, Material, Normals, Object, Samples, Truth, trace_view};

#[test]
fn an_orthographic_sphere_is_the_formula_and_what_single_rays_hit() {
    let mut scene = scene_of(&icosphere(60.0, 5), Normals::Smooth, [0.5; 3]);
    let mut small = icosphere(15.0, 3);
    for p in &mut small.positions {
        *p += facile_core::Vector3::new(50.0, 30.0, 60.0);
    }
    scene.add(Object::new(&small, Normals::Flat, Material::default()).expect("valid"));
    let camera = camera_at(600.0, 90, 0.3)
        .orthographic(600.0)
        .expect("valid");
    let (view, _) = render(&scene, &camera, &[ambient()]);
    let depth_z = view.gbuffer.depth_z.expect("asked for");
    let hits = view.gbuffer.hit.expect("asked for");
    let mm_per_px = 2.0 * 600.0 * 0.15_f64.tan() / 90.0;
    let mut checked = [0; 2];
    for y in 0..90 {
        for x in 0..90 {
            let ray = camera.ray([x as f64 + 0.5, y as f64 + 0.5]);
            let single = scene.closest_hit(&ray, Layer::All);
            assert_eq!(hits[(x, y)].ok(), single, "{x} {y}");
            let (u, v) = ((x as f64 - 44.5) * mm_per_px, (44.5 - y as f64) * mm_per_px);
            let of_small = 225.0 - (u - 50.0).powi(2) - (v - 30.0).powi(2);
            let of_large = 3600.0 - u * u - v * v;
            let found = f64::from(depth_z[(x, y)]);
            // Nearer things are no larger
            if of_small > 8.0 {
                let exact = 600.0 - 60.0 - of_small.sqrt();
                assert!((found - exact).abs() < 0.3, "{x} {y}: {found} {exact}");
                checked[0] += 1;
            } else if of_small < -4.0 && of_large > 60.0 {
                let exact = 600.0 - of_large.sqrt();
                assert!((found - exact).abs() < 0.2, "{x} {y}: {found} {exact}");
                checked[1] += 1;
            } else if of_small < -4.0 && of_large < -4.0 {
                assert_eq!(found, f64::INFINITY);
            }
        }
    }
    assert!(checked[0] > 80 && checked[1] > 1_500, "{checked:?}");
}

/// A white half plane at a depth of `600 - z`, its border at `x = 0`, seen through a lens that focuses on `focus_mm`.
fn border(z: f64, focus_mm: f64, count: u32) -> Vec<f32> {
    let mut half = wall(z, 400.0);
    for p in &mut half.positions {
        p.x += 400.0;
    }
    let scene = scene_of(&half, Normals::Flat, [1.0; 3]);
    let lens = Lens {
        radius_mm: 20.0,
        focus_mm,
    };
    let camera = camera_at(600.0, 64, 0.2).with_lens(lens).expect("valid");
    let samples = settings(Samples::Count(count), Truth::ALL);
    let view = trace_view(&scene, &camera, &samples).expect("valid");
    let image = view.shade(&scene, &[ambient()]).expect("valid").color;
    // Labels are those of the pinhole
    let sharp = trace_view(&scene, &camera_at(600.0, 64, 0.2), &samples).expect("valid");
    assert_eq!(view.gbuffer.depth_z, sharp.gbuffer.depth_z);
    assert_eq!(view.gbuffer.hit, sharp.gbuffer.hit);
    assert_eq!(view.gbuffer.coverage, sharp.gbuffer.coverage);
    let again = trace_view(&scene, &camera, &samples).expect("valid");
    assert_eq!(
        again.shade(&scene, &[ambient()]).expect("valid").color,
        image
    );
    let mean = |x: usize| (0..64).map(|y| image[(x, y)].x).sum::<f32>() / 64.0;
    (0..64).map(mean).collect()
}

#[test]
fn a_lens_blurs_a_border_by_its_disc() {
    let focal = 32.0 / 0.1_f64.tan();
    for (z, focus) in [(100.0, 600.0), (-200.0, 600.0), (0.0, 500.0)] {
        let depth: f64 = 600.0 - z;
        let radius = 20.0 * focal * (1.0 / depth - 1.0 / focus).abs();
        assert!(radius > 1.5, "{radius}");
        let found = border(z, focus, 64);
        for (x, found) in found.iter().enumerate() {
            // Share of a disc on one side of a line, the mean over the pixel's width
            let share = |x: f64| {
                let a = (x / radius).clamp(-1.0, 1.0);
                0.5 + (a * (1.0 - a * a).sqrt() + a.asin()) / std::f64::consts::PI
            };
            let parts = (0..16).map(|k| share(x as f64 - 32.0 + (f64::from(k) + 0.5) / 16.0));
            let exact = parts.sum::<f64>() / 16.0;
            assert!(
                (f64::from(*found) - exact).abs() < 0.02,
                "{z} {x}: {found} {exact}"
            );
        }
    }
    // In focus the border is as sharp as the pixels
    let found = border(0.0, 600.0, 64);
    assert!(found[31] < 1e-3 && found[32] > 0.999, "{found:?}");
}

#[test]
fn a_lens_needs_a_number_of_samples() {
    let scene = scene_of(&wall(0.0, 40.0), Normals::Flat, [1.0; 3]);
    let lens = Lens {
        radius_mm: 20.0,
        focus_mm: 500.0,
    };
    let camera = camera_at(600.0, 16, 0.2).with_lens(lens).expect("valid");
    for samples in [Samples::Count(1), Samples::ADAPTIVE] {
        let error = trace_view(&scene, &camera, &settings(samples, Truth::default()));
        assert!(error.expect_err("refused").to_string().contains("lens"));
    }
}

#[test]
fn as_many_lights_as_one_likes() {
    let scene = scene_of(&icosphere(60.0, 2), Normals::Smooth, [0.5; 3]);
    let camera = camera_at(600.0, 24, 0.3);
    let (view, dark) = render(&scene, &camera, &[]);
    assert!(dark.color.as_slice().iter().all(|c| *c == Rgb::zeros()));
    assert!(
        dark.shadow
            .expect("asked for")
            .as_slice()
            .iter()
            .all(|s| *s == 1.0)
    );
    let one = light("kind = 'point'\nposition = [200, 300, 500]\nintensity = 0.5");
    let weak = light("kind = 'point'\nposition = [200, 300, 500]\nintensity = 0.0005");
    let lit = view.shade(&scene, &[one]).expect("valid");
    let many = view.shade(&scene, &vec![weak; 1000]).expect("valid");
    for (a, b) in lit.color.as_slice().iter().zip(many.color.as_slice()) {
        assert!((a - b).abs().max() < 1e-4, "{a:?} {b:?}");
    }
    assert_eq!(lit.shadow, many.shadow);
}

#[test]
fn triangles_without_area_are_never_seen_and_change_nothing() {
    let ball = icosphere(60.0, 2);
    let mut broken = ball.clone();
    let point = broken.positions.len() as u32;
    // A needle before the ball, a point, and a sliver of it
    broken.positions.extend([
        Point3::new(-90.0, 0.0, 100.0),
        Point3::new(90.0, 0.0, 100.0),
        Point3::new(0.0, 0.0, 100.0),
    ]);
    broken
        .triangles
        .extend([[point, point + 1, point + 2], [point; 3], [0, 0, 1]]);
    let camera = Camera::look_at(
        40,
        40,
        Point3::new(0.0, 0.0, 600.0),
        Point3::origin(),
        facile_core::Vector3::y(),
        0.3,
    )
    .expect("valid");
    let sun = light("kind = 'directional'\ndirection = [0.1, -0.2, -1]\nintensity = 1");
    let [(a, lit_a), (b, lit_b)] = [&ball, &broken].map(|mesh| {
        let scene = scene_of(mesh, Normals::Smooth, [0.5; 3]);
        render(&scene, &camera, std::slice::from_ref(&sun))
    });
    assert_eq!(a.gbuffer.hit, b.gbuffer.hit);
    assert_eq!(a.gbuffer.normal_in_world, b.gbuffer.normal_in_world);
    assert_eq!(lit_a.color, lit_b.color);
}
