//! The windows' systems with a membrane between neighbours, relaxed line by line.
//!
//! Every second row is solved exactly, as a chain of 2x2 blocks from border to border, with the rows above and below held;
//! then the rows between. What a feature knows reaches the whole row in one sweep, and left and right are treated alike.
//! Cells are kept by column, the rows of one colour beside each other, so that a step along the chain is one plain loop
//! over all of them. Source: Briggs, Henson and `McCormick`, A multigrid tutorial, 2000, ch. 2 and 7 (zebra line relaxation).

use facile_core::Plane;
use facile_core::simd::{Kernel, dispatch};

use super::Normal;

/// Over-relaxation factor of the lines: between 1 and 2.
const RELAXATION: f32 = 1.7;

/// The rows of one colour.
struct Lines {
    /// Number of rows.
    count: usize,
    /// The solution, `[x][row]` with an empty row before the first and after the last.
    v: [Vec<f32>; 2],
    /// Right side without the rows above and below, `[x][row]`.
    fixed: [Vec<f32>; 2],
    /// Inverse blocks of the chain's elimination `[xx, xy, yy]`, times the membrane's weight, `[x][row]`.
    inverse: [Vec<f32>; 3],
    /// What the forward step leaves, `[x][row]`.
    begun: [Vec<f32>; 2],
    /// The solved line at the column before, by row.
    next: [Vec<f32>; 2],
}

/// Solves `(J + alpha n) v - alpha sum of neighbours = J start - b` for all cells, starting at `v`, in `sweeps` sweeps;
/// `alpha` is the membrane's weight, `n` the number of a cell's neighbours.
pub(super) fn relax(v: &mut Plane<[f32; 2]>, normal: &Plane<Normal>, alpha: f32, sweeps: usize) {
    let mut colours = [0, 1].map(|colour| Lines::new(v, normal, alpha, colour));
    let width = v.width();
    dispatch(Sweeps {
        colours: &mut colours,
        width,
        count: sweeps,
    });
    for (colour, lines) in colours.iter().enumerate() {
        let stride = lines.count + 2;
        for k in 0..lines.count {
            for (x, cell) in v.row_mut(2 * k + colour).iter_mut().enumerate() {
                *cell = [0, 1].map(|axis| lines.v[axis][x * stride + k + 1]);
            }
        }
    }
}

/// Sweeps over both colours in turns.
struct Sweeps<'a> {
    colours: &'a mut [Lines; 2],
    width: usize,
    count: usize,
}

impl Kernel for Sweeps<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for _ in 0..self.count {
            let [even, odd] = &mut *self.colours;
            // Row 2k lies between the odd rows k - 1 and k, row 2k + 1 between the even rows k and k + 1.
            even.solve(self.width, odd, 0);
            odd.solve(self.width, even, 1);
        }
    }
}

impl Lines {
    /// The rows `colour`, `colour + 2`, and so on, with their chains eliminated.
    fn new(v: &Plane<[f32; 2]>, normal: &Plane<Normal>, alpha: f32, colour: usize) -> Self {
        let (nx, ny) = (v.width(), v.height());
        let count = (ny + 1 - colour) / 2;
        let zeros = |n: usize| vec![0.0_f32; n];
        let mut lines = Self {
            count,
            v: [0, 1].map(|_| zeros(nx * (count + 2))),
            fixed: [0, 1].map(|_| zeros(nx * count)),
            inverse: [0, 1, 2].map(|_| zeros(nx * count)),
            begun: [0, 1].map(|_| zeros(nx * count)),
            next: [0, 1].map(|_| zeros(count)),
        };
        for k in 0..count {
            let y = 2 * k + colour;
            let beside = f32::from(u8::from(y > 0)) + f32::from(u8::from(y + 1 < ny));
            let mut before = [0.0_f32; 3];
            for x in 0..nx {
                let n = beside + f32::from(u8::from(x > 0)) + f32::from(u8::from(x + 1 < nx));
                let [jxx, jxy, jyy, bx, by] = normal[(x, y)];
                let [sx, sy] = v[(x, y)];
                // The block that is left after the one before is eliminated.
                let [ixx, ixy, iyy] = before.map(|i| alpha * i);
                let axx = jxx + alpha * n - ixx;
                let ayy = jyy + alpha * n - iyy;
                let axy = jxy - ixy;
                let scale = alpha / (axx * ayy - axy * axy);
                before = [ayy * scale, -axy * scale, axx * scale];
                let at = x * count + k;
                for (inverse, value) in lines.inverse.iter_mut().zip(before) {
                    inverse[at] = value;
                }
                // Over the weight of the membrane, which the inverse has in it.
                lines.fixed[0][at] = (jxx * sx + jxy * sy - bx) / alpha;
                lines.fixed[1][at] = (jxy * sx + jyy * sy - by) / alpha;
                lines.v[0][x * (count + 2) + k + 1] = sx;
                lines.v[1][x * (count + 2) + k + 1] = sy;
            }
        }
        lines
    }

