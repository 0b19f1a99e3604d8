//! Symmetric positive definite sparse systems: one symbolic analysis (faer), many numeric factors.
//!
//! The elimination order and the supernodes are faer's. The numbers are computed here, by a left-looking supernodal
//! Cholesky factorisation, because faer's kernels use fused operations where the processor has them and so give other
//! bits on other machines. Every lane is a system of its own: four matrices of one pattern are factored and solved in the
//! time of one. Source: Chen et al., Algorithm 887: CHOLMOD, 2008.

use faer::Side;
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholeskyRaw, SymmetricOrdering, factorize_symbolic_cholesky,
};

use crate::SimError;
use crate::simd::{Kernel, LANES, Lanes, dispatch, lanes};

/// The lower triangle of a symmetric matrix, by columns, and the structure of its factor.
#[derive(Debug)]
pub(crate) struct Pattern {
    starts: Vec<u32>,
    rows: Vec<u32>,
    /// Row of the factor of each row.
    order: Vec<u32>,
    supernodes: Vec<Supernode>,
    /// Rows of the factor below the supernodes' diagonal blocks.
    below: Vec<u32>,
    /// For each supernode, which earlier ones change it.
    updates: Vec<Update>,
    /// Where each entry of the matrix is added in the factor's values.
    places: Vec<u32>,
    values: usize,
    /// Most rows of a supernode.
    tallest: usize,
}

/// Columns of the factor with the same rows, stored as one dense block by columns: first the rows of its own columns,
/// then those below.
#[derive(Clone, Copy, Debug)]
struct Supernode {
    start: u32,
    width: u32,
    below: (u32, u32),
    values: u32,
    updates: (u32, u32),
}

impl Supernode {
    fn height(&self) -> usize {
        (self.width + self.below.1 - self.below.0) as usize
    }
}

