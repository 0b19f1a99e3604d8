//! The factor's numbers: left-looking, panel by panel, in tiles of registers.

use super::{BlockFactor, COLUMNS, ROWS, WIDE};
use crate::simd::Kernel;
use crate::sparse::{Pattern, Update};

/// Rows that follow each other in two panels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    from: u32,
    to: u32,
    length: u32,
}

/// The factorisation; on failure the row of the bad pivot.
pub(super) struct Numeric<'a> {
    pub(super) pattern: &'a Pattern,
    pub(super) factor: &'a mut BlockFactor,
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
                put(strip, tall, row, &tile_of_six(source, tall, row, first));
            } else {
                put(strip, tall, row, &tile_of_three(source, tall, row, first));
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
fn put<const C: usize>(strip: &mut [f32], tall: usize, row: usize, sums: &[Strip; C]) {
    for (k, sum) in sums.iter().enumerate() {
        strip[k * tall + row..][..ROWS].copy_from_slice(sum);
    }
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
