//! Distributions of numbers, by the inverse of their cumulative distribution, so that evenly spread points stay so.

/// How a number is distributed.
#[derive(Clone, Debug, PartialEq)]
pub enum Distribution {
    /// Evenly between two values.
    Uniform {
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
    },
    /// A normal distribution cut off at two values; what is cut off goes to the rest.
    Normal {
        /// Mean before the cut.
        mean: f64,
        /// Standard deviation before the cut, over 0.
        deviation: f64,
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
    },
    /// One of some values.
    Choice {
        /// The values, at least one.
        values: Vec<f64>,
        /// How often each comes.
        weights: Weights,
    },
}

impl Distribution {
    /// The largest value.
    pub(crate) fn largest(&self) -> f64 {
        match self {
            Self::Uniform { high, .. } | Self::Normal { high, .. } => *high,
            Self::Choice { values, .. } => values.iter().copied().fold(f64::MIN, f64::max),
        }
    }

    /// The value below which a share `u` in `[0, 1)` of the distribution lies.
    pub fn at(&self, u: f64) -> f64 {
        match self {
            Self::Uniform { low, high } => low + u * (high - low),
            Self::Normal {
                mean,
                deviation,
                low,
                high,
            } => {
                let z = |v: f64| (v - mean) / deviation;
                // In the upper tail the complement keeps its digits.
                let sign = if z(*low) > 0.0 { -1.0 } else { 1.0 };
                let share = |v: f64| cumulative(sign * z(v));
                let (from, to) = (share(*low), share(*high));
                let z = sign * quantile(from + u * (to - from));
                (mean + deviation * z).clamp(*low, *high)
            }
            Self::Choice { values, weights } => values[weights.at(u)],
        }
    }

    /// Smallest and largest value.
    pub fn range(&self) -> [f64; 2] {
        match self {
            Self::Uniform { low, high } | Self::Normal { low, high, .. } => [*low, *high],
            Self::Choice { values, .. } => values
                .iter()
                .fold([f64::MAX, f64::MIN], |[a, b], v| [a.min(*v), b.max(*v)]),
        }
    }
}

/// Shares of several things, not all 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Sums of the weights up to each thing, over the sum of all.
    cumulative: Vec<f64>,
}

impl Weights {
    /// From weights of at least 0; `None` if all are 0, or one is negative or not finite.
    pub fn new(weights: &[f64]) -> Option<Self> {
        let mut sum = 0.0;
        let sums: Vec<f64> = weights
            .iter()
            .map(|w| {
                sum += w;
                sum
            })
            .collect();
        let is_good = sum > 0.0 && sum.is_finite() && weights.iter().all(|w| *w >= 0.0);
        is_good.then(|| Self {
            cumulative: sums.iter().map(|s| s / sum).collect(),
        })
    }

    /// Equal weights of `n` things.
    pub fn equal(n: usize) -> Self {
        let cumulative = (1..=n.max(1)).map(|k| k as f64 / n.max(1) as f64).collect();
        Self { cumulative }
    }

    /// The thing below which a share `u` in `[0, 1)` of all lies.
    pub fn at(&self, u: f64) -> usize {
        let last = self.cumulative.len() - 1;
        self.cumulative.partition_point(|s| *s <= u).min(last)
    }

    /// The share of thing `i`.
    pub fn share(&self, i: usize) -> f64 {
        self.cumulative[i] - if i == 0 { 0.0 } else { self.cumulative[i - 1] }
    }
}

/// Standard normal cumulative distribution.
fn cumulative(z: f64) -> f64 {
    0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
}

/// Its inverse: P. J. Acklam's rational approximation (1e-9) and one step of Halley's method, then 1e-14 in the middle.
fn quantile(p: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969_683_028_665_376e1,
        2.209_460_984_245_205e2,
        -2.759_285_104_469_687e2,
        1.383_577_518_672_69e2,
        -3.066_479_806_614_716e1,
        2.506_628_277_459_239,
    ];
    const B: [f64; 6] = [
        -5.447_609_879_822_406e1,
        1.615_858_368_580_409e2,
        -1.556_989_798_598_866e2,
        6.680_131_188_771_972e1,
        -1.328_068_155_288_572e1,
        1.0,
    ];
    const C: [f64; 6] = [
        -7.784_894_002_430_293e-3,
        -3.223_964_580_411_365e-1,
        -2.400_758_277_161_838,
        -2.549_732_539_343_734,
        4.374_664_141_464_968,
        2.938_163_982_698_783,
    ];
    const D: [f64; 5] = [
        7.784_695_709_041_462e-3,
        3.224_671_290_700_398e-1,
        2.445_134_137_142_996,
        3.754_408_661_907_416,
        1.0,
    ];
    const TAIL: f64 = 0.024_25;
    let polynomial = |c: &[f64], x: f64| c.iter().fold(0.0, |sum, c| sum * x + c);
    let p = p.clamp(1e-300, 1.0 - f64::EPSILON / 2.0);
    let tail = |p: f64| {
        let q = libm::sqrt(-2.0 * libm::log(p));
        polynomial(&C, q) / polynomial(&D, q)
    };
    let z = if p < TAIL {
        tail(p)
    } else if p > 1.0 - TAIL {
        -tail(1.0 - p)
    } else {
        let q = p - 0.5;
        q * polynomial(&A, q * q) / polynomial(&B, q * q)
    };
    let error = (cumulative(z) - p) * libm::sqrt(std::f64::consts::TAU) * libm::exp(0.5 * z * z);
    if error.is_finite() {
        z - error / (1.0 + 0.5 * z * error)
    } else {
        z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quantile_inverts_the_cumulative_distribution() {
        for p in [1e-12, 1e-6, 0.01, 0.3, 0.5, 0.8, 0.999, 1.0 - 1e-9] {
            let back = cumulative(quantile(p));
            assert!((back - p).abs() < 1e-12 * p.max(1e-3), "{p}: {back}");
        }
        assert!((quantile(0.975) - 1.959_963_984_540_054).abs() < 1e-13);
    }

    #[test]
    fn moments_of_cut_normals_are_right() {
        let n = 20_000;
        let mean_of = |d: &Distribution| {
            (0..n)
                .map(|i| d.at((f64::from(i) + 0.5) / f64::from(n)))
                .sum::<f64>()
                / f64::from(n)
        };
        let normal = |low, high| Distribution::Normal {
            mean: 2.0,
            deviation: 3.0,
            low,
            high,
        };
        assert!((mean_of(&normal(-30.0, 34.0)) - 2.0).abs() < 1e-3);
        // Half a normal: mean + deviation sqrt(2 / pi).
        assert!((mean_of(&normal(2.0, 60.0)) - 2.0 - 3.0 * 0.797_884_56).abs() < 1e-3);
        // Far out in the tail values crowd at the near end.
        let far = normal(32.0, 34.0);
        assert!((32.0..32.5).contains(&mean_of(&far)), "{}", mean_of(&far));
        assert!(far.at(0.0) >= 32.0 && far.at(1.0 - 1e-16) <= 34.0);
    }

    #[test]
    fn choices_come_as_often_as_they_weigh() {
        let weights = Weights::new(&[1.0, 0.0, 3.0]).expect("good");
        let counts = (0..400).fold([0; 3], |mut counts, i| {
            counts[weights.at((f64::from(i) + 0.5) / 400.0)] += 1;
            counts
        });
        assert_eq!(counts, [100, 0, 300]);
        assert!(Weights::new(&[0.0, 0.0]).is_none() && Weights::new(&[1.0, -1.0]).is_none());
        assert_eq!(Weights::equal(4).at(0.999), 3);
    }
}
