//! From what a view's rays found to an image: shading, and the samples that light asks for.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use facile_core::Plane;

use super::{CENTER, EDGE_SPACING, View, first_edge};
use crate::bends::bent_pixels;
use crate::bounces::{BounceParams, ShadingPoints, Spacing};
use crate::error::TraceError;
use crate::lanes::LANES;
use crate::lens::LensRays;
use crate::light::{Light, LightSource};
use crate::math::Rgb;
use crate::primary::{find_samples, sample_px};
use crate::ray::{Hit, NO_OBJECT};
use crate::sampling::{
    FIRST_OFFSETS, GLINT_SAMPLES, MORE_SAMPLES, Samples, is_uneven, sample_offsets,
};
use crate::scene::Scene;
use crate::scratch;
use crate::srgb::srgb8;
use crate::subsurface::SPREAD_SHARE;
use crate::surface;
use crate::whitted::{Shaded, Shader, Wanted};

/// Samples that are shaded together: bounds the buffers. Many at once are cheaper, since each light sorts its rays.
const BATCH: usize = 1 << 16;

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

impl View {
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
        let (few, more) = (&FIRST_OFFSETS, &sample_offsets(MORE_SAMPLES));
        let trace = |pixels: &[[u32; 2]], offsets: &[[f64; 2]]| {
            let mut hits = Vec::new();
            find_samples(shader.scene, &self.camera, pixels, offsets, &mut hits);
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