    /// Solves every line with those of the `other` colour held; `shift` is the place of the row above among them.
    #[inline(always)]
    fn solve(&mut self, width: usize, other: &Self, shift: usize) {
        let (n, stride, far) = (self.count, self.count + 2, other.count + 2);
        let Self {
            v,
            fixed: [fx, fy],
            inverse: [gxx, gxy, gyy],
            begun: [zx, zy],
            next: [next_x, next_y],
            ..
        } = self;
        next_x.fill(0.0);
        next_y.fill(0.0);
        for x in 0..width {
            let span = x * n..(x + 1) * n;
            let (gxx, gxy, gyy) = (&gxx[span.clone()], &gxy[span.clone()], &gyy[span.clone()]);
            let (fx, fy) = (&fx[span.clone()], &fy[span.clone()]);
            let (zx, zy) = (&mut zx[span.clone()], &mut zy[span]);
            let beside = x * far + shift;
            let (down_x, up_x) = (&other.v[0][beside..][..n], &other.v[0][beside + 1..][..n]);
            let (down_y, up_y) = (&other.v[1][beside..][..n], &other.v[1][beside + 1..][..n]);
            let (next_x, next_y) = (&mut next_x[..n], &mut next_y[..n]);
            for k in 0..n {
                let bx = fx[k] + down_x[k] + up_x[k] + next_x[k];
                let by = fy[k] + down_y[k] + up_y[k] + next_y[k];
                zx[k] = gxx[k] * bx + gxy[k] * by;
                zy[k] = gxy[k] * bx + gyy[k] * by;
                next_x[k] = zx[k];
                next_y[k] = zy[k];
            }
        }
        next_x.fill(0.0);
        next_y.fill(0.0);
        let [vx, vy] = v;
        for x in (0..width).rev() {
            let span = x * n..(x + 1) * n;
            let (gxx, gxy, gyy) = (&gxx[span.clone()], &gxy[span.clone()], &gyy[span.clone()]);
            let (zx, zy) = (&zx[span.clone()], &zy[span]);
            let vx = &mut vx[x * stride + 1..][..n];
            let vy = &mut vy[x * stride + 1..][..n];
            let (next_x, next_y) = (&mut next_x[..n], &mut next_y[..n]);
            for k in 0..n {
                let sx = zx[k] + (gxx[k] * next_x[k] + gxy[k] * next_y[k]);
                let sy = zy[k] + (gxy[k] * next_x[k] + gyy[k] * next_y[k]);
                (next_x[k], next_y[k]) = (sx, sy);
                vx[k] += RELAXATION * (sx - vx[k]);
                vy[k] += RELAXATION * (sy - vy[k]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A system whose windows know something here and there.
    fn system(nx: usize, ny: usize) -> Plane<Normal> {
        Plane::from_fn(nx, ny, |x, y| {
            let (x, y) = (x as f32, y as f32);
            let known = ((0.7 * x).sin() * (0.5 * y).cos()).max(0.0).powi(4);
            let (a, b) = ((0.3 * y).sin(), (0.2 * x).cos());
            [
                known * a * a,
                known * a * b,
                known * b * b,
                0.1 * known * a,
                0.2 * known * b,
            ]
        })
    }

    /// `J (v - start) + b + alpha (n v - sum of neighbours)`, the largest over all cells.
    fn residual(v: &Plane<[f32; 2]>, normal: &Plane<Normal>, alpha: f32) -> f32 {
        let (nx, ny) = (v.width(), v.height());
        let mut worst = 0.0_f32;
        for y in 0..ny {
            for x in 0..nx {
                let [jxx, jxy, jyy, bx, by] = normal[(x, y)];
                let [vx, vy] = v[(x, y)];
                let mut r = [jxx * vx + jxy * vy + bx, jxy * vx + jyy * vy + by];
                let around = [
                    (x > 0, (-1, 0)),
                    (x + 1 < nx, (1, 0)),
                    (y > 0, (0, -1)),
                    (y + 1 < ny, (0, 1)),
                ];
                for (_, (dx, dy)) in around.into_iter().filter(|a| a.0) {
                    let at = ((x as i32 + dx) as usize, (y as i32 + dy) as usize);
                    for axis in 0..2 {
                        r[axis] += alpha * (v[(x, y)][axis] - v[at][axis]);
                    }
                }
                worst = worst.max(r[0].abs()).max(r[1].abs());
            }
        }
        worst
    }

    #[test]
    fn many_sweeps_solve_the_system_for_odd_and_even_sizes() {
        for (nx, ny) in [(24, 17), (15, 20), (8, 1), (1, 6)] {
            let normal = system(nx, ny);
            let mut v = Plane::filled(nx, ny, [0.0_f32; 2]);
            relax(&mut v, &normal, 0.2, 400);
            let left = residual(&v, &normal, 0.2);
            assert!(left < 2e-5, "{nx} x {ny}: {left}");
        }
    }

    #[test]
    fn a_mirrored_system_has_the_mirrored_solution() {
        let (nx, ny) = (24, 17);
        let normal = system(nx, ny);
        let mirrored = Plane::from_fn(nx, ny, |x, y| {
            let [xx, xy, yy, bx, by] = normal[(nx - 1 - x, y)];
            [xx, -xy, yy, -bx, by]
        });
        let zero = Plane::filled(nx, ny, [0.0_f32; 2]);
        let (mut v, mut w) = (zero.clone(), zero);
        relax(&mut v, &normal, 0.2, 5);
        relax(&mut w, &mirrored, 0.2, 5);
        for y in 0..ny {
            for x in 0..nx {
                let ([a, b], [c, d]) = (v[(x, y)], w[(nx - 1 - x, y)]);
                assert!((a + c).abs() < 1e-5 && (b - d).abs() < 1e-5);
            }
        }
    }
}
