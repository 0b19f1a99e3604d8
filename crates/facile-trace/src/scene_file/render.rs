//! Renders a scene file.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use facile_core::color::LINEAR_FROM_SRGB8;
use facile_core::rng::RandomStream;
use facile_core::{Mesh, Plane, Point3, Texture};

use super::load::load_mesh;
use super::{MeshSection, SceneFile, Spread, TimingReport};
use crate::TraceError;
use crate::gbuffer::{GBuffer, LayerMaps};
use crate::geometry::Normals;
use crate::material::{Albedo, Material, Transmission};
use crate::math::Rgb;
use crate::object::Object;
use crate::png_file::{encode_rgb8, write_bytes, write_gray8, write_gray16, write_rgb8};
use crate::scene::Scene;
use crate::view::{Rendering, View, trace_view};

/// Steps of a depth map's 16 bits: the largest power of two per mm that holds the image's depths, at most 64.
const FINEST_DEPTH_STEPS_PER_MM: f32 = 64.0;

/// Random streams of the sensor: this number with that of the frame. Motion uses the streams below.
const SENSOR_STREAMS: u64 = 1 << 62;

/// Renders `path` into `out_dir`: `color.png`, the label maps that the file asks for, and `scene.json` with the camera's
/// matrices and the depth scale. `timing`, if given, gets the [`TimingReport`] as JSON, which is also returned.
///
/// # Errors
/// [`TraceError`] with the file, line or setting that is wrong.
pub fn render_scene_file(
    path: &Path,
    out_dir: &Path,
    timing: Option<&Path>,
) -> Result<TimingReport, TraceError> {
    let file = SceneFile::read(path)?;
    let camera = file.camera()?;
    file.sensor.check()?;
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(out_dir).map_err(|source| TraceError::Io {
        path: out_dir.to_owned(),
        source,
    })?;
    let (mut scene, mut report) = load_scene(&file, folder)?;
    report.frames = file.frames;
    let settings = file.settings();
    let rest = rest_positions(&scene);
    let mut times = FrameTimes::default();
    let mut last = None;
    for frame in 0..file.frames {
        let moved = (file.jitter_mm > 0.0).then(|| jittered(&rest, file.jitter_mm, frame));
        let start = Instant::now();
        for (object, positions) in scene.objects_mut().iter_mut().zip(moved.iter().flatten()) {
            object.set_positions(positions)?;
        }
        let refit = start.elapsed();
        let view = trace_view(&scene, &camera, &settings)?;
        let rendering = view.shade(&scene, &file.light)?;
        let mut noise = RandomStream::new(0, SENSOR_STREAMS | u64::from(frame));
        let image = file.sensor.develop(&rendering.color, &mut noise);
        let whole = start.elapsed();
        let encode_start = Instant::now();
        let color_path = out_dir.join("color.png");
        let bytes = encode_rgb8(&image)?;
        times.push(refit, &view, &rendering, encode_start.elapsed(), whole);
        last = Some((view, rendering, color_path, bytes));
    }
    if let Some((view, rendering, color_path, bytes)) = last {
        write_bytes(&color_path, &bytes)?;
        write_maps(out_dir, &view, &rendering)?;
    }
    times.fill(&mut report);
    if let Some(path) = timing {
        write_json(path, &report)?;
    }
    Ok(report)
}

/// The scene of a file, and what reading and building took.
pub(super) fn load_scene(
    file: &SceneFile,
    folder: &Path,
) -> Result<(Scene, TimingReport), TraceError> {
    load_scene_of(file, folder, Mesh::clone)
}

/// As [`load_scene`], with meshes changed on the way.
pub(super) fn load_scene_of(
    file: &SceneFile,
    folder: &Path,
    change: impl Fn(&Mesh) -> Mesh,
) -> Result<(Scene, TimingReport), TraceError> {
    let background = Rgb::from(
        file.image
            .background
            .map(|v| LINEAR_FROM_SRGB8[usize::from(v)]),
    );
    let mut scene = Scene::new(background);
    let (mut load, mut build) = (Duration::ZERO, Duration::ZERO);
    let mut triangles = 0;
    for section in &file.mesh {
        let start = Instant::now();
        let texture = section.texture.as_ref().map(|t| folder.join(t));
        let loaded = load_mesh(&folder.join(&section.file), texture.as_deref())?;
        let (mesh, texture) = (change(&loaded.mesh), loaded.texture);
        let material = material(section, texture, !mesh.colors.is_empty())?;
        load += start.elapsed();
        let start = Instant::now();
        let normals = if section.smooth {
            Normals::SmoothWelded
        } else {
            Normals::Flat
        };
        let mut object = Object::new(&mesh, normals, material)?;
        let is_same = mesh.positions.len() == loaded.mesh.positions.len();
        if let Some(normals) = loaded.normals.filter(|_| section.smooth && is_same) {
            object = object.with_vertex_normals(normals)?;
        }
        if section.occluder {
            object = object.as_occluder();
        }
        triangles += mesh.triangles.len();
        scene.add(object);
        build += start.elapsed();
    }
    let report = TimingReport {
        triangles,
        load_ms: milliseconds(load),
        build_ms: milliseconds(build),
        ..TimingReport::default()
    };
    Ok((scene, report))
}

