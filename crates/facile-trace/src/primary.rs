//! The primary pass: what each pixel or sample sees, drawn or by rays, whichever is faster.

use crate::camera::Camera;
use crate::raster;
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};

/// Rays that are traced together: bounds the buffers.
const BATCH: usize = 4096;

/// Pixels that show something, and what, in the order of blocks, so that eight in a row are close together.
#[derive(Clone, Debug, Default)]
pub(crate) struct PixelHits {
    pub(crate) pixels: Vec<[u32; 2]>,
    pub(crate) hits: Vec<Hit>,
}

/// How to find out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Method {
    /// Triangles over pixels.
    Draw,
    /// Packets through the trees.
    Rays,
}

impl Method {
    /// The method for the pixels `[x0, y0, x1, y1)`.
    pub(crate) fn for_view(scene: &Scene, camera: &Camera, bounds: [usize; 4]) -> Self {
        if !camera.is_orthographic() && raster::suits(scene, camera, Layer::All, bounds) {
            Self::Draw
        } else {
            Self::Rays
        }
    }
}

/// What the centres of the pixels `[x0, y0, x1, y1)` see. The method does not change the result.
pub(crate) fn centers(
    scene: &Scene,
    camera: &Camera,
    bounds: [usize; 4],
    method: Method,
) -> PixelHits {
    let mut seen = PixelHits::default();
    match method {
        Method::Draw => {
            let [x0, y0, x1, y1] = bounds;
            let pixels = (x1 - x0) * (y1 - y0);
            seen.pixels.reserve(pixels);
            seen.hits.reserve(pixels);
            raster::draw(scene, camera, Layer::All, bounds, [0.5; 2], |pixel, hit| {
                seen.pixels.push(pixel);
                seen.hits.push(hit);
            });
        }
        Method::Rays => {
            let pixels = pixels_in_blocks(bounds);
            let mut hits = Vec::new();
            trace_samples(scene, camera, &pixels, &[[0.5; 2]], Layer::All, &mut hits);
            for (pixel, hit) in pixels.into_iter().zip(hits).filter(|(_, h)| h.is_some()) {
                seen.pixels.push(pixel);
                seen.hits.push(hit);
            }
        }
    }
    seen
}

/// The pixels of a rectangle `[x0, y0, x1, y1)` in blocks of 4 x 2.
pub(crate) fn pixels_in_blocks([x0, y0, x1, y1]: [usize; 4]) -> Vec<[u32; 2]> {
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

/// Image position at an offset in a pixel.
pub(crate) fn sample_px([x, y]: [u32; 2], [dx, dy]: [f64; 2]) -> [f64; 2] {
    [f64::from(x) + dx, f64::from(y) + dy]
}

/// Traces samples at the same offsets in each pixel; the hits of a pixel are adjacent.
pub(crate) fn trace_samples(
    scene: &Scene,
    camera: &Camera,
    pixels: &[[u32; 2]],
    offsets: &[[f64; 2]],
    layer: Layer,
    hits: &mut Vec<Hit>,
) {
    hits.clear();
    hits.reserve(pixels.len() * offsets.len());
    let mut rays: Vec<Ray> = Vec::with_capacity(BATCH);
    for chunk in pixels.chunks(BATCH.div_ceil(offsets.len())) {
        rays.clear();
        for &pixel in chunk {
            rays.extend(offsets.iter().map(|o| camera.ray(sample_px(pixel, *o))));
        }
        scene.closest_hits(&rays, layer, hits);
    }
}
