//! One factor for all three coordinates together: supernodal Cholesky of a matrix of 3x3 blocks, in `f32`.
//!
//! The blocks share the pattern of a scalar matrix, so that the symbolic analysis is that of a third of the rows.
//! Columns of a supernode are padded to whole tiles: the kernels know no remainders.
//! Source: Chen et al., Algorithm 887: CHOLMOD, 2008.

mod numeric;
mod solve;

use super::Pattern;
use crate::SimError;
use crate::simd::dispatch;
use numeric::{Numeric, Run};
use solve::Solve;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Kernel;
    use crate::vector::M3;
    use crate::vector::noise;

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
