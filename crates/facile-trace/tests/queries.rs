//! Ray queries against their oracles.

mod common;

use common::{icosphere, refitted_and_rebuilt, scene_of, soup};
use facile_core::rng::RandomStream;
use facile_core::{Mesh, Vector3};
use facile_trace::math::{Pose, Rgb, Vec3};
use facile_trace::triangle::{RayShear, intersect};
use facile_trace::{Hit, Layer, Material, Normals, Object, Ray, Scene};

fn vec3(v: Vector3) -> Vec3 {
    v.cast()
}

fn random_rays(count: usize, seed: u64) -> Vec<Ray> {
    let mut random = RandomStream::new(seed, 1);
    (0..count)
        .map(|i| {
            let mut point = || vec3(Vector3::from_fn(|_, _| random.uniform(-150.0, 150.0)));
            let (origin, target) = (point(), point());
            match i % 4 {
                // Along an axis, through whole numbers, to the target only, and on beyond it
                0 => Ray::new(
                    origin,
                    Vec3::ith(i / 4 % 3, if i % 8 == 0 { 1.0 } else { -1.0 }),
                ),
                1 => Ray::new(
                    origin.map(f32::round),
                    (target - origin).map(f32::round) + Vec3::z(),
                ),
                2 => Ray::between(origin, target),
                _ => Ray::new(origin, target - origin),
            }
        })
        .collect()
}

fn brute_force(mesh: &Mesh, ray: &Ray) -> Option<(f32, u32)> {
    let shear = RayShear::new(ray.direction);
    let mut best = None;
    for (id, triangle) in mesh.triangles.iter().enumerate() {
        let corners = triangle.map(|v| vec3(mesh.positions[v as usize].coords));
        if let Some((t, ..)) = intersect(ray, &shear, &corners)
            && t < ray.t_max
            && best.is_none_or(|(nearest, _)| t < nearest)
        {
            best = Some((t, id as u32));
        }
    }
    best
}

#[test]
fn packets_equal_single_rays_equal_brute_force() {
    let mesh = soup(1_500, 3);
    let scene = scene_of(&mesh, Normals::Flat, [0.5; 3]);
    let rays = random_rays(4_003, 5);
    let mut packed = Vec::new();
    scene.closest_hits(&rays, Layer::All, &mut packed);
    let mut shares = Vec::new();
    scene.transmittances(&rays, &mut shares);
    let mut hits = 0;
    for ((ray, packed), share) in rays.iter().zip(&packed).zip(&shares) {
        let single = scene.closest_hit(ray, Layer::All);
        assert_eq!(packed.ok(), single, "{ray:?}");
        let brute = brute_force(&mesh, ray);
        assert_eq!(single.map(|h| (h.t, h.triangle)), brute, "{ray:?}");
        assert_eq!(scene.any_opaque_hit(ray), brute.is_some(), "{ray:?}");
        assert_eq!(*share, Rgb::repeat(if brute.is_some() { 0.0 } else { 1.0 }));
        hits += usize::from(single.is_some());
    }
    assert!(hits > 1_000 && hits < 3_500, "the rays try both: {hits}");
}

#[test]
fn posed_objects_are_hit_where_they_are() {
    let mesh = soup(300, 8);
    let pose = Pose::new(Vec3::new(30.0, -20.0, 50.0), Vec3::new(0.4, 0.8, -0.3));
    let mut moved = mesh.clone();
    for p in &mut moved.positions {
        *p = pose.cast::<f64>() * *p;
    }
    let mut posed = scene_of(&mesh, Normals::Flat, [0.5; 3]);
    posed.objects_mut()[0].set_pose(&pose).expect("finite");
    let baked = scene_of(&moved, Normals::Flat, [0.5; 3]);
    let rays = random_rays(2_000, 9);
    let (mut of_posed, mut of_baked) = (Vec::new(), Vec::new());
    posed.closest_hits(&rays, Layer::All, &mut of_posed);
    baked.closest_hits(&rays, Layer::All, &mut of_baked);
    let mut differing = 0;
    for ((ray, a), b) in rays.iter().zip(&of_posed).zip(&of_baked) {
        assert_eq!(a.ok(), posed.closest_hit(ray, Layer::All));
        if a.is_some() && b.is_some() && a.triangle == b.triangle {
            assert!((a.t - b.t).abs() <= 1e-4 * b.t.abs() + 1e-4, "{a:?} {b:?}");
        } else if a.is_some() || b.is_some() {
            differing += 1;
        }
    }
    assert!(differing < 5, "only rays at edges may differ: {differing}");
}

#[test]
fn several_objects_give_the_nearest_and_ties_go_to_the_first() {
    let mesh = icosphere(40.0, 2);
    let mut scene = scene_of(&mesh, Normals::Flat, [0.5; 3]);
    let second = scene_of(&mesh, Normals::Flat, [0.5; 3]).objects()[0].clone();
    scene.add(second.clone().as_occluder());
    let rays = random_rays(500, 2);
    let mut hits = Vec::new();
    scene.closest_hits(&rays, Layer::All, &mut hits);
    assert!(hits.iter().filter(|h| h.is_some()).all(|h| h.object == 0));
    let mut front = second.as_occluder();
    front
        .set_pose(&Pose::translation(0.0, 0.0, 60.0))
        .expect("finite");
    scene.truncate(1);
    scene.add(front);
    let ray = Ray::new(Vec3::new(1.0, 2.0, 300.0), -Vec3::z());
    assert_eq!(
        scene.closest_hit(&ray, Layer::All).map(|h| h.object),
        Some(1)
    );
    assert_eq!(
        scene
            .closest_hit(&ray, Layer::BehindOccluders)
            .map(|h| h.object),
        Some(0)
    );
    scene.objects_mut()[1].set_visible(false);
    assert_eq!(
        scene.closest_hit(&ray, Layer::All).map(|h| h.object),
        Some(0)
    );
}

