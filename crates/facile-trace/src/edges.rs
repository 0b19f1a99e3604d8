//! Pixels that show several objects: how much of each, from many rays, and what each looks like, from few.
//!
//! Whether a ray meets an object is cheap to find out, what light does there is dear. So the borders of objects get
//! [`VISIBLE_SAMPLES`] rays a pixel, of which at most [`SHADED_SAMPLES`] of each object are shaded. Nothing here depends on
//! light.

use std::collections::BTreeSet;

use facile_core::Plane;

use crate::camera::Camera;
use crate::primary::{find_samples, sample_px};
use crate::ray::Hit;
use crate::sampling::lattice_offsets;
use crate::scene::Scene;

/// Rays of a pixel on the border of an object.
pub const VISIBLE_SAMPLES: usize = 32;

/// Rays that find out whether the border passes through the pixel: the outermost ones, which no sliver misses.
const FIRST_SAMPLES: usize = 16;

/// Rays of an object in a pixel that are shaded.
pub const SHADED_SAMPLES: usize = 4;

/// The same for surfaces with sharp highlights or mirror images, which few rays would miss.
pub const GLOSSY_SAMPLES: usize = 8;

/// Shininess from which highlights are sharp.
const GLOSSY_SHININESS: f32 = 50.0;

/// Pixels that show several objects, and what to shade of each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edges {
    pub(crate) parts: Vec<Part>,
    /// The samples of all parts, one after the other, and their image positions, px.
    pub(crate) hits: Vec<Hit>,
    pub(crate) places: Vec<[f64; 2]>,
    /// Rays that were traced.
    pub(crate) rays: usize,
}

/// What a pixel shows of one object, or of none.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    pub(crate) pixel: [u32; 2],
    /// Of the pixel.
    pub(crate) share: f32,
    /// Samples of this part.
    pub(crate) samples: u32,
    pub(crate) is_first: bool,
    /// Whether its highlights are sharp.
    pub(crate) is_glossy: bool,
    pub(crate) is_surface: bool,
}

impl Edges {
    /// Looks at the pixels of a list, and at the neighbours of those where it finds a border. Pixels that show one object all
    /// over, and no glossy one, are left out.
    pub(crate) fn find(scene: &Scene, camera: &Camera, pixels: Vec<[u32; 2]>) -> Self {
        let mut edges = Self::default();
        let mut seen: BTreeSet<[u32; 2]> = pixels.iter().copied().collect();
        let mut next = pixels;
        while !next.is_empty() {
            let found = edges.look(scene, camera, &next);
            // A sliver of an object may lie between the centres of pixels
            let size = [camera.width() as u32, camera.height() as u32];
            let around = found.iter().flat_map(|[x, y]| {
                let rows = y.saturating_sub(1)..(y + 2).min(size[1]);
                let columns = x.saturating_sub(1)..(x + 2).min(size[0]);
                rows.flat_map(move |v| columns.clone().map(move |u| [u, v]))
            });
            next = around.filter(|pixel| seen.insert(*pixel)).collect();
        }
        edges
    }

    /// Looks at the pixels of a list, and returns those where it finds a border.
    fn look(&mut self, scene: &Scene, camera: &Camera, pixels: &[[u32; 2]]) -> Vec<[u32; 2]> {
        let (first, rest) = offsets();
        let mut hits = Vec::new();
        find_samples(scene, camera, pixels, &first, &mut hits);
        self.rays += hits.len();
        let seen = pixels.iter().zip(hits.chunks_exact(FIRST_SAMPLES));
        let is_mixed = |hits: &[Hit]| {
            hits.iter().any(|h| h.object != hits[0].object) || is_glossy(scene, &hits[0])
        };
        let (pixels, firsts): (Vec<[u32; 2]>, Vec<&[Hit]>) =
            seen.filter(|(_, hits)| is_mixed(hits)).unzip();
        let mut others = Vec::new();
        find_samples(scene, camera, &pixels, &rest, &mut others);
        self.rays += others.len();
        let offsets: Vec<[f64; 2]> = first.iter().chain(&rest).copied().collect();
        let others = others.chunks_exact(VISIBLE_SAMPLES - FIRST_SAMPLES);
        let mut borders = Vec::new();
        for ((pixel, first), rest) in pixels.iter().zip(firsts).zip(others) {
            let hits = first.iter().chain(rest).zip(&offsets);
            let mut hits: Vec<(&Hit, &[f64; 2])> = hits.collect();
            // By object, neighbours together; nothing comes last
            hits.sort_by_key(|(hit, offset)| (hit.object, z_order(**offset)));
            if hits[0].0.object != hits[hits.len() - 1].0.object {
                borders.push(*pixel);
            }
            self.add(scene, *pixel, &hits);
        }
        borders
    }

