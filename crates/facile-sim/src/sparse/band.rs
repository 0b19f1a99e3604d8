//! Cholesky factor of a symmetric positive definite matrix whose entries are near its diagonal, by rows, in `f64`.

use crate::SimError;
use crate::simd::{Kernel, dispatch, inner};

/// The lower triangle: each row holds its last columns up to the diagonal.
#[derive(Clone, Debug)]
pub(crate) struct BandMatrix {
    size: usize,
    /// Columns before the diagonal.
    reach: usize,
    values: Vec<f64>,
}

impl BandMatrix {
    /// Zeros. `reach`: largest distance of an entry from the diagonal.
    pub(crate) fn new(size: usize, reach: usize) -> Self {
        Self {
            size,
            reach,
            values: vec![0.0; size * (reach + 1)],
        }
    }

    /// Adds to the entry of two rows, in either order.
    pub(crate) fn add(&mut self, a: usize, b: usize, value: f64) {
        let (row, column) = (a.max(b), a.min(b));
        self.values[row * (self.reach + 1) + self.reach + column - row] += value;
    }

    /// Solves the system; the matrix becomes its factor. Cost: `size * reach^2 / 2`.
    ///
    /// # Errors
    /// [`SimError::Singular`] with the row of a pivot that is not positive.
    pub(crate) fn solve(&mut self, what: &'static str, right: &mut [f64]) -> Result<(), SimError> {
        dispatch(Solve {
            matrix: self,
            right,
        })
        .map_err(|row| SimError::Singular { what, row })
    }

    /// First column of a row.
    #[inline(always)]
    fn first(&self, row: usize) -> usize {
        row.saturating_sub(self.reach)
    }

    /// Columns `from..to` of a row.
    #[inline(always)]
    fn span(&self, row: usize, from: usize, to: usize) -> &[f64] {
        let start = row * (self.reach + 1) + self.reach - row;
        &self.values[start + from..start + to]
    }
}

struct Solve<'a> {
    matrix: &'a mut BandMatrix,
    right: &'a mut [f64],
}

impl Kernel for Solve<'_> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn run(self) -> Result<(), usize> {
        let Self { matrix, right } = self;
        // The diagonal of the factor is stored as one over its root.
        for i in 0..matrix.size {
            let first = matrix.first(i);
            let at = i * (matrix.reach + 1) + matrix.reach - i;
            for j in first..i {
                let sum = inner(matrix.span(i, first, j), matrix.span(j, first, j));
                let scale = matrix.span(j, j, j + 1)[0];
                matrix.values[at + j] = (matrix.values[at + j] - sum) * scale;
            }
            let done = matrix.span(i, first, i);
            let pivot = matrix.values[at + i] - inner(done, done);
            if !(pivot > 0.0 && pivot.is_finite()) {
                return Err(i);
            }
            right[i] -= inner(done, &right[first..i]);
            let scale = 1.0 / pivot.sqrt();
            right[i] *= scale;
            matrix.values[at + i] = scale;
        }
        for i in (0..matrix.size).rev() {
            let first = matrix.first(i);
            let row = matrix.span(i, first, i + 1);
            let (scale, row) = row.split_last().expect("the diagonal");
            let (before, rest) = right.split_at_mut(i);
            rest[0] *= scale;
            for (r, v) in before[first..].iter_mut().zip(row) {
                *r -= v * rest[0];
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stiff_beam_is_solved_exactly_and_a_loose_one_is_refused() {
        let n = 40;
        let truth: Vec<f64> = (0..n).map(|i| libm::sin(i as f64)).collect();
        let mut matrix = BandMatrix::new(n, 3);
        let mut right = vec![0.0; n];
        // Bending over neighbours two apart, a weak spring to the ground.
        for i in 0..n {
            matrix.add(i, i, 0.01);
            right[i] += 0.01 * truth[i];
            if i + 2 < n {
                let bend = [1.0, -2.0, 1.0];
                for (a, p) in bend.iter().enumerate() {
                    for (b, q) in bend.iter().enumerate() {
                        if b >= a {
                            matrix.add(i + b, i + a, p * q);
                        }
                        right[i + a] += p * q * truth[i + b];
                    }
                }
            }
        }
        matrix.solve("beam", &mut right).expect("positive");
        for (r, t) in right.iter().zip(&truth) {
            assert!((r - t).abs() < 1e-9);
        }
        assert!(
            BandMatrix::new(2, 1)
                .solve("nothing", &mut [1.0, 1.0])
                .is_err()
        );
    }
}
