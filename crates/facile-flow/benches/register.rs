//! Time of a registration and of its stages on a person of the identity model, some 40,000 triangles, one thread.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use facile_core::{Plane, ReferenceHead};
use facile_flow::channels::{CHANNELS, CylinderImage};
use facile_flow::curvature::vertex_operators;
use facile_flow::flow::{FlowParams, displacement_field};
use facile_flow::pyramid::Pyramid;
use facile_flow::radial_map::{CylinderGrid, RadialMap};
use facile_flow::work_precision::known_people;
use facile_flow::{Registrar, RegistrationParams};

/// Scan to subject, at both settings, with the texture of each.
fn whole(c: &mut Criterion) {
    let known = known_people(1).expect("a person").remove(0);
    let mut group = c.benchmark_group("register");
    group.throughput(Throughput::Elements(known.scan.mesh.triangles.len() as u64));
    group.sample_size(10);
    for (name, params) in [
        ("default", RegistrationParams::default()),
        ("coarse", RegistrationParams::coarse()),
    ] {
        let registrar = Registrar::new(ReferenceHead::embedded(), params).expect("a registrar");
        // The texels are placed at the first registration.
        registrar.register(&known.scan).expect("a face");
        group.bench_function(name, |b| {
            b.iter(|| registrar.register(black_box(&known.scan)).expect("a face"));
        });
    }
    group.finish();
}

/// What a scan goes through once: the radial map and the curvature.
fn views(c: &mut Criterion) {
    let known = known_people(1).expect("a person").remove(0);
    let mesh = &known.scan.mesh;
    let normals = mesh.vertex_normals();
    let grid = CylinderGrid::new(2.0, -130.0, 100.0, 1.5, 80.0);
    let mut group = c.benchmark_group("view");
    group.throughput(Throughput::Elements(mesh.triangles.len() as u64));
    group.bench_function("radial_map", |b| {
        b.iter(|| RadialMap::cast(black_box(&mesh.positions), &mesh.triangles, grid));
    });
    group.bench_function("curvature", |b| {
        b.iter(|| vertex_operators(black_box(mesh), &normals));
    });
    group.finish();
}

/// A displacement field over images of the size of a face, by resolution.
fn flow(c: &mut Criterion) {
    let image = |shift: f64, (nx, ny): (usize, usize)| {
        let scale = 200.0 / nx as f64;
        let wave = |x: f64, y: f64, k: f64| {
            0.3 * libm::sin((0.09 + 0.02 * k) * x + k) * libm::cos((0.13 - 0.01 * k) * y)
        };
        CylinderImage {
            values: Plane::from_fn(nx, ny, |x, y| {
                let (x, y) = (scale * x as f64 + shift, scale * y as f64);
                let value = |k: usize| wave(x, y, k as f64) as f32;
                std::array::from_fn::<f32, CHANNELS, _>(value)
            }),
            mask: Plane::filled(nx, ny, 1.0),
        }
    };
    let params = FlowParams::default();
    let mut group = c.benchmark_group("displacement_field");
    for size in [(107, 77), (214, 154), (320, 230)] {
        let (source, target) = (image(0.0, size), image(3.0, size));
        let (source, target) = (
            Pyramid::new(source, params.levels),
            Pyramid::new(target, params.levels),
        );
        group.throughput(Throughput::Elements((size.0 * size.1) as u64));
        group.bench_function(
            BenchmarkId::from_parameter(format!("{}x{}", size.0, size.1)),
            |b| b.iter(|| displacement_field(black_box(&source), &target, &params)),
        );
    }
    group.finish();
}

criterion_group!(benches, whole, views, flow);
criterion_main!(benches);