/// Rows `from..to` below the diagonal block of supernode `source` are columns of the supernode that is changed.
#[derive(Clone, Copy, Debug)]
struct Update {
    source: u32,
    from: u32,
    to: u32,
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
        let mut pattern = Self {
            starts,
            rows,
            order: Vec::new(),
            supernodes: Vec::new(),
            below: Vec::new(),
            updates: Vec::new(),
            places: Vec::new(),
            values: 0,
            tallest: 0,
        };
        if n > 0 {
            pattern.analyse(what)?;
            pattern.place(&entries);
        }
        Ok(pattern)
    }

    fn analyse(&mut self, what: &'static str) -> Result<(), SimError> {
        let n = self.size();
        let structure = SymbolicSparseColMatRef::new_checked(n, n, &self.starts, None, &self.rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..CholeskySymbolicParams::default()
        };
        let symbolic =
            factorize_symbolic_cholesky(structure, Side::Lower, SymmetricOrdering::Amd, params)
                .map_err(|_| SimError::Singular { what, row: 0 })?;
        let SymbolicCholeskyRaw::Supernodal(blocks) = symbolic.raw() else {
            return Err(SimError::Singular { what, row: 0 });
        };
        self.order = match symbolic.perm() {
            Some(order) => order.arrays().1.to_vec(),
            None => (0..n as u32).collect(),
        };
        for s in 0..blocks.n_supernodes() {
            let below = self.below.len() as u32;
            let (start, end) = (blocks.supernode_begin()[s], blocks.supernode_end()[s]);
            self.below.extend(blocks.supernode(s).pattern());
            let supernode = Supernode {
                start,
                width: end - start,
                below: (below, self.below.len() as u32),
                values: self.values as u32,
                updates: (0, 0),
            };
            self.values += supernode.height() * supernode.width as usize;
            self.tallest = self.tallest.max(supernode.height());
            self.supernodes.push(supernode);
        }
        self.link();
        Ok(())
    }

    /// Finds for each supernode the earlier ones that change it.
    fn link(&mut self) {
        let mut owner = vec![0u32; self.size()];
        for (s, block) in self.supernodes.iter().enumerate() {
            owner[block.start as usize..(block.start + block.width) as usize].fill(s as u32);
        }
        let mut changed_by = vec![Vec::new(); self.supernodes.len()];
        for (source, block) in self.supernodes.iter().enumerate() {
            let rows = &self.below[block.below.0 as usize..block.below.1 as usize];
            let mut from = 0;
            while from < rows.len() {
                let target = owner[rows[from] as usize];
                let to = from
                    + rows[from..]
                        .iter()
                        .take_while(|r| owner[**r as usize] == target)
                        .count();
                changed_by[target as usize].push(Update {
                    source: source as u32,
                    from: from as u32,
                    to: to as u32,
                });
                from = to;
            }
        }
        for (block, updates) in self.supernodes.iter_mut().zip(changed_by) {
            let first = self.updates.len() as u32;
            self.updates.extend(updates);
            block.updates = (first, self.updates.len() as u32);
        }
    }

    fn place(&mut self, entries: &[(u32, u32)]) {
        let n = self.size();
        let mut owner = vec![0usize; n];
        for (s, block) in self.supernodes.iter().enumerate() {
            owner[block.start as usize..(block.start + block.width) as usize].fill(s);
        }
        self.places = entries
            .iter()
            .map(|&(a, b)| {
                let (p, q) = (self.order[a as usize], self.order[b as usize]);
                let (column, row) = (p.min(q), p.max(q));
                let block = &self.supernodes[owner[column as usize]];
                let local = if row < block.start + block.width {
                    row - block.start
                } else {
                    let rows = &self.below[block.below.0 as usize..block.below.1 as usize];
                    let at = rows.binary_search(&row).expect("a row of the factor");
                    block.width + at as u32
                };
                block.values + (column - block.start) * block.height() as u32 + local
            })
            .collect();
    }

    /// Row of the factor of each row of the matrix.
    pub(crate) fn order(&self) -> &[u32] {
        &self.order
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

/// Numbers of a factor as they are kept for solving.
pub(crate) trait Stored: Copy + Default {
    /// Rounds.
    fn store(value: Lanes) -> Self;
    /// Widens.
    fn load(self) -> Lanes;
}

impl Stored for Lanes {
    #[inline(always)]
    fn store(value: Lanes) -> Self {
        value
    }
    #[inline(always)]
    fn load(self) -> Lanes {
        self
    }
}

impl Stored for [f32; LANES] {
    #[inline(always)]
    fn store(v: Lanes) -> Self {
        [v[0] as f32, v[1] as f32, v[2] as f32, v[3] as f32]
    }
    #[inline(always)]
    fn load(self) -> Lanes {
        lanes(|l| f64::from(self[l]))
    }
}

/// Numeric factors of four matrices. `[f32; 4]` halves the memory that a solve reads, where an approximate inverse will
/// do; the factors themselves are always computed in `f64`.
#[derive(Debug)]
pub(crate) struct Factor<T> {
    values: Vec<Lanes>,
    /// The same by rows, inverse diagonal, in the order in which a solve reads them.
    packed: Vec<T>,
    column: Vec<Lanes>,
    local: Vec<u32>,
}

impl<T: Stored> Factor<T> {
    /// Work space for a pattern.
    pub(crate) fn new(pattern: &Pattern) -> Self {
        Self {
            values: vec![[0.0; LANES]; pattern.values],
            packed: vec![T::default(); pattern.values],
            column: vec![[0.0; LANES]; pattern.tallest],
            local: vec![0; pattern.size()],
        }
    }

    /// Factors the matrices with these entries, one per slot of the pattern.
    pub(crate) fn refactor(
        &mut self,
        pattern: &Pattern,
        what: &'static str,
        entries: &[Lanes],
    ) -> Result<(), SimError> {
        self.values.fill([0.0; LANES]);
        for (&place, value) in pattern.places.iter().zip(entries) {
            self.values[place as usize] = *value;
        }
        dispatch(Numeric {
            pattern,
            factor: self,
        })
        .map_err(|row| SimError::Singular { what, row })
    }

    /// Factors one matrix, the same in every lane.
    pub(crate) fn refactor_one(
        &mut self,
        pattern: &Pattern,
        what: &'static str,
        entries: &[f64],
    ) -> Result<(), SimError> {
        let entries: Vec<Lanes> = entries.iter().map(|&e| [e; LANES]).collect();
        self.refactor(pattern, what, &entries)
    }

    /// Replaces right-hand sides by the solutions: `sides[i]` holds row `i` of the systems of the first three lanes.
    pub(crate) fn solve(&self, pattern: &Pattern, sides: &mut [[f64; 3]]) {
        assert_eq!(sides.len(), pattern.size(), "right-hand sides");
        let mut ordered = vec![[0.0; LANES]; pattern.size()];
        for (&row, s) in pattern.order.iter().zip(&*sides) {
            ordered[row as usize] = [s[0], s[1], s[2], 0.0];
        }
        self.solve_ordered(pattern, &mut ordered);
        for (&row, s) in pattern.order.iter().zip(sides) {
            let [x, y, z, _] = ordered[row as usize];
            *s = [x, y, z];
        }
    }

    /// The same for right-hand sides in the factor's order, see [`Pattern::order`], one per lane.
    pub(crate) fn solve_ordered(&self, pattern: &Pattern, sides: &mut [Lanes]) {
        dispatch(Solve {
            pattern,
            packed: &self.packed,
            y: sides,
        });
    }
}

/// The factorisation; on failure the row of the bad pivot.
struct Numeric<'a, T> {
    pattern: &'a Pattern,
    factor: &'a mut Factor<T>,
}

