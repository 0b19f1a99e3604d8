use super::*;
use crate::math::Rgb;
use crate::ray::Ray;
use crate::scene::Scene;
use crate::sight::Sight;
use crate::{Material, Normals};
use facile_core::rng::RandomStream;
use facile_core::{Mesh, Point3};

/// Triangles of many sizes in a box of side 200 mm.
fn scene() -> Scene {
    let mut random = RandomStream::new(5, 0);
    let mut mesh = Mesh::default();
    for t in 0..400_u32 {
        let size = 25.0 * random.unit().powi(3) + 0.5;
        let center = [0; 3].map(|_| random.uniform(-100.0, 100.0));
        for _ in 0..3 {
            let at = center.map(|c| c + random.uniform(-size, size));
            mesh.positions.push(Point3::from(at));
        }
        mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
    }
    let mut scene = Scene::default();
    scene.add(Object::new(&mesh, Normals::Flat, Material::default()).expect("valid"));
    scene
}

/// Where rays start, all lit.
fn starts(rays: &[Ray]) -> Arriving {
    let mut arriving = Arriving::default();
    for chunk in rays.chunks(LANES) {
        let mut start = [Eight::default(); 3];
        for (lane, ray) in chunk.iter().enumerate() {
            for k in 0..3 {
                start[k].0[lane] = ray.origin[k];
            }
        }
        arriving.start.push(start);
        arriving.lit.push(0xFF >> (LANES - chunk.len()));
    }
    arriving
}

#[test]
fn cells_block_what_single_rays_find_blocked() {
    let scene = scene();
    let position = Vec3::new(40.0, 90.0, 700.0);
    let towards = Vec3::new(0.0, 0.6, 0.8);
    let power = Rgb::repeat(1.0);
    let lights = [
        Light::Point { position, power },
        Light::Directional { towards, power },
    ];
    for light in lights {
        let mut random = RandomStream::new(9, 1);
        let rays: Vec<Ray> = (0..3_003)
            .map(|_| {
                let start = Vec3::from([0; 3].map(|_| random.uniform(-90.0, 90.0) as f32));
                match light.position() {
                    Some(position) => Ray::between(start, position),
                    None => Ray::new(start, towards),
                }
            })
            .collect();
        let arriving = starts(&rays);
        let image = image_of(&LightRays {
            light: &light,
            arriving: &arriving,
        });
        let image = image.expect("all on one side");
        assert!(suits(&scene.objects()[0], &image.projection, image.rays));
        let mut sight = Sight::default();
        scene.sight(&light, &arriving, &mut sight);
        let found = sight.blocked;
        let mut blocked = 0;
        for (i, ray) in rays.iter().enumerate() {
            let expected = scene.any_opaque_hit(ray);
            assert_eq!(
                found[i / LANES] >> (i % LANES) & 1 == 1,
                expected,
                "{ray:?}"
            );
            blocked += usize::from(expected);
        }
        assert!(
            blocked > 200 && blocked < 2_500,
            "the rays try both: {blocked}"
        );
    }
}

#[test]
fn a_light_among_the_rays_has_no_image() {
    let rays: Vec<Ray> = (0..LANES)
        .map(|i| Ray::new(Vec3::new(i as f32 - 4.0, 0.0, 0.0), Vec3::y()))
        .collect();
    let arriving = starts(&rays);
    let image_of = |light: &Light| {
        let arriving = &arriving;
        image_of(&LightRays { light, arriving }).map(|i| i.rays)
    };
    let power = Rgb::repeat(1.0);
    let position = Vec3::new(-0.5, 0.0, 0.0);
    assert!(image_of(&Light::Point { position, power }).is_none());
    let ambient = Light::Ambient {
        power,
        slope: power,
        up: Vec3::y(),
    };
    assert!(image_of(&ambient).is_none());
}
