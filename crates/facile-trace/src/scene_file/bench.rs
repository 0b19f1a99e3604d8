//! Time and error of the tracer on a scene file: the rows of `facile bench trace`.

use std::path::Path;

use facile_core::{Plane, Texture};
use serde::Serialize;

use super::render::{jittered, load_scene, milliseconds, rest_positions};
use super::timing::ThreadClock;
use super::{SceneFile, Spread};
use crate::instructions::InstructionSet;
use crate::sampling::Samples;
use crate::view::{RenderSettings, trace_view};
use crate::{Camera, TraceError, Truth};

/// Amplitude of the motion in the rows with moved vertices, mm.
const MOTION_MM: f64 = 0.2;

/// One way to render the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// What was done: `frame`, `labels`, `moved`, `relight` or `layers`: four of them, and amodal masks.
    pub variant: &'static str,
    /// Samples per pixel, a number or `adaptive`.
    pub samples: Samples,
    /// Vector instructions, see [`InstructionSet::name`].
    pub instructions: &'static str,
    /// Time of a frame without encoding, one thread, ms on a processor.
    pub ms: Spread,
    /// Root of the mean squared error of the 8-bit image, all channels, against the reference.
    pub rmse: f64,
}

/// Times the ways to render a scene file, `repeats` times each (at least once), and compares with `reference`, an image
/// of the same size. Without one the scene is rendered with 256 samples first. Runs on the calling thread.
///
/// # Errors
/// As [`super::render_scene_file`]; [`TraceError::SizeMismatch`] for a reference of another size.
pub fn bench_scene_file(
    path: &Path,
    reference: Option<&Texture>,
    repeats: usize,
) -> Result<Vec<BenchRow>, TraceError> {
    let file = SceneFile::read(path)?;
    let camera = file.camera()?;
    let bench = Bench {
        reference: reference_image(&file, path, &camera, reference)?,
        file,
        path,
        camera,
        repeats: repeats.max(1),
    };
    let labels = Truth {
        depth_z: true,
        normal_in_world: true,
        segment: true,
        ..Truth::default()
    };
    let amodal = Truth {
        occlusion: true,
        layers: 4,
        ..labels
    };
    let one = Samples::Count(1);
    let mut rows = Vec::new();
    for set in InstructionSet::ALL.into_iter().filter(|s| s.is_available()) {
        rows.push(set.limit(|| bench.frames("labels", one, labels, false))?);
    }
    rows.push(bench.frames("frame", one, Truth::default(), false)?);
    rows.push(bench.frames("moved", one, labels, true)?);
    rows.push(bench.frames("layers", one, amodal, false)?);
    rows.push(bench.relights()?);
    for samples in [4, 9, 16, 36, 64, 100] {
        rows.push(bench.frames("frame", Samples::Count(samples), Truth::default(), false)?);
    }
    rows.push(bench.frames("frame", Samples::ADAPTIVE, Truth::default(), false)?);
    Ok(rows)
}

struct Bench<'a> {
    file: SceneFile,
    path: &'a Path,
    camera: Camera,
    reference: Plane<[u8; 3]>,
    repeats: usize,
}

impl Bench<'_> {
    /// Whole frames, with vertices moved before each if `is_moved`. The error is that of the scene at rest.
    fn frames(
        &self,
        variant: &'static str,
        samples: Samples,
        truth: Truth,
        is_moved: bool,
    ) -> Result<BenchRow, TraceError> {
        let (mut scene, _) = load_scene(&self.file, folder_of(self.path))?;
        let settings = RenderSettings {
            samples,
            truth,
            ..self.file.settings()
        };
        let view = trace_view(&scene, &self.camera, &settings)?;
        let image = view.shade(&scene, &self.file.light)?.to_srgb8();
        let rest = rest_positions(&scene);
        let mut times = Vec::with_capacity(self.repeats);
        for frame in 0..self.repeats {
            let moved = is_moved.then(|| jittered(&rest, MOTION_MM, frame as u32));
            let start = ThreadClock::start();
            for (object, positions) in scene.objects_mut().iter_mut().zip(moved.iter().flatten()) {
                object.set_positions(positions)?;
            }
            let view = trace_view(&scene, &self.camera, &settings)?;
            let lit = view.shade(&scene, &self.file.light)?.to_srgb8();
            times.push(milliseconds(start.elapsed()));
            drop(lit);
        }
        Ok(self.row(variant, samples, times, &image))
    }

    /// The same view lit again.
    fn relights(&self) -> Result<BenchRow, TraceError> {
        let (scene, _) = load_scene(&self.file, folder_of(self.path))?;
        let samples = Samples::Count(1);
        let settings = RenderSettings {
            samples,
            truth: Truth::default(),
            ..self.file.settings()
        };
        let view = trace_view(&scene, &self.camera, &settings)?;
        let mut image = view.shade(&scene, &self.file.light)?.to_srgb8();
        let mut times = Vec::with_capacity(self.repeats);
        for _ in 0..self.repeats {
            let start = ThreadClock::start();
            image = view.shade(&scene, &self.file.light)?.to_srgb8();
            times.push(milliseconds(start.elapsed()));
        }
        Ok(self.row("relight", samples, times, &image))
    }

    fn row(
        &self,
        variant: &'static str,
        samples: Samples,
        times: Vec<f64>,
        image: &Plane<[u8; 3]>,
    ) -> BenchRow {
        BenchRow {
            variant,
            samples,
            instructions: InstructionSet::current().name(),
            ms: Spread::of(times),
            rmse: root_mean_square(image, &self.reference),
        }
    }
}

pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("."))
}

fn reference_image(
    file: &SceneFile,
    path: &Path,
    camera: &Camera,
    given: Option<&Texture>,
) -> Result<Plane<[u8; 3]>, TraceError> {
    let (width, height) = (camera.width(), camera.height());
    if let Some(image) = given {
        for (what, expected, got) in [
            ("columns of the reference image", width, image.width()),
            ("rows of the reference image", height, image.height()),
        ] {
            if expected != got {
                return Err(TraceError::SizeMismatch {
                    what,
                    expected,
                    got,
                });
            }
        }
        return Ok(Plane::from_vec(width, height, image.texels().to_vec()));
    }
    let (scene, _) = load_scene(file, folder_of(path))?;
    let settings = RenderSettings {
        samples: Samples::Count(256),
        truth: Truth::default(),
        ..file.settings()
    };
    let view = trace_view(&scene, camera, &settings)?;
    Ok(view.shade(&scene, &file.light)?.to_srgb8())
}

pub(super) fn root_mean_square(a: &Plane<[u8; 3]>, b: &Plane<[u8; 3]>) -> f64 {
    let (a, b) = (a.as_slice().as_flattened(), b.as_slice().as_flattened());
    let squares = a
        .iter()
        .zip(b)
        .map(|(p, q)| f64::from(p.abs_diff(*q)).powi(2));
    (squares.sum::<f64>() / a.len().max(1) as f64).sqrt()
}
