//! Gaussian smoothing of planes, with and without holes.

use facile_core::Plane;

/// Values of one cell that can be averaged.
pub(crate) trait Blend: Copy {
    /// Nothing.
    const ZERO: Self;

    /// `self + other * weight`.
    fn add_scaled(self, other: Self, weight: f32) -> Self;
}

impl Blend for f32 {
    const ZERO: Self = 0.0;

    fn add_scaled(self, other: Self, weight: f32) -> Self {
        self + other * weight
    }
}

impl<const N: usize> Blend for [f32; N] {
    const ZERO: Self = [0.0; N];

    fn add_scaled(mut self, other: Self, weight: f32) -> Self {
        for (s, o) in self.iter_mut().zip(&other) {
            *s += o * weight;
        }
        self
    }
}

/// One side of a Gaussian kernel of standard deviation `sigma` cells, centre first, cut at `2.5 sigma`, summing to 1
/// over both sides.
fn kernel(sigma: f64) -> Vec<f32> {
    let reach = (2.5 * sigma).ceil().max(0.0) as usize;
    let raw: Vec<f64> = (0..=reach)
        .map(|k| libm::exp(-((k * k) as f64) / (2.0 * sigma * sigma).max(1e-12)))
        .collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|w| (w / sum) as f32).collect()
}

/// Convolves every cell with a Gaussian; cells beyond the border count as nothing, so values fade there.
pub(crate) fn blur<T: Blend>(plane: &Plane<T>, sigma: f64) -> Plane<T> {
    let kernel = kernel(sigma);
    let (nx, ny) = (plane.width(), plane.height());
    let mut across = Plane::filled(nx, ny, T::ZERO);
    for y in 0..ny {
        let (row, out) = (plane.row(y), across.row_mut(y));
        for x in 0..nx {
            let mut sum = T::ZERO.add_scaled(row[x], kernel[0]);
            for (k, &w) in kernel.iter().enumerate().skip(1) {
                if x >= k {
                    sum = sum.add_scaled(row[x - k], w);
                }
                if x + k < nx {
                    sum = sum.add_scaled(row[x + k], w);
                }
            }
            out[x] = sum;
        }
    }
    let mut out = Plane::filled(nx, ny, T::ZERO);
    for y in 0..ny {
        let target = out.row_mut(y);
        for (k, &w) in kernel.iter().enumerate() {
            let mut add = |row: &[T]| {
                for (t, v) in target.iter_mut().zip(row) {
                    *t = t.add_scaled(*v, w);
                }
            };
            if y >= k {
                add(across.row(y - k));
            }
            if k > 0 && y + k < ny {
                add(across.row(y + k));
            }
        }
    }
    out
}

/// Gaussian mean of the cells that `mask` (weights in `[0, 1]`) lets through; where it lets nothing through nearby,
/// nothing.
pub(crate) fn masked_blur<T: Blend>(plane: &Plane<T>, mask: &Plane<f32>, sigma: f64) -> Plane<T> {
    let (nx, ny) = (plane.width(), plane.height());
    let weighted = Plane::from_fn(nx, ny, |x, y| {
        T::ZERO.add_scaled(plane[(x, y)], mask[(x, y)])
    });
    let (sum, weight) = (blur(&weighted, sigma), blur(mask, sigma));
    Plane::from_fn(nx, ny, |x, y| {
        let w = weight[(x, y)];
        if w > 1e-4 {
            T::ZERO.add_scaled(sum[(x, y)], 1.0 / w)
        } else {
            T::ZERO
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_impulse_keeps_its_sum_and_gets_the_variance() {
        let mut plane = Plane::filled(41, 41, 0.0_f32);
        plane[(20, 20)] = 1.0;
        let smooth = blur(&plane, 2.0);
        let sum: f32 = smooth.as_slice().iter().sum();
        assert!((sum - 1.0).abs() < 1e-5);
        let mut variance = 0.0;
        for y in 0..41 {
            for x in 0..41 {
                variance += smooth[(x, y)] * (x as f32 - 20.0).powi(2);
            }
        }
        assert!((variance - 4.0).abs() < 0.6, "{variance}");
    }

    #[test]
    fn a_constant_stays_constant_around_holes() {
        let plane = Plane::from_fn(30, 20, |x, _| if x < 10 { 99.0 } else { 3.0 });
        let mask = Plane::from_fn(30, 20, |x, _| if x < 10 { 0.0 } else { 1.0_f32 });
        let smooth = masked_blur(&plane, &mask, 1.5);
        assert!((smooth[(11, 5)] - 3.0).abs() < 1e-5);
    }
}
