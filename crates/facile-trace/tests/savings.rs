//! What is left out changes no byte.

mod common;

use common::{busy_scene, camera_at, icosphere, light, refitted_and_rebuilt, scene_of, soup};
use facile_core::Plane;
use facile_trace::math::Pose;
use facile_trace::{
    Camera, GBuffer, LightSource, Material, Normals, Object, RenderSettings, Samples, Scene, Skips,
    Transmission, Truth, trace_view,
};

/// Lights of all kinds, some of which leave half of the scene in the dark.
fn lights() -> Vec<LightSource> {
    [
        "kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.4",
        "kind = 'point'\nposition = [0, 0, -400]\nintensity = 0.4",
        "kind = 'spot'\nposition = [0, 300, 300]\ntarget = [0, 0, 0]\nangle_deg = 7\nsoftness = 0.5\nintensity = 0.4",
        "kind = 'area'\nposition = [-200, 100, 400]\ntarget = [0, 0, 0]\nsize = [90, 50]\nintensity = 0.1\nsamples = 4",
        "kind = 'directional'\ndirection = [1, -1, -1]\nintensity = 0.2",
        "kind = 'hemisphere'\nintensity = 0.2",
    ]
    .into_iter()
    .map(light)
    .collect()
}

/// The busy scene with a mirror, glass and skin, small in its image and partly outside it.
fn scene() -> (Scene, Camera) {
    let mut scene = busy_scene();
    let materials = [
        Material {
            reflectivity: 0.4,
            ..Material::default()
        },
        Material {
            transmission: Some(Transmission::Thin {
                tint: [0.9, 0.8, 0.7].into(),
            }),
            ..Material::default()
        },
    ];
    for (k, material) in materials.into_iter().enumerate() {
        let mut ball = Object::new(&icosphere(20.0, 3), Normals::Smooth, material).expect("valid");
        let place = nalgebra::Vector3::new(90.0 * k as f32 - 45.0, -30.0, 70.0);
        let pose = Pose::new(place, nalgebra::Vector3::zeros());
        ball.set_pose(&pose).expect("finite");
        scene.add(ball);
    }
    let camera = camera_at(600.0, 112, 0.6);
    (scene, camera)
}

/// The bits of the colours, the map of shadows and the labels.
type Frame = (Plane<[u32; 3]>, Option<Plane<f32>>, GBuffer);

fn frame(scene: &Scene, camera: &Camera, samples: Samples, skips: Skips) -> Frame {
    let settings = RenderSettings {
        samples,
        truth: Truth::ALL,
        skips,
        ..RenderSettings::default()
    };
    let view = trace_view(scene, camera, &settings).expect("valid");
    let image = view.shade(scene, &lights()).expect("valid");
    let bits = image.color.map(|c| [c.x, c.y, c.z].map(f32::to_bits));
    (bits, image.shadow, view.gbuffer)
}

#[test]
fn every_saving_can_be_switched_off_without_changing_a_byte() {
    let (scene, camera) = scene();
    // There is something to save
    let bounds = scene.objects().iter().filter_map(Object::bounds_in_world);
    let [x0, y0, x1, y1] = camera.pixel_bounds(bounds).expect("in the image");
    assert!((x1 - x0) * (y1 - y0) < 112 * 112 / 2);
    for samples in [Samples::Count(1), Samples::Count(4), Samples::ADAPTIVE] {
        let expected = frame(&scene, &camera, samples, Skips::default());
        for (name, skips) in Skips::each_off() {
            assert_ne!(skips, Skips::default());
            let found = frame(&scene, &camera, samples, skips);
            assert!(found.0 == expected.0, "colours without {name}, {samples:?}");
            assert!(found.1 == expected.1, "shadows without {name}, {samples:?}");
            assert!(found.2 == expected.2, "labels without {name}, {samples:?}");
        }
    }
}

#[test]
fn a_refitted_tree_gives_the_bytes_of_a_rebuilt_one() {
    let mesh = soup(2_000, 7);
    let [refitted, rebuilt] = refitted_and_rebuilt(&mesh);
    assert!(refitted.objects()[0].bvh().wear() > rebuilt.objects()[0].bvh().wear());
    let camera = camera_at(600.0, 90, 0.4);
    let of = |scene: &Scene| frame(scene, &camera, Samples::ADAPTIVE, Skips::default());
    assert!(of(&refitted) == of(&rebuilt));
    assert!(of(&refitted) != of(&scene_of(&mesh, Normals::Smooth, [0.5; 3])));
}
