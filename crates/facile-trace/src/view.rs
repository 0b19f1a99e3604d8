//! From a scene and a camera to labels and images.
//!
//! [`trace_view`] shoots the primary rays and fills the labels; [`View::shade`] lights what they hit. One view serves any
//! number of light settings. Only pixels inside the projected bounds of the scene are traced.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use facile_core::Plane;

use crate::TraceError;
use crate::bounces::{BounceParams, ShadingPoints, Spacing};
use crate::camera::Camera;
use crate::edges::{self, Edges};
use crate::gbuffer::{CenterHits, GBuffer, Truth};
use crate::lanes::LANES;
use crate::layers;
use crate::lens::LensRays;
use crate::light::{Light, LightSource};
use crate::math::Rgb;
use crate::object::Object;
use crate::primary::{self, Method, PixelHits, pixels_in_blocks, sample_px, trace_samples};
use crate::ray::{Hit, NO_OBJECT};
use crate::sampling::{
    FIRST_SAMPLES, GLINT_SAMPLES, MORE_SAMPLES, Samples, bent_pixels, is_uneven, sample_offsets,
};
use crate::scene::{Layer, Scene};
use crate::scratch;
use crate::srgb::srgb8;
use crate::subsurface::{SPREAD_SHARE, Skin, SkinPixel};
use crate::surface;
use crate::whitted::{Shaded, Shader, Wanted};

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

/// Offset of a pixel's centre.
const CENTER: [f64; 2] = [0.5; 2];

/// Distance of the shaded rays of a pixel on a border, px.
const EDGE_SPACING: f32 = 0.25;

/// Samples that are shaded together: bounds the buffers. Many at once are cheaper, since each light sorts its rays.
const BATCH: usize = 1 << 16;

/// Surfaces that a view keeps for its next lights: 80 MB.
const MAX_KEPT_SURFACES: usize = 1 << 20;

/// What the primary rays of a camera found in a scene.
#[derive(Clone, Debug)]
pub struct View {
    camera: Camera,
    settings: RenderSettings,
    /// Pixels `[x0, y0, x1, y1)` that can show anything.
    bounds: Option<[usize; 4]>,
    /// What the pixels' centres see.
    centers: PixelHits,
    /// Pixels on the borders of objects, if sampling is adaptive.
    edges: Edges,
    /// The surfaces of centres and edges, and in their mirrors; none if there are more than [`MAX_KEPT_SURFACES`].
    points: Option<ShadingPoints>,
    /// Skin under which light spreads.
    skin: Option<Skin>,
    /// Pixels with a fixed number of samples above 1.
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
        srgb8(&self.color)
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
    check_lens(camera, settings.samples)?;
    let start = Instant::now();
    let bounds = camera.pixel_bounds(scene.bounds_in_world(Layer::All));
    let centers = bounds.map_or_else(PixelHits::default, |bounds| {
        let method = Method::for_view(scene, camera, bounds);
        primary::centers(scene, camera, bounds, method)
    });
    let mut behind = Vec::new();
    if settings.truth.occlusion {
        behind = trace_behind(scene, camera, &centers);
    }
    let mut edges = Edges::default();
    let is_adaptive = matches!(settings.samples, Samples::Adaptive(_));
    if is_adaptive || settings.truth.coverage {
        let pixels = border_pixels(scene, camera, bounds, &centers);
        edges = Edges::find(scene, camera, pixels);
    }
    let covering = if is_adaptive {
        edges.clone()
    } else {
        // The image does without them
        std::mem::take(&mut edges)
    };
    let layers = layers::behind(scene, camera, &centers, settings.truth.layers);
    let points = (centers.hits.len() + edges.hits.len() <= MAX_KEPT_SURFACES).then(|| {
        let mut directions = center_directions(camera, &centers.pixels);
        let mut hits = Cow::Borrowed(&centers.hits[..]);
        let from = first_edge(&centers);
        if !edges.hits.is_empty() {
            hits.to_mut().resize(from, Hit::MISS);
            hits.to_mut().extend_from_slice(&edges.hits);
            directions.resize(from, [1.0; 3]);
            let of_edges = edges.places.iter().zip(&edges.hits);
            directions.extend(of_edges.map(|(px, hit)| camera.sight(*px, hit.is_some())));
        }
        let mut points = ShadingPoints::default();
        let pixel = camera.pixel_spacing();
        let mm = [pixel, pixel * EDGE_SPACING];
        points.find(
            scene,
            &hits,
            &directions,
            Spacing { from, mm },
            settings.bounces(),
        );
        points
    });
    let found = CenterHits {
        pixels: &centers.pixels,
        hits: &centers.hits,
        behind: &behind,
        surfaces: points.as_ref().map_or(&[], |p| &p.surfaces[..]),
        layers: &layers,
        edges: &covering,
    };
    let gbuffer = GBuffer::new(scene, camera, settings.truth, &found);
    let mut view = View {
        camera: camera.clone(),
        settings: *settings,
        bounds,
        skin: Skin::new(camera, skin_pixels(scene, &centers)),
        centers,
        edges,
        points,
        dense_pixels: Vec::new(),
        dense_hits: Vec::new(),
        gbuffer,
        primary_time: Duration::ZERO,
    };
    if let Samples::Count(count @ 2..) = settings.samples {
        view.dense_pixels = view.bounds.map_or_else(Vec::new, pixels_in_blocks);
        let (offsets, hits) = (sample_offsets(count), &mut view.dense_hits);
        match LensRays::of(camera, count as usize) {
            Some(lens) => lens.trace(scene, &view.dense_pixels, &offsets, hits),
            None => trace_samples(
                scene,
                camera,
                &view.dense_pixels,
                &offsets,
                Layer::All,
                hits,
            ),
        }
    }
    view.primary_time = start.elapsed();
    Ok(view)
}

