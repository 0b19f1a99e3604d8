//! Samples beside the pixels' centres, where light asks for them.
//!
//! Which pixels need more samples depends on the light; what those samples see does not. A view keeps it, so its next light
//! traces what is new alone. Of what is kept a light shades only what it asks for, so its image is the same whatever was
//! asked for before.

use std::cell::Cell;
use std::sync::Mutex;

use super::View;
use super::shade::{BatchScratch, UnevenEdges, sum};
use crate::bends::bent_pixels;
use crate::bounces::{ShadingPoints, Spacing};
use crate::lanes::LANES;
use crate::lens::LensRays;
use crate::math::Rgb;
use crate::primary::{find_samples, sample_px};
use crate::ray::{Hit, NO_OBJECT};
use crate::sampling::{FIRST_OFFSETS, GLINT_SAMPLES, MORE_SAMPLES, is_uneven, sample_offsets};
use crate::surface::{self, SurfaceBlock};
use crate::whitted::{Shaded, Shader, Wanted};
use facile_core::Plane;

/// Samples that a view keeps at most, what mirrors show not counted: 25 MB.
const MAX_KEPT_SAMPLES: usize = 1 << 18;

/// A pixel without samples.
const NONE: u32 = u32::MAX;

/// Samples of a pixel that are taken together.
#[derive(Clone, Copy, Debug)]
enum Pattern {
    /// A few, where a pixel does not follow its neighbours.
    First,
    /// More, where those differ.
    More,
    /// Those of a sharp highlight.
    Glint,
}

impl Pattern {
    /// Number of patterns.
    const COUNT: usize = 3;

    fn offsets(self) -> Vec<[f64; 2]> {
        match self {
            Self::First => FIRST_OFFSETS.to_vec(),
            Self::More => sample_offsets(MORE_SAMPLES),
            Self::Glint => sample_offsets(GLINT_SAMPLES),
        }
    }

    fn samples(self) -> usize {
        match self {
            Self::First => FIRST_OFFSETS.len(),
            Self::More => MORE_SAMPLES as usize,
            Self::Glint => GLINT_SAMPLES as usize,
        }
    }
}

/// Pixels whose samples are asked for.
type Request<'a> = (Pattern, &'a [[u32; 2]]);

thread_local! {
    /// Buffers of a view that is gone.
    static SPARE: Cell<Option<Kept>> = const { Cell::new(None) };
}

/// What the samples of a view see that any light has asked for so far. A copy of a view begins with none.
#[derive(Debug, Default)]
pub(super) struct Further(Mutex<Kept>);

impl Drop for Further {
    fn drop(&mut self) {
        let own = self.0.get_mut().map(std::mem::take);
        if let Ok(mut kept) = own
            && kept.samples > 0
        {
            kept.clear();
            // Threads that end have no more use for it
            let _ = SPARE.try_with(|spare| spare.set(Some(kept)));
        }
    }
}

impl Clone for Further {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Further {
    /// Bytes of memory.
    pub(super) fn bytes(&self) -> usize {
        // Whoever lights the view now will have them counted later
        let kept = self.0.try_lock();
        kept.map_or(0, |kept| {
            let numbers: usize = kept.first.iter().map(Vec::len).sum();
            kept.points.surfaces.len() * size_of::<SurfaceBlock>() + numbers * size_of::<u32>()
        })
    }
}

#[derive(Debug, Default)]
struct Kept {
    /// Number of each pixel's first sample, row by row, for each pattern; empty before there is any.
    first: [Vec<u32>; Pattern::COUNT],
    samples: usize,
    points: ShadingPoints,
}

impl Kept {
    fn clear(&mut self) {
        self.first.iter_mut().for_each(Vec::clear);
        self.samples = 0;
        self.points.clear();
    }

    /// The first sample of a pixel, given by its number.
    fn first_of(&self, pattern: Pattern, pixel: usize) -> Option<usize> {
        let first = self.first[pattern as usize].get(pixel)?;
        (*first != NONE).then_some(*first as usize)
    }

