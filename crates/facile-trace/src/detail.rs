//! Pores and fine wrinkles: what a skin's vertices and texels cannot hold, for views close enough to show it.
//!
//! Noise over the texture coordinates tilts the shading normal and varies the highlight, so it moves with the skin. Labels
//! keep the smooth normal. Materials without detail cost nothing.

use crate::lanes::lanes_of;
use crate::math::{Vec3, unit_or};
use crate::ray::Hit;
use crate::scene::Scene;
use crate::surface::{SurfaceBlock, lane};

/// Cells of the noise along the texture: pores of some 0.5 mm and wrinkles of some 1.4 mm on the reference head.
const PORES: f32 = 760.0;
const WRINKLES: f32 = 290.0;
/// Largest tilt of the normal by each, rad.
const PORE_TILT: f32 = 0.13;
const WRINKLE_TILT: f32 = 0.1;
/// Change of the highlight's strength at most, as a share.
const GLOSS: f32 = 0.45;

/// Adds detail to the lanes `wanted` of a block, whose hits these are.
pub(crate) fn add(scene: &Scene, hits: &[Hit], wanted: u32, block: &mut SurfaceBlock) {
    for k in lanes_of(wanted) {
        let hit = &hits[k];
        let object = &scene.objects()[hit.object as usize];
        let Some(corners) = object.geometry.texcoords(hit.triangle) else {
            continue;
        };
        let strength = object.material(hit.triangle).detail;
        let weights = hit.barycentric();
        let uv = [0, 1].map(|axis| (0..3).map(|c| corners[c][axis] * weights[c]).sum::<f32>());
        let places = object.geometry.corners(hit.triangle);
        let Some([along_u, along_v]) = gradients(places, corners) else {
            continue;
        };
        let (pore, pore_slope) = noise(uv, PORES, 1);
        let (_, wrinkle_slope) = noise(uv, WRINKLES, 2);
        let slope = [0, 1].map(|i| pore_slope[i] * PORE_TILT + wrinkle_slope[i] * WRINKLE_TILT);
        // Texture steps have any length; only their directions matter
        let tilt =
            unit_or(along_u, Vec3::zeros()) * slope[0] + unit_or(along_v, Vec3::zeros()) * slope[1];
        let tilt = object.vector_in_world(tilt) * strength;
        let own = lane(&block.normal, k);
        let normal = unit_or(own - tilt, own);
        for axis in 0..3 {
            block.normal[axis].0[k] = normal[axis];
        }
        block.specular.0[k] *= 1.0 + GLOSS * strength * (2.0 * pore - 1.0);
    }
}

/// How a triangle's texture coordinates change over its surface.
fn gradients([a, b, c]: [Vec3; 3], [p, q, r]: [[f32; 2]; 3]) -> Option<[Vec3; 2]> {
    let (e, f) = (b - a, c - a);
    let normal = e.cross(&f);
    let squared = normal.norm_squared();
    (squared > 1e-12).then(|| {
        // Gradients of the weights of the second and third corner
        let (second, third) = (f.cross(&normal) / squared, normal.cross(&e) / squared);
        [0, 1].map(|k| second * (q[k] - p[k]) + third * (r[k] - p[k]))
    })
}

/// Smooth noise in `[0, 1]` of `cells` along the texture, and its slope, of about 1 at most.
fn noise(uv: [f32; 2], cells: f32, seed: u32) -> (f32, [f32; 2]) {
    let [x, y] = uv.map(|v| v * cells);
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let at = |dx: i32, dy: i32| value(x0 as i32 + dx, y0 as i32 + dy, seed);
    let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let slope = |t: f32| 6.0 * t * (1.0 - t);
    let (sx, sy) = (smooth(fx), smooth(fy));
    let (top, bottom) = (a + (b - a) * sx, c + (d - c) * sx);
    let along_x = ((b - a) + ((d - c) - (b - a)) * sy) * slope(fx);
    let along_y = (bottom - top) * slope(fy);
    (top + (bottom - top) * sy, [along_x, along_y])
}

/// A number in `[0, 1]` for each point of a lattice.
fn value(x: i32, y: i32, seed: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ seed.wrapping_mul(0xcb1a_b31f);
    h ^= h >> 15;
    h = h.wrapping_mul(0x2c1b_3c6d);
    h ^= h >> 12;
    h = h.wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    (h >> 8) as f32 / 16_777_216.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_the_noise() {
        for i in 0..200 {
            let t = i as f32;
            let uv = [0.37 + t * 0.001_37, 0.21 + t * 0.000_91];
            let step = 1e-3;
            let (_, slope) = noise(uv, 10.0, 3);
            for k in 0..2 {
                let moved = |by: f32| {
                    let mut at = uv;
                    at[k] += by;
                    noise(at, 10.0, 3).0
                };
                let found = (moved(step) - moved(-step)) / (2.0 * step * 10.0);
                assert!((found - slope[k]).abs() < 0.02, "{i}: {found} {}", slope[k]);
            }
        }
    }

    #[test]
    fn gradients_follow_the_texture() {
        let places = [
            Vec3::zeros(),
            Vec3::new(2.0, 0.0, 0.0),
            Vec3::new(0.0, 4.0, 0.0),
        ];
        let found = gradients(places, [[0.1, 0.1], [0.5, 0.1], [0.1, 0.9]]).expect("not flat");
        assert!((found[0] - Vec3::new(0.2, 0.0, 0.0)).norm() < 1e-6);
        assert!((found[1] - Vec3::new(0.0, 0.2, 0.0)).norm() < 1e-6);
        assert!(gradients([Vec3::zeros(); 3], [[0.0; 2]; 3]).is_none());
    }
}
