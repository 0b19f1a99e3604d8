//! Arithmetic on lanes for the kernels that [`facile_core::simd`] runs with the widest registers of a processor.
//!
//! Lanes are small arrays, which the compiler turns into registers of whatever width is allowed.

pub(crate) use facile_core::simd::{Kernel, dispatch};

/// Lanes of a kernel.
pub(crate) const LANES: usize = 4;
/// One number per lane.
pub(crate) type Lanes = [f64; LANES];

/// `f` on each lane.
#[inline(always)]
pub(crate) fn lanes(f: impl Fn(usize) -> f64) -> Lanes {
    let mut out = [0.0; LANES];
    for (l, value) in out.iter_mut().enumerate() {
        *value = f(l);
    }
    out
}

/// Sum over lanes, in a fixed order.
#[inline(always)]
pub(crate) fn total(a: Lanes) -> f64 {
    (a[0] + a[1]) + (a[2] + a[3])
}

/// Inner product of two slices of the same length, in a fixed order.
#[inline(always)]
pub(crate) fn inner(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [[0.0; LANES]; 4];
    let (blocks_a, rest_a) = a.as_chunks::<16>();
    let (blocks_b, rest_b) = b.as_chunks::<16>();
    for (p, q) in blocks_a.iter().zip(blocks_b) {
        for (s, sum) in sums.iter_mut().enumerate() {
            for (l, lane) in sum.iter_mut().enumerate() {
                *lane += p[LANES * s + l] * q[LANES * s + l];
            }
        }
    }
    let rest: f64 = rest_a.iter().zip(rest_b).map(|(p, q)| p * q).sum();
    (total(sums[0]) + total(sums[1])) + (total(sums[2]) + total(sums[3])) + rest
}

/// `a += s b`.
#[inline(always)]
pub(crate) fn add_to(a: &mut [f64], b: &[f64], s: f64) {
    for (p, q) in a.iter_mut().zip(b) {
        *p += s * q;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Inner<'a>(&'a [f64], &'a [f64]);

    impl Kernel for Inner<'_> {
        type Output = f64;
        #[inline(always)]
        fn run(self) -> f64 {
            inner(self.0, self.1)
        }
    }

    #[test]
    fn an_inner_product_has_the_same_bits_with_and_without_avx2() {
        let a: Vec<f64> = (0..1003).map(|i| libm::sin(f64::from(i))).collect();
        let b: Vec<f64> = (0..1003).map(|i| libm::cos(f64::from(3 * i))).collect();
        let wide = dispatch(Inner(&a, &b));
        assert_eq!(wide.to_bits(), Inner(&a, &b).run().to_bits());
        let plain: f64 = a.iter().zip(&b).map(|(p, q)| p * q).sum();
        assert!((wide - plain).abs() < 1e-10);
    }
}