    fn add(&mut self, scene: &Scene, pixel: [u32; 2], hits: &[(&Hit, &[f64; 2])]) {
        let parts = hits.chunk_by(|(a, _), (b, _)| a.object == b.object);
        for (number, part) in parts.enumerate() {
            let is_surface = part[0].0.is_some();
            let is_glossy = is_glossy(scene, part[0].0);
            let wanted = match is_surface {
                false => 1,
                true if is_glossy => GLOSSY_SAMPLES,
                true => SHADED_SAMPLES,
            };
            let samples = part.len().min(wanted);
            self.parts.push(Part {
                pixel,
                share: part.len() as f32 / VISIBLE_SAMPLES as f32,
                samples: samples as u32,
                is_first: number == 0,
                is_glossy,
                is_surface,
            });
            for k in 0..samples {
                // One of each run of neighbours, not the same one of each
                let (hit, offset) = part[(8 * k + 2 * (k % 4) + 1) * part.len() / (8 * samples)];
                self.hits.push(*hit);
                self.places.push(sample_px(pixel, *offset));
            }
        }
    }

    /// Share of each pixel that shows any surface; `plane` holds that of the pixels' centres.
    pub(crate) fn cover(&self, plane: &mut Plane<f32>) {
        for part in &self.parts {
            let at = &mut plane[(part.pixel[0] as usize, part.pixel[1] as usize)];
            if part.is_first {
                *at = 0.0;
            }
            if part.is_surface {
                *at += part.share;
            }
        }
    }
}

/// Number of a place along a curve that keeps neighbours together.
fn z_order(offset: [f64; 2]) -> u32 {
    let [x, y] = offset.map(|v| (v * 8.0) as u32);
    (0..3).fold(0, |z, bit| {
        z | (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1)
    })
}

/// Whether a hit is on an opaque surface with sharp highlights.
pub(crate) fn is_glossy(scene: &Scene, hit: &Hit) -> bool {
    scene.objects().get(hit.object as usize).is_some_and(|o| {
        let material = o.material(hit.triangle);
        let is_sharp = material.roughness <= 0.0 && material.shininess >= GLOSSY_SHININESS;
        material.specular > 0.0 && is_sharp && !material.is_transparent()
    })
}

/// Places of the first rays and of the others. None share a column or a row, so that a sliver along a side of the pixel
/// counts for what it is.
fn offsets() -> (Vec<[f64; 2]>, Vec<[f64; 2]>) {
    let mut all = lattice_offsets(VISIBLE_SAMPLES as u32);
    let inside = |[x, y]: &[f64; 2]| x.min(1.0 - x).min(y.min(1.0 - y));
    all.sort_by(|a, b| inside(a).total_cmp(&inside(b)));
    let rest = all.split_off(FIRST_SAMPLES);
    (all, rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_rays_go_around_the_others() {
        let (first, rest) = offsets();
        assert_eq!(first.len(), FIRST_SAMPLES);
        assert_eq!(first.len() + rest.len(), VISIBLE_SAMPLES);
        // On every side one passes close by
        for k in 0..2 {
            assert!(first.iter().any(|o| o[k] < 0.03));
            assert!(first.iter().any(|o| o[k] > 0.97));
        }
        let inside = |o: &[f64; 2]| o.iter().all(|v| (0.1..0.9).contains(v));
        assert!(rest.iter().all(inside));
    }
}