    /// The lanes of the samples of some requests, and of all that mirrors and lenses show them.
    fn lanes(&self, view: &View, requests: &[Request<'_>]) -> Vec<u32> {
        let mut lanes = vec![0; self.points.surfaces.len()];
        for (pattern, pixels) in requests {
            for pixel in *pixels {
                if let Some(first) = self.first_of(*pattern, view.number(*pixel)) {
                    for sample in first..first + pattern.samples() {
                        lanes[sample / LANES] |= 1 << (sample % LANES);
                    }
                }
            }
        }
        self.points.follow(&mut lanes);
        lanes
    }
}

impl View {
    /// Takes a few samples where the pixels' centres do not follow their neighbours, and more where those differ.
    pub(super) fn refine(
        &self,
        color: &mut Plane<Rgb>,
        uneven_edges: &UnevenEdges,
        (shader, scratch): (&Shader<'_>, &mut BatchScratch),
    ) {
        // Take a few samples where a pixel does not lie between its neighbours on the same object
        let mut objects = self.plane_of(NO_OBJECT, |i| self.centers.hits[i].object);
        for part in &self.edges.parts {
            objects[(part.pixel[0] as usize, part.pixel[1] as usize)] = NO_OBJECT;
        }
        let uneven = bent_pixels(color, &objects, &self.centers.pixels);
        let (mut unsettled, mut firsts) = (Vec::new(), Vec::new());
        let requests = [
            (Pattern::First, &uneven[..]),
            (Pattern::Glint, &uneven_edges.glossy),
        ];
        self.for_each_asked((shader, scratch), &requests, |pattern, pixel, samples| {
            let sum = sum(samples);
            color[(pixel[0] as usize, pixel[1] as usize)] = sum / samples.len() as f32;
            if matches!(pattern, Pattern::First) && is_uneven(samples) {
                unsettled.push(pixel);
                firsts.push(sum);
            }
        });
        // Take the rest where those differ, and where the samples of a border do
        unsettled.extend_from_slice(&uneven_edges.rough);
        let mut firsts = firsts.iter();
        let requests = [(Pattern::More, &unsettled[..])];
        self.for_each_asked((shader, scratch), &requests, |_, pixel, samples| {
            let (more, count) = (sum(samples), samples.len());
            color[(pixel[0] as usize, pixel[1] as usize)] = match firsts.next() {
                Some(first) => (first + more) / (FIRST_OFFSETS.len() + count) as f32,
                None => more / count as f32,
            };
        });
    }

    /// Number of a pixel, row by row.
    fn number(&self, [x, y]: [u32; 2]) -> usize {
        y as usize * self.camera.width() + x as usize
    }

    /// Calls `visit` with each pixel that is asked for, in order, and the colours of its samples.
    fn for_each_asked(
        &self,
        (shader, scratch): (&Shader<'_>, &mut BatchScratch),
        requests: &[Request<'_>],
        mut visit: impl FnMut(Pattern, [u32; 2], &[Rgb]),
    ) {
        // Whoever lights the view at the same time keeps nothing
        let mut own = Kept::default();
        let mut lock = self.further.0.try_lock();
        let kept = match &mut lock {
            Ok(kept) => &mut **kept,
            Err(_) => &mut own,
        };
        if !self.keep(shader, requests, kept) {
            for &(pattern, pixels) in requests {
                let (offsets, mut hits) = (pattern.offsets(), Vec::new());
                find_samples(shader.scene, &self.camera, pixels, &offsets, &mut hits);
                let samples = (pixels, &hits[..], &offsets[..]);
                self.for_each_pixel((shader, scratch), samples, |pixel, samples| {
                    visit(pattern, pixel, samples);
                });
            }
            return;
        }
        let wanted = Wanted {
            lanes: Some(&kept.lanes(self, requests)),
            ..Wanted::default()
        };
        shader.shade(&kept.points, wanted, &mut scratch.shaded);
        let colors = &scratch.shaded.colors;
        let mut samples = Vec::new();
        for (pattern, pixels) in requests {
            for pixel in *pixels {
                let first = kept.first_of(*pattern, self.number(*pixel));
                samples.clear();
                samples.extend(first.into_iter().flat_map(|first| {
                    (first..first + pattern.samples())
                        .map(|k| surface::lane(&colors[k / LANES], k % LANES))
                }));
                visit(*pattern, *pixel, &samples);
            }
        }
    }

    /// Finds what is asked for and not kept yet. `false`, and nothing is kept, if that is too much.
    fn keep(&self, shader: &Shader<'_>, requests: &[Request<'_>], kept: &mut Kept) -> bool {
        if kept.samples == 0 {
            *kept = SPARE.take().unwrap_or_default();
        }
        let missing = |kept: &Kept| -> Vec<Vec<[u32; 2]>> {
            let of = |(pattern, pixels): &Request<'_>| {
                let is_missing =
                    |pixel: &[u32; 2]| kept.first_of(*pattern, self.number(*pixel)).is_none();
                pixels.iter().copied().filter(is_missing).collect()
            };
            requests.iter().map(of).collect()
        };
        let samples = |pixels: &[Vec<[u32; 2]>]| -> usize {
            let own = requests.iter().zip(pixels);
            own.map(|((pattern, _), pixels)| pattern.samples() * pixels.len())
                .sum()
        };
        let mut found = missing(kept);
        if kept.samples + samples(&found) > MAX_KEPT_SAMPLES {
            kept.clear();
            found = missing(kept);
        }
        if samples(&found) > MAX_KEPT_SAMPLES {
            return false;
        }
        kept.samples += samples(&found);
        for ((pattern, _), pixels) in requests.iter().zip(&found) {
            let (offsets, mut hits) = (pattern.offsets(), Vec::new());
            if pixels.is_empty() {
                continue;
            }
            find_samples(shader.scene, &self.camera, pixels, &offsets, &mut hits);
            let places = pixels
                .iter()
                .flat_map(|pixel| offsets.iter().map(|o| sample_px(*pixel, *o)));
            let directions: Vec<[f32; 3]> = places
                .zip(&hits)
                .map(|(px, hit)| self.camera.sight(px, hit.is_some()))
                .collect();
            let spacing = self.spacing_of(offsets.len());
            let bounces = self.settings.bounces();
            let block = kept
                .points
                .add(shader.scene, &hits, &directions, spacing, bounces);
            let numbers = &mut kept.first[*pattern as usize];
            numbers.resize(self.camera.width() * self.camera.height(), NONE);
            for (k, pixel) in pixels.iter().enumerate() {
                numbers[self.number(*pixel)] = (block * LANES + k * offsets.len()) as u32;
            }
        }
        true
    }

    /// Distance of as many samples in each pixel.
    fn spacing_of(&self, samples: usize) -> Spacing {
        Spacing::even(self.camera.pixel_spacing() / (samples as f32).sqrt())
    }

    /// Shades the samples of each pixel, given as pixels, hits and offsets, and calls `visit` with their colours.
    pub(super) fn for_each_pixel(
        &self,
        (shader, scratch): (&Shader<'_>, &mut BatchScratch),
        (pixels, hits, offsets): (&[[u32; 2]], &[Hit], &[[f64; 2]]),
        mut visit: impl FnMut([u32; 2], &[Rgb]),
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
        let spacing = self.spacing_of(count);
        let take = |_: &ShadingPoints, shaded: &Shaded, in_batch: usize| {
            for k in 0..in_batch {
                samples.push(surface::lane(&shaded.colors[k / LANES], k % LANES));
                if samples.len() == count {
                    if let Some(pixel) = pixels.next() {
                        visit(*pixel, &samples);
                    }
                    samples.clear();
                }
            }
        };
        let wanted = Wanted::default();
        scratch.for_each_batch(shader, hits, direction, (spacing, bounces), wanted, take);
    }
}