impl RenderSettings {
    fn bounces(&self) -> BounceParams {
        BounceParams {
            max_depth: self.max_depth,
            offset: self.offset_mm,
        }
    }
}

/// Number of the first sample of an edge among the shading points: those of centres fill whole blocks.
fn first_edge(centers: &PixelHits) -> usize {
    centers.hits.len().next_multiple_of(LANES)
}

/// The pixels under whose surface light spreads.
fn skin_pixels(scene: &Scene, centers: &PixelHits) -> Vec<SkinPixel> {
    let mut skin = Vec::new();
    if !scene.objects().iter().any(Object::scatters) {
        return skin;
    }
    for (sample, (hit, at)) in centers.hits.iter().zip(&centers.pixels).enumerate() {
        let object = &scene.objects()[hit.object as usize];
        let scatter_mm = object.material(hit.triangle).scatter_mm;
        if scatter_mm.x > 0.0 || scatter_mm.y > 0.0 || scatter_mm.z > 0.0 {
            skin.push(SkinPixel {
                sample: sample as u32,
                at: *at,
                depth_z: hit.t,
                scatter_mm,
            });
        }
    }
    skin
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
    if settings.truth.layers > layers::MAX_LAYERS {
        return Err(TraceError::Setting {
            name: "layers",
            expected: "at most 16",
            got: settings.truth.layers.to_string(),
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

fn check_lens(camera: &Camera, samples: Samples) -> Result<(), TraceError> {
    if camera.lens().is_none() || matches!(samples, Samples::Count(2..)) {
        return Ok(());
    }
    Err(TraceError::Setting {
        name: "samples",
        expected: "a number from 2 on with a lens",
        got: format!("{samples:?}"),
    })
}

/// A value for each pixel whose centre shows something.
fn plane_of<T: Clone>(
    camera: &Camera,
    centers: &PixelHits,
    empty: T,
    value: impl Fn(usize) -> T,
) -> Plane<T> {
    let mut plane = Plane::filled(camera.width(), camera.height(), empty);
    for (i, [x, y]) in centers.pixels.iter().enumerate() {
        plane[(*x as usize, *y as usize)] = value(i);
    }
    plane
}

/// Pixels next to another object or to nothing, including those just outside the bounds of what was hit, and pixels with
/// sharp highlights.
fn border_pixels(
    scene: &Scene,
    camera: &Camera,
    bounds: Option<[usize; 4]>,
    centers: &PixelHits,
) -> Vec<[u32; 2]> {
    // A number that is no object's makes its neighbours differ
    let glossy = NO_OBJECT - 1;
    let objects = plane_of(camera, centers, NO_OBJECT, |i| {
        let hit = &centers.hits[i];
        if edges::is_glossy(scene, hit) {
            glossy
        } else {
            hit.object
        }
    });
    let differs = |[x, y]: &[u32; 2]| {
        let (x, y) = (*x as usize, *y as usize);
        let own = objects[(x, y)];
        let columns = x.saturating_sub(1)..(x + 2).min(objects.width());
        let mut rows = y.saturating_sub(1)..(y + 2).min(objects.height());
        own == glossy || rows.any(|v| objects.row(v)[columns.clone()].iter().any(|o| *o != own))
    };
    let pixels = bounds.map_or_else(Vec::new, pixels_in_blocks);
    pixels.into_iter().filter(differs).collect()
}

/// The hits without occluders: only pixels that show an occluder are traced anew.
fn trace_behind(scene: &Scene, camera: &Camera, centers: &PixelHits) -> Vec<Hit> {
    let (pixels, hits) = (&centers.pixels, &centers.hits);
    let objects = scene.objects();
    let covered: Vec<usize> = (0..hits.len())
        .filter(|&i| objects[hits[i].object as usize].is_occluder())
        .collect();
    let covered_pixels: Vec<[u32; 2]> = covered.iter().map(|&i| pixels[i]).collect();
    let mut found = Vec::new();
    trace_samples(
        scene,
        camera,
        &covered_pixels,
        &[CENTER],
        Layer::BehindOccluders,
        &mut found,
    );
    let mut behind = hits.clone();
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
        self.centers.hits.len() + self.edges.rays + self.dense_hits.len()
    }

    fn plane_of<T: Clone>(&self, empty: T, value: impl Fn(usize) -> T) -> Plane<T> {
        plane_of(&self.camera, &self.centers, empty, value)
    }

    /// Lights the view. `scene` is the one that was traced, unchanged. Ambient light is summed, every directed light
    /// casts hard shadows.
    ///
    /// # Errors
    /// [`TraceError::Setting`] or [`TraceError::NotFinite`] for a light with impossible numbers.
    pub fn shade(&self, scene: &Scene, lights: &[LightSource]) -> Result<Rendering, TraceError> {
        let sources = lights;
        let mut lights: Vec<Light> = Vec::with_capacity(sources.len());
        for source in sources {
            source.add_to(&mut lights, &self.camera)?;
        }
        let shader = Shader {
            scene,
            camera: &self.camera,
            lights: &lights,
            offset: self.settings.offset_mm,
        };
        Ok(scratch::with(&SCRATCH, |scratch| {
            self.shade_with(&shader, scratch)
        }))
    }

    fn shade_with(&self, shader: &Shader<'_>, scratch: &mut BatchScratch) -> Rendering {
        let start = Instant::now();
        scratch.shaded.shadow_time = Duration::ZERO;
        let (width, height) = (self.camera.width(), self.camera.height());
        let mut color = match &shader.scene.backdrop {
            None => Plane::filled(width, height, shader.scene.background),
            Some(backdrop) => Plane::from_fn(width, height, |x, y| {
                let px = sample_px([x as u32, y as u32], CENTER);
                backdrop.color(&self.camera, self.camera.direction(px).into())
            }),
        };
        let mut shadow = None;
        let (mut spread, mut uneven_edges) = (Vec::new(), UnevenEdges::default());
        let is_dense = matches!(self.settings.samples, Samples::Count(2..));
        if !is_dense || self.settings.truth.shadow || self.skin.is_some() {
            let mut lit = self.shade_centers(shader, scratch);
            for ([x, y], own) in self.centers.pixels.iter().zip(lit.colors.drain(..)) {
                color[(*x as usize, *y as usize)] = own;
            }
            if self.settings.truth.shadow {
                shadow = Some(self.plane_of(1.0, |i| lit.shadow[i]));
            }
            uneven_edges = self.resolve_edges(&lit.edges, &mut color);
            spread = lit.spread;
        }
        let (centers, centers_shadow) = (start.elapsed(), scratch.shaded.shadow_time);
        match self.settings.samples {
            Samples::Count(1) => {}
            Samples::Count(count) => {
                let (pixels, hits) = (&self.dense_pixels, &self.dense_hits);
                let offsets = sample_offsets(count);
                let samples = (&pixels[..], &hits[..], &offsets[..]);
                self.for_each_pixel(shader, scratch, samples, |pixel, samples| {
                    color[pixel] = sum(samples) / count as f32;
                });
            }
            Samples::Adaptive(_) => self.refine(&mut color, &uneven_edges, shader, scratch),
        }
        for (pixel, added) in spread {
            let own = &mut color[pixel];
            *own = (*own + added).sup(&Rgb::zeros());
        }
        let shadow_time = scratch.shaded.shadow_time;
        let times = ShadeTimes {
            shadow: shadow_time,
            shade: centers.saturating_sub(centers_shadow),
            resolve: start
                .elapsed()
                .saturating_sub(centers)
                .saturating_sub(shadow_time.saturating_sub(centers_shadow)),
        };
        Rendering {
            color,
            shadow,
            times,
        }
    }

    /// Shades the pixels' centres.
    fn shade_centers(&self, shader: &Shader<'_>, scratch: &mut BatchScratch) -> LitCenters {
        let wanted = Wanted {
            irradiance: self.skin.is_some(),
            shadow: self.settings.truth.shadow,
        };
        let mut lit = LitCenters::default();
        let hits = &self.centers.hits;
        let mut irradiance = Vec::new();
        let mut albedo = Vec::new();
        let mut take = |points: &ShadingPoints, shaded: &Shaded, count: usize| {
            let of = |k: usize| &shaded.colors[k / LANES];
            lit.colors
                .extend((0..count).map(|k| surface::lane(of(k), k % LANES)));
            if wanted.shadow {
                let share = |k: usize| {
                    let [arrived, possible] = &shaded.arrived[k / LANES];
                    let (arrived, possible) = (arrived.0[k % LANES], possible.0[k % LANES]);
                    if possible > 0.0 {
                        arrived / possible
                    } else {
                        1.0
                    }
                };
                lit.shadow.extend((0..count).map(share));
            }
            if wanted.irradiance {
                irradiance.extend_from_slice(&shaded.irradiance);
                albedo.extend(
                    points.surfaces[..points.primary_blocks]
                        .iter()
                        .map(|b| b.albedo),
                );
            }
        };
        let edges = &self.edges.hits;
        if let Some(points) = &self.points {
            shader.shade(points, wanted, &mut scratch.shaded);
            take(points, &scratch.shaded, hits.len());
            let of = |k: usize| surface::lane(&scratch.shaded.colors[k / LANES], k % LANES);
            let from = first_edge(&self.centers);
            lit.edges.extend((from..from + edges.len()).map(of));
        } else {
            let direction = |i: usize| {
                self.camera
                    .sight(sample_px(self.centers.pixels[i], CENTER), true)
            };
            let bounces = self.settings.bounces();
            let spacing = self.camera.pixel_spacing();
            scratch.for_each_batch(shader, hits, direction, (spacing, bounces), wanted, take);
            let direction = |i: usize| {
                let is_surface = self.edges.hits[i].is_some();
                self.camera.sight(self.edges.places[i], is_surface)
            };
            let take = |_: &ShadingPoints, shaded: &Shaded, count: usize| {
                let of = |k: usize| surface::lane(&shaded.colors[k / LANES], k % LANES);
                lit.edges.extend((0..count).map(of));
            };
            let wanted = Wanted::default();
            let spacing = spacing * EDGE_SPACING;
            scratch.for_each_batch(shader, edges, direction, (spacing, bounces), wanted, take);
        }
        if let Some(skin) = &self.skin {
            let added = skin.spread(&irradiance).into_iter().zip(skin.pixels());
            lit.spread.extend(added.map(|(added, pixel)| {
                let (block, k) = (pixel.sample as usize / LANES, pixel.sample as usize % LANES);
                let at = (pixel.at[0] as usize, pixel.at[1] as usize);
                let spread = added.component_mul(&SPREAD_SHARE);
                (at, surface::lane(&albedo[block], k).component_mul(&spread))
            }));
        }
        lit
    }

    /// Mixes what the pixels on the borders of objects show, and returns those where the few samples of an object differ.
    fn resolve_edges(&self, samples: &[Rgb], color: &mut Plane<Rgb>) -> UnevenEdges {
        let mut uneven = UnevenEdges::default();
        let mut rest = samples;
        for part in &self.edges.parts {
            let (own, others) = rest.split_at(part.samples as usize);
            rest = others;
            let sum = sum(own);
            if is_uneven(own) {
                let list = if part.is_glossy {
                    &mut uneven.glossy
                } else {
                    &mut uneven.rough
                };
                list.push(part.pixel);
            }
            let own = &mut color[(part.pixel[0] as usize, part.pixel[1] as usize)];
            if part.is_first {
                *own = Rgb::zeros();
            }
            *own += sum * (part.share / part.samples as f32);
        }
        // Glossy parts get more samples than others of their pixel
        uneven.rough.dedup();
        uneven.glossy.dedup();
        let glossy: BTreeSet<[u32; 2]> = uneven.glossy.iter().copied().collect();
        uneven.rough.retain(|pixel| !glossy.contains(pixel));
        uneven
    }

    /// Takes a few samples where the pixels' centres do not follow their neighbours, and more where those differ.
    fn refine(
        &self,
        color: &mut Plane<Rgb>,
        uneven_edges: &UnevenEdges,
        shader: &Shader<'_>,
        scratch: &mut BatchScratch,
    ) {
        let (few, more) = (
            &sample_offsets(FIRST_SAMPLES),
            &sample_offsets(MORE_SAMPLES),
        );
        let trace = |pixels: &[[u32; 2]], offsets: &[[f64; 2]]| {
            let mut hits = Vec::new();
            trace_samples(
                shader.scene,
                &self.camera,
                pixels,
                offsets,
                Layer::All,
                &mut hits,
            );
            hits
        };
        // Take a few samples where a pixel does not lie between its neighbours on the same object
        let mut objects = self.plane_of(NO_OBJECT, |i| self.centers.hits[i].object);
        for part in &self.edges.parts {
            objects[(part.pixel[0] as usize, part.pixel[1] as usize)] = NO_OBJECT;
        }
        let uneven = bent_pixels(color, &objects, &self.centers.pixels);
        let hits = trace(&uneven, few);
        let mut firsts = Vec::with_capacity(uneven.len());
        self.for_each_pixel(shader, scratch, (&uneven, &hits, few), |pixel, samples| {
            let sum = sum(samples);
            color[pixel] = sum / few.len() as f32;
            if is_uneven(samples) {
                firsts.push((pixel, sum));
            }
        });
        // Take the rest where those differ, and where the samples of a border do
        let pixel = |(x, y): (usize, usize)| [x as u32, y as u32];
        let mut unsettled: Vec<[u32; 2]> = firsts.iter().map(|(at, _)| pixel(*at)).collect();
        unsettled.extend_from_slice(&uneven_edges.rough);
        let hits = trace(&unsettled, more);
        let mut firsts = firsts.iter();
        let all = (few.len() + more.len()) as f32;
        self.for_each_pixel(
            shader,
            scratch,
            (&unsettled, &hits, more),
            |pixel, samples| {
                color[pixel] = match firsts.next() {
                    Some((_, first)) => (first + sum(samples)) / all,
                    None => sum(samples) / more.len() as f32,
                };
            },
        );
        let many = &sample_offsets(GLINT_SAMPLES);
        let glints = &uneven_edges.glossy;
        let hits = trace(glints, many);
        self.for_each_pixel(shader, scratch, (glints, &hits, many), |pixel, samples| {
            color[pixel] = sum(samples) / many.len() as f32;
        });
    }

    /// Shades the samples of each pixel, given as pixels, hits and offsets, and calls `visit` with their colours.
    fn for_each_pixel(
        &self,
        shader: &Shader<'_>,
        scratch: &mut BatchScratch,
        (pixels, hits, offsets): (&[[u32; 2]], &[Hit], &[[f64; 2]]),
        mut visit: impl FnMut((usize, usize), &[Rgb]),
    ) {
        let count = offsets.len();
        let lens = LensRays::of(&self.camera, count);
        let direction = |i: usize| {
            let (pixel, offset, is_surface) =
                (pixels[i / count], offsets[i % count], hits[i].is_some());
            match &lens {
                // Backdrops are as sharp as their pictures are
                Some(lens) if is_surface => lens.ray(pixel, offset, i % count).direction.into(),
                _ => self.camera.sight(sample_px(pixel, offset), is_surface),
            }
        };
        let mut pixels = pixels.iter();
        let mut samples = Vec::with_capacity(count);
        let bounces = self.settings.bounces();
        let spacing = self.camera.pixel_spacing() / (count as f32).sqrt();
        let take = |_: &ShadingPoints, shaded: &Shaded, in_batch: usize| {
            for k in 0..in_batch {
                samples.push(surface::lane(&shaded.colors[k / LANES], k % LANES));
                if samples.len() == count {
                    if let Some([x, y]) = pixels.next() {
                        visit((*x as usize, *y as usize), &samples);
                    }
                    samples.clear();
                }
            }
        };
        let wanted = Wanted::default();
        scratch.for_each_batch(shader, hits, direction, (spacing, bounces), wanted, take);
    }
}

/// Pixels on borders where the few samples of an object differ.
#[derive(Default)]
struct UnevenEdges {
    rough: Vec<[u32; 2]>,
    glossy: Vec<[u32; 2]>,
}

/// What the pixels' centres show.
#[derive(Default)]
struct LitCenters {
    colors: Vec<Rgb>,
    /// Of the samples of [`Edges`].
    edges: Vec<Rgb>,
    /// Share of directed light that arrives; empty unless asked for.
    shadow: Vec<f32>,
    /// What pixels gain or lose by light that spreads under the skin.
    spread: Vec<((usize, usize), Rgb)>,
}

fn sum(samples: &[Rgb]) -> Rgb {
    samples.iter().fold(Rgb::zeros(), |sum, c| sum + c)
}

/// Directions of the rays through pixels' centres.
fn center_directions(camera: &Camera, pixels: &[[u32; 2]]) -> Vec<[f32; 3]> {
    let direction = |pixel: &[u32; 2]| camera.sight(sample_px(*pixel, CENTER), true);
    pixels.iter().map(direction).collect()
}

thread_local! {
    static SCRATCH: Cell<Option<Box<BatchScratch>>> = const { Cell::new(None) };
}

/// Buffers of [`View::shade`].
#[derive(Default)]
struct BatchScratch {
    directions: Vec<[f32; 3]>,
    points: ShadingPoints,
    shaded: Shaded,
}

impl BatchScratch {
    /// Shades hits in batches; `direction(i)` is that of the ray that made hit `i`. `take` gets what was shaded, and of how
    /// many hits.
    fn for_each_batch(
        &mut self,
        shader: &Shader<'_>,
        hits: &[Hit],
        direction: impl Fn(usize) -> [f32; 3],
        (spacing, bounces): (f32, BounceParams),
        wanted: Wanted,
        mut take: impl FnMut(&ShadingPoints, &Shaded, usize),
    ) {
        for start in (0..hits.len()).step_by(BATCH) {
            let end = (start + BATCH).min(hits.len());
            self.directions.clear();
            self.directions.extend((start..end).map(&direction));
            let hits = &hits[start..end];
            self.points.find(
                shader.scene,
                hits,
                &self.directions,
                Spacing::even(spacing),
                bounces,
            );
            shader.shade(&self.points, wanted, &mut self.shaded);
            take(&self.points, &self.shaded, hits.len());
        }
    }
}
