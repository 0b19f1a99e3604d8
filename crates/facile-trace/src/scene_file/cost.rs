//! What a frame of a scene file costs by what is in it: the curves of `facile bench trace`.

use std::collections::BTreeMap;
use std::path::Path;

use facile_core::{Mesh, Plane};
use serde::Serialize;

use super::bench::{folder_of, root_mean_square};
use super::render::{load_scene, load_scene_of, milliseconds};
use super::timing::ThreadClock;
use super::{CameraSection, SceneFile, Spread};
use crate::bvh::Bvh;
use crate::sampling::Samples;
use crate::scene::Scene;
use crate::skips::Skips;
use crate::view::{RenderSettings, trace_view};
use crate::{Camera, LightSource, TraceError, Truth};

/// Triangles of the scene that are wanted at the ends of its curve.
const FEWEST_TRIANGLES: usize = 9_000;
const MOST_TRIANGLES: usize = 600_000;

/// Sides of the images.
const SIDES: [usize; 5] = [64, 128, 256, 512, 1024];

/// Numbers of lights.
const LIGHTS: [usize; 5] = [0, 1, 2, 4, 8];

/// Shares of light below which rays are cut.
const SHARES: [f32; 6] = [0.1, 0.03, 0.01, 3e-3, 1e-3, 0.0];

/// One point of a curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CostRow {
    /// `triangles`, `pixels` (the side of a square image), `lights`, `truth`, `skips` (what is left out, switched off) or `cut`
    /// (the least share of light that a ray is followed for).
    pub curve: &'static str,
    /// The place on it.
    pub value: f64,
    /// What was asked for, for `truth`, or switched off, for `skips`; else empty.
    pub label: &'static str,
    /// Time of a frame of one sample a pixel, one thread, ms on a processor.
    pub ms: Spread,
    /// Root of the mean squared error of the 8-bit image against the one without a cut, for `cut`; else 0.
    pub rmse: f64,
}

/// Times frames of a scene file with more and fewer triangles, pixels, lights and labels, and with rays that are cut sooner and
/// later, `repeats` times each (at least once). Runs on the calling thread.
///
/// # Errors
/// As [`super::render_scene_file`].
pub fn bench_scene_cost(path: &Path, repeats: usize) -> Result<Vec<CostRow>, TraceError> {
    let file = SceneFile::read(path)?;
    let (scene, _) = load_scene(&file, folder_of(path))?;
    let bench = Bench {
        camera: file.camera()?,
        settings: RenderSettings {
            samples: Samples::Count(1),
            truth: Truth::default(),
            ..file.settings()
        },
        file,
        path,
        repeats: repeats.max(1),
    };
    let mut rows = bench.triangles()?;
    rows.extend(bench.pixels(&scene)?);
    rows.extend(bench.lights(&scene)?);
    rows.extend(bench.truth(&scene)?);
    rows.extend(bench.skips(&scene)?);
    rows.extend(bench.cut(&scene)?);
    Ok(rows)
}

struct Bench<'a> {
    file: SceneFile,
    path: &'a Path,
    camera: Camera,
    settings: RenderSettings,
    repeats: usize,
}

