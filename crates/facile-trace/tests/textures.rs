//! Which level of a texture a ray sees, and what is lost with rays of little light.

mod common;

use std::sync::Arc;

use common::{ambient, camera_at, light, settings, square, wall};
use facile_core::{Mesh, Plane, Point3, Texture, Vector3};
use facile_trace::math::Rgb;
use facile_trace::{
    Albedo, Material, Normals, Object, RenderSettings, Samples, Scene, Truth, trace_view,
};

/// A wall of 256 mm with one texel to each mm: a board of squares.
fn board(texels_a_square: usize) -> Scene {
    let code = |i: usize| (i % 256 / texels_a_square + i / 256 / texels_a_square) % 2 * 255;
    let texels = (0..256 * 256).map(|i| [code(i) as u8; 3]).collect();
    let mesh = Mesh {
        texcoords: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        texcoord_triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..wall(0.0, 128.0)
    };
    let material = Material {
        albedo: Albedo::texture(Arc::new(Texture::new(256, 256, texels))),
        ..Material::matt(Rgb::zeros())
    };
    let mut scene = Scene::default();
    scene.add(Object::new(&mesh, Normals::Flat, material).expect("valid"));
    scene
}

/// Root mean square of what the middle of the board differs from its mean, with rays `spacing` texels apart.
fn contrast(scene: &Scene, spacing: f64) -> f32 {
    let size = 64;
    let z = 1_000.0;
    let fov_y = 2.0 * (spacing * size as f64 / 2.0 / z).atan();
    let truth = Truth {
        albedo: true,
        ..Truth::default()
    };
    let camera = camera_at(z, size, fov_y);
    let view = trace_view(scene, &camera, &settings(Samples::Count(1), truth)).expect("valid");
    let albedo = view.gbuffer.albedo.expect("asked for");
    // Inside the board, whatever the spacing
    let reach = ((100.0 / spacing) as usize).min(size / 2);
    let inside = size / 2 - reach..size / 2 + reach;
    let values: Vec<f32> = inside
        .clone()
        .flat_map(|y| inside.clone().map(move |x| (x, y)))
        .map(|at| albedo[at][0])
        .collect();
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    let squares: f32 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (squares / values.len() as f32).sqrt()
}

#[test]
fn a_ray_sees_the_level_whose_texels_are_as_far_apart_as_rays() {
    // Level n is taken from 2^(n - 1/2) texels a ray on; squares of 2^k texels are grey from level k + 1 on
    for k in 0..4 {
        let side = 1 << k;
        let scene = board(side);
        let border = f64::from(1 << k) * std::f64::consts::SQRT_2;
        for (spacing, is_seen) in [
            (0.37 * border, true),
            (0.93 * border, true),
            (1.07 * border, false),
            (1.9 * border, false),
        ] {
            let found = contrast(&scene, spacing);
            assert_eq!(found > 0.05, is_seen, "{side} texels at {spacing}: {found}");
            assert!(
                is_seen || found < 0.01,
                "{side} texels at {spacing}: {found}"
            );
        }
    }
}

#[test]
fn rays_of_little_light_are_not_missed() {
    // Panes that throw back a quarter, one behind the other, before a bright wall
    let mut scene = Scene::new(Rgb::repeat(0.8));
    for k in 0..6 {
        let z = 60.0 - 10.0 * f64::from(k);
        let pane = square(Point3::new(0.0, 0.0, z), Vector3::x(), Vector3::y(), 50.0);
        let glass = Material {
            reflectivity: 0.25,
            ..Material::thin_glass(Rgb::new(0.9, 0.8, 0.7))
        };
        scene.add(Object::new(&pane, Normals::Flat, glass).expect("valid"));
    }
    scene.add(
        Object::new(
            &wall(-20.0, 80.0),
            Normals::Flat,
            Material::matt(Rgb::repeat(0.6)),
        )
        .expect("valid"),
    );
    let lights = [
        ambient(),
        light("kind = 'point'\nposition = [100, 200, 400]\nintensity = 0.5"),
    ];
    let camera = camera_at(400.0, 24, 0.3);
    let shade = |min_share: f32| -> Plane<Rgb> {
        let settings = RenderSettings {
            min_share,
            ..settings(Samples::Count(1), Truth::default())
        };
        let view = trace_view(&scene, &camera, &settings).expect("valid");
        view.shade(&scene, &lights).expect("valid").color
    };
    let whole = shade(0.0);
    let error = |min_share: f32| {
        let cut = shade(min_share);
        let pairs = cut.as_slice().iter().zip(whole.as_slice());
        pairs.map(|(a, b)| (a - b).abs().max()).fold(0.0, f32::max)
    };
    let [tenth, hundredth, thousandth] = [0.1, 0.01, 1e-3].map(error);
    assert!(
        tenth > hundredth && hundredth > thousandth,
        "{tenth} {hundredth} {thousandth}"
    );
    assert!(thousandth < 4e-3, "a step of 8 bits: {thousandth}");
    assert!(shade(RenderSettings::default().min_share) == shade(1e-3));
    let bad = RenderSettings {
        min_share: 2.0,
        ..RenderSettings::default()
    };
    assert!(trace_view(&scene, &camera, &bad).is_err());
}
