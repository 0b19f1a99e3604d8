//! Gaussian smoothing of planes, with and without holes.

use facile_core::Plane;

/// Values of one cell that can be averaged.
pub(crate) trait Blend: Copy {
    /// Numbers in one cell.
    const LEN: usize;

    /// Nothing.
    const ZERO: Self;

    /// All numbers of a row of cells.
    fn flat(row: &[Self]) -> &[f32];

    /// As [`Self::flat`], to write.
    fn flat_mut(row: &mut [Self]) -> &mut [f32];

    /// Every number times `weight`.
    fn scaled(self, weight: f32) -> Self;
}

impl Blend for f32 {
    const LEN: usize = 1;
    const ZERO: Self = 0.0;

    fn flat(row: &[Self]) -> &[f32] {
        row
    }

    fn flat_mut(row: &mut [Self]) -> &mut [f32] {
        row
    }

    fn scaled(self, weight: f32) -> Self {
        self * weight
    }
}

impl<const N: usize> Blend for [f32; N] {
    const LEN: usize = N;
    const ZERO: Self = [0.0; N];

    fn flat(row: &[Self]) -> &[f32] {
        row.as_flattened()
    }

    fn flat_mut(row: &mut [Self]) -> &mut [f32] {
        row.as_flattened_mut()
    }

    fn scaled(self, weight: f32) -> Self {
        self.map(|v| v * weight)
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
///
/// Whole rows are added to whole rows, shifted by a tap: plain loops over numbers, which the compiler turns to vectors.
pub(crate) fn blur<T: Blend>(plane: &Plane<T>, sigma: f64) -> Plane<T> {
    let kernel = kernel(sigma);
    let (nx, ny) = (plane.width(), plane.height());
    let mut across = Plane::filled(nx, ny, T::ZERO);
    for y in 0..ny {
        let (row, out) = (T::flat(plane.row(y)), T::flat_mut(across.row_mut(y)));
        add_scaled(out, row, kernel[0]);
        for (k, &w) in kernel.iter().enumerate().take(nx).skip(1) {
            let shift = k * T::LEN;
            add_scaled(&mut out[shift..], row, w);
            add_scaled(out, &row[shift..], w);
        }
    }
    let mut out = Plane::filled(nx, ny, T::ZERO);
    for y in 0..ny {
        let target = T::flat_mut(out.row_mut(y));
        for (k, &w) in kernel.iter().enumerate() {
            if y >= k {
                add_scaled(target, T::flat(across.row(y - k)), w);
            }
            if k > 0 && y + k < ny {
                add_scaled(target, T::flat(across.row(y + k)), w);
            }
        }
    }
    out
}

/// `target += row * weight`, as far as both reach.
fn add_scaled(target: &mut [f32], row: &[f32], weight: f32) {
    for (t, v) in target.iter_mut().zip(row) {
        *t += v * weight;
    }
}

/// Gaussian mean of the cells that `mask` (weights in `[0, 1]`) lets through; where it lets nothing through nearby,
/// nothing.
pub(crate) fn masked_blur<T: Blend>(plane: &Plane<T>, mask: &Plane<f32>, sigma: f64) -> Plane<T> {
    let mut weighted = plane.clone();
    for (cell, w) in weighted.as_mut_slice().iter_mut().zip(mask.as_slice()) {
        *cell = cell.scaled(*w);
    }
    let (mut sum, weight) = (blur(&weighted, sigma), blur(mask, sigma));
    for (cell, w) in sum.as_mut_slice().iter_mut().zip(weight.as_slice()) {
        *cell = if *w > 1e-4 {
            cell.scaled(1.0 / w)
        } else {
            T::ZERO
        };
    }
    sum
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
