//! Light and materials against what optics says they must give.

mod common;

use common::{
    ambient, assert_close, camera_at, icosphere, light, render, scene_of, settings, slab, square,
    wall,
};
use facile_core::{Plane, Point3, Vector3};
use facile_trace::math::Rgb;
use facile_trace::{
    Albedo, Camera, LightSource, Material, Normals, Object, Rendering, Samples, Scene,
    Transmission, Truth, View, trace_view,
};

#[test]
fn a_facing_wall_has_the_stated_brightness() {
    let scene = scene_of(&wall(0.0, 400.0), Normals::Flat, [0.8, 0.4, 0.2]);
    let camera = camera_at(600.0, 33, 0.02);
    let middle = |lights: &[LightSource]| render(&scene, &camera, lights).1.color[(16, 16)];
    let point = light("kind = 'point'\nposition = [0, 0, 1000]\nintensity = 1");
    assert_close(middle(&[point]), Rgb::new(0.8, 0.4, 0.2), 1e-4);
    let far = light("kind = 'point'\nposition = [0, 0, 2000]\nintensity = 1");
    assert_close(
        middle(std::slice::from_ref(&far)),
        Rgb::new(0.2, 0.1, 0.05),
        1e-4,
    );
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
    let bare = render(&scene, &camera, std::slice::from_ref(&lamp)).1.color;
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
        let (_, rendering) = render(&scene, &camera, std::slice::from_ref(&lamp));
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
    let (a, b, both) = (
        shade(std::slice::from_ref(&lamp)),
        shade(std::slice::from_ref(&sky)),
        shade(&[lamp.clone(), sky]),
    );
    for i in 0..both.as_slice().len() {
        assert_close(a.as_slice()[i] + b.as_slice()[i], both.as_slice()[i], 1e-6);
    }
    assert_eq!(shade(&[lamp]), a);
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

/// A sphere inside the same light from everywhere, as `count` parallel lights.
fn furnace(material: Material, count: u32) -> (View, Rendering) {
    let mut scene = Scene::default();
    scene.add(Object::new(&icosphere(60.0, 5), Normals::Smooth, material).expect("valid"));
    let lights: Vec<LightSource> = (0..count)
        .map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
            let turn = f64::from(i) * 2.399_963_229_728_653;
            let r = (1.0 - z * z).sqrt();
            let strength = 4.0 / f64::from(count);
            let (x, y) = (r * turn.cos(), r * turn.sin());
            light(&format!(
                "kind = 'directional'\ndirection = [{x}, {y}, {z}]\nintensity = {strength}"
            ))
        })
        .collect();
    render(&scene, &camera_at(600.0, 48, 0.26), &lights)
}

#[test]
fn in_a_furnace_a_white_sphere_vanishes_and_skin_gives_back_no_more_than_it_gets() {
    let mid = |r: &Rendering| r.color[(24, 24)];
    let (_, white) = furnace(Material::matt(Rgb::repeat(1.0)), 400);
    assert_close(mid(&white), Rgb::repeat(1.0), 0.01);
    let texture = std::sync::Arc::new(facile_core::Texture::constant([230; 3]));
    let skin = Material::skin(texture);
    let bare = Material {
        specular: 0.0,
        ..skin.clone()
    };
    let ((view, shiny), (_, dull)) = (furnace(skin, 400), furnace(bare, 400));
    // The highlight adds its reflectance in front, more at the rim, and nothing is brighter than the furnace
    let added = mid(&shiny).x - mid(&dull).x;
    assert!(added > 0.02 && added < 0.04, "{added}");
    let segments = view.gbuffer.segment.expect("asked for");
    let colors = shiny.color.as_slice().iter().zip(segments.as_slice());
    let brightest = colors
        .filter(|(_, s)| **s != 0)
        .map(|(c, _)| c.max())
        .fold(0.0, f32::max);
    assert!(brightest < 1.2, "{brightest}");
}

#[test]
fn an_area_light_throws_a_soft_shadow_of_the_stated_width() {
    // A blade over half of the light: on the wall the shadow goes from dark to light over the light's size
    let text = "kind = 'area'\nposition = [0, 0, 400]\ntarget = [0, 0, 0]\nsize = [40, 40]\nintensity = 0.1\nsamples = 64";
    let camera = camera_at(900.0, 201, 0.3);
    let mut scene = scene_of(&wall(0.0, 150.0), Normals::Flat, [1.0; 3]);
    let bare = render(&scene, &camera, &[light(text)]).1.color;
    let blade = square(
        Point3::new(-100.0, 0.0, 200.0),
        Vector3::x(),
        Vector3::y(),
        100.0,
    );
    scene.add(Object::new(&blade, Normals::Flat, Material::matt(Rgb::zeros())).expect("valid"));
    // The camera looks past the blade's edge from the right
    let eye = Point3::new(600.0, 0.0, 700.0);
    let aside = Camera::look_at(201, 201, eye, Point3::origin(), Vector3::y(), 0.2).expect("valid");
    let (_, shaded) = render(&scene, &aside, &[light(text)]);
    let (_, open) = {
        scene.truncate(1);
        render(&scene, &aside, &[light(text)])
    };
    let share = |x: f64| {
        let (px, _) = aside.project(&Point3::new(x, 0.0, 0.0)).expect("in front");
        let at = (px[0] as usize, px[1] as usize);
        shaded.color[at].x / open.color[at].x
    };
    assert!(bare[(100, 100)].x > 0.0);
    assert!(share(-22.0) < 0.02 && share(22.0) > 0.98);
    for x in [-15.0, -8.0, 0.0, 8.0, 15.0] {
        let expected = (x + 20.0) / 40.0;
        assert!(
            (f64::from(share(x)) - expected).abs() < 0.05,
            "{x}: {}",
            share(x)
        );
    }
}
