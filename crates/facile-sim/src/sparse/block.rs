//! One factor for all three coordinates together: supernodal Cholesky of a matrix of 3x3 blocks, in `f32`.
//!
//! The blocks share the pattern of a scalar matrix, so that the symbolic analysis is that of a third of the rows.
//! Columns of a supernode are padded to whole tiles: the kernels know no remainders.
//! Source: Chen et al., Algorithm 887: CHOLMOD, 2008.

use super::{Pattern, Update};
use crate::SimError;
use crate::simd::{Kernel, dispatch};

/// A block: three rows of three numbers, and one that pads them.
pub(crate) type Block = [[f64; 4]; 3];
/// A block of zeros.
pub(crate) const NO_BLOCK: Block = [[0.0; 4]; 3];

/// Rows and most columns of a tile: six registers of sixteen numbers, or twelve of eight.
const ROWS: usize = 16;
const COLUMNS: usize = 6;
/// Numbers that are multiplied at once.
const WIDE: usize = 8;

/// Where a block of the matrix goes: its first number, the distance of its columns, and whether it is transposed.
#[derive(Clone, Copy, Debug)]
struct Place {
    at: u32,
    leading: u32,
    is_turned: bool,
}

/// A supernode's numbers: the first, and the distance of the columns.
#[derive(Clone, Copy, Debug)]
struct Panel {
    at: usize,
    leading: usize,
}

/// Rows that follow each other in two panels.
#[derive(Clone, Copy, Debug)]
struct Run {
    from: u32,
    to: u32,
    length: u32,
}

/// The numeric factor of a symmetric positive definite matrix of 3x3 blocks.
#[derive(Debug)]
pub(crate) struct BlockFactor {
    values: Vec<f32>,
    panels: Vec<Panel>,
    places: Vec<Place>,
    strip: Vec<f32>,
    local: Vec<u32>,
    runs: Vec<Run>,
    work: Vec<f32>,
    /// Smallest pivot.
    pub(crate) smallest: f32,
}

impl BlockFactor {
    /// Work space for a pattern.
    pub(crate) fn new(pattern: &Pattern) -> Self {
        let mut at = 0;
        let mut tallest = 0;
        let mut panels = Vec::with_capacity(pattern.supernodes.len());
        for block in &pattern.supernodes {
            let leading = (3 * block.height()).next_multiple_of(ROWS);
            panels.push(Panel { at, leading });
            at += leading * 3 * block.width as usize;
            tallest = tallest.max(leading);
        }
        let places = pattern
            .sites()
            .iter()
            .map(|site| {
                let panel = &panels[site.supernode];
                Place {
                    at: (panel.at + 3 * site.column * panel.leading + 3 * site.row) as u32,
                    leading: panel.leading as u32,
                    is_turned: site.is_turned,
                }
            })
            .collect();
        Self {
            // A run may be read and written past its end.
            values: vec![0.0; at + ROWS],
            panels,
            places,
            strip: vec![0.0; COLUMNS * tallest + ROWS],
            local: vec![0; pattern.size()],
            runs: Vec::new(),
            work: vec![0.0; tallest],
            smallest: 0.0,
        }
    }

    /// Factors the matrix with these blocks, one per slot of the pattern: rows of the larger index, columns of the smaller.
    pub(crate) fn refactor(
        &mut self,
        pattern: &Pattern,
        what: &'static str,
        blocks: &[Block],
    ) -> Result<(), SimError> {
        self.fill(blocks);
        dispatch(Numeric {
            pattern,
            factor: self,
        })
        .map_err(|row| SimError::Singular { what, row })
    }

    /// Copies the matrix to where its factor will be.
    fn fill(&mut self, blocks: &[Block]) {
        self.values.fill(0.0);
        for (place, block) in self.places.iter().zip(blocks) {
            for column in 0..3 {
                let start = place.at as usize + column * place.leading as usize;
                for row in 0..3 {
                    let value = if place.is_turned {
                        block[column][row]
                    } else {
                        block[row][column]
                    };
                    self.values[start + row] = value as f32;
                }
            }
        }
    }

    /// Replaces a right-hand side, three numbers for each row in the pattern's order, by the solution.
    pub(crate) fn solve(&mut self, pattern: &Pattern, side: &mut [f32]) {
        dispatch(Solve {
            pattern,
            panels: &self.panels,
            values: &self.values,
            work: &mut self.work,
            y: side,
        });
    }
}

/// The factorisation; on failure the row of the bad pivot.
struct Numeric<'a> {
    pattern: &'a Pattern,
    factor: &'a mut BlockFactor,
}

