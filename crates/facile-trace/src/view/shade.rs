//! From what a view's rays found to an image.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use facile_core::Plane;

use super::{CENTER, EDGE_SPACING, View, first_edge};
use crate::bounces::{BounceParams, ShadingPoints, Spacing};
use crate::error::TraceError;
use crate::lanes::LANES;
use crate::light::{Light, LightSource};
use crate::math::Rgb;
use crate::primary::sample_px;
use crate::ray::Hit;
use crate::sampling::{Samples, is_uneven, sample_offsets};
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
            skips: self.settings.skips,
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
                self.for_each_pixel((shader, scratch), samples, |[x, y], samples| {
                    color[(x as usize, y as usize)] = sum(samples) / count as f32;
                });
            }
            Samples::Adaptive(_) => self.refine(&mut color, &uneven_edges, (shader, scratch)),
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
            lanes: None,
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
            let spacing = Spacing::even(self.camera.pixel_spacing());
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
            let spacing = Spacing::even(self.camera.pixel_spacing() * EDGE_SPACING);
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
}

/// Pixels on borders where the few samples of an object differ.
#[derive(Default)]
pub(super) struct UnevenEdges {
    pub(super) rough: Vec<[u32; 2]>,
    pub(super) glossy: Vec<[u32; 2]>,
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

pub(super) fn sum(samples: &[Rgb]) -> Rgb {
    samples.iter().fold(Rgb::zeros(), |sum, c| sum + c)
}

thread_local! {
    static SCRATCH: Cell<Option<Box<BatchScratch>>> = const { Cell::new(None) };
}

/// Buffers of [`View::shade`].
#[derive(Default)]
pub(super) struct BatchScratch {
    directions: Vec<[f32; 3]>,
    points: ShadingPoints,
    pub(super) shaded: Shaded,
}

impl BatchScratch {
    /// Shades hits in batches; `direction(i)` is that of the ray that made hit `i`. `take` gets what was shaded, and of how
    /// many hits.
    pub(super) fn for_each_batch(
        &mut self,
        shader: &Shader<'_>,
        hits: &[Hit],
        direction: impl Fn(usize) -> [f32; 3],
        (spacing, bounces): (Spacing, BounceParams),
        wanted: Wanted<'_>,
        mut take: impl FnMut(&ShadingPoints, &Shaded, usize),
    ) {
        for start in (0..hits.len()).step_by(BATCH) {
            let end = (start + BATCH).min(hits.len());
            self.directions.clear();
            self.directions.extend((start..end).map(&direction));
            let hits = &hits[start..end];
            self.points
                .find(shader.scene, hits, &self.directions, spacing, bounces);
            shader.shade(&self.points, wanted, &mut self.shaded);
            take(&self.points, &self.shaded, hits.len());
        }
    }
}
