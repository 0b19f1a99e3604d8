//! From a scene and a camera to labels and images.
//!
//! [`trace_view`] shoots the primary rays and fills the labels; [`View::shade`] lights what they hit. One view serves any
//! number of light settings. Only pixels inside the projected bounds of the scene are traced.

use std::time::{Duration, Instant};

use facile_core::Plane;
use facile_core::color::srgb8_from_linear;

use crate::TraceError;
use crate::camera::Camera;
use crate::gbuffer::{CenterHits, GBuffer, Truth};
use crate::light::{Light, LightSource};
use crate::math::Rgb;
use crate::ray::{Hit, Ray};
use crate::sampling::{ADAPTIVE_SAMPLES, Samples, sample_offset, uneven_pixels};
use crate::scene::{Layer, Scene};
use crate::whitted::{ShadeScratch, Shader};

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Samples per pixel.
    pub samples: Samples,
    /// Labels to compute.
    pub truth: Truth,
    /// Mirror and refraction rays in a chain at most, 5 by default.
    pub max_depth: u32,
    /// Distance from a surface at which shadow and mirror rays start, mm; 0.05 by default. Larger hides contact
    /// shadows, smaller lets rounding darken surfaces.
    pub offset_mm: f32,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            samples: Samples::default(),
            truth: Truth::default(),
            max_depth: 5,
            offset_mm: 0.05,
        }
    }
}

/// Samples that are shaded together: bounds the buffers.
const BATCH: usize = 4096;

/// What the primary rays of a camera found in a scene.
#[derive(Clone, Debug)]
pub struct View {
    camera: Camera,
    settings: RenderSettings,
    /// Pixels whose centre was traced, in blocks, and what was found there.
    pixels: Vec<[u32; 2]>,
    hits: Vec<Hit>,
    /// Pixels with several samples: all of them, or those on the borders of objects.
    dense_pixels: Vec<[u32; 2]>,
    dense_hits: Vec<Hit>,
    /// Labels.
    pub gbuffer: GBuffer,
    /// What primary rays and labels took, wall clock.
    pub primary_time: Duration,
}

/// A lit image.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Linear RGB, row 0 at the top.
    pub color: Plane<Rgb>,
    /// Share of directed light that arrives at each pixel's centre, in `[0, 1]`; 1 where none could. Only if
    /// [`Truth::shadow`] is asked for.
    pub shadow: Option<Plane<f32>>,
    /// What it took.
    pub times: ShadeTimes,
}

/// Wall clock time of the steps of [`View::shade`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ShadeTimes {
    /// Shadow rays of all samples.
    pub shadow: Duration,
    /// Shading of pixel centres, or of all samples of a fixed count, without shadow rays.
    pub shade: Duration,
    /// Further samples of uneven pixels without their shadow rays, and the mean of samples.
    pub resolve: Duration,
}

impl Rendering {
    /// The image in 8-bit sRGB.
    pub fn to_srgb8(&self) -> Plane<[u8; 3]> {
        self.color.map(|c| [c.x, c.y, c.z].map(srgb8_from_linear))
    }
}

/// Traces the primary rays of a view.
///
/// # Errors
/// [`TraceError::Setting`] for a sample count outside `1..=1024` or a negative offset.
pub fn trace_view(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
) -> Result<View, TraceError> {
    check(settings)?;
    let start = Instant::now();
    let pixels = pixels_in_blocks(camera.pixel_bounds(scene.bounds_in_world(Layer::All)));
    let mut hits = Vec::new();
    trace_samples(scene, camera, &pixels, 1, Layer::All, &mut hits);
    let mut behind = Vec::new();
    if settings.truth.occlusion {
        behind = trace_behind(scene, camera, &pixels, &hits);
    }
    let centers = CenterHits {
        pixels: &pixels,
        hits: &hits,
        behind: &behind,
    };
    let gbuffer = GBuffer::new(scene, camera, settings.truth, &centers);
    let mut view = View {
        camera: camera.clone(),
        settings: *settings,
        pixels,
        hits,
        dense_pixels: Vec::new(),
        dense_hits: Vec::new(),
        gbuffer,
        primary_time: Duration::ZERO,
    };
    let count = view.dense_count();
    if count > 1 {
        view.dense_pixels = match settings.samples {
            Samples::Count(_) => view.pixels.clone(),
            Samples::Adaptive(_) => view.border_pixels(),
        };
        let dense = &view.dense_pixels;
        trace_samples(
            scene,
            camera,
            dense,
            count,
            Layer::All,
            &mut view.dense_hits,
        );
    }
    view.primary_time = start.elapsed();
    Ok(view)
}

