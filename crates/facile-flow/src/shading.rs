//! Light that is baked into a scan's colours, as a function of the normal.
//!
//! Under distant lights the shading of a matt surface is almost a quadratic of its normal. It is fitted to the ratio of
//! the scan's brightness to the mean face's, whose own albedo is known. Source: Ramamoorthi and Hanrahan, An efficient
//! representation for irradiance environment maps, 2001 (nine terms, 1 % of the energy left out).

use facile_core::Vector3;
use nalgebra::{SMatrix, SVector};

/// Terms of a quadratic of the normal.
const TERMS: usize = 9;

/// Logarithm of the shading, by normal; its mean over the fitted places is 0.
pub(crate) struct Shading {
    coefficients: SVector<f64, TERMS>,
    mean: f64,
}

fn terms(n: &Vector3) -> SVector<f64, TERMS> {
    SVector::from([
        1.0,
        n.x,
        n.y,
        n.z,
        n.x * n.y,
        n.y * n.z,
        n.z * n.x,
        n.x * n.x - n.y * n.y,
        3.0 * n.z * n.z - 1.0,
    ])
}

impl Shading {
    /// Fits to `(unit normal, logarithm of brightness against the mean face, weight)`. `None` for too little to fit.
    pub(crate) fn fit(samples: &[(Vector3, f64, f64)]) -> Option<Self> {
        let total: f64 = samples.iter().map(|s| s.2).sum();
        if total <= 0.0 {
            return None;
        }
        // A weak pull to no shading keeps directions that nothing looks at from running away.
        let mut matrix = SMatrix::<f64, TERMS, TERMS>::identity() * (1e-3 * total);
        let mut right = SVector::<f64, TERMS>::zeros();
        let mut sum = SVector::<f64, TERMS>::zeros();
        for (normal, value, weight) in samples {
            let row = terms(normal);
            matrix += row * row.transpose() * *weight;
            right += row * (value * weight);
            sum += row * *weight;
        }
        let coefficients = matrix.cholesky()?.solve(&right);
        Some(Self {
            coefficients,
            mean: coefficients.dot(&sum) / total,
        })
    }

    /// Factor that takes the shading out of linear light at a unit normal.
    pub(crate) fn inverse(&self, normal: &Vector3) -> f64 {
        libm::exp((self.mean - self.coefficients.dot(&terms(normal))).clamp(-1.5, 1.5))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_light_from_the_side_is_divided_out() {
        let light = Vector3::new(0.8, 0.3, 0.52).normalize();
        let shade = |n: &Vector3| 0.3 + 0.7 * n.dot(&light).max(0.0);
        let mut samples = Vec::new();
        for i in 0..40 {
            for j in 0..20 {
                let (a, b) = (f64::from(i) * 0.07 - 1.4, f64::from(j) * 0.1 - 1.0);
                let n = Vector3::new(
                    libm::sin(a) * libm::cos(b),
                    libm::sin(b),
                    libm::cos(a) * libm::cos(b),
                );
                samples.push((n, libm::log(shade(&n)), libm::cos(b)));
            }
        }
        let shading = Shading::fit(&samples).expect("enough");
        let even: Vec<f64> = samples
            .iter()
            .map(|(n, ..)| shade(n) * shading.inverse(n))
            .collect();
        let spread = |v: &[f64]| {
            let high = v.iter().copied().fold(0.0, f64::max);
            high / v.iter().copied().fold(f64::INFINITY, f64::min)
        };
        let raw: Vec<f64> = samples.iter().map(|(n, ..)| shade(n)).collect();
        assert!(
            spread(&raw) > 3.0 && spread(&even) < 1.6,
            "{}",
            spread(&even)
        );
    }
}