impl<T: Stored> Kernel for Numeric<'_, T> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn run(self) -> Result<(), usize> {
        let (pattern, factor) = (self.pattern, self.factor);
        for block in &pattern.supernodes {
            let (height, width) = (block.height(), block.width as usize);
            let below = &pattern.below[block.below.0 as usize..block.below.1 as usize];
            for j in 0..block.width {
                factor.local[(block.start + j) as usize] = j;
            }
            for (&row, local) in below.iter().zip(block.width..) {
                factor.local[row as usize] = local;
            }
            // Earlier columns are all in front of this block.
            let (before, own) = factor.values.split_at_mut(block.values as usize);
            let own = &mut own[..height * width];
            for update in &pattern.updates[block.updates.0 as usize..block.updates.1 as usize] {
                let source = &pattern.supernodes[update.source as usize];
                subtract(
                    (own, height),
                    block.start,
                    (&before[source.values as usize..], source),
                    &pattern.below[source.below.0 as usize..source.below.1 as usize],
                    *update,
                    (&factor.local, &mut factor.column),
                );
            }
            dense(own, height, width).map_err(|j| block.start as usize + j)?;
            pack(
                own,
                height,
                width,
                &mut factor.packed[block.values as usize..],
            );
        }
        Ok(())
    }
}

/// `a + b c` on each lane.
#[inline(always)]
fn plus(a: Lanes, b: Lanes, c: Lanes) -> Lanes {
    lanes(|l| a[l] + b[l] * c[l])
}

/// `a - b c` on each lane.
#[inline(always)]
fn minus(a: Lanes, b: Lanes, c: Lanes) -> Lanes {
    lanes(|l| a[l] - b[l] * c[l])
}

