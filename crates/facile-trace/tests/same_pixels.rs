//! The way that pixels are computed leaves no trace in them; strange input is survived.

mod common;

use common::{
    ambient, assert_close, busy_scene, camera_at, icosphere, light, render, scene_of, settings,
    soup, wall,
};
use facile_core::{Plane, Point3, Vector3};
use facile_trace::math::Rgb;
use facile_trace::{
    Camera, InstructionSet, Layer, Material, Normals, Object, RenderSettings, Samples, Scene,
    Truth, trace_view,
};

#[test]
fn threads_do_not_change_bytes() {
    let camera = camera_at(600.0, 64, 0.3);
    let frame = |k: usize| {
        let scene = scene_of(
            &icosphere(40.0 + 5.0 * k as f64, 3),
            Normals::Smooth,
            [0.5; 3],
        );
        let lights = [light(
            "kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4",
        )];
        let view =
            trace_view(&scene, &camera, &settings(Samples::ADAPTIVE, Truth::ALL)).expect("valid");
        let image = view.shade(&scene, &lights).expect("valid").to_srgb8();
        (image, view.gbuffer.depth_z, view.gbuffer.hit)
    };
    let run = |threads: usize| {
        use rayon::prelude::*;
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| (0..6).into_par_iter().map(frame).collect::<Vec<_>>())
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn drawn_pixels_are_those_of_single_rays() {
    let scene = busy_scene();
    // The second camera looks past the diagonals where the longest axis of its rays changes
    for eye in [
        Point3::new(60.0, 10.0, 640.0),
        Point3::new(400.0, 120.0, 410.0),
    ] {
        let camera = Camera::look_at(131, 97, eye, Point3::origin(), Vector3::y(), 0.35);
        let camera = camera.expect("valid");
        let (view, _) = render(&scene, &camera, &[]);
        let hits = view.gbuffer.hit.expect("asked for");
        let mut found = 0;
        for y in 0..97 {
            for x in 0..131 {
                let ray = camera.ray([x as f64 + 0.5, y as f64 + 0.5]);
                let expected = scene.closest_hit(&ray, Layer::All);
                assert_eq!(hits[(x, y)].ok(), expected, "{x} {y}");
                found += usize::from(expected.is_some());
            }
        }
        assert!(found > 2_000, "{found}");
    }
}

#[test]
fn small_triangles_and_needles_are_drawn_where_their_rays_hit() {
    // From many triangles to a pixel to many pixels to a triangle, and needles that no pixel may miss
    for (count, stretch, size) in [(9_000, 1.0, 48), (6_000, 1.0, 150), (3_000, 40.0, 150)] {
        let mut mesh = soup(count, 5);
        for corners in mesh.positions.as_chunks_mut::<3>().0 {
            let middle = (corners[0].coords + corners[1].coords + corners[2].coords) / 3.0;
            for p in corners {
                let mut offset = (p.coords - middle) * 0.1;
                offset.x *= stretch;
                offset.y /= stretch;
                *p = Point3::from(middle + offset);
            }
        }
        let scene = scene_of(&mesh, Normals::Flat, [0.5; 3]);
        for eye in [
            Point3::new(60.0, 10.0, 640.0),
            Point3::new(400.0, 120.0, 410.0),
        ] {
            let camera = Camera::look_at(size, size, eye, Point3::origin(), Vector3::y(), 0.35);
            let camera = camera.expect("valid");
            let (view, _) = render(&scene, &camera, &[]);
            let hits = view.gbuffer.hit.expect("asked for");
            let mut found = 0;
            for y in 0..size {
                for x in 0..size {
                    let ray = camera.ray([x as f64 + 0.5, y as f64 + 0.5]);
                    let expected = scene.closest_hit(&ray, Layer::All);
                    assert_eq!(hits[(x, y)].ok(), expected, "{stretch} {size}: {x} {y}");
                    found += usize::from(expected.is_some());
                }
            }
            assert!(20 * found > size * size, "{found}");
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_bytes() {
    let scene = busy_scene();
    let camera = camera_at(600.0, 96, 0.35);
    let lights = [
        light("kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4"),
        light("kind = 'directional'\ndirection = [1, -1, -1]\nintensity = 0.3"),
        light("kind = 'ambient'\nintensity = 0.1"),
    ];
    let frame = |set: InstructionSet| {
        set.limit(|| {
            let settings = settings(Samples::ADAPTIVE, Truth::ALL);
            let view = trace_view(&scene, &camera, &settings).expect("valid");
            let rendering = view.shade(&scene, &lights).expect("valid");
            let bits = |c: &Rgb| [c.x, c.y, c.z].map(f32::to_bits);
            let maps = (
                view.gbuffer.depth_z,
                view.gbuffer.normal_in_world,
                view.gbuffer.hit,
                view.gbuffer.layers,
                view.gbuffer.coverage,
            );
            (
                rendering.color.map(bits),
                rendering.shadow,
                maps,
                view.gbuffer.segment,
            )
        })
    };
    let expected = frame(InstructionSet::Portable);
    for set in InstructionSet::ALL.into_iter().filter(|s| s.is_available()) {
        assert!(frame(set) == expected, "{set:?}");
    }
}

#[test]
fn an_image_does_not_depend_on_the_lights_before() {
    let mut scene = busy_scene();
    let mirror = Material {
        reflectivity: 0.4,
        ..Material::default()
    };
    let ball = icosphere(20.0, 3);
    let mut ball = Object::new(&ball, Normals::Smooth, mirror).expect("valid");
    let place = nalgebra::Vector3::new(-45.0, -30.0, 70.0);
    let pose = facile_trace::math::Pose::new(place, nalgebra::Vector3::zeros());
    ball.set_pose(&pose).expect("finite");
    scene.add(ball);
    let camera = camera_at(600.0, 96, 0.35);
    let sets = [
        vec![light(
            "kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4",
        )],
        vec![light(
            "kind = 'directional'\ndirection = [1, -1, -1]\nintensity = 0.3",
        )],
        vec![ambient()],
        vec![
            light("kind = 'point'\nposition = [-300, 100, 300]\nintensity = 0.4"),
            ambient(),
        ],
    ];
    let settings = settings(Samples::ADAPTIVE, Truth::default());
    let trace = || trace_view(&scene, &camera, &settings).expect("valid");
    let alone: Vec<Plane<[u8; 3]>> = sets
        .iter()
        .map(|lights| trace().shade(&scene, lights).expect("valid").to_srgb8())
        .collect();
    let view = trace();
    assert_eq!(view.bytes_for_lights(), 0);
    for set in [0, 1, 2, 3, 1, 0] {
        let image = view.shade(&scene, &sets[set]).expect("valid").to_srgb8();
        assert!(image == alone[set], "{set}");
    }
    // What was kept served lights again
    let kept = view.bytes_for_lights();
    view.shade(&scene, &sets[3]).expect("valid");
    assert!(kept > 0 && kept == view.bytes_for_lights());
    assert_eq!(view.clone().bytes_for_lights(), 0);
}

#[test]
fn tiny_images_and_empty_scenes_are_right() {
    let lights = [ambient()];
    let scene = scene_of(&wall(0.0, 100.0), Normals::Flat, [0.25; 3]);
    for samples in [Samples::Count(1), Samples::Count(5), Samples::ADAPTIVE] {
        let view = trace_view(
            &scene,
            &camera_at(300.0, 1, 0.1),
            &settings(samples, Truth::ALL),
        )
        .expect("valid");
        assert_close(
            view.shade(&scene, &lights).expect("valid").color[(0, 0)],
            Rgb::repeat(0.25),
            1e-6,
        );
        let empty = Scene::new(Rgb::new(0.1, 0.2, 0.3));
        let view = trace_view(
            &empty,
            &camera_at(300.0, 7, 0.1),
            &settings(samples, Truth::ALL),
        )
        .expect("valid");
        let image = view.shade(&empty, &lights).expect("valid");
        assert!(
            image
                .color
                .as_slice()
                .iter()
                .all(|c| *c == Rgb::new(0.1, 0.2, 0.3))
        );
        assert_eq!(view.gbuffer.segment, Some(Plane::filled(7, 7, 0)));
        assert_eq!(view.primary_rays(), 0);
    }
    // No light: black; a thousand lights: the sum
    let camera = camera_at(300.0, 3, 0.1);
    assert_close(
        render(&scene, &camera, &[]).1.color[(1, 1)],
        Rgb::zeros(),
        0.0,
    );
    let faint = light("kind = 'directional'\ndirection = [0, 0, -1]\nintensity = 0.001");
    assert_close(
        render(&scene, &camera, &vec![faint; 1000]).1.color[(1, 1)],
        Rgb::repeat(0.25),
        1e-4,
    );
}

#[test]
fn a_camera_inside_the_mesh_sees_its_inside() {
    let scene = scene_of(&icosphere(60.0, 2), Normals::Smooth, [0.5; 3]);
    let eye = Point3::new(3.0, 0.0, 1.0);
    let camera = Camera::look_at(16, 16, eye, Point3::new(0.0, 0.0, -60.0), Vector3::y(), 1.5)
        .expect("valid");
    let (view, rendering) = render(&scene, &camera, &[ambient()]);
    assert!(
        view.gbuffer
            .depth_z
            .expect("asked for")
            .as_slice()
            .iter()
            .all(|z| z.is_finite())
    );
    assert!(
        rendering
            .color
            .as_slice()
            .iter()
            .all(|c| (c.x - 0.5).abs() < 1e-6)
    );
}

#[test]
fn bad_settings_are_refused() {
    let scene = Scene::default();
    let camera = camera_at(300.0, 2, 0.1);
    for samples in [Samples::Count(0), Samples::Count(5_000)] {
        assert!(trace_view(&scene, &camera, &settings(samples, Truth::default())).is_err());
    }
    let bad = RenderSettings {
        offset_mm: f32::NAN,
        ..RenderSettings::default()
    };
    assert!(trace_view(&scene, &camera, &bad).is_err());
    let mut mesh = wall(0.0, 1.0);
    mesh.positions[2].x = f64::NAN;
    assert!(Object::new(&mesh, Normals::Smooth, Material::default()).is_err());
}

#[test]
#[ignore = "takes 2 GB"]
fn the_largest_image_of_a_recipe_is_rendered() {
    let scene = scene_of(&icosphere(60.0, 4), Normals::Smooth, [0.5; 3]);
    let camera = camera_at(600.0, 8192, 0.3);
    let truth = Truth {
        segment: true,
        ..Truth::default()
    };
    let view = trace_view(&scene, &camera, &settings(Samples::Count(1), truth)).expect("valid");
    let image = view.shade(&scene, &[ambient()]).expect("valid").color;
    assert_close(image[(4096, 4096)], Rgb::repeat(0.5), 1e-6);
    assert_close(image[(1, 1)], Rgb::zeros(), 0.0);
    let seen = view
        .gbuffer
        .segment
        .expect("asked for")
        .as_slice()
        .iter()
        .filter(|s| **s != 0)
        .count();
    // A disc of the sphere's outline: sin of its half angle is 60 / 600
    let radius = 8192.0 / 2.0 * (0.1_f64.asin().tan() / 0.15_f64.tan());
    let expected = std::f64::consts::PI * radius * radius;
    assert!(
        (seen as f64 / expected - 1.0).abs() < 5e-3,
        "{seen} {expected}"
    );
}