impl Kernel for Numeric<'_> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn run(self) -> Result<(), usize> {
        let (pattern, factor) = (self.pattern, self.factor);
        factor.smallest = f32::INFINITY;
        for (block, &panel) in pattern.supernodes.iter().zip(&factor.panels) {
            let (height, width) = (3 * block.height(), 3 * block.width as usize);
            for j in 0..block.width {
                factor.local[(block.start + j) as usize] = j;
            }
            let below = &pattern.below[block.below.0 as usize..block.below.1 as usize];
            for (&row, local) in below.iter().zip(block.width..) {
                factor.local[row as usize] = local;
            }
            // Earlier panels are all in front of this one.
            let (before, own) = factor.values.split_at_mut(panel.at);
            for update in &pattern.updates[block.updates.0 as usize..block.updates.1 as usize] {
                let source = &pattern.supernodes[update.source as usize];
                let from = factor.panels[update.source as usize];
                let wide = 3 * source.width as usize;
                subtract(
                    (own, panel.leading, block.start),
                    (
                        &before[from.at..from.at + from.leading * wide],
                        from.leading,
                        wide,
                    ),
                    &pattern.below[source.below.0 as usize..source.below.1 as usize],
                    *update,
                    (&factor.local, &mut factor.strip, &mut factor.runs),
                );
            }
            let own = &mut own[..panel.leading * width];
            let smallest = dense(own, panel.leading, width, height)
                .map_err(|j| block.start as usize + j / 3)?;
            factor.smallest = factor.smallest.min(smallest);
        }
        Ok(())
    }
}

/// A tile's rows of one column.
type Strip = [f32; ROWS];

#[inline(always)]
fn plus(sum: &Strip, rows: &Strip, factor: f32) -> Strip {
    let mut out = *sum;
    for l in 0..ROWS {
        out[l] += rows[l] * factor;
    }
    out
}

#[inline(always)]
fn strip(column: &[f32], row: usize) -> Strip {
    let mut out = [0.0; ROWS];
    out.copy_from_slice(&column[row..row + ROWS]);
    out
}

/// Products of `ROWS` rows of a panel with six of its rows, over all its columns. Written out: a loop over the six is
/// turned into gathers and scatters where registers are wide.
#[inline(always)]
fn tile_of_six(panel: &[f32], leading: usize, row: usize, with: usize) -> [Strip; 6] {
    let zero = [0.0; ROWS];
    let (mut a, mut b, mut c, mut d, mut e, mut f) = (zero, zero, zero, zero, zero, zero);
    for column in panel.chunks_exact(leading) {
        let rows = strip(column, row);
        let by = &column[with..with + 6];
        a = plus(&a, &rows, by[0]);
        b = plus(&b, &rows, by[1]);
        c = plus(&c, &rows, by[2]);
        d = plus(&d, &rows, by[3]);
        e = plus(&e, &rows, by[4]);
        f = plus(&f, &rows, by[5]);
    }
    [a, b, c, d, e, f]
}

/// The same for three rows.
#[inline(always)]
fn tile_of_three(panel: &[f32], leading: usize, row: usize, with: usize) -> [Strip; 3] {
    let zero = [0.0; ROWS];
    let (mut a, mut b, mut c) = (zero, zero, zero);
    for column in panel.chunks_exact(leading) {
        let rows = strip(column, row);
        let by = &column[with..with + 3];
        a = plus(&a, &rows, by[0]);
        b = plus(&b, &rows, by[1]);
        c = plus(&c, &rows, by[2]);
    }
    [a, b, c]
}