impl Bench<'_> {
    /// Times frames, and returns the image.
    fn frames(
        &self,
        scene: &Scene,
        camera: &Camera,
        settings: &RenderSettings,
        lights: &[LightSource],
    ) -> Result<(Spread, Plane<[u8; 3]>), TraceError> {
        let frame = || -> Result<Plane<[u8; 3]>, TraceError> {
            let view = trace_view(scene, camera, settings)?;
            Ok(view.shade(scene, lights)?.to_srgb8())
        };
        let image = frame()?;
        let mut times = Vec::with_capacity(self.repeats);
        for _ in 0..self.repeats {
            let start = ThreadClock::start();
            let again = frame()?;
            times.push(milliseconds(start.elapsed()));
            drop(again);
        }
        Ok((Spread::of(times), image))
    }

    fn triangles(&self) -> Result<Vec<CostRow>, TraceError> {
        let mut rows = Vec::new();
        let folder = folder_of(self.path);
        let (whole, _) = load_scene(&self.file, folder)?;
        let count = |scene: &Scene| -> usize {
            let objects = scene.objects().iter();
            objects.map(|o| o.geometry().triangles().len()).sum()
        };
        // The largest cells that leave enough
        let mut scenes = Vec::new();
        if count(&whole) > 2 * FEWEST_TRIANGLES {
            let mut side = 16.0;
            loop {
                let coarse = |mesh: &Mesh| clustered(mesh, side);
                let (scene, _) = load_scene_of(&self.file, folder, coarse)?;
                if count(&scene) >= FEWEST_TRIANGLES {
                    scenes.push(scene);
                    break;
                }
                side *= 0.8;
            }
        }
        let mut fine = 0;
        scenes.push(whole);
        while scenes
            .last()
            .is_some_and(|s| 4 * count(s) <= MOST_TRIANGLES)
        {
            fine += 1;
            let split = |mesh: &Mesh| (0..fine).fold(mesh.clone(), |mesh, _| quartered(&mesh));
            scenes.push(load_scene_of(&self.file, folder, split)?.0);
        }
        for scene in scenes {
            let (ms, _) = self.frames(&scene, &self.camera, &self.settings, &self.file.light)?;
            rows.push(row("triangles", count(&scene) as f64, ms));
        }
        Ok(rows)
    }

    fn pixels(&self, scene: &Scene) -> Result<Vec<CostRow>, TraceError> {
        let mut rows = Vec::new();
        if !matches!(self.file.camera, CameraSection::LookAt { .. }) {
            // Matrices hold for one size
            return Ok(rows);
        }
        for side in SIDES {
            let mut file = self.file.clone();
            file.image.size = [side; 2];
            let (ms, _) = self.frames(scene, &file.camera()?, &self.settings, &file.light)?;
            rows.push(row("pixels", side as f64, ms));
        }
        Ok(rows)
    }

    /// Point lights on a circle about the camera.
    fn lights(&self, scene: &Scene) -> Result<Vec<CostRow>, TraceError> {
        let mut rows = Vec::new();
        for count in LIGHTS {
            let lamp = |k: usize| -> Result<LightSource, TraceError> {
                let turn = std::f64::consts::TAU * k as f64 / count as f64 + 0.4;
                let position = [400.0 * libm::cos(turn), 400.0 * libm::sin(turn), 0.0];
                let text = format!(
                    "kind = 'point'\nattach = 'camera'\nposition = {position:?}\nintensity = 0.3"
                );
                toml::from_str(&text).map_err(|error| TraceError::Setting {
                    name: "light",
                    expected: "a point light",
                    got: error.to_string(),
                })
            };
            let lights = (0..count).map(lamp).collect::<Result<Vec<_>, _>>()?;
            let (ms, _) = self.frames(scene, &self.camera, &self.settings, &lights)?;
            rows.push(row("lights", count as f64, ms));
        }
        Ok(rows)
    }

    fn truth(&self, scene: &Scene) -> Result<Vec<CostRow>, TraceError> {
        let none = Truth::default();
        #[rustfmt::skip]
        let kinds = [
            ("none", none),
            ("depth", Truth { depth_z: true, ..none }),
            ("normals", Truth { normal_in_world: true, ..none }),
            ("segments", Truth { segment: true, ..none }),
            ("hits", Truth { hit: true, ..none }),
            ("albedo", Truth { albedo: true, ..none }),
            ("shadow", Truth { shadow: true, ..none }),
            ("occlusion and amodal", Truth { occlusion: true, ..none }),
            ("coverage", Truth { coverage: true, ..none }),
            ("four layers", Truth { layers: 4, ..none }),
            ("all", Truth::ALL),
        ];
        let mut rows = Vec::new();
        for (number, (label, truth)) in kinds.into_iter().enumerate() {
            let settings = RenderSettings {
                truth,
                ..self.settings
            };
            let (ms, _) = self.frames(scene, &self.camera, &settings, &self.file.light)?;
            rows.push(CostRow {
                label,
                ..row("truth", number as f64, ms)
            });
        }
        Ok(rows)
    }

    /// Frames with all savings, and with each of them switched off.
    fn skips(&self, scene: &Scene) -> Result<Vec<CostRow>, TraceError> {
        let lights = &self.file.light;
        let mut rows = Vec::new();
        let mut push = |label, ms| {
            let value = rows.len() as f64;
            rows.push(CostRow {
                label,
                ..row("skips", value, ms)
            });
        };
        push(
            "none",
            self.frames(scene, &self.camera, &self.settings, lights)?.0,
        );
        for (name, skips) in Skips::each_off() {
            let settings = RenderSettings {
                skips,
                ..self.settings
            };
            push(name, self.frames(scene, &self.camera, &settings, lights)?.0);
        }
        let all = RenderSettings {
            truth: Truth::ALL,
            ..self.settings
        };
        push(
            "unasked truth",
            self.frames(scene, &self.camera, &all, lights)?.0,
        );
        // Trees of a moved face, and views of a changed light, by themselves
        let mut objects = scene.objects().to_vec();
        push(
            "refitted trees alone",
            self.times(|| {
                for o in &mut objects {
                    o.bvh.refit(&o.geometry.positions, &o.geometry.triangles);
                }
                Ok(())
            })?,
        );
        push(
            "rebuilt trees alone",
            self.times(|| {
                for o in &mut objects {
                    o.bvh = Bvh::build(&o.geometry.positions, &o.geometry.triangles)?;
                }
                Ok(())
            })?,
        );
        let view = trace_view(scene, &self.camera, &self.settings)?;
        push(
            "a light of a kept view",
            self.times(|| {
                view.shade(scene, lights)
                    .map(|image| drop(image.to_srgb8()))
            })?,
        );
        Ok(rows)
    }

    /// Times of some work.
    fn times(
        &self,
        mut work: impl FnMut() -> Result<(), TraceError>,
    ) -> Result<Spread, TraceError> {
        let mut times = Vec::with_capacity(self.repeats);
        for _ in 0..self.repeats {
            let start = ThreadClock::start();
            work()?;
            times.push(milliseconds(start.elapsed()));
        }
        Ok(Spread::of(times))
    }

    /// Empty if nothing in the scene sends out rays.
    fn cut(&self, scene: &Scene) -> Result<Vec<CostRow>, TraceError> {
        let spawns =
            |object: &crate::Object| object.materials.iter().any(crate::Material::spawns_rays);
        if !scene.objects().iter().any(spawns) {
            return Ok(Vec::new());
        }
        let of = |min_share: f32| {
            let settings = RenderSettings {
                min_share,
                ..self.settings
            };
            self.frames(scene, &self.camera, &settings, &self.file.light)
        };
        let (_, whole) = of(0.0)?;
        let mut rows = Vec::new();
        for share in SHARES {
            let (ms, image) = of(share)?;
            rows.push(CostRow {
                rmse: root_mean_square(&image, &whole),
                ..row("cut", f64::from(share), ms)
            });
        }
        Ok(rows)
    }
}

