//! Where in a pixel the samples lie, and which pixels need more of them.

use facile_core::Plane;
use facile_core::color::srgb8_from_linear;
use serde::{Deserialize, Serialize};

use crate::math::Rgb;
use crate::ray::NO_OBJECT;
use crate::srgb::srgb8;

/// How many samples a pixel's colour is the mean of. Truth always comes from the pixel's centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Samples {
    /// The same number everywhere; 1 is the centre.
    Count(u32),
    /// The centre, and more where neighbouring pixels or samples differ.
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

/// Samples that a pixel gets which does not follow its neighbours.
pub const FIRST_SAMPLES: u32 = 4;

/// Samples that it gets beside them if those differ.
pub const MORE_SAMPLES: u32 = 16;

/// Samples of a pixel with an uneven sharp highlight.
pub const GLINT_SAMPLES: u32 = 36;

/// Twice the distance of a pixel from the middle of two opposite neighbours, in steps of 8-bit sRGB, from which it gets
/// [`FIRST_SAMPLES`].
pub const BEND_LIMIT: i32 = 14;

/// Difference from a neighbour from which it gets them in any case.
pub const STEP_LIMIT: i32 = 24;

/// Difference of two of a pixel's samples from which it gets more.
pub const SPREAD_LIMIT: u8 = 10;

/// The golden ratio's fraction: its multiples spread most evenly over the unit interval.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Places of `count` samples in their pixel, each coordinate in `(0, 1)` with a mean of 0.5. A square number of samples is
/// a square grid, which leaves the smallest holes; other counts lie on a golden-ratio lattice, so that every one has a
/// column of its own and rows are evenly spread.
///
/// RMSE of 16 samples on one scene against 256: grid 0.69, lattice 0.71 (0.65 with a mean off 0.5, which shifts the image
/// against its labels), Hammersley net 0.85.
pub fn sample_offsets(count: u32) -> Vec<[f64; 2]> {
    let side = count.isqrt();
    if side * side == count {
        let at = |i: u32| (f64::from(i) + 0.5) / f64::from(side);
        return (0..count).map(|i| [at(i % side), at(i / side)]).collect();
    }
    lattice_offsets(count)
}

/// Places of `count` samples on a golden-ratio lattice of the unit square, whatever the count: none share a column or a
/// row, and their mean is 0.5.
pub(crate) fn lattice_offsets(count: u32) -> Vec<[f64; 2]> {
    let rows = |shift: f64| (0..count).map(move |i| fract(shift + f64::from(i) * GOLDEN));
    let mean = |shift: f64| rows(shift).sum::<f64>() / f64::from(count);
    // A shift moves the mean along until a sample leaves at the end and comes back at the start
    let mut shift = 0.0;
    for _ in 0..8 {
        shift = fract(shift + 0.5 - mean(shift));
    }
    rows(shift)
        .enumerate()
        .map(|(i, y)| [(i as f64 + 0.5) / f64::from(count), y])
        .collect()
}

fn fract(v: f64) -> f64 {
    v - libm::floor(v)
}

/// Whether two samples differ by more than [`SPREAD_LIMIT`] in sRGB.
pub(crate) fn is_uneven(samples: &[Rgb]) -> bool {
    let (low, high) = samples.iter().fold(
        (Rgb::repeat(f32::INFINITY), Rgb::repeat(f32::NEG_INFINITY)),
        |(low, high), c| (low.inf(c), high.sup(c)),
    );
    (0..3).any(|k| srgb8_from_linear(high[k]) - srgb8_from_linear(low[k]) > SPREAD_LIMIT)
}

/// The pixels of a list that are bent or stepped against two opposite neighbours, by more than [`BEND_LIMIT`] or
/// [`STEP_LIMIT`], and those next to another object, where neighbours tell nothing. Even slopes are right as they are: the
/// centre's colour is their mean. Pixels of [`NO_OBJECT`] are left out.
pub(crate) fn bent_pixels(
    colors: &Plane<Rgb>,
    objects: &Plane<u32>,
    pixels: &[[u32; 2]],
) -> Vec<[u32; 2]> {
    let (width, height) = (colors.width(), colors.height());
    let codes = srgb8(colors);
    let (codes, objects) = (codes.as_slice(), objects.as_slice());
    let is_bent = |[x, y]: &[u32; 2]| {
        let (x, y) = (*x as usize, *y as usize);
        let at = y * width + x;
        let object = objects[at];
        if object == NO_OBJECT {
            return false;
        }
        let (is_across, is_along) = (x > 0 && x + 1 < width, y > 0 && y + 1 < height);
        let ways = [
            (is_across, 1),
            (is_along, width),
            (is_across && is_along, width + 1),
            (is_across && is_along, width - 1),
        ];
        ways.into_iter().any(|(is_inside, step)| {
            is_inside
                && (objects[at - step] != object
                    || objects[at + step] != object
                    || (0..3).any(|k| {
                        let [a, b, c] = [at - step, at, at + step].map(|i| i32::from(codes[i][k]));
                        let (before, after) = (b - a, c - b);
                        (before - after).abs() > BEND_LIMIT
                            || before.abs().max(after.abs()) > STEP_LIMIT
                    }))
        })
    };
    pixels.iter().copied().filter(is_bent).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::color::LINEAR_FROM_SRGB8;

    #[test]
    fn offsets_cover_the_pixel_evenly() {
        for count in [1, 2, 4, 7, 13, 16, 64] {
            let offsets = sample_offsets(count);
            for k in 0..2 {
                let mut values: Vec<f64> = offsets.iter().map(|o| o[k]).collect();
                values.sort_by(f64::total_cmp);
                let mean = values.iter().sum::<f64>() / f64::from(count);
                assert!((mean - 0.5).abs() < 1e-9, "{count}: {mean}");
                let rows = if count.isqrt().pow(2) == count {
                    count.isqrt()
                } else {
                    count
                };
                let step = 1.0 / f64::from(rows);
                let widest = values.windows(2).map(|w| w[1] - w[0]).fold(0.0, f64::max);
                assert!(widest < 2.7 * step, "{count}: gap of {widest}");
                assert!(values[0] > 0.0 && values[values.len() - 1] < 1.0);
            }
        }
    }

    #[test]
    fn steps_are_bent_and_slopes_are_not() {
        let pixels: Vec<[u32; 2]> = (0..24).map(|i| [i % 6, i / 6]).collect();
        let bent = |value: &dyn Fn(usize) -> f32, object: &dyn Fn(usize) -> u32| {
            let code = |x: usize| LINEAR_FROM_SRGB8[value(x) as usize];
            let image = Plane::from_fn(6, 4, |x, _| Rgb::repeat(code(x)));
            let objects = Plane::from_fn(6, 4, |x, _| object(x));
            bent_pixels(&image, &objects, &pixels)
        };
        let step = |x: usize| if x < 3 { 100.0 } else { 120.0 };
        let columns: Vec<u32> = bent(&step, &|_| 0).iter().map(|p| p[0]).collect();
        assert_eq!(columns, [2, 3, 2, 3, 2, 3, 2, 3]);
        assert!(bent(&|x| 20.0 * x as f32, &|_| 0).is_empty());
        // Next to another object neighbours tell nothing
        let columns: Vec<u32> = bent(&|_| 90.0, &|x| u32::from(x < 3))
            .iter()
            .map(|p| p[0])
            .collect();
        assert_eq!(columns, [2, 3, 2, 3, 2, 3, 2, 3]);
        assert!(bent(&step, &|_| NO_OBJECT).is_empty());
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