/// Subtracts what an earlier supernode contributes to a panel.
#[inline(always)]
fn subtract(
    (own, leading, start): (&mut [f32], usize, u32),
    (source, tall, wide): (&[f32], usize, usize),
    rows: &[u32],
    update: Update,
    (local, strip, runs): (&[u32], &mut [f32], &mut Vec<Run>),
) {
    let (from, to) = (update.from as usize, update.to as usize);
    runs.clear();
    for (k, &row) in rows.iter().enumerate().skip(from) {
        let to = 3 * local[row as usize];
        match runs.last_mut() {
            Some(run) if run.to + run.length == to => run.length += 3,
            _ => runs.push(Run {
                from: 3 * k as u32,
                to,
                length: 3,
            }),
        }
    }
    let mut c = from;
    while c < to {
        // Two block columns at a time.
        let columns = if c + 2 <= to { 6 } else { 3 };
        let first = wide + 3 * c;
        let mut row = first / ROWS * ROWS;
        while row < wide + 3 * rows.len() {
            if columns == 6 {
                let sums = tile_of_six(source, tall, row, first);
                for (k, sum) in sums.iter().enumerate() {
                    strip[k * tall + row..][..ROWS].copy_from_slice(sum);
                }
            } else {
                let sums = tile_of_three(source, tall, row, first);
                for (k, sum) in sums.iter().enumerate() {
                    strip[k * tall + row..][..ROWS].copy_from_slice(sum);
                }
            }
            row += ROWS;
        }
        let mut targets = [0; COLUMNS];
        for (k, target) in targets.iter_mut().enumerate().take(columns) {
            *target = (3 * (rows[c + k / 3] - start) as usize + k % 3) * leading;
        }
        let sums = &strip[wide..];
        // Run by run, not column by column: a run's last register overlaps the next run's first one, which should not be
        // read before it was written.
        for run in &*runs {
            let (from, to) = (run.from as usize, run.to as usize);
            for (k, target) in targets.iter().enumerate().take(columns) {
                take_run(
                    &mut own[target + to..],
                    &sums[k * tall + from..],
                    run.length as usize,
                );
            }
        }
        c += columns / 3;
    }
}

/// Ones for the first numbers of a register, zeros for the rest.
const FIRST: [[f32; WIDE]; WIDE] = {
    let mut masks = [[0.0; WIDE]; WIDE];
    let mut k = 0;
    while k < WIDE {
        let mut l = 0;
        while l < k {
            masks[k][l] = 1.0;
            l += 1;
        }
        k += 1;
    }
    masks
};

/// `target -= sums`, for so many numbers. Whole registers are read and written: what lies beyond is left as it is.
#[inline(always)]
fn take_run(target: &mut [f32], sums: &[f32], length: usize) {
    let mut at = 0;
    while at + WIDE <= length {
        let (target, sums) = (&mut target[at..at + WIDE], &sums[at..at + WIDE]);
        for l in 0..WIDE {
            target[l] -= sums[l];
        }
        at += WIDE;
    }
    if at < length {
        let (target, sums) = (&mut target[at..at + WIDE], &sums[at..at + WIDE]);
        let mask = &FIRST[length - at];
        for l in 0..WIDE {
            target[l] -= sums[l] * mask[l];
        }
    }
}

/// Factors a panel; the diagonal becomes one over its root. Returns the smallest pivot, or the place of a bad one.
#[inline(always)]
fn dense(own: &mut [f32], leading: usize, width: usize, height: usize) -> Result<f32, usize> {
    let mut smallest = f32::INFINITY;
    let mut j = 0;
    while j < width {
        let columns = if j + 6 <= width { 6 } else { 3 };
        let (done, rest) = own.split_at_mut(j * leading);
        let mut row = j / ROWS * ROWS;
        while row < height && j > 0 {
            if columns == 6 {
                take(rest, leading, row, &tile_of_six(done, leading, row, j));
            } else {
                take(rest, leading, row, &tile_of_three(done, leading, row, j));
            }
            row += ROWS;
        }
        let pivot = if columns == 6 {
            triangle::<6>(rest, leading, j, height)
        } else {
            triangle::<3>(rest, leading, j, height)
        };
        smallest = smallest.min(pivot?);
        j += columns;
    }
    Ok(smallest)
}

/// Factors the columns `j..j + C` of a panel, which `rest` begins with, after those before them were taken out.
#[inline(always)]
fn triangle<const C: usize>(
    rest: &mut [f32],
    leading: usize,
    j: usize,
    height: usize,
) -> Result<f32, usize> {
    let mut smallest = f32::INFINITY;
    let mut top = [[0.0; C]; C];
    for (c, column) in top.iter_mut().enumerate() {
        column.copy_from_slice(&rest[c * leading + j..][..C]);
    }
    for c in 0..C {
        for k in 0..c {
            for r in c..C {
                top[c][r] -= top[k][c] * top[k][r];
            }
        }
        let pivot = top[c][c];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(j + c);
        }
        smallest = smallest.min(pivot);
        let inverse = 1.0 / pivot.sqrt();
        top[c][c] = inverse;
        for r in c + 1..C {
            top[c][r] *= inverse;
        }
    }
    // The first register may hold rows above: they are put back, or never read.
    let mut row = (j + C) / ROWS * ROWS;
    while row < height {
        let mut rows = [[0.0; ROWS]; C];
        for c in 0..C {
            rows[c] = strip(&rest[c * leading..], row);
            for k in 0..c {
                for l in 0..ROWS {
                    rows[c][l] -= top[k][c] * rows[k][l];
                }
            }
            for l in 0..ROWS {
                rows[c][l] *= top[c][c];
            }
        }
        for (c, rows) in rows.iter().enumerate() {
            rest[c * leading + row..][..ROWS].copy_from_slice(rows);
        }
        row += ROWS;
    }
    for (c, column) in top.iter().enumerate() {
        rest[c * leading + j + c..][..C - c].copy_from_slice(&column[c..]);
    }
    Ok(smallest)
}