/// Subtracts what an earlier supernode contributes to a block.
#[inline(always)]
fn subtract(
    (own, height): (&mut [Lanes], usize),
    start: u32,
    (values, source): (&[Lanes], &Supernode),
    rows: &[u32],
    update: Update,
    (local, column): (&[u32], &mut [Lanes]),
) {
    let (tall, wide) = (source.height(), source.width as usize);
    for c in update.from as usize..update.to as usize {
        let first = wide + c;
        let sum = &mut column[..tall - first];
        sum.fill([0.0; LANES]);
        // Two columns of the source at a time.
        let mut k = 0;
        while k + 2 <= wide {
            let p = &values[k * tall + first..(k + 1) * tall];
            let q = &values[(k + 1) * tall + first..(k + 2) * tall];
            let (a, b) = (p[0], q[0]);
            for ((sum, p), q) in sum.iter_mut().zip(p).zip(q) {
                *sum = plus(plus(*sum, a, *p), b, *q);
            }
            k += 2;
        }
        if k < wide {
            let p = &values[k * tall + first..(k + 1) * tall];
            let a = p[0];
            for (sum, p) in sum.iter_mut().zip(p) {
                *sum = plus(*sum, a, *p);
            }
        }
        let target = &mut own[(rows[c] - start) as usize * height..][..height];
        for (&row, sum) in rows[c..].iter().zip(&*sum) {
            let t = &mut target[local[row as usize] as usize];
            *t = lanes(|l| t[l] - sum[l]);
        }
    }
}

/// Factors a dense block by columns; on failure the place of the bad pivot.
#[inline(always)]
fn dense(own: &mut [Lanes], height: usize, width: usize) -> Result<(), usize> {
    for j in 0..width {
        let (done, rest) = own.split_at_mut(j * height);
        let column = &mut rest[j..height];
        for k in 0..j {
            let left = &done[k * height + j..(k + 1) * height];
            let a = left[0];
            for (c, l) in column.iter_mut().zip(left) {
                *c = minus(*c, a, *l);
            }
        }
        let pivot = column[0];
        for p in pivot {
            if !(p > 0.0 && p.is_finite()) {
                return Err(j);
            }
        }
        let root = lanes(|l| pivot[l].sqrt());
        let inverse = lanes(|l| 1.0 / root[l]);
        column[0] = root;
        for c in &mut column[1..] {
            *c = lanes(|l| c[l] * inverse[l]);
        }
    }
    Ok(())
}

#[inline(always)]
fn pack<T: Stored>(own: &[Lanes], height: usize, width: usize, packed: &mut [T]) {
    for i in 0..height {
        for j in 0..width.min(i + 1) {
            let value = own[j * height + i];
            packed[i * width + j] = T::store(if i == j {
                lanes(|l| 1.0 / value[l])
            } else {
                value
            });
        }
    }
}

/// Forward and backward substitution.
struct Solve<'a, T> {
    pattern: &'a Pattern,
    packed: &'a [T],
    y: &'a mut [Lanes],
}

impl<T: Stored> Kernel for Solve<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pattern, packed, y } = self;
        for block in &pattern.supernodes {
            let width = block.width as usize;
            let rows = &pattern.below[block.below.0 as usize..block.below.1 as usize];
            let values = &packed[block.values as usize..][..block.height() * width];
            let (diagonal, lower) = values.split_at(width * width);
            let (own, later) = y[block.start as usize..].split_at_mut(width);
            for i in 0..width {
                let line = &diagonal[i * width..=i * width + i];
                let (done, rest) = own.split_at_mut(i);
                let (sum, scale) = (contract(line, done), line[i].load());
                rest[0] = lanes(|l| (rest[0][l] - sum[l]) * scale[l]);
            }
            let shift = block.start + block.width;
            for (&row, line) in rows.iter().zip(lower.chunks_exact(width)) {
                let target = &mut later[(row - shift) as usize];
                let sum = contract(line, own);
                *target = lanes(|l| target[l] - sum[l]);
            }
        }
        for block in pattern.supernodes.iter().rev() {
            let width = block.width as usize;
            let rows = &pattern.below[block.below.0 as usize..block.below.1 as usize];
            let values = &packed[block.values as usize..][..block.height() * width];
            let (diagonal, lower) = values.split_at(width * width);
            let (own, later) = y[block.start as usize..].split_at_mut(width);
            let shift = block.start + block.width;
            for (&row, line) in rows.iter().zip(lower.chunks_exact(width)) {
                spread(own, line, later[(row - shift) as usize]);
            }
            for i in (0..width).rev() {
                let line = &diagonal[i * width..=i * width + i];
                let (before, rest) = own.split_at_mut(i);
                let scale = line[i].load();
                rest[0] = lanes(|l| rest[0][l] * scale[l]);
                spread(before, line, rest[0]);
            }
        }
    }
}

