//! Images and labels against what optics says they must be.

mod common;

use common::{ambient, camera_at, icosphere, light, scene_of, square, wall};
use facile_core::{Mesh, Plane, Point3, Segment, Vector3};
use facile_trace::math::Rgb;
use facile_trace::{
    Albedo, Camera, InstructionSet, Layer, LightSource, Material, Normals, Object, Occlusion,
    RenderSettings, Rendering, Samples, Scene, Transmission, Truth, View, trace_view,
};

fn settings(samples: Samples, truth: Truth) -> RenderSettings {
    RenderSettings {
        samples,
        truth,
        ..RenderSettings::default()
    }
}

fn render(scene: &Scene, camera: &Camera, lights: &[LightSource]) -> (View, Rendering) {
    let view = trace_view(scene, camera, &settings(Samples::Count(1), Truth::ALL)).expect("valid");
    let rendering = view.shade(scene, lights).expect("valid");
    (view, rendering)
}

fn assert_close(a: Rgb, b: Rgb, tolerance: f32) {
    assert!((a - b).abs().max() <= tolerance, "{a:?} is not {b:?}");
}

#[test]
fn depth_of_a_sphere_is_analytic() {
    let scene = scene_of(&icosphere(80.0, 5), Normals::Smooth, [0.5; 3]);
    let camera = camera_at(600.0, 64, 0.3);
    let (view, _) = render(&scene, &camera, &[]);
    let depth_z = view.gbuffer.depth_z.expect("asked for");
    let mut checked = 0;
    for y in 0..64 {
        for x in 0..64 {
            // |o + t d|^2 = r^2 with d of depth 1
            let ray = camera.ray([x as f64 + 0.5, y as f64 + 0.5]);
            let (o, d) = (ray.origin.cast::<f64>(), ray.direction.cast::<f64>());
            let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 6400.0);
            let root = b * b - a * c;
            let found = f64::from(depth_z[(x, y)]);
            if root > 0.06 * b * b * 0.1 {
                let exact = (-b - root.sqrt()) / a;
                assert!((found - exact).abs() < 0.15, "{x} {y}: {found} {exact}");
                checked += 1;
            } else if root < -1.0 {
                assert_eq!(found, f64::INFINITY);
            }
        }
    }
    assert!(checked > 500, "{checked}");
}

#[test]
fn hits_project_back_to_their_pixels() {
    let tilted = Vector3::new(1.0, 0.0, 0.4)
        .try_normalize(0.0)
        .expect("not zero");
    let scene = scene_of(
        &square(Point3::origin(), tilted, Vector3::y(), 120.0),
        Normals::Flat,
        [0.5; 3],
    );
    let eye = Point3::new(150.0, -80.0, 500.0);
    let camera =
        Camera::look_at(97, 61, eye, Point3::new(3.0, 4.0, 5.0), Vector3::y(), 0.4).expect("valid");
    let (view, _) = render(&scene, &camera, &[]);
    let hits = view.gbuffer.hit.expect("asked for");
    let mut checked = 0;
    for y in 0..61 {
        for x in 0..97 {
            let Some(hit) = hits[(x, y)].ok() else {
                continue;
            };
            let geometry = scene.objects()[0].geometry();
            let [a, b, c] = geometry.triangles()[hit.triangle as usize]
                .map(|v| geometry.positions()[v as usize]);
            let [wa, wb, wc] = hit.barycentric();
            let point = Point3::from((a * wa + b * wb + c * wc).cast::<f64>());
            let (px, _) = camera.project(&point).expect("in front");
            let off = (px[0] - x as f64 - 0.5).hypot(px[1] - y as f64 - 0.5);
            assert!(off < 0.01, "{x} {y}: {px:?}");
            checked += 1;
        }
    }
    assert!(checked > 2_000);
}

#[test]
fn a_facing_wall_has_the_stated_brightness() {
    let scene = scene_of(&wall(0.0, 400.0), Normals::Flat, [0.8, 0.4, 0.2]);
    let camera = camera_at(600.0, 33, 0.02);
    let middle = |lights: &[LightSource]| render(&scene, &camera, lights).1.color[(16, 16)];
    let point = light("kind = 'point'\nposition = [0, 0, 1000]\nintensity = 1");
    assert_close(middle(&[point]), Rgb::new(0.8, 0.4, 0.2), 1e-4);
    let far = light("kind = 'point'\nposition = [0, 0, 2000]\nintensity = 1");
    assert_close(middle(&[far]), Rgb::new(0.2, 0.1, 0.05), 1e-4);
    let oblique =
        light("kind = 'directional'\ndirection = [-1, 0, -1]\nintensity = 0.5\ncolor = [1, 1, 0]");
    let cosine = std::f32::consts::FRAC_1_SQRT_2;
    assert_close(middle(&[oblique]), Rgb::new(0.4, 0.2, 0.0) * cosine, 1e-4);
    let behind = light("kind = 'directional'\ndirection = [0, 0, 1]\nintensity = 1");
    assert_close(middle(&[behind]), Rgb::zeros(), 0.0);
    let dim = light("kind = 'ambient'\nintensity = 0.25");
    assert_close(middle(&[dim, far]), Rgb::new(0.4, 0.2, 0.1), 1e-4);
}

