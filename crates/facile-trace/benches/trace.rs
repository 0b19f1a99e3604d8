//! Time of a frame and of its parts on `data/trace_scene`, one thread. Skipped where the shared data is absent.

use std::hint::black_box;
use std::path::PathBuf;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use facile_core::io::obj::ObjFile;
use facile_core::rng::RandomStream;
use facile_core::{Mesh, Point3, Texture, Vector3};
use facile_trace::{
    Camera, LightSource, Material, Normals, Object, RenderSettings, Samples, Scene, Truth,
    trace_view,
};

/// The scene of the rendering table, `None` without the shared data.
fn trace_scene() -> Option<(Mesh, Scene, Vec<LightSource>)> {
    let shared = std::env::var_os("FACILE_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = shared.join("data/trace_scene/head_36k.obj");
    let obj = ObjFile::parse(&std::fs::read(&path).ok()?, &path).ok()?;
    let mut mesh = Mesh {
        positions: obj.positions.clone(),
        texcoords: obj.texcoords.clone(),
        ..Mesh::default()
    };
    for polygon in &obj.polygons {
        let [a, b, c] = obj.corners_of(polygon) else {
            return None;
        };
        mesh.triangles.push([a[0], b[0], c[0]]);
        mesh.texcoord_triangles.push([a[1], b[1], c[1]]);
    }
    let image = image::open(shared.join("data/trace_scene/tex.png"))
        .ok()?
        .into_rgb8();
    let texels = image.as_raw().as_chunks::<3>().0.to_vec();
    let texture = Texture::new(image.width() as usize, image.height() as usize, texels);
    let material = Material {
        specular: 0.06,
        shininess: 24.0,
        ..Material::skin(Arc::new(texture))
    };
    let mut scene = Scene::default();
    scene.add(Object::new(&mesh, Normals::SmoothWelded, material).ok()?);
    let lights = [
        "kind = 'point'\nposition = [-260, 300, 520]\nintensity = 0.366",
        "kind = 'ambient'\nintensity = 0.18",
    ];
    let lights = lights
        .iter()
        .map(|l| toml::from_str(l).ok())
        .collect::<Option<_>>()?;
    Some((mesh, scene, lights))
}

fn camera(size: usize) -> Option<Camera> {
    let (eye, target) = (Point3::new(60.0, 10.0, 640.0), Point3::new(0.0, -5.0, 20.0));
    Camera::look_at(size, size, eye, target, Vector3::y(), 25.0_f64.to_radians()).ok()
}

fn frames(criterion: &mut Criterion) {
    let Some((mesh, mut scene, lights)) = trace_scene() else {
        eprintln!("skipped: no shared data");
        return;
    };
    let labels = Truth {
        depth_z: true,
        normal_in_world: true,
        segment: true,
        ..Truth::default()
    };
    let mut group = criterion.benchmark_group("trace");
    group.sample_size(20);
    let cases = [
        ("frame_256/1", 256, Samples::Count(1), Truth::default()),
        ("frame_256/1_labels", 256, Samples::Count(1), labels),
        ("frame_256/16", 256, Samples::Count(16), Truth::default()),
        (
            "frame_256/adaptive",
            256,
            Samples::ADAPTIVE,
            Truth::default(),
        ),
        ("frame_512/1", 512, Samples::Count(1), Truth::default()),
    ];
    for (name, size, samples, truth) in cases {
        let Some(camera) = camera(size) else { continue };
        let settings = RenderSettings {
            samples,
            truth,
            ..RenderSettings::default()
        };
        group.throughput(Throughput::Elements((size * size) as u64));
        group.bench_function(name, |b| {
            b.iter(|| {
                let view = trace_view(&scene, &camera, &settings);
                black_box(view.and_then(|v| v.shade(&scene, &lights)))
            });
        });
    }
    let Some(camera) = camera(256) else { return };
    let settings = RenderSettings {
        samples: Samples::Count(1),
        ..RenderSettings::default()
    };
    group.bench_function("primary_256", |b| {
        b.iter(|| trace_view(&scene, &camera, &settings));
    });
    if let Ok(view) = trace_view(&scene, &camera, &settings) {
        group.bench_function("relight_256", |b| b.iter(|| view.shade(&scene, &lights)));
    }
    let mut random = RandomStream::new(1, 0);
    let moved: Vec<Point3> = mesh
        .positions
        .iter()
        .map(|p| p.map(|v| v + random.uniform(-0.2, 0.2)))
        .collect();
    group.throughput(Throughput::Elements(mesh.triangles.len() as u64));
    group.bench_function("refit_36k", |b| {
        b.iter(|| scene.objects_mut()[0].set_positions(black_box(&moved)));
    });
    group.bench_function("build_36k", |b| {
        b.iter(|| Object::new(&mesh, Normals::SmoothWelded, Material::default()));
    });
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
