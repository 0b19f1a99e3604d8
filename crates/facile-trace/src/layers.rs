//! The first surfaces of each pixel, one behind the other: what lies under glasses, masks and hair.
//!
//! Where the view is drawn they come with it ([`crate::raster`]). By rays, each further surface is the nearest one past the
//! last. Surfaces at the very same distance count once.

use crate::camera::Camera;
use crate::primary::{PixelHits, sample_px, trace_samples};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};

/// Surfaces of a pixel at most.
pub const MAX_LAYERS: u32 = 16;

/// A surface behind the one that a pixel's centre sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FurtherSurface {
    /// Number of the pixel among those that show something.
    pub(crate) pixel: u32,
    /// Depth along the optical axis, mm.
    pub(crate) depth_z: f32,
    /// Its [`facile_core::Segment`].
    pub(crate) segment: u8,
}

/// The surfaces behind those that the pixels' centres see, at most `count` for each pixel: a list for each layer.
pub(crate) fn by_rays(
    scene: &Scene,
    camera: &Camera,
    centers: &PixelHits,
    count: usize,
) -> Vec<Vec<FurtherSurface>> {
    let mut open: Vec<(u32, Hit)> = (0..).zip(centers.hits.iter().copied()).collect();
    let mut rays: Vec<Ray> = Vec::new();
    let mut found = Vec::new();
    let mut layers = Vec::with_capacity(count);
    for _ in 0..count {
        rays.clear();
        rays.extend(open.iter().map(|(pixel, last)| Ray {
            t_min: last.t,
            ..camera.ray(sample_px(centers.pixels[*pixel as usize], [0.5; 2]))
        }));
        found.clear();
        scene.closest_hits(&rays, Layer::All, &mut found);
        let pixels = open.iter().map(|(pixel, _)| *pixel);
        open = pixels
            .zip(found.iter().copied())
            .filter(|(_, hit)| hit.is_some())
            .collect();
        let surface = |(pixel, hit): &(u32, Hit)| FurtherSurface {
            pixel: *pixel,
            depth_z: hit.t,
            segment: scene.objects()[hit.object as usize].segment_at(hit).id(),
        };
        layers.push(open.iter().map(surface).collect());
    }
    layers
}

/// The hits without occluders: only pixels that show an occluder are traced anew.
pub(crate) fn without_occluders(scene: &Scene, camera: &Camera, centers: &PixelHits) -> Vec<Hit> {
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
        &[[0.5; 2]],
        Layer::BehindOccluders,
        &mut found,
    );
    let mut behind = hits.clone();
    for (i, hit) in covered.into_iter().zip(found) {
        behind[i] = hit;
    }
    behind
}
