//! Labels against geometry, and what they cost nothing else.

mod common;

use common::{camera_at, icosphere, light, render, scene_of, settings, soup, square, wall};
use facile_core::{Point3, Segment, Vector3};
use facile_trace::math::Rgb;
use facile_trace::triangle::{RayShear, intersect};
use facile_trace::{Camera, Material, Normals, Object, Occlusion, Samples, Truth, trace_view};

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
fn layers_are_all_surfaces_of_a_ray_in_order() {
    let mesh = soup(400, 12);
    let scene = scene_of(&mesh, Normals::Flat, [0.5; 3]);
    let camera = camera_at(600.0, 32, 0.3);
    let (view, _) = render(&scene, &camera, &[]);
    let layers = &view.gbuffer.layers;
    assert_eq!(layers.len(), 4);
    assert_eq!(Some(&layers[0].depth_z), view.gbuffer.depth_z.as_ref());
    assert_eq!(Some(&layers[0].segment), view.gbuffer.segment.as_ref());
    let mut deep = 0;
    for (y, x) in (0..32).flat_map(|y| (0..32).map(move |x| (y, x))) {
        // Brute force: every triangle that the ray meets
        let ray = camera.ray([x as f64 + 0.5, y as f64 + 0.5]);
        let shear = RayShear::new(ray.direction);
        let mut all: Vec<f32> = mesh
            .triangles
            .iter()
            .filter_map(|t| {
                let corners = t.map(|v| mesh.positions[v as usize].coords.cast());
                intersect(&ray, &shear, &corners).map(|(t, ..)| t)
            })
            .collect();
        all.sort_by(f32::total_cmp);
        all.dedup();
        for (k, layer) in layers.iter().enumerate() {
            let expected = all.get(k).copied().unwrap_or(f32::INFINITY);
            assert_eq!(layer.depth_z[(x, y)], expected, "{x} {y} {k}");
        }
        deep += usize::from(all.len() > 3);
    }
    assert!(deep > 50, "{deep}");
}

#[test]
fn the_second_layer_is_the_face_behind_the_glasses() {
    let camera = camera_at(600.0, 60, 0.3);
    let mut ball = icosphere(60.0, 3);
    ball.segments = vec![Segment::Skin; ball.triangles.len()];
    let mut scene = scene_of(&ball, Normals::Smooth, [0.5; 3]);
    let (bare, _) = render(&scene, &camera, &[]);
    let lens = square(
        Point3::new(0.0, 0.0, 100.0),
        Vector3::x(),
        Vector3::y(),
        25.0,
    );
    let glass = Material::thin_glass(Rgb::repeat(0.5));
    scene.add(
        Object::new(&lens, Normals::Flat, glass)
            .expect("valid")
            .as_occluder(),
    );
    let (view, _) = render(&scene, &camera, &[]);
    let bare = bare.gbuffer.depth_z.expect("asked for");
    let [first, second] = [&view.gbuffer.layers[0], &view.gbuffer.layers[1]];
    let mut covered = 0;
    for i in 0..60 * 60 {
        let [first, second, bare] =
            [&first.depth_z, &second.depth_z, &bare].map(|plane| plane.as_slice()[i]);
        if first < bare {
            assert_eq!(second, bare, "{i}");
            covered += 1;
        } else {
            assert_eq!(first, bare, "{i}");
        }
    }
    assert!(covered > 200, "{covered}");
}

#[test]
fn coverage_is_the_area_of_the_outline() {
    let scene = scene_of(&wall(0.0, 60.0), Normals::Flat, [0.5; 3]);
    let camera = camera_at(600.0, 61, 0.3);
    for samples in [Samples::Count(1), Samples::ADAPTIVE] {
        let truth = Truth {
            coverage: true,
            ..Truth::default()
        };
        let view = trace_view(&scene, &camera, &settings(samples, truth)).expect("valid");
        let coverage = view.gbuffer.coverage.expect("asked for");
        let found: f64 = coverage.as_slice().iter().map(|v| f64::from(*v)).sum();
        let side = 120.0 / 600.0 / (2.0 * 0.15_f64.tan()) * 61.0;
        assert!((found / (side * side) - 1.0).abs() < 3e-3, "{found} {side}");
        assert!(coverage.as_slice().iter().any(|v| *v > 0.05 && *v < 0.95));
    }
}