#[inline(always)]
fn take<const C: usize>(rest: &mut [f32], leading: usize, row: usize, sums: &[[f32; ROWS]; C]) {
    for (k, sum) in sums.iter().enumerate() {
        let target = &mut rest[k * leading + row..][..ROWS];
        for l in 0..ROWS {
            target[l] -= sum[l];
        }
    }
}

/// Forward and backward substitution.
struct Solve<'a> {
    pattern: &'a Pattern,
    panels: &'a [Panel],
    values: &'a [f32],
    work: &'a mut [f32],
    y: &'a mut [f32],
}

impl Kernel for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            pattern,
            panels,
            values,
            work,
            y,
        } = self;
        for (block, panel) in pattern.supernodes.iter().zip(panels) {
            let (width, leading) = (3 * block.width as usize, panel.leading);
            let height = 3 * block.height();
            let values = &values[panel.at..panel.at + leading * width];
            let own = &mut y[3 * block.start as usize..][..width];
            let work = &mut work[..height];
            work[..width].copy_from_slice(own);
            work[width..].fill(0.0);
            for (k, columns) in values.chunks_exact(3 * leading).enumerate() {
                let k = 3 * k;
                let (p, rest) = columns.split_at(leading);
                let (q, r) = rest.split_at(leading);
                let a = work[k] * p[k];
                let b = (work[k + 1] - a * p[k + 1]) * q[k + 1];
                let c = (work[k + 2] - a * p[k + 2] - b * q[k + 2]) * r[k + 2];
                (work[k], work[k + 1], work[k + 2]) = (a, b, c);
                let (p, q, r) = (&p[k + 3..height], &q[k + 3..height], &r[k + 3..height]);
                for (((w, p), q), r) in work[k + 3..].iter_mut().zip(p).zip(q).zip(r) {
                    *w -= a * p + b * q + c * r;
                }
            }
            own.copy_from_slice(&work[..width]);
            let rows = &pattern.below[block.below.0 as usize..block.below.1 as usize];
            for (&row, w) in rows.iter().zip(work[width..].as_chunks::<3>().0) {
                let t = &mut y[3 * row as usize..][..3];
                t[0] += w[0];
                t[1] += w[1];
                t[2] += w[2];
            }
        }
        for (block, panel) in pattern.supernodes.iter().zip(panels).rev() {
            let (width, leading) = (3 * block.width as usize, panel.leading);
            let height = 3 * block.height();
            let values = &values[panel.at..panel.at + leading * width];
            let work = &mut work[..height];
            let rows = &pattern.below[block.below.0 as usize..block.below.1 as usize];
            for (&row, w) in rows.iter().zip(work[width..].as_chunks_mut::<3>().0) {
                w.copy_from_slice(&y[3 * row as usize..][..3]);
            }
            let own = &mut y[3 * block.start as usize..][..width];
            work[..width].copy_from_slice(own);
            for (k, columns) in values.chunks_exact(3 * leading).enumerate().rev() {
                let k = 3 * k;
                let (p, rest) = columns.split_at(leading);
                let (q, r) = rest.split_at(leading);
                let [a, b, c] = three_inner(
                    [&p[k + 3..height], &q[k + 3..height], &r[k + 3..height]],
                    &work[k + 3..],
                );
                let z = (work[k + 2] - c) * r[k + 2];
                let y = (work[k + 1] - b - q[k + 2] * z) * q[k + 1];
                let x = (work[k] - a - p[k + 1] * y - p[k + 2] * z) * p[k];
                (work[k], work[k + 1], work[k + 2]) = (x, y, z);
            }
            own.copy_from_slice(&work[..width]);
        }
    }
}