/// A closed surface with bumps, its corners rounded to `f32`.
fn bumpy_sphere(seed: u64) -> Mesh {
    let mut random = RandomStream::new(seed, 0);
    let mut mesh = icosphere(70.0, 3);
    for p in &mut mesh.positions {
        *p *= 1.0 + 0.15 * random.normal().clamp(-2.0, 2.0);
        *p = p.map(|v| f64::from(v as f32));
    }
    mesh
}

#[test]
fn no_ray_leaks_out_of_a_closed_mesh() {
    count_leaks(3, 340_000);
}

#[test]
#[ignore = "ten million rays take a minute"]
fn not_one_of_ten_million_rays_leaks_out_of_a_closed_mesh() {
    count_leaks(10, 1_000_000);
}

fn count_leaks(meshes: u64, rays_each: usize) {
    for seed in 0..meshes {
        let mesh = bumpy_sphere(seed);
        let scene = scene_of(&mesh, Normals::Flat, [0.5; 3]);
        let mut random = RandomStream::new(seed, 7);
        let mut rays = Vec::new();
        for i in 0..rays_each {
            let inside = vec3(Vector3::from_fn(|_, _| random.uniform(-20.0, 20.0)));
            let triangle = mesh.triangles[i % mesh.triangles.len()];
            let [a, b, c] = triangle.map(|v| vec3(mesh.positions[v as usize].coords));
            let share = random.unit() as f32;
            // At a vertex, along an edge, across the surface, from whole numbers, along an axis
            let ray = match i % 6 {
                0 => Ray::new(inside, a - inside),
                1 | 2 => Ray::new(inside, a + (b - a) * share - inside),
                3 => Ray::new(
                    inside,
                    a + (b - a) * share * 0.5 + (c - a) * share * 0.3 - inside,
                ),
                4 => Ray::new(inside.map(f32::round), a - inside.map(f32::round)),
                _ => Ray::new(Vec3::new(a.x, a.y, 0.0) * 0.2, Vec3::ith(i / 6 % 3, 1.0)),
            };
            rays.push(ray);
        }
        let mut hits: Vec<Hit> = Vec::new();
        scene.closest_hits(&rays, Layer::All, &mut hits);
        let leaks: Vec<&Ray> = rays
            .iter()
            .zip(&hits)
            .filter(|(_, h)| !h.is_some())
            .map(|(r, _)| r)
            .collect();
        assert!(
            leaks.is_empty(),
            "{} leaks, first {:?}",
            leaks.len(),
            leaks[0]
        );
    }
}

#[test]
fn refitted_trees_hit_what_rebuilt_trees_hit() {
    let mesh = bumpy_sphere(4);
    let [refitted, rebuilt] = refitted_and_rebuilt(&mesh);
    let rays = random_rays(4_000, 21);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    refitted.closest_hits(&rays, Layer::All, &mut a);
    rebuilt.closest_hits(&rays, Layer::All, &mut b);
    assert_eq!(a, b);
    let [refitted, rebuilt] = [&refitted, &rebuilt].map(|s| s.objects()[0].clone());
    assert_eq!(refitted.geometry().normals(), rebuilt.geometry().normals());
    assert!(refitted.bvh().wear() > 1.0 && (rebuilt.bvh().wear() - 1.0).abs() < 1e-6);
}

#[test]
fn an_empty_scene_and_an_empty_mesh_are_never_hit() {
    let ray = Ray::new(Vec3::zeros(), Vec3::z());
    let mut scene = Scene::default();
    let empty = Object::new(&Mesh::default(), Normals::Smooth, Material::default());
    for _ in 0..2 {
        let mut hits = Vec::new();
        scene.closest_hits(&[ray; 3], Layer::All, &mut hits);
        assert_eq!(hits, vec![Hit::MISS; 3]);
        assert!(!scene.any_opaque_hit(&ray));
        assert_eq!(scene.bounds_in_world(Layer::All).count(), 0);
        scene.add(empty.as_ref().expect("allowed").clone());
    }
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config {
        cases: 24,
        failure_persistence: None,
        ..proptest::test_runner::Config::default()
    })]

    #[test]
    fn any_soup_is_hit_alike_by_packets_rays_and_brute_force(
        seed in 0_u64..10_000,
        triangles in 1_usize..200,
    ) {
        let mesh = soup(triangles, seed);
        let scene = scene_of(&mesh, Normals::Flat, [0.5; 3]);
        let rays = random_rays(203, seed);
        let mut packed = Vec::new();
        scene.closest_hits(&rays, Layer::All, &mut packed);
        for (ray, packed) in rays.iter().zip(&packed) {
            let single = scene.closest_hit(ray, Layer::All);
            proptest::prop_assert_eq!(packed.ok(), single);
            proptest::prop_assert_eq!(single.map(|h| (h.t, h.triangle)), brute_force(&mesh, ray));
        }
    }
}