fn check(settings: &RenderSettings) -> Result<(), TraceError> {
    if let Samples::Count(count) = settings.samples
        && !(1..=1024).contains(&count)
    {
        return Err(TraceError::Setting {
            name: "samples",
            expected: "1 to 1024, or \"adaptive\"",
            got: count.to_string(),
        });
    }
    if !(settings.offset_mm >= 0.0 && settings.offset_mm.is_finite()) {
        return Err(TraceError::Setting {
            name: "offset_mm",
            expected: "a finite distance of at least 0",
            got: settings.offset_mm.to_string(),
        });
    }
    Ok(())
}

/// The pixels of a rectangle `[x0, y0, x1, y1)` in blocks of 4 x 2, so that eight in a row are close together.
fn pixels_in_blocks(bounds: Option<[usize; 4]>) -> Vec<[u32; 2]> {
    let Some([x0, y0, x1, y1]) = bounds else {
        return Vec::new();
    };
    let mut pixels = Vec::with_capacity((x1 - x0) * (y1 - y0));
    for y in (y0..y1).step_by(2) {
        for x in (x0..x1).step_by(4) {
            for dy in 0..2.min(y1 - y) {
                for dx in 0..4.min(x1 - x) {
                    pixels.push([(x + dx) as u32, (y + dy) as u32]);
                }
            }
        }
    }
    pixels
}

/// The ray of sample `index` of `count` in a pixel.
fn sample_ray(camera: &Camera, [x, y]: [u32; 2], index: u32, count: u32) -> Ray {
    let [dx, dy] = sample_offset(index, count);
    camera.ray([f64::from(x) + dx, f64::from(y) + dy])
}

/// Traces `count` samples of each pixel; the hits of a pixel are adjacent.
fn trace_samples(
    scene: &Scene,
    camera: &Camera,
    pixels: &[[u32; 2]],
    count: u32,
    layer: Layer,
    hits: &mut Vec<Hit>,
) {
    hits.clear();
    hits.reserve(pixels.len() * count as usize);
    let mut rays = Vec::with_capacity(BATCH);
    for chunk in pixels.chunks(BATCH.div_ceil(count as usize)) {
        rays.clear();
        for &pixel in chunk {
            rays.extend((0..count).map(|i| sample_ray(camera, pixel, i, count)));
        }
        scene.closest_hits(&rays, layer, hits);
    }
}

/// The hits without occluders: only pixels that show an occluder are traced anew.
fn trace_behind(scene: &Scene, camera: &Camera, pixels: &[[u32; 2]], hits: &[Hit]) -> Vec<Hit> {
    let objects = scene.objects();
    let covered: Vec<usize> = (0..hits.len())
        .filter(|&i| hits[i].is_some() && objects[hits[i].object as usize].is_occluder())
        .collect();
    let covered_pixels: Vec<[u32; 2]> = covered.iter().map(|&i| pixels[i]).collect();
    let mut found = Vec::new();
    trace_samples(
        scene,
        camera,
        &covered_pixels,
        1,
        Layer::BehindOccluders,
        &mut found,
    );
    let mut behind = hits.to_vec();
    for (i, hit) in covered.into_iter().zip(found) {
        behind[i] = hit;
    }
    behind
}

impl View {
    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Number of primary rays that were traced.
    pub fn primary_rays(&self) -> usize {
        self.hits.len() + self.dense_hits.len()
    }

    fn dense_count(&self) -> u32 {
        match self.settings.samples {
            Samples::Count(count) => count,
            Samples::Adaptive(_) => ADAPTIVE_SAMPLES,
        }
    }

    /// Pixels next to another object or to nothing, including those just outside the bounds of what was traced.
    fn border_pixels(&self) -> Vec<[u32; 2]> {
        let objects = self.plane_of(u32::MAX, |i| self.hits[i].object);
        let differs = |[x, y]: [u32; 2]| {
            let (x, y) = (x as usize, y as usize);
            let own = objects[(x, y)];
            let columns = x.saturating_sub(1)..(x + 2).min(objects.width());
            let mut rows = y.saturating_sub(1)..(y + 2).min(objects.height());
            rows.any(|v| objects.row(v)[columns.clone()].iter().any(|o| *o != own))
        };
        self.pixels
            .iter()
            .copied()
            .filter(|p| differs(*p))
            .collect()
    }

    fn plane_of<T: Clone>(&self, empty: T, value: impl Fn(usize) -> T) -> Plane<T> {
        let mut plane = Plane::filled(self.camera.width(), self.camera.height(), empty);
        for (i, [x, y]) in self.pixels.iter().enumerate() {
            plane[(*x as usize, *y as usize)] = value(i);
        }
        plane
    }