#[test]
fn shadows_have_the_stated_place_and_tint() {
    // Light above the left; a small screen half-way between light and wall
    let lamp = light("kind = 'point'\nposition = [-200, 0, 200]\nintensity = 0.1");
    let screen = square(
        Point3::new(-100.0, 0.0, 100.0),
        Vector3::x(),
        Vector3::y(),
        10.0,
    );
    let camera = camera_at(900.0, 101, 0.3);
    let mut scene = scene_of(&wall(0.0, 150.0), Normals::Flat, [1.0; 3]);
    let bare = render(&scene, &camera, &[lamp]).1.color;
    let opaque = Object::new(&screen, Normals::Flat, Material::matt(Rgb::zeros())).expect("valid");
    let foil = Material::thin_glass(Rgb::new(1.0, 0.5, 0.0));
    let foil = Object::new(
        &screen,
        Normals::Flat,
        Material {
            reflectivity: 0.0,
            specular: 0.0,
            ..foil
        },
    )
    .expect("valid");
    let at = |image: &Plane<Rgb>, x: f64, y: f64| {
        let (px, _) = camera.project(&Point3::new(x, y, 0.0)).expect("in front");
        image[(px[0] as usize, px[1] as usize)]
    };
    // The shadow is the screen seen from the lamp: twice as large, about the origin
    let tints = [(opaque, Rgb::zeros()), (foil, Rgb::new(1.0, 0.5, 0.0))];
    for (object, tint) in tints {
        scene.truncate(1);
        scene.add(object);
        let (_, rendering) = render(&scene, &camera, &[lamp]);
        let shadow = rendering.shadow.expect("asked for");
        for (x, y) in [(0.0, 0.0), (17.0, 0.0), (0.0, -17.0), (-17.0, 17.0)] {
            assert_close(
                at(&rendering.color, x, y),
                at(&bare, x, y).component_mul(&tint),
                1e-5,
            );
        }
        for (x, y) in [(24.0, 0.0), (0.0, -24.0), (60.0, 60.0)] {
            assert_close(at(&rendering.color, x, y), at(&bare, x, y), 0.0);
        }
        assert!((shadow[(50, 50)] - tint.sum() / 3.0).abs() < 1e-5);
        assert!((shadow[(80, 50)] - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_mirror_shows_what_is_behind_the_camera() {
    let mut scene = Scene::new(Rgb::new(0.0, 0.0, 0.3));
    scene.add(Object::new(&wall(0.0, 50.0), Normals::Flat, Material::mirror()).expect("valid"));
    let colors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    for (side, color) in [-1.0, 1.0].into_iter().zip(colors) {
        let center = Point3::new(side * 100.0, 0.0, 900.0);
        let mesh = square(center, -Vector3::x(), Vector3::y(), 99.0);
        scene.add(
            Object::new(&mesh, Normals::Flat, Material::matt(Rgb::from(color))).expect("valid"),
        );
    }
    let camera = camera_at(400.0, 41, 0.24);
    let image = render(&scene, &camera, &[ambient()]).1.color;
    // A pixel at x on the mirror sees x + x / 400 * 900 behind
    assert_close(image[(10, 20)], Rgb::new(1.0, 0.0, 0.0), 1e-5);
    assert_close(image[(30, 20)], Rgb::new(0.0, 1.0, 0.0), 1e-5);
    // Above and below, the mirror shows the background
    scene.truncate(1);
    let image = render(&scene, &camera, &[ambient()]).1.color;
    assert_close(image[(20, 20)], Rgb::new(0.0, 0.0, 0.3), 1e-5);
}

/// A closed box.
fn slab(low: Point3, high: Point3) -> Mesh {
    let (middle, half) = (nalgebra::center(&low, &high), (high - low) / 2.0);
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let (u, v) = (
                Vector3::ith((axis + 1) % 3, 1.0),
                Vector3::ith((axis + 2) % 3, 1.0),
            );
            let (u, v) = if side > 0.0 { (u, v) } else { (v, u) };
            let center = middle + Vector3::ith(axis, side * half[axis]);
            let corner =
                |a: f64, b: f64| center + u.component_mul(&half) * a + v.component_mul(&half) * b;
            let base = mesh.positions.len() as u32;
            mesh.positions.extend([
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ]);
            mesh.triangles
                .extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
    }
    mesh
}

#[test]
fn a_thick_pane_shifts_what_is_behind_it() {
    // A pane of 40 mm at 45 degrees to the line of sight shifts it by d sin(a) (1 - cos(a) / (n cos(b)))
    let (a, n, d) = (std::f64::consts::FRAC_PI_4, 1.5_f64, 40.0);
    let b = (a.sin() / n).asin();
    let shift = d * a.sin() * (1.0 - a.cos() / (n * b.cos()));
    let transmission = Transmission::Solid {
        ior: 1.5,
        tint: Rgb::repeat(1.0),
    };
    let glass = Material {
        transmission: Some(transmission),
        ..Material::default()
    };
    let pane = slab(
        Point3::new(-200.0, -200.0, -20.0),
        Point3::new(200.0, 200.0, 20.0),
    );
    let eye = Point3::new(5_000.0, 0.0, 5_000.0);
    let camera = Camera::look_at(1, 1, eye, Point3::origin(), Vector3::y(), 1e-5).expect("valid");
    let along = Vector3::new(1.0, 0.0, 1.0) / 2.0_f64.sqrt();
    let across = Vector3::new(1.0, 0.0, -1.0) / 2.0_f64.sqrt();
    // A card far behind, its edge just short of and just past the shifted line of sight
    let sees_card = |edge: f64| {
        let mut scene = Scene::default();
        scene.add(Object::new(&pane, Normals::Flat, glass.clone()).expect("valid"));
        let center = Point3::from(along * -400.0 + across * (edge + 50.0));
        let card = square(center, across, Vector3::y(), 50.0);
        scene.add(
            Object::new(&card, Normals::Flat, Material::matt(Rgb::repeat(1.0))).expect("valid"),
        );
        render(&scene, &camera, &[ambient()]).1.color[(0, 0)].x > 0.5
    };
    // Refraction bends towards the pane's normal z, so the line comes out on the side of +across
    assert!(shift > 8.0);
    assert!(sees_card(shift - 0.1) && !sees_card(shift + 0.1));
}

#[test]
fn smooth_terminators_have_no_facets() {
    // A coarse sphere with smooth normals, lit from the side, against Lambert's law of the true sphere
    let scene = scene_of(&icosphere(80.0, 3), Normals::Smooth, [1.0; 3]);
    let camera = camera_at(5_000.0, 128, 0.036);
    let side = light("kind = 'directional'\ndirection = [-1, 0, -0.2]\nintensity = 1");
    let (view, rendering) = render(&scene, &camera, &[side]);
    let normals = view.gbuffer.normal_in_world.expect("asked for");
    let segments = view.gbuffer.segment.expect("asked for");
    let towards = Vector3::new(1.0, 0.0, 0.2)
        .try_normalize(0.0)
        .expect("not zero")
        .cast::<f32>();
    let mut lit = 0;
    for (i, (color, normal)) in rendering
        .color
        .as_slice()
        .iter()
        .zip(normals.as_slice())
        .enumerate()
    {
        let cosine = towards.dot(&nalgebra::Vector3::from(*normal));
        if segments.as_slice()[i] != 0 {
            let expected = cosine.max(0.0);
            assert!(
                (color.x - expected).abs() < 0.02,
                "pixel {i}: {} for {expected}",
                color.x
            );
            lit += usize::from(expected > 0.0);
        }
    }
    assert!(lit > 3_000);
}

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

#[test]
fn amodal_labels_are_those_of_the_scene_without_occluders() {
    let camera = camera_at(600.0, 60, 0.3);
    let mut ball = icosphere(60.0, 3);
    ball.segments = vec![Segment::Skin; ball.triangles.len()];
    let mut scene = scene_of(&ball, Normals::Smooth, [0.5; 3]);
    let (bare, _) = render(&scene, &camera, &[]);
    let mut add = |x: f64, material: Material| {
        let mesh = square(Point3::new(x, 0.0, 100.0), Vector3::x(), Vector3::y(), 12.0);
        scene.add(
            Object::new(&mesh, Normals::Flat, material)
                .expect("valid")
                .as_occluder(),
        );
    };
    add(-25.0, Material::default());
    add(25.0, Material::thin_glass(Rgb::repeat(0.5)));
    add(75.0, Material::default());
    let (view, _) = render(&scene, &camera, &[]);
    assert_eq!(view.gbuffer.amodal_segment, bare.gbuffer.segment);
    assert_eq!(view.gbuffer.amodal_depth_z, bare.gbuffer.depth_z);
    assert_ne!(view.gbuffer.segment, bare.gbuffer.segment);
    let occlusion = view.gbuffer.occlusion.expect("asked for");
    let at = |x: f64| {
        let (px, _) = camera
            .project(&Point3::new(x, 0.0, 100.0))
            .expect("in front");
        occlusion[(px[0] as usize, px[1] as usize)]
    };
    assert_eq!(at(-25.0), Occlusion::Covered as u8);
    assert_eq!(at(25.0), Occlusion::Through as u8);
    assert_eq!(at(0.0), Occlusion::Visible as u8);
    assert_eq!(at(75.0), Occlusion::NoFace as u8);
}

#[test]
fn what_is_not_asked_for_is_not_there_and_changes_nothing() {
    let scene = scene_of(&icosphere(60.0, 3), Normals::Smooth, [0.5; 3]);
    let camera = camera_at(600.0, 40, 0.3);
    let lights = [light(
        "kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4",
    )];
    let images: Vec<_> = [Truth::default(), Truth::ALL]
        .map(|truth| {
            let view =
                trace_view(&scene, &camera, &settings(Samples::ADAPTIVE, truth)).expect("valid");
            assert_eq!(view.gbuffer.depth_z.is_some(), truth.depth_z);
            view.shade(&scene, &lights).expect("valid").to_srgb8()
        })
        .into();
    assert_eq!(images[0], images[1]);
}

#[test]
fn a_view_can_be_lit_again_and_lights_add_up() {
    let scene = scene_of(&icosphere(60.0, 3), Normals::Smooth, [0.5; 3]);
    let view = trace_view(
        &scene,
        &camera_at(600.0, 40, 0.3),
        &settings(Samples::Count(1), Truth::default()),
    )
    .expect("valid");
    let lamp = light("kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4");
    let sky = light("kind = 'directional'\ndirection = [0, -1, 0]\nintensity = 0.3");
    let shade = |lights: &[LightSource]| view.shade(&scene, lights).expect("valid").color;
    let (a, b, both) = (shade(&[lamp]), shade(&[sky]), shade(&[lamp, sky]));
    for i in 0..both.as_slice().len() {
        assert_close(a.as_slice()[i] + b.as_slice()[i], both.as_slice()[i], 1e-6);
    }
    assert_eq!(shade(&[lamp]), a);
}

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
fn vertex_colours_and_textures_show() {
    let camera = camera_at(300.0, 9, 0.02);
    let mut mesh = wall(0.0, 100.0);
    mesh.colors = vec![[0.2, 0.4, 0.6]; 4];
    let mut scene = Scene::default();
    let material = Material {
        albedo: Albedo::VertexColor,
        ..Material::default()
    };
    scene.add(Object::new(&mesh, Normals::Flat, material).expect("valid"));
    assert_close(
        render(&scene, &camera, &[ambient()]).1.color[(4, 4)],
        Rgb::new(0.2, 0.4, 0.6),
        1e-6,
    );
    // The upper left texel of the image is at the upper left of the wall
    mesh.texcoords = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    mesh.texcoord_triangles = mesh.triangles.clone();
    let texels = vec![[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];
    let texture = std::sync::Arc::new(facile_core::Texture::new(2, 2, texels));
    let mut scene = Scene::default();
    let material = Material {
        albedo: Albedo::texture(texture),
        ..Material::default()
    };
    scene.add(Object::new(&mesh, Normals::Flat, material).expect("valid"));
    let image = render(&scene, &camera_at(300.0, 8, 0.6), &[ambient()])
        .1
        .color;
    assert_close(image[(0, 0)], Rgb::new(1.0, 0.0, 0.0), 1e-5);
    assert_close(image[(7, 0)], Rgb::new(0.0, 1.0, 0.0), 1e-5);
    assert_close(image[(0, 7)], Rgb::new(0.0, 0.0, 1.0), 1e-5);
}

/// Objects of all kinds: posed and not, hiding each other, with faces that coincide.
fn busy_scene() -> Scene {
    let mut scene = scene_of(&icosphere(60.0, 4), Normals::Smooth, [0.7, 0.5, 0.4]);
    let eye = Object::new(&icosphere(15.0, 3), Normals::Smooth, Material::default());
    let mut eye = eye.expect("valid");
    let turn = nalgebra::Vector3::new(0.1, 0.3, 0.2);
    let place = nalgebra::Vector3::new(20.0, 10.0, 55.0);
    eye.set_pose(&facile_trace::math::Pose::new(place, turn))
        .expect("finite");
    scene.add(eye);
    for _ in 0..2 {
        let card = square(
            Point3::new(-70.0, 30.0, 20.0),
            Vector3::x(),
            Vector3::y(),
            40.0,
        );
        scene.add(Object::new(&card, Normals::Flat, Material::default()).expect("valid"));
    }
    scene
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
