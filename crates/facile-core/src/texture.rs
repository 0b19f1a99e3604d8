//! Colour textures: 8-bit sRGB in memory, linear when sampled.

use std::sync::OnceLock;

use crate::color::{LINEAR_FROM_SRGB8, Srgb8Codes};

/// An RGB image, row 0 at the top as in files. Texture coordinate `(0, 0)` is the lower left corner of the image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    width: usize,
    height: usize,
    texels: Vec<[u8; 3]>,
    smaller: Smaller,
}

/// The levels of a texture below the first, made when they are first asked for. They follow from the texels, so all are
/// equal here.
#[derive(Clone, Debug, Default)]
struct Smaller(OnceLock<Vec<Texture>>);

impl PartialEq for Smaller {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Smaller {}

impl Texture {
    /// A texture over existing sRGB texels, top row first.
    ///
    /// # Panics
    /// If `texels` does not hold `width * height` values, or either is 0.
    pub fn new(width: usize, height: usize, texels: Vec<[u8; 3]>) -> Self {
        assert!(width > 0 && height > 0, "a texture has at least one texel");
        assert_eq!(
            texels.len(),
            width * height,
            "texels fill the texture exactly"
        );
        Self {
            width,
            height,
            texels,
            smaller: Smaller::default(),
        }
    }

    /// A single texel of one sRGB colour.
    pub fn constant(srgb: [u8; 3]) -> Self {
        Self::new(1, 1, vec![srgb])
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All sRGB texels, top row first.
    pub fn texels(&self) -> &[[u8; 3]] {
        &self.texels
    }

    /// All sRGB texels, to write.
    pub fn texels_mut(&mut self) -> &mut [[u8; 3]] {
        self.smaller = Smaller::default();
        &mut self.texels
    }

    /// The sRGB texel at column `x`, row `y` from the top.
    pub fn texel(&self, x: usize, y: usize) -> [u8; 3] {
        self.texels[y * self.width + x]
    }

    /// Continuous texel position of a texture coordinate: texel centres lie at whole numbers, y downwards.
    pub fn texel_from_texcoord(&self, uv: [f32; 2]) -> [f32; 2] {
        [
            uv[0] * self.width as f32 - 0.5,
            (1.0 - uv[1]) * self.height as f32 - 0.5,
        ]
    }

    /// The texture at half the size, `level` times, down to one texel: each texel is the mean light of the four below it.
    /// The first call for a level above 0 makes all levels, O(texels).
    pub fn level(&self, level: usize) -> &Self {
        if level == 0 {
            return self;
        }
        let smaller = self.smaller.0.get_or_init(|| {
            let mut levels: Vec<Self> = Vec::new();
            loop {
                let last = levels.last().unwrap_or(self);
                if last.width == 1 && last.height == 1 {
                    return levels;
                }
                levels.push(last.halved());
            }
        });
        smaller.get(level - 1).or(smaller.last()).unwrap_or(self)
    }

    fn halved(&self) -> Self {
        let (lut, codes): (&[f32; 256], _) = (&LINEAR_FROM_SRGB8, Srgb8Codes::default());
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut texels = Vec::with_capacity(width * height);
        let mean = |a: &[u8; 3], b: &[u8; 3], c: &[u8; 3], d: &[u8; 3]| {
            let of = |k: usize| {
                let linear = |texel: &[u8; 3]| lut[usize::from(texel[k])];
                codes.of(0.25 * (linear(a) + linear(b) + linear(c) + linear(d)))
            };
            [of(0), of(1), of(2)]
        };
        for y in 0..height {
            let row = |y: usize| &self.texels[y * self.width..(y + 1) * self.width];
            let (top, bottom) = (row(2 * y), row((2 * y + 1).min(self.height - 1)));
            let ((tops, top), (bottoms, bottom)) = (top.as_chunks::<2>(), bottom.as_chunks::<2>());
            let pairs = tops.iter().zip(bottoms);
            texels.extend(pairs.map(|([a, b], [c, d])| mean(a, b, c, d)));
            // A last column by itself counts twice
            let alone = top.iter().zip(bottom);
            texels.extend(alone.map(|(a, c)| mean(a, a, c, c)));
        }
        Self::new(width, height, texels)
    }

    /// Linear RGB at a texture coordinate, bilinear, clamped at the border.
    pub fn sample(&self, uv: [f32; 2]) -> [f32; 3] {
        let [x, y] = self.texel_from_texcoord(uv);
        let (x_floor, y_floor) = (x.floor(), y.floor());
        let (fx, fy) = (x - x_floor, y - y_floor);
        let clamp = |v: f32, n: usize| (v.max(0.0) as usize).min(n - 1);
        let (x0, x1) = (clamp(x_floor, self.width), clamp(x_floor + 1.0, self.width));
        let (y0, y1) = (
            clamp(y_floor, self.height),
            clamp(y_floor + 1.0, self.height),
        );
        let lut = &*LINEAR_FROM_SRGB8;
        let (a, b) = (self.texel(x0, y0), self.texel(x1, y0));
        let (c, d) = (self.texel(x0, y1), self.texel(x1, y1));
        std::array::from_fn(|k| {
            let [a, b, c, d] = [a, b, c, d].map(|t| lut[usize::from(t[k])]);
            let top = a + (b - a) * fx;
            let bottom = c + (d - c) * fx;
            top + (bottom - top) * fy
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lower_left_corner_is_the_origin() {
        let texture = Texture::new(2, 2, vec![[0; 3], [0; 3], [255, 0, 0], [0; 3]]);
        for uv in [[0.25, 0.25], [-3.0, -3.0]] {
            let [r, g, b] = texture.sample(uv);
            assert!((r - 1.0).abs() < 1e-6 && g.abs() + b.abs() < 1e-6);
        }
        let middle = texture.sample([0.5, 0.5]);
        assert!((middle[0] - 0.25).abs() < 1e-6);
    }

    #[test]
    fn smaller_levels_keep_the_mean_light() {
        let texels = (0..15).map(|i| [if i % 2 == 0 { 255 } else { 0 }, 90, 0]);
        let mut texture = Texture::new(5, 3, texels.collect());
        assert_eq!(texture.level(0), &texture);
        let sizes: Vec<_> = (1..6)
            .map(|l| (texture.level(l).width(), texture.level(l).height()))
            .collect();
        assert_eq!(sizes, [(3, 2), (2, 1), (1, 1), (1, 1), (1, 1)]);
        // Half of the light is 188 in sRGB, not 128
        assert_eq!(texture.level(1).texel(0, 0), [188, 90, 0]);
        texture.texels_mut().fill([7; 3]);
        assert_eq!(texture.level(2).texel(0, 0), [7; 3]);
    }
}
