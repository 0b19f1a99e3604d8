//! Where in the unit cube samples are drawn: at random, one in each stratum, or on a scrambled Sobol sequence.
//!
//! A coordinate is a function of seed, point and dimension alone, so that any sample can be made without those before
//! it. Strata and permutations take no memory, whatever the number of points.

use std::sync::OnceLock;

use facile_core::rng::RandomStream;

/// How the points of a dataset fill the space of what is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// Independent points.
    Random,
    /// A Latin hypercube: in each dimension exactly one point in each of as many equal intervals as there are points.
    Stratified,
    /// Owen-scrambled Sobol points: any first `2^k` of them are stratified in each dimension, and evenly spread over
    /// pairs of dimensions.
    Sobol,
}

/// Points of the unit cube.
#[derive(Clone, Copy, Debug)]
pub(super) struct Points {
    pub(super) pattern: Pattern,
    pub(super) seed: u64,
    /// Number of points.
    pub(super) len: u64,
}

impl Points {
    /// Coordinates of point `number`, each in `[0, 1)`, into `out`. `retry` is 0 first; for what was drawn again it
    /// counts up, and the point is a random one.
    pub(super) fn point(&self, number: u64, retry: u32, out: &mut [f64]) {
        if retry > 0 || self.pattern == Pattern::Random {
            let mut stream = RandomStream::new(mix(self.seed ^ u64::from(retry)), number);
            out.fill_with(|| stream.unit());
            return;
        }
        for (dimension, value) in out.iter_mut().enumerate() {
            let key = mix(self.seed ^ mix(dimension as u64 + 1));
            *value = match self.pattern {
                Pattern::Stratified => {
                    let stratum = permuted(number, self.len, key) as f64;
                    let inside = unit(mix(key ^ mix(number)));
                    ((stratum + inside) / self.len as f64).min(BELOW_ONE)
                }
                _ => sobol(number, dimension, key),
            };
        }
    }
}

/// The largest number below 1.
const BELOW_ONE: f64 = 1.0 - f64::EPSILON / 2.0;
/// Levels of the binary tree whose halves are exchanged; below them coordinates are random. There are fewer than 2^40
/// points.
const LEVELS: u32 = 40;

/// A 64-bit mixing function (the finaliser of `SplitMix64`, Steele et al. 2014).
pub(super) fn mix(v: u64) -> u64 {
    let v = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ (v >> 31)
}

/// Bits as a number in `[0, 1)`.
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
}

/// Element `number` of a random permutation of `0..len`: a Feistel network on the next even power of two, walked until
/// it leads back into the range (Black and Rogaway 2002). Takes at most a few steps on average.
pub(super) fn permuted(number: u64, len: u64, key: u64) -> u64 {
    const ROUNDS: u64 = 4;
    let half = (64 - len.saturating_sub(1).leading_zeros())
        .div_ceil(2)
        .max(1);
    let mask = (1_u64 << half) - 1;
    let mut v = number;
    loop {
        let (mut left, mut right) = (v >> half, v & mask);
        for round in 0..ROUNDS {
            let next = left ^ (mix(key ^ mix(right ^ (round << 56))) & mask);
            left = right;
            right = next;
        }
        v = (left << half) | right;
        if v < len {
            return v;
        }
    }
}

/// Exchanges the halves of each of the first [`LEVELS`] levels of intervals at random (Owen 1995), exactly.
fn scrambled(x: u64, key: u64) -> u64 {
    let mut flips = 0;
    for level in 0..LEVELS {
        // The bits above this one, with a leading 1 that tells their number.
        let above = if level == 0 {
            1
        } else {
            (x >> (64 - level)) | (1 << level)
        };
        flips |= (mix(key ^ mix(above)) & 1) << (63 - level);
    }
    x ^ flips
}

/// Coordinate of a Sobol point. Dimensions beyond the table take it again with the points in another order.
fn sobol(number: u64, dimension: usize, key: u64) -> f64 {
    let directions = directions();
    let (turn, dimension) = (dimension / directions.len(), dimension % directions.len());
    let number = match turn {
        0 => number,
        // The same points in another order that keeps blocks of 2^k together (B. Burley 2020).
        _ => scrambled(number << (64 - LEVELS), mix(turn as u64)) >> (64 - LEVELS),
    };
    let mut x = 0;
    let mut rest = number;
    while rest != 0 {
        x ^= directions[dimension][rest.trailing_zeros() as usize];
        rest &= rest - 1;
    }
    let inside = mix(key ^ mix(number)) >> LEVELS;
    let kept = (scrambled(x, key) >> (64 - LEVELS)) << (64 - LEVELS);
    unit(kept | inside)
}