fn material(
    section: &MeshSection,
    texture: Option<Texture>,
    has_colors: bool,
) -> Result<Material, TraceError> {
    let check = |name, value: f32, high: f32, expected| {
        if (0.0..=high).contains(&value) {
            Ok(())
        } else {
            Err(TraceError::Setting {
                name,
                expected,
                got: value.to_string(),
            })
        }
    };
    check(
        "specular",
        section.specular,
        f32::MAX,
        "a finite number of at least 0",
    )?;
    check(
        "shininess",
        section.shininess,
        f32::MAX,
        "a finite number of at least 0",
    )?;
    check("roughness", section.roughness, 1.0, "a number in 0..=1")?;
    for distance in section.scatter_mm {
        check("scatter_mm", distance, 100.0, "distances of 0 to 100 mm")?;
    }
    check(
        "reflectivity",
        section.reflectivity,
        1.0,
        "a number in 0..=1",
    )?;
    for share in section.transmission.iter().flatten() {
        check("transmission", *share, 1.0, "numbers in 0..=1")?;
    }
    if let Some(ior) = section.ior {
        check("ior", ior - 0.1, 10.0, "a refractive index in 0.1..=10")?;
    }
    let color = Rgb::from(section.color.map(|v| LINEAR_FROM_SRGB8[usize::from(v)]));
    Ok(Material {
        albedo: match texture {
            Some(texture) => Albedo::texture(Arc::new(texture)),
            None if has_colors => Albedo::VertexColor,
            None => Albedo::Constant(color),
        },
        specular: section.specular,
        shininess: section.shininess,
        roughness: section.roughness,
        scatter_mm: Rgb::from(section.scatter_mm),
        reflectivity: section.reflectivity,
        transmission: section.transmission.map(|tint| {
            let tint = Rgb::from(tint);
            section
                .ior
                .map_or(Transmission::Thin { tint }, |ior| Transmission::Solid {
                    ior,
                    tint,
                })
        }),
        detail: 0.0,
        exposure: 1.0,
        aperture: None,
    })
}

/// Where the vertices of each object are, mm.
pub(super) fn rest_positions(scene: &Scene) -> Vec<Vec<Point3>> {
    let positions = |o: &Object| {
        o.geometry()
            .positions()
            .iter()
            .map(|p| Point3::from(p.cast::<f64>()))
            .collect()
    };
    scene.objects().iter().map(positions).collect()
}

/// Every vertex moved; the same for the same frame on every run.
pub(super) fn jittered(rest: &[Vec<Point3>], amplitude: f64, frame: u32) -> Vec<Vec<Point3>> {
    let mut stream = RandomStream::new(0, u64::from(frame));
    let mut moved = |p: &Point3| p.map(|v| v + stream.uniform(-amplitude, amplitude));
    rest.iter()
        .map(|positions| positions.iter().map(&mut moved).collect())
        .collect()
}

