//! Where in a pixel the samples lie, and which pixels need more of them.

use facile_core::Plane;
use serde::{Deserialize, Serialize};

use crate::math::Rgb;

/// How many samples a pixel's colour is the mean of. Truth always comes from the pixel's centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Samples {
    /// The same number everywhere; 1 is the centre.
    Count(u32),
    /// The centre, and [`ADAPTIVE_SAMPLES`] where neighbouring pixels differ.
    Adaptive(AdaptiveWord),
}

/// The word `adaptive`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AdaptiveWord {
    /// See [`Samples::Adaptive`].
    Adaptive,
}

impl Samples {
    /// [`Samples::Adaptive`].
    pub const ADAPTIVE: Self = Self::Adaptive(AdaptiveWord::Adaptive);
}

impl Default for Samples {
    fn default() -> Self {
        Self::ADAPTIVE
    }
}

/// Samples of a pixel on an edge when sampling is adaptive.
pub const ADAPTIVE_SAMPLES: u32 = 16;

/// Difference of two neighbours, in steps of 8-bit sRGB, from which both are sampled more often.
pub const CONTRAST_LIMIT: u8 = 8;

/// The golden ratio's fraction: its multiples spread most evenly over the unit interval.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Place of sample `index` of `count` in its pixel, each coordinate in `(0, 1)`. One sample is the centre; more lie on a
/// golden-ratio lattice, so that every one has a column of its own and rows are evenly spread.
pub fn sample_offset(index: u32, count: u32) -> [f64; 2] {
    if count <= 1 {
        return [0.5; 2];
    }
    let x = (f64::from(index) + 0.5) / f64::from(count);
    let y = 0.5 + f64::from(index) * GOLDEN;
    [x, fract(y)]
}

fn fract(v: f64) -> f64 {
    v - libm::floor(v)
}

/// Marks every pixel that differs from one of its eight neighbours by more than [`CONTRAST_LIMIT`] in sRGB, or that
/// `id` tells apart from it.
pub(crate) fn uneven_pixels(colors: &Plane<Rgb>, id: impl Fn(usize, usize) -> u32) -> Plane<bool> {
    let (width, height) = (colors.width(), colors.height());
    let codes = colors.map(|c| [0, 1, 2].map(|k| facile_core::color::srgb8_from_linear(c[k])));
    let ids = Plane::from_fn(width, height, id);
    let mut marks = Plane::filled(width, height, false);
    let mut compare = |a: (usize, usize), b: (usize, usize)| {
        let (p, q) = (codes[a], codes[b]);
        if ids[a] != ids[b] || (0..3).any(|k| p[k].abs_diff(q[k]) > CONTRAST_LIMIT) {
            marks[a] = true;
            marks[b] = true;
        }
    };
    for y in 0..height {
        for x in 0..width {
            if x + 1 < width {
                compare((x, y), (x + 1, y));
            }
            if y + 1 < height {
                compare((x, y), (x, y + 1));
                if x + 1 < width {
                    compare((x, y), (x + 1, y + 1));
                    compare((x + 1, y), (x, y + 1));
                }
            }
        }
    }
    marks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_cover_the_pixel_evenly() {
        for count in [1, 2, 4, 7, 16, 64] {
            let offsets: Vec<_> = (0..count).map(|i| sample_offset(i, count)).collect();
            for k in 0..2 {
                let mut values: Vec<f64> = offsets.iter().map(|o| o[k]).collect();
                values.sort_by(f64::total_cmp);
                let mean = values.iter().sum::<f64>() / f64::from(count);
                assert!(
                    (mean - 0.5).abs() < 0.6 / f64::from(count) + 1e-9,
                    "{count}: {mean}"
                );
                let step = 1.0 / f64::from(count);
                let widest = values.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
                assert!(widest < 2.7 * step, "{count}: gap of {widest}");
                assert!(values[0] > 0.0 && values[values.len() - 1] < 1.0);
            }
        }
    }

    #[test]
    fn only_borders_are_uneven() {
        let image = Plane::from_fn(6, 4, |x, _| Rgb::repeat(if x < 3 { 0.2 } else { 0.4 }));
        let marks = uneven_pixels(&image, |_, _| 0);
        for y in 0..4 {
            assert_eq!(marks.row(y), &[false, false, true, true, false, false]);
        }
        let flat = Plane::filled(6, 4, Rgb::repeat(0.3));
        assert!(uneven_pixels(&flat, |_, _| 0).as_slice().iter().all(|m| !m));
        let by_id = uneven_pixels(&flat, |_, y| u32::from(y > 1));
        assert!(by_id[(0, 1)] && by_id[(5, 2)] && !by_id[(0, 0)]);
    }

    #[test]
    fn the_file_form_is_a_number_or_a_word() {
        #[derive(Deserialize)]
        struct S {
            samples: Samples,
        }
        let parse = |t: &str| toml::from_str::<S>(t).map(|s| s.samples);
        assert_eq!(parse("samples = 4").expect("valid"), Samples::Count(4));
        assert_eq!(
            parse("samples = 'adaptive'").expect("valid"),
            Samples::ADAPTIVE
        );
        assert!(parse("samples = 'many'").is_err());
        assert!(parse("samples = -1").is_err());
    }
}