fn row(curve: &'static str, value: f64, ms: Spread) -> CostRow {
    CostRow {
        curve,
        value,
        label: "",
        ms,
        rmse: 0.0,
    }
}

/// The mesh with the vertices of each cube of a side, mm, made one, and the triangles that are left. Of the texture
/// coordinates each corner keeps its own.
fn clustered(mesh: &Mesh, side: f64) -> Mesh {
    let mut first: BTreeMap<[i64; 3], u32> = BTreeMap::new();
    let to: Vec<u32> = (0..)
        .zip(&mesh.positions)
        .map(|(v, p)| {
            let cell = std::array::from_fn(|k| (p[k] / side).floor() as i64);
            *first.entry(cell).or_insert(v)
        })
        .collect();
    let moved = |t: &[u32; 3]| t.map(|v| to[v as usize]);
    let is_left = |t: &[u32; 3]| {
        let [a, b, c] = moved(t);
        a != b && b != c && c != a
    };
    let kept: Vec<usize> = (0..mesh.triangles.len())
        .filter(|t| is_left(&mesh.triangles[*t]))
        .collect();
    Mesh {
        triangles: kept.iter().map(|t| moved(&mesh.triangles[*t])).collect(),
        texcoord_triangles: picked(&mesh.texcoord_triangles, &kept),
        segments: picked(&mesh.segments, &kept),
        ..mesh.clone()
    }
}

fn picked<T: Copy>(list: &[T], kept: &[usize]) -> Vec<T> {
    kept.iter().filter_map(|t| list.get(*t).copied()).collect()
}

/// The mesh with each triangle cut into four.
fn quartered(mesh: &Mesh) -> Mesh {
    let mut fine = mesh.clone();
    fine.colors.clear();
    fine.triangles = split(&mesh.triangles, &mut fine.positions, |a, b| {
        nalgebra::center(a, b)
    });
    fine.texcoord_triangles = split(&mesh.texcoord_triangles, &mut fine.texcoords, |a, b| {
        [0, 1].map(|k| f32::midpoint(a[k], b[k]))
    });
    let four = mesh.segments.iter().flat_map(|s| [*s; 4]);
    fine.segments = four.collect();
    fine
}

fn split<T: Clone>(
    triangles: &[[u32; 3]],
    values: &mut Vec<T>,
    middle: impl Fn(&T, &T) -> T,
) -> Vec<[u32; 3]> {
    let mut middles = BTreeMap::new();
    let mut fine = Vec::with_capacity(4 * triangles.len());
    for [a, b, c] in triangles {
        let mut between = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                values.push(middle(&values[a as usize], &values[b as usize]));
                values.len() as u32 - 1
            })
        };
        let (ab, bc, ca) = (between(*a, *b), between(*b, *c), between(*c, *a));
        fine.extend([[*a, ab, ca], [ab, *b, bc], [ca, bc, *c], [ab, bc, ca]]);
    }
    fine
}
