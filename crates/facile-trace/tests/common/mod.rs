//! Meshes and scenes that several tests share.
#![allow(dead_code, reason = "each test file uses a part of it")]

use std::collections::BTreeMap;

use facile_core::rng::RandomStream;
use facile_core::{Mesh, Point3, Vector3};
use facile_trace::math::{Pose, Rgb};
use facile_trace::{
    Camera, LightSource, Material, Normals, Object, RenderSettings, Rendering, Samples, Scene,
    Truth, View, trace_view,
};

/// A sphere of `20 * 4^levels` triangles about the origin.
pub(crate) fn icosphere(radius: f64, levels: u32) -> Mesh {
    let g = f64::midpoint(1.0, 5.0_f64.sqrt());
    let mut points: Vec<Vector3> = Vec::new();
    for (a, b) in [(1.0, g), (-1.0, g), (1.0, -g), (-1.0, -g)] {
        points.extend([
            Vector3::new(0.0, a, b),
            Vector3::new(a, b, 0.0),
            Vector3::new(b, 0.0, a),
        ]);
    }
    // The 20 faces are the triples at the smallest distance
    let mut triangles = Vec::new();
    for i in 0..12_u32 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let [a, b, c] = [i, j, k].map(|v| points[v as usize]);
                let near = |p: Vector3, q: Vector3| (p - q).norm() < 2.1;
                if near(a, b) && near(b, c) && near(c, a) {
                    let outwards = (b - a).cross(&(c - a)).dot(&a) > 0.0;
                    triangles.push(if outwards { [i, j, k] } else { [i, k, j] });
                }
            }
        }
    }
    for _ in 0..levels {
        let mut middles = BTreeMap::new();
        let mut middle = |a: u32, b: u32, points: &mut Vec<Vector3>| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push((points[a as usize] + points[b as usize]) / 2.0);
                points.len() as u32 - 1
            })
        };
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let ab = middle(a, b, &mut points);
                let bc = middle(b, c, &mut points);
                let ca = middle(c, a, &mut points);
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
        for p in &mut points {
            *p = p.try_normalize(1e-9).expect("off the origin");
        }
    }
    Mesh {
        positions: points
            .iter()
            .map(|p| Point3::from(p * (radius / p.norm())))
            .collect(),
        triangles,
        ..Mesh::default()
    }
}

/// A square of side `2 half` about `center`, spanned by unit vectors `u` and `v`, facing `u x v`.
pub(crate) fn square(center: Point3, u: Vector3, v: Vector3, half: f64) -> Mesh {
    let corner = |a: f64, b: f64| center + u * (a * half) + v * (b * half);
    Mesh {
        positions: vec![
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

/// A square in the plane `z`, facing `+z`.
pub(crate) fn wall(z: f64, half: f64) -> Mesh {
    square(Point3::new(0.0, 0.0, z), Vector3::x(), Vector3::y(), half)
}

/// Triangles of all sizes and directions in a box of side 200 mm, some sharing corners, some without area.
pub(crate) fn soup(triangles: usize, seed: u64) -> Mesh {
    let mut random = RandomStream::new(seed, 0);
    let mut mesh = Mesh::default();
    for t in 0..triangles {
        let size = 60.0 * random.unit().powi(3) + 0.2;
        let center = Vector3::from_fn(|_, _| random.uniform(-100.0, 100.0));
        let mut corners: [Vector3; 3] =
            std::array::from_fn(|_| center + Vector3::from_fn(|_, _| random.uniform(-size, size)));
        if t % 97 == 5 {
            corners[2] = corners[1];
        }
        if t % 10 == 3 && t > 0 {
            corners[0] = mesh.positions[mesh.positions.len() - 1].coords;
        }
        let base = mesh.positions.len() as u32;
        mesh.positions.extend(corners.map(Point3::from));
        mesh.triangles.push([base, base + 1, base + 2]);
    }
    mesh
}

/// A scene of one matt object.
pub(crate) fn scene_of(mesh: &Mesh, normals: Normals, color: [f32; 3]) -> Scene {
    let mut scene = Scene::new(Rgb::zeros());
    scene.add(Object::new(mesh, normals, Material::matt(Rgb::from(color))).expect("valid mesh"));
    scene
}

/// A mesh whose vertices all moved by up to 9 mm: its tree refitted, and built anew.
pub(crate) fn refitted_and_rebuilt(mesh: &Mesh) -> [Scene; 2] {
    let mut moved = mesh.clone();
    let mut random = RandomStream::new(11, 0);
    for p in &mut moved.positions {
        *p += Vector3::from_fn(|_, _| random.uniform(-9.0, 9.0));
    }
    let mut refitted = scene_of(mesh, Normals::Smooth, [0.5; 3]);
    refitted.objects_mut()[0]
        .set_positions(&moved.positions)
        .expect("finite");
    [refitted, scene_of(&moved, Normals::Smooth, [0.5; 3])]
}

/// A camera on the `z` axis that looks at the origin.
pub(crate) fn camera_at(z: f64, size: usize, fov_y: f64) -> Camera {
    let eye = Point3::new(0.0, 0.0, z);
    Camera::look_at(size, size, eye, Point3::origin(), Vector3::y(), fov_y).expect("valid camera")
}

/// A light from its TOML form.
pub(crate) fn light(text: &str) -> LightSource {
    toml::from_str(text).expect("valid light")
}

/// Ambient light of intensity 1: colours come out as they are.
pub(crate) fn ambient() -> LightSource {
    light("kind = 'ambient'\nintensity = 1")
}

/// Settings of tests: these samples and labels, else the defaults.
pub(crate) fn settings(samples: Samples, truth: Truth) -> RenderSettings {
    RenderSettings {
        samples,
        truth,
        ..RenderSettings::default()
    }
}

/// A view with one sample per pixel and all labels, and its image.
pub(crate) fn render(scene: &Scene, camera: &Camera, lights: &[LightSource]) -> (View, Rendering) {
    let view = trace_view(scene, camera, &settings(Samples::Count(1), Truth::ALL)).expect("valid");
    let rendering = view.shade(scene, lights).expect("valid");
    (view, rendering)
}

/// Fails if a channel differs by more than `tolerance`.
pub(crate) fn assert_close(a: Rgb, b: Rgb, tolerance: f32) {
    assert!((a - b).abs().max() <= tolerance, "{a:?} is not {b:?}");
}

/// A closed box.
pub(crate) fn slab(low: Point3, high: Point3) -> Mesh {
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

/// Objects of all kinds: posed and not, hiding each other, with faces that coincide.
pub(crate) fn busy_scene() -> Scene {
    let mut scene = scene_of(&icosphere(60.0, 4), Normals::Smooth, [0.7, 0.5, 0.4]);
    let eye = Object::new(&icosphere(15.0, 3), Normals::Smooth, Material::default());
    let mut eye = eye.expect("valid");
    let turn = nalgebra::Vector3::new(0.1, 0.3, 0.2);
    let place = nalgebra::Vector3::new(20.0, 10.0, 55.0);
    eye.set_pose(&Pose::new(place, turn)).expect("finite");
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
