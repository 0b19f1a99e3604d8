//! Symmetric positive definite sparse systems: one symbolic analysis, many numeric factors (faer).
//!
//! Everything runs sequentially: faer's parallel factors differ in their last bits.

use std::fmt;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side, Spec};

use crate::SimError;

/// The lower triangle of a symmetric matrix, by columns, and its elimination order.
#[derive(Debug)]
pub(crate) struct Pattern {
    starts: Vec<u32>,
    rows: Vec<u32>,
    symbolic: SymbolicCholesky<u32>,
}

impl Pattern {
    /// The pattern of an `n` x `n` matrix with these entries besides its diagonal; order and side do not matter.
    pub(crate) fn new(
        n: usize,
        what: &'static str,
        pairs: impl Iterator<Item = (u32, u32)>,
    ) -> Result<Self, SimError> {
        let mut entries: Vec<(u32, u32)> = pairs
            .map(|(a, b)| (a.min(b), a.max(b)))
            .chain((0..n as u32).map(|i| (i, i)))
            .collect();
        entries.sort_unstable();
        entries.dedup();
        let mut starts = vec![0; n + 1];
        for &(column, _) in &entries {
            starts[column as usize + 1] += 1;
        }
        for k in 0..n {
            starts[k + 1] += starts[k];
        }
        let rows: Vec<u32> = entries.iter().map(|e| e.1).collect();
        let structure = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
        let symbolic = factorize_symbolic_cholesky(
            structure,
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        )
        .map_err(|_| SimError::Singular { what, row: 0 })?;
        Ok(Self {
            starts,
            rows,
            symbolic,
        })
    }

    /// Number of rows.
    pub(crate) fn size(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of stored entries.
    pub(crate) fn entries(&self) -> usize {
        self.rows.len()
    }

    /// Where the entry of two rows is stored.
    ///
    /// # Panics
    /// If the pattern has no such entry.
    pub(crate) fn slot(&self, a: u32, b: u32) -> u32 {
        let (column, row) = (a.min(b) as usize, a.max(b));
        let start = self.starts[column] as usize;
        let rows = &self.rows[start..self.starts[column + 1] as usize];
        let place = rows.binary_search(&row).expect("an entry of the pattern");
        (start + place) as u32
    }
}

/// A numeric factor with its work space.
pub(crate) struct Factor {
    values: Vec<f64>,
    memory: MemBuffer,
    columns: usize,
}

impl fmt::Debug for Factor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.values.len();
        f.debug_struct("Factor")
            .field("size", &size)
            .finish_non_exhaustive()
    }
}

impl Factor {
    /// Work space for a pattern and for right-hand sides of up to `columns` columns.
    pub(crate) fn new(pattern: &Pattern, columns: usize) -> Self {
        let symbolic = &pattern.symbolic;
        let need = symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default())
            .or(symbolic.solve_in_place_scratch::<f64>(columns, Par::Seq));
        Self {
            values: vec![0.0; symbolic.len_val()],
            memory: MemBuffer::new(need),
            columns,
        }
    }

    /// Factors the matrix with these entries, one per slot of the pattern.
    pub(crate) fn refactor(
        &mut self,
        pattern: &Pattern,
        what: &'static str,
        entries: &[f64],
    ) -> Result<(), SimError> {
        let n = pattern.size();
        let structure =
            SymbolicSparseColMatRef::new_checked(n, n, &pattern.starts, None, &pattern.rows);
        pattern
            .symbolic
            .factorize_numeric_llt(
                &mut self.values,
                SparseColMatRef::new(structure, entries),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Spec::default(),
            )
            .map(|_| ())
            .map_err(|LltError::NonPositivePivot { index }| SimError::Singular { what, row: index })
    }

    /// Replaces `columns` right-hand sides, one after the other, by the solutions.
    pub(crate) fn solve(&mut self, pattern: &Pattern, sides: &mut [f64]) {
        let n = pattern.size();
        if n == 0 {
            return;
        }
        assert_eq!(sides.len(), n * self.columns, "right-hand sides");
        LltRef::<'_, u32, f64>::new(&pattern.symbolic, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(sides, n, self.columns),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_of_springs_is_solved_exactly() {
        // Unit springs between 5 nodes, the first one held by a unit spring: K x = load at the end gives 1, 2, .. 5.
        let pattern = Pattern::new(5, "chain", (0..4).map(|i| (i + 1, i))).expect("small");
        let mut entries = vec![0.0; pattern.entries()];
        for i in 0..5 {
            entries[pattern.slot(i, i) as usize] = if i == 4 { 1.0 } else { 2.0 };
            if i > 0 {
                entries[pattern.slot(i, i - 1) as usize] = -1.0;
            }
        }
        let mut factor = Factor::new(&pattern, 1);
        factor
            .refactor(&pattern, "chain", &entries)
            .expect("positive");
        let mut x = [0.0, 0.0, 0.0, 0.0, 1.0];
        factor.solve(&pattern, &mut x);
        for (i, v) in x.iter().enumerate() {
            assert!((v - (i + 1) as f64).abs() < 1e-12);
        }
        entries.fill(0.0);
        assert!(factor.refactor(&pattern, "chain", &entries).is_err());
    }
}