/// `sum_k line_k done_k`, in two chains that do not wait for each other.
#[inline(always)]
fn contract<T: Stored>(line: &[T], done: &[Lanes]) -> Lanes {
    let n = line.len().min(done.len());
    let (mut even, mut odd) = ([0.0; LANES], [0.0; LANES]);
    let mut k = 0;
    while k + 2 <= n {
        even = plus(even, line[k].load(), done[k]);
        odd = plus(odd, line[k + 1].load(), done[k + 1]);
        k += 2;
    }
    if k < n {
        even = plus(even, line[k].load(), done[k]);
    }
    lanes(|l| even[l] + odd[l])
}

/// `own_k -= line_k a`.
#[inline(always)]
fn spread<T: Stored>(own: &mut [Lanes], line: &[T], a: Lanes) {
    for (o, l) in own.iter_mut().zip(line) {
        *o = minus(*o, l.load(), a);
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
        let mut factor = Factor::<Lanes>::new(&pattern);
        factor
            .refactor_one(&pattern, "chain", &entries)
            .expect("positive");
        let mut x = [[0.0; 3]; 5];
        x[4] = [0.0, 1.0, -2.0];
        factor.solve(&pattern, &mut x);
        for (i, v) in x.iter().enumerate() {
            let t = (i + 1) as f64;
            assert!((v[1] - t).abs() < 1e-12 && (v[2] + 2.0 * t).abs() < 1e-12 && v[0] == 0.0);
        }
        entries.fill(0.0);
        assert!(factor.refactor_one(&pattern, "chain", &entries).is_err());
    }

    #[test]
    fn a_sheet_of_random_springs_is_solved_to_rounding() {
        // A grid of 40 x 30 nodes with diagonals, random stiffness, a weak spring to the ground at each node.
        let (w, h) = (40u32, 30u32);
        let at = |i: u32, j: u32| i * w + j;
        let mut pairs = Vec::new();
        for i in 0..h {
            for j in 0..w {
                for (di, dj) in [(0, 1), (1, 0), (1, 1)] {
                    if i + di < h && j + dj < w {
                        pairs.push((at(i, j), at(i + di, j + dj)));
                    }
                }
            }
        }
        let n = (w * h) as usize;
        let pattern = Pattern::new(n, "sheet", pairs.iter().copied()).expect("small");
        let mut entries = vec![0.0; pattern.entries()];
        let mut product = vec![[0.0; 3]; n];
        let truth: Vec<[f64; 3]> = (0..n)
            .map(|i| [0.37, 1.1, 2.3].map(|f| libm::sin(f * i as f64)))
            .collect();
        let mut add = |a: u32, b: u32, value: f64| {
            entries[pattern.slot(a, b) as usize] += value;
            for k in 0..3 {
                product[a as usize][k] += value * truth[b as usize][k];
                if a != b {
                    product[b as usize][k] += value * truth[a as usize][k];
                }
            }
        };
        for (s, &(a, b)) in pairs.iter().enumerate() {
            let k = 1.5 + libm::sin(12.9 * s as f64);
            add(a, a, k);
            add(b, b, k);
            add(a, b, -k);
        }
        for i in 0..n as u32 {
            add(i, i, 0.05);
        }
        let mut factor = Factor::<Lanes>::new(&pattern);
        factor
            .refactor_one(&pattern, "sheet", &entries)
            .expect("positive");
        factor.solve(&pattern, &mut product);
        let worst = product
            .iter()
            .zip(&truth)
            .flat_map(|(p, t)| (0..3).map(|k| (p[k] - t[k]).abs()))
            .fold(0.0, f64::max);
        assert!(worst < 1e-10, "{worst}");
    }
}
