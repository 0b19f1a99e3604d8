//! The first surfaces of each pixel, one behind the other: what lies under glasses, masks and hair.
//!
//! Each further surface is the nearest one past the last, by the same rays as the first: surfaces at the very same distance
//! count once.

use crate::camera::Camera;
use crate::primary::{PixelHits, sample_px};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};

/// Surfaces of a pixel at most.
pub const MAX_LAYERS: u32 = 16;

/// The surfaces behind those that the pixels' centres see, at most `count - 1` for each pixel: a list for each further
/// layer, with [`Hit::MISS`] where there is nothing more.
pub(crate) fn behind(
    scene: &Scene,
    camera: &Camera,
    centers: &PixelHits,
    count: u32,
) -> Vec<Vec<Hit>> {
    let mut layers: Vec<Vec<Hit>> = Vec::new();
    let mut rays: Vec<Ray> = Vec::new();
    let mut found = Vec::new();
    for _ in 1..count {
        let last = layers.last().map_or(&centers.hits[..], |l| &l[..]);
        let open: Vec<usize> = (0..last.len()).filter(|i| last[*i].is_some()).collect();
        rays.clear();
        rays.extend(open.iter().map(|&i| Ray {
            t_min: last[i].t,
            ..camera.ray(sample_px(centers.pixels[i], [0.5; 2]))
        }));
        found.clear();
        scene.closest_hits(&rays, Layer::All, &mut found);
        let mut layer = vec![Hit::MISS; last.len()];
        for (i, hit) in open.into_iter().zip(&found) {
            layer[i] = *hit;
        }
        layers.push(layer);
    }
    layers
}