/// Inner products of three columns with a vector, in a fixed order.
#[inline(always)]
fn three_inner(columns: [&[f32]; 3], w: &[f32]) -> [f32; 3] {
    let mut sums = [[0.0f32; WIDE]; 3];
    let (blocks, rest) = w.as_chunks::<WIDE>();
    for (c, sum) in columns.iter().zip(&mut sums) {
        for (p, w) in c.as_chunks::<WIDE>().0.iter().zip(blocks) {
            for l in 0..WIDE {
                sum[l] += p[l] * w[l];
            }
        }
    }
    let mut out = [0.0; 3];
    for ((c, s), out) in columns.iter().zip(&sums).zip(&mut out) {
        let tail: f32 = c[WIDE * blocks.len()..]
            .iter()
            .zip(rest)
            .map(|(p, w)| p * w)
            .sum();
        *out = ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7])) + tail;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::M3;

    /// Numbers in `[-1, 1]` without a pattern.
    fn noise(k: usize) -> f64 {
        libm::sin(12.9898 * k as f64 + 0.3 * libm::sin(78.233 * k as f64))
    }

    #[test]
    fn a_sheet_of_random_blocks_is_solved_to_single_precision() {
        let (w, h) = (23u32, 17u32);
        let mut pairs = Vec::new();
        for i in 0..h {
            for j in 0..w {
                for (di, dj) in [(0, 1), (1, 0), (1, 1)] {
                    if i + di < h && j + dj < w {
                        pairs.push((i * w + j, (i + di) * w + j + dj));
                    }
                }
            }
        }
        let n = (w * h) as usize;
        let pattern = Pattern::new(n, "sheet", pairs.iter().copied()).expect("small");
        let mut blocks = vec![NO_BLOCK; pattern.entries()];
        for i in 0..n as u32 {
            let block = &mut blocks[pattern.slot(i, i) as usize];
            for k in 0..3 {
                block[k][k] = 0.1;
            }
        }
        // Each pair adds g g^T for g = (B, -C) with blocks that are not symmetric.
        for (s, &(a, b)) in pairs.iter().enumerate() {
            let part =
                |t: usize| [0, 1, 2].map(|r| [0, 1, 2].map(|c| noise(18 * s + t + 3 * r + c)));
            let (p, q): (M3, M3) = (part(0), part(9));
            let product = |x: &M3, y: &M3, sign: f64| -> M3 {
                [0, 1, 2].map(|r| {
                    [0, 1, 2].map(|c| sign * (0..3).map(|k| x[r][k] * y[c][k]).sum::<f64>())
                })
            };
            let mut add = |slot: u32, m: M3| {
                for (row, m) in blocks[slot as usize].iter_mut().zip(m) {
                    for (x, m) in row.iter_mut().zip(m) {
                        *x += m;
                    }
                }
            };
            add(pattern.slot(a, a), product(&p, &p, 1.0));
            add(pattern.slot(b, b), product(&q, &q, 1.0));
            // Rows of the larger index, which is `b`.
            add(pattern.slot(a, b), product(&q, &p, -1.0));
        }
        let truth: Vec<f64> = (0..3 * n).map(|k| noise(5 * k + 3)).collect();
        let mut right = vec![0.0; 3 * n];
        for ([a, b], block) in pattern.pairs().zip(&blocks) {
            let (a, b) = (3 * a as usize, 3 * b as usize);
            for r in 0..3 {
                for c in 0..3 {
                    right[b + r] += block[r][c] * truth[a + c];
                    if a != b {
                        right[a + c] += block[r][c] * truth[b + r];
                    }
                }
            }
        }
        let mut factor = BlockFactor::new(&pattern);
        factor
            .refactor(&pattern, "sheet", &blocks)
            .expect("positive");
        let mut side = vec![0.0f32; 3 * n];
        for (i, &row) in pattern.order().iter().enumerate() {
            for k in 0..3 {
                side[3 * row as usize + k] = right[3 * i + k] as f32;
            }
        }
        factor.solve(&pattern, &mut side);
        for (i, &row) in pattern.order().iter().enumerate() {
            for k in 0..3 {
                let away = f64::from(side[3 * row as usize + k]) - truth[3 * i + k];
                assert!(away.abs() < 2e-4, "row {i}: {away}");
            }
        }
        assert!(factor.smallest > 0.0);
        // Registers of any width give the same bits.
        let wide = factor.values.clone();
        factor.fill(&blocks);
        let plain = Numeric {
            pattern: &pattern,
            factor: &mut factor,
        };
        plain.run().expect("positive");
        assert_eq!(factor.values, wide);
        blocks[pattern.slot(7, 7) as usize][1][1] = -1.0;
        assert!(factor.refactor(&pattern, "sheet", &blocks).is_err());
    }
}