fn write_maps(out_dir: &Path, view: &View, rendering: &Rendering) -> Result<(), TraceError> {
    let maps: &GBuffer = &view.gbuffer;
    let to = |name: &str| out_dir.join(name);
    let mut depth_steps_per_mm = None;
    if let Some(depth_z) = &maps.depth_z {
        // All layers in the same steps
        let all = maps.layers.iter().map(|l| &l.depth_z).chain([depth_z]);
        let steps = all.map(depth_steps).fold(f32::INFINITY, f32::min);
        depth_steps_per_mm = Some(steps);
        write_gray16(&to("depth.png"), &depth_z.map(|z| depth_code(*z, steps)))?;
    }
    if let Some(coverage) = &maps.coverage {
        let code = |share: &f32| (share * 255.0).round() as u8;
        write_gray8(&to("coverage.png"), &coverage.map(code))?;
    }
    if !maps.layers.is_empty() {
        let depths = stacked(&maps.layers, |l| &l.depth_z);
        let steps = *depth_steps_per_mm.get_or_insert_with(|| depth_steps(&depths));
        write_gray16(
            &to("layer_depth.png"),
            &depths.map(|z| depth_code(*z, steps)),
        )?;
        write_gray8(&to("layers.png"), &stacked(&maps.layers, |l| &l.segment))?;
    }
    if let Some(normals) = &maps.normal_in_world {
        let code = |v: f32| (127.5 * (v + 1.0)).round() as u8;
        write_rgb8(&to("normals.png"), &normals.map(|n| n.map(code)))?;
    }
    let planes = [
        ("segments.png", &maps.segment),
        ("occlusion.png", &maps.occlusion),
        ("amodal_segments.png", &maps.amodal_segment),
    ];
    for (name, plane) in planes {
        if let Some(plane) = plane {
            write_gray8(&to(name), plane)?;
        }
    }
    if let Some(albedo) = &maps.albedo {
        let code = |c: &[f32; 3]| c.map(facile_core::color::srgb8_from_linear);
        write_rgb8(&to("albedo.png"), &albedo.map(code))?;
    }
    if let Some(shadow) = &rendering.shadow {
        write_gray8(
            &to("shadow.png"),
            &shadow.map(|s| (s * 255.0).round() as u8),
        )?;
    }
    let camera = view.camera();
    let rows = |m: &facile_core::Matrix3| -> Vec<Vec<f64>> {
        m.row_iter().map(|r| r.iter().copied().collect()).collect()
    };
    let record = serde_json::json!({
        "size": [camera.width(), camera.height()],
        "k": rows(camera.intrinsics()),
        "r": rows(camera.camera_from_world()),
        "t": camera.translation().as_slice(),
        "orthographic": camera.is_orthographic().then(|| camera.scale_depth(0.0)),
        "lens": camera.lens().map(|l| [2.0 * l.radius_mm, l.focus_mm]),
        "depth_steps_per_mm": depth_steps_per_mm,
    });
    write_json(&to("scene.json"), &record)
}

/// The planes of all layers, one below the other.
fn stacked<T: Copy>(layers: &[LayerMaps], plane: impl Fn(&LayerMaps) -> &Plane<T>) -> Plane<T> {
    let width = layers.first().map_or(0, |l| plane(l).width());
    let rows = layers.iter().map(|l| plane(l).height()).sum();
    let values = layers.iter().flat_map(|l| plane(l).as_slice());
    Plane::from_vec(width, rows, values.copied().collect())
}

/// Steps per mm that 16 bits hold, a power of two; code 0 is left for pixels without a surface.
fn depth_steps(depth_z: &Plane<f32>) -> f32 {
    let finite = depth_z.as_slice().iter().copied().filter(|z| z.is_finite());
    let deepest = finite.fold(0.0, f32::max);
    let mut steps = FINEST_DEPTH_STEPS_PER_MM;
    while deepest * steps > 65_535.0 {
        steps /= 2.0;
    }
    steps
}

fn depth_code(z: f32, steps: f32) -> u16 {
    if z.is_finite() {
        (z * steps).round().clamp(1.0, 65_535.0) as u16
    } else {
        0
    }
}

fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), TraceError> {
    let text = serde_json::to_string_pretty(value).map_err(|e| TraceError::Encode {
        path: path.to_owned(),
        reason: e.to_string(),
    })?;
    write_bytes(path, text.as_bytes())
}

pub(super) fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Times of every frame, ms.
#[derive(Default)]
struct FrameTimes {
    refit: Vec<f64>,
    primary: Vec<f64>,
    shadow: Vec<f64>,
    shade: Vec<f64>,
    resolve: Vec<f64>,
    encode: Vec<f64>,
    frame: Vec<f64>,
}

impl FrameTimes {
    fn push(
        &mut self,
        refit: Duration,
        view: &View,
        rendering: &Rendering,
        encode: Duration,
        frame: Duration,
    ) {
        self.refit.push(milliseconds(refit));
        self.primary.push(milliseconds(view.primary_time));
        self.shadow.push(milliseconds(rendering.times.shadow));
        self.shade.push(milliseconds(rendering.times.shade));
        self.resolve.push(milliseconds(rendering.times.resolve));
        self.encode.push(milliseconds(encode));
        self.frame.push(milliseconds(frame));
    }

    fn fill(self, report: &mut TimingReport) {
        report.refit_ms = Spread::of(self.refit);
        report.primary_ms = Spread::of(self.primary);
        report.shadow_ms = Spread::of(self.shadow);
        report.shade_ms = Spread::of(self.shade);
        report.resolve_ms = Spread::of(self.resolve);
        report.encode_ms = Spread::of(self.encode);
        report.frame_ms = Spread::of(self.frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_codes_round_trip() {
        let plane = Plane::from_vec(3, 1, vec![600.2, f32::INFINITY, 700.7]);
        let steps = depth_steps(&plane);
        assert!((steps - 64.0).abs() < 1e-6);
        assert_eq!(depth_code(f32::INFINITY, steps), 0);
        assert!((f32::from(depth_code(600.2, steps)) / steps - 600.2).abs() <= 0.5 / steps);
        let far = Plane::from_vec(1, 1, vec![50_000.0]);
        assert!((depth_steps(&far) - 1.0).abs() < 1e-6);
    }
}
