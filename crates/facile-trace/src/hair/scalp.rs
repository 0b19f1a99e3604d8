//! The scalp under hair: painted in the hair's colour.

use facile_core::{Texture, hair};

use crate::math::Rgb;

/// Brightness of roots and shaded scalp over the hair's.
const ROOTS: f32 = 0.5;
/// Share of the scalp that roots hide at most.
const MOST_COVER: f32 = 0.92;

/// A skin texture of the reference UV whose scalp has the linear colour of the hair over it. What is painted there keeps its
/// pattern.
pub fn toned_scalp(skin: &Texture, color: Rgb) -> Texture {
    let lut = &*facile_core::color::LINEAR_FROM_SRGB8;
    let mask = hair::scalp();
    let (width, height) = (skin.width(), skin.height());
    let share = |i: usize| {
        let (x, y) = (i % width, i / width);
        let uv = [
            (x as f32 + 0.5) / width as f32,
            1.0 - (y as f32 + 0.5) / height as f32,
        ];
        let [u, v] = mask.texel_from_texcoord(uv);
        bilinear(mask, u, v)
    };
    let light = |t: [u8; 3]| {
        let [r, g, b] = t.map(|c| lut[usize::from(c)]);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let shares: Vec<f32> = (0..width * height).map(share).collect();
    let (sum, count) = skin
        .texels()
        .iter()
        .zip(&shares)
        .filter(|(_, s)| **s > 0.9)
        .fold((0.0_f64, 0_u32), |(sum, n), (t, _)| {
            (sum + f64::from(light(*t)), n + 1)
        });
    let mean = (sum / f64::from(count.max(1))).max(1e-3) as f32;
    let mut toned = skin.clone();
    for (texel, share) in toned.texels_mut().iter_mut().zip(&shares) {
        if *share <= 0.0 {
            continue;
        }
        let pattern = (light(*texel) / mean).clamp(0.5, 1.6);
        let cover = share * MOST_COVER;
        for (k, own) in texel.iter_mut().enumerate() {
            let from = lut[usize::from(*own)];
            let mixed = from + (color[k] * ROOTS * pattern - from) * cover;
            *own = facile_core::color::srgb8_from_linear(mixed);
        }
    }
    toned
}

/// Grey level at a texel position, 0 to 1, not linear light: the mask is a share.
fn bilinear(mask: &Texture, x: f32, y: f32) -> f32 {
    let last = [mask.width() as f32 - 1.0, mask.height() as f32 - 1.0];
    let (x, y) = (x.clamp(0.0, last[0]), y.clamp(0.0, last[1]));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = (
        (x0 + 1).min(mask.width() - 1),
        (y0 + 1).min(mask.height() - 1),
    );
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let at = |x: usize, y: usize| f32::from(mask.texel(x, y)[0]) / 255.0;
    let top = at(x0, y0) + (at(x1, y0) - at(x0, y0)) * fx;
    let bottom = at(x0, y1) + (at(x1, y1) - at(x0, y1)) * fx;
    top + (bottom - top) * fy
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::{ReferenceHead, Segment};

    #[test]
    fn only_the_scalp_changes() {
        let reference = ReferenceHead::embedded();
        let red = Rgb::new(0.6, 0.1, 0.02);
        let toned = toned_scalp(&reference.texture, red);
        let mesh = &reference.mesh;
        let (mut scalp, mut nose) = (0, 0);
        for (corners, segment) in mesh.texcoord_triangles.iter().zip(&mesh.segments) {
            let uv = [0, 1].map(|k| {
                corners
                    .iter()
                    .map(|v| mesh.texcoords[*v as usize][k])
                    .sum::<f32>()
                    / 3.0
            });
            let (before, after) = (reference.texture.sample(uv), toned.sample(uv));
            match segment {
                Segment::Nose => {
                    assert_eq!(before, after);
                    nose += 1;
                }
                Segment::Scalp if after[0] > 3.0 * after[1] => scalp += 1,
                _ => {}
            }
        }
        assert!(nose > 300 && scalp > 300, "{nose} {scalp}");
    }
}