/// Degree, coefficients and first direction numbers (S. Joe and F. Y. Kuo, new-joe-kuo-6, 2008); the first dimension is
/// van der Corput's.
const POLYNOMIALS: [(usize, u64, &[u64]); 20] = [
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
    (5, 4, &[1, 1, 5, 5, 5]),
    (5, 7, &[1, 1, 7, 11, 19]),
    (5, 11, &[1, 1, 5, 1, 1]),
    (5, 13, &[1, 1, 1, 3, 11]),
    (5, 14, &[1, 3, 5, 5, 31]),
    (6, 1, &[1, 3, 3, 9, 7, 49]),
    (6, 13, &[1, 1, 1, 15, 21, 21]),
    (6, 16, &[1, 3, 1, 13, 27, 49]),
    (6, 19, &[1, 1, 1, 15, 7, 5]),
    (6, 22, &[1, 3, 1, 15, 13, 25]),
    (6, 25, &[1, 1, 5, 5, 19, 61]),
    (7, 1, &[1, 3, 7, 11, 23, 15, 103]),
    (7, 4, &[1, 3, 7, 13, 13, 15, 69]),
];

fn directions() -> &'static [[u64; 64]] {
    static TABLE: OnceLock<Vec<[u64; 64]>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let mut table = vec![std::array::from_fn(|k| 1 << (63 - k))];
        for (degree, coefficients, first) in POLYNOMIALS {
            let mut v = [0_u64; 64];
            for k in 0..64 {
                v[k] = if k < degree {
                    first[k] << (63 - k)
                } else {
                    let taps = (1..degree)
                        .filter(|j| (coefficients >> (degree - 1 - j)) & 1 == 1)
                        .fold(0, |sum, j| sum ^ v[k - j]);
                    v[k - degree] ^ (v[k - degree] >> degree) ^ taps
                };
            }
            table.push(v);
        }
        table
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coordinates(pattern: Pattern, len: u64, dimensions: usize) -> Vec<Vec<f64>> {
        let points = Points {
            pattern,
            seed: 5,
            len,
        };
        let mut point = vec![0.0; dimensions];
        (0..len)
            .map(|number| {
                points.point(number, 0, &mut point);
                assert!(point.iter().all(|v| (0.0..1.0).contains(v)), "{point:?}");
                point.clone()
            })
            .collect()
    }

    /// The number of intervals of equal length that hold exactly one point.
    fn filled(points: &[Vec<f64>], dimension: usize) -> usize {
        let mut seen = vec![0; points.len()];
        for p in points {
            seen[(p[dimension] * points.len() as f64) as usize] += 1;
        }
        seen.iter().filter(|n| **n == 1).count()
    }

    #[test]
    fn every_interval_has_one_point_unless_points_are_random() {
        for dimension in [0, 1, 7, 20, 21, 45] {
            assert_eq!(
                filled(&coordinates(Pattern::Sobol, 256, 46), dimension),
                256,
                "{dimension}"
            );
            assert_eq!(
                filled(&coordinates(Pattern::Stratified, 1000, 46), dimension),
                1000
            );
        }
        assert!(filled(&coordinates(Pattern::Random, 1000, 1), 0) < 500);
    }

    #[test]
    fn sobol_points_fill_every_box_of_the_first_two_dimensions() {
        let points = coordinates(Pattern::Sobol, 64, 2);
        // All shapes of boxes of 1/64: 64 x 1, 32 x 2, ... 1 x 64.
        for columns in 0..=6 {
            let (w, h) = (1_usize << columns, 64_usize >> columns);
            let mut seen = vec![0; 64];
            for p in &points {
                seen[(p[0] * w as f64) as usize * h + (p[1] * h as f64) as usize] += 1;
            }
            assert!(seen.iter().all(|n| *n == 1), "{w} x {h}: {seen:?}");
        }
    }

    #[test]
    fn sobol_points_integrate_better_than_random_ones() {
        let error = |pattern| {
            let points = coordinates(pattern, 4096, 8);
            let sum: f64 = points
                .iter()
                .map(|p| p.iter().map(|v| 0.5 + v).product::<f64>())
                .sum();
            (sum / 4096.0 - 1.0).abs()
        };
        assert!(error(Pattern::Sobol) < 0.2 * error(Pattern::Random).max(5e-3));
    }

    #[test]
    fn permutations_reach_everything_once() {
        for len in [1, 2, 3, 5, 64, 1000, 1025] {
            let mut seen: Vec<u64> = (0..len).map(|i| permuted(i, len, 77)).collect();
            seen.sort_unstable();
            assert_eq!(seen, (0..len).collect::<Vec<_>>());
        }
        let far = permuted(9_999_999_999, 10_000_000_000, 3);
        assert!(far < 10_000_000_000);
    }
}
