//! The numbers of a sparse factor: supernodal Cholesky, every lane a system of its own.
//!
//! Four matrices of one pattern are factored and solved in the time of one.
//! Source: Chen et al., Algorithm 887: CHOLMOD, 2008.

use super::{Pattern, Supernode, Update};
use crate::SimError;
use crate::simd::{Kernel, LANES, Lanes, dispatch, lanes};

/// Numeric factors of four matrices.
#[derive(Debug)]
pub(crate) struct Factor {
    values: Vec<Lanes>,
    /// The same by rows, inverse diagonal, in the order in which a solve reads them.
    packed: Vec<Lanes>,
    column: Vec<Lanes>,
    local: Vec<u32>,
}

impl Factor {
    /// Work space for a pattern.
    pub(crate) fn new(pattern: &Pattern) -> Self {
        Self {
            values: vec![[0.0; LANES]; pattern.values],
            packed: vec![[0.0; LANES]; pattern.values],
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
struct Numeric<'a> {
    pattern: &'a Pattern,
    factor: &'a mut Factor,
}

impl Kernel for Numeric<'_> {
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
fn pack(own: &[Lanes], height: usize, width: usize, packed: &mut [Lanes]) {
    for i in 0..height {
        for j in 0..width.min(i + 1) {
            let value = own[j * height + i];
            packed[i * width + j] = if i == j {
                lanes(|l| 1.0 / value[l])
            } else {
                value
            };
        }
    }
}

/// Forward and backward substitution.
struct Solve<'a> {
    pattern: &'a Pattern,
    packed: &'a [Lanes],
    y: &'a mut [Lanes],
}

impl Kernel for Solve<'_> {
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
                let (sum, scale) = (contract(line, done), line[i]);
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
                let scale = line[i];
                rest[0] = lanes(|l| rest[0][l] * scale[l]);
                spread(before, line, rest[0]);
            }
        }
    }
}

/// `sum_k line_k done_k`, in two chains that do not wait for each other.
#[inline(always)]
fn contract(line: &[Lanes], done: &[Lanes]) -> Lanes {
    let n = line.len().min(done.len());
    let (mut even, mut odd) = ([0.0; LANES], [0.0; LANES]);
    let mut k = 0;
    while k + 2 <= n {
        even = plus(even, line[k], done[k]);
        odd = plus(odd, line[k + 1], done[k + 1]);
        k += 2;
    }
    if k < n {
        even = plus(even, line[k], done[k]);
    }
    lanes(|l| even[l] + odd[l])
}

/// `own_k -= line_k a`.
#[inline(always)]
fn spread(own: &mut [Lanes], line: &[Lanes], a: Lanes) {
    for (o, l) in own.iter_mut().zip(line) {
        *o = minus(*o, *l, a);
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
        let mut factor = Factor::new(&pattern);
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
        let mut factor = Factor::new(&pattern);
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