    /// Lights the view. `scene` is the one that was traced, unchanged. Ambient light is summed, every directed light
    /// casts hard shadows.
    ///
    /// # Errors
    /// [`TraceError::Setting`] or [`TraceError::NotFinite`] for a light with impossible numbers.
    pub fn shade(&self, scene: &Scene, lights: &[LightSource]) -> Result<Rendering, TraceError> {
        let lights: Vec<Light> = lights
            .iter()
            .map(|l| l.in_world(&self.camera))
            .collect::<Result<_, _>>()?;
        let shader = Shader {
            scene,
            lights: &lights,
            max_depth: self.settings.max_depth,
            offset: self.settings.offset_mm,
        };
        let start = Instant::now();
        let mut scratch = BatchScratch::default();
        let (width, height) = (self.camera.width(), self.camera.height());
        let mut color = Plane::filled(width, height, scene.background);
        let mut shadow = None;
        let is_dense = self.settings.samples != Samples::Count(1);
        let is_adaptive = self.settings.samples == Samples::ADAPTIVE;
        if is_adaptive || !is_dense || self.settings.truth.shadow {
            // Shade the pixels' centres
            let center = |i: usize| sample_ray(&self.camera, self.pixels[i], 0, 1);
            let mut lit = self
                .settings
                .truth
                .shadow
                .then(|| vec![1.0; self.hits.len()]);
            let colors = scratch.shade(&shader, &self.hits, center, lit.as_deref_mut());
            color = self.plane_of(scene.background, |i| colors[i]);
            shadow = lit.map(|lit| self.plane_of(1.0, |i| lit[i]));
        }
        let (centers, centers_shadow) = (start.elapsed(), scratch.shade.shadow_time);
        if is_dense {
            self.resolve(
                &mut color,
                &self.dense_pixels,
                &self.dense_hits,
                &shader,
                &mut scratch,
            );
        }
        if is_adaptive {
            // Refine where the light makes a difference that the objects' borders did not show
            let mut marks = uneven_pixels(&color, |_, _| 0);
            for [x, y] in &self.dense_pixels {
                marks[(*x as usize, *y as usize)] = false;
            }
            let more: Vec<[u32; 2]> = self
                .pixels
                .iter()
                .copied()
                .filter(|[x, y]| marks[(*x as usize, *y as usize)])
                .collect();
            let mut hits = Vec::new();
            trace_samples(
                scene,
                &self.camera,
                &more,
                ADAPTIVE_SAMPLES,
                Layer::All,
                &mut hits,
            );
            self.resolve(&mut color, &more, &hits, &shader, &mut scratch);
        }
        let times = ShadeTimes {
            shadow: scratch.shade.shadow_time,
            shade: centers.saturating_sub(centers_shadow),
            resolve: start
                .elapsed()
                .saturating_sub(centers)
                .saturating_sub(scratch.shade.shadow_time.saturating_sub(centers_shadow)),
        };
        Ok(Rendering {
            color,
            shadow,
            times,
        })
    }

    /// Sets pixels to the mean of their samples.
    fn resolve(
        &self,
        color: &mut Plane<Rgb>,
        pixels: &[[u32; 2]],
        hits: &[Hit],
        shader: &Shader<'_>,
        scratch: &mut BatchScratch,
    ) {
        let count = self.dense_count() as usize;
        let ray = |i: usize| {
            let index = (i % count) as u32;
            sample_ray(&self.camera, pixels[i / count], index, count as u32)
        };
        let colors = scratch.shade(shader, hits, ray, None);
        for ([x, y], samples) in pixels.iter().zip(colors.chunks_exact(count)) {
            let sum = samples.iter().fold(Rgb::zeros(), |sum, c| sum + c);
            color[(*x as usize, *y as usize)] = sum / count as f32;
        }
    }
}

/// Buffers of one call of [`View::shade`].
#[derive(Default)]
struct BatchScratch {
    samples: Vec<(Ray, Hit)>,
    colors: Vec<Rgb>,
    shade: ShadeScratch,
}

impl BatchScratch {
    /// Shades hits in batches; `ray(i)` is the ray that made hit `i`.
    fn shade(
        &mut self,
        shader: &Shader<'_>,
        hits: &[Hit],
        ray: impl Fn(usize) -> Ray,
        mut shadow: Option<&mut [f32]>,
    ) -> &[Rgb] {
        self.colors.clear();
        self.colors.resize(hits.len(), Rgb::zeros());
        for start in (0..hits.len()).step_by(BATCH) {
            let end = (start + BATCH).min(hits.len());
            self.samples.clear();
            self.samples.extend((start..end).map(|i| (ray(i), hits[i])));
            let shadow = shadow.as_deref_mut().map(|s| &mut s[start..end]);
            let colors = &mut self.colors[start..end];
            shader.shade_batch(&self.samples, colors, shadow, &mut self.shade);
        }
        &self.colors
    }
}
