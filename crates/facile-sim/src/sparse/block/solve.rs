//! Substitution with a factor: its columns are read once forwards and once backwards.

use super::{Panel, WIDE};
use crate::simd::Kernel;
use crate::sparse::Pattern;

/// Forward and backward substitution.
pub(super) struct Solve<'a> {
    pub(super) pattern: &'a Pattern,
    pub(super) panels: &'a [Panel],
    pub(super) values: &'a [f32],
    pub(super) work: &'a mut [f32],
    pub(super) y: &'a mut [f32],
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
