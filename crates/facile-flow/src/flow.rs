//! Optical flow between two cylinder images: eq. 2-3, coarse to fine.
//!
//! On every pyramid level the target is warped by the field so far, eq. 3 is accumulated over a Gaussian window, and
//! the 2x2 systems of all cells are solved together with a membrane between neighbours, so that cells whose window
//! says nothing (cheeks, forehead, holes) take what cells with features found. Without that coupling
//! (`smoothness = 0`) each cell is solved alone, as printed, where its system is well conditioned; on faces that is
//! worse than a rigid alignment. Sources: Facile eq. 2-3; Bruhn, Weickert, Schnoerr, Lucas/Kanade meets Horn/Schunck,
//! 2005 (window and membrane together); Brox et al. 2004 (warping).

use facile_core::Plane;
use serde::{Deserialize, Serialize};

use crate::blur::blur;
use crate::channels::{CHANNELS, Channels, CylinderImage, bilinear};
use crate::pyramid::Pyramid;

/// How the displacement field is computed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowParams {
    /// Pyramid levels, at least 1.
    pub levels: usize,
    /// Warps on each level.
    pub warps: usize,
    /// Standard deviation of the window `R` of eq. 3, cells.
    pub window_cells: f64,
    /// Weight of the membrane against the squared gradients of the channels; 0 solves each cell alone.
    pub smoothness: f64,
    /// Difference of channels beyond which a cell counts as an outlier.
    pub outlier: f64,
    /// Relaxation sweeps per warp.
    pub sweeps: usize,
}

impl Default for FlowParams {
    fn default() -> Self {
        Self {
            levels: 4,
            warps: 3,
            window_cells: 1.5,
            smoothness: 0.2,
            outlier: 0.3,
            sweeps: 20,
        }
    }
}

/// `v(h, phi)` of the paper, from source to target, with its confidence.
#[derive(Clone, Debug)]
pub struct DisplacementField {
    /// `[columns, rows]` to add to a source cell, in cells.
    pub cells: Plane<[f32; 2]>,
    /// `[0, 1]`: how much of the displacement each cell's own window determines.
    pub confidence: Plane<f32>,
}

/// Sums of eq. 3 over a window: `[J_xx, J_xy, J_yy, b_x, b_y]`.
type Normal = [f32; 5];

/// Successive over-relaxation factor; between 1 and 2, fast for a few hundred cells across.
const RELAXATION: f32 = 1.7;

/// Computes the field that carries `source` onto `target`; both pyramids have the same shape.
pub fn displacement_field(
    source: &Pyramid,
    target: &Pyramid,
    params: &FlowParams,
) -> DisplacementField {
    let count = source.levels.len().min(target.levels.len());
    let mut field: Option<Plane<[f32; 2]>> = None;
    let mut confidence = Plane::filled(1, 1, 0.0);
    for level in (0..count).rev() {
        let (from, to) = (&source.levels[level], &target.levels[level]);
        let (nx, ny) = (from.mask.width(), from.mask.height());
        let mut v = match field {
            Some(coarse) => refine(&coarse, nx, ny),
            None => Plane::filled(nx, ny, [0.0; 2]),
        };
        for warp in 0..params.warps.max(1) {
            let normal = accumulate(from, to, &v, params);
            if params.smoothness > 0.0 {
                relax(&mut v, &normal, params);
            } else {
                solve_alone(&mut v, &normal);
            }
            if level == 0 && warp + 1 == params.warps.max(1) {
                confidence = normal.map(determinacy);
            }
        }
        field = Some(v);
    }
    DisplacementField {
        cells: field.unwrap_or_else(|| Plane::filled(1, 1, [0.0; 2])),
        confidence,
    }
}

/// Distance in cells between each source cell and where forward and backward field lead it.
pub fn forward_backward(forward: &DisplacementField, backward: &DisplacementField) -> Plane<f32> {
    let v = &forward.cells;
    Plane::from_fn(v.width(), v.height(), |x, y| {
        let [dx, dy] = v[(x, y)];
        let [bx, by] = bilinear(&backward.cells, x as f32 + dx, y as f32 + dy);
        (dx + bx).hypot(dy + by)
    })
}

/// A field of the next finer level from a coarse one.
fn refine(coarse: &Plane<[f32; 2]>, nx: usize, ny: usize) -> Plane<[f32; 2]> {
    Plane::from_fn(nx, ny, |x, y| {
        bilinear(coarse, 0.5 * x as f32 - 0.25, 0.5 * y as f32 - 0.25).map(|c| 2.0 * c)
    })
}

/// Gathers eq. 3 in every window, for the increment of `v`.
fn accumulate(
    from: &CylinderImage,
    to: &CylinderImage,
    v: &Plane<[f32; 2]>,
    params: &FlowParams,
) -> Plane<Normal> {
    let (nx, ny) = (v.width(), v.height());
    let inside = |x: f32, y: f32| {
        (0.0..=(nx - 1) as f32).contains(&x) && (0.0..=(ny - 1) as f32).contains(&y)
    };
    let mut warped: Plane<Channels> = Plane::filled(nx, ny, [0.0; CHANNELS]);
    let mut trust = Plane::filled(nx, ny, 0.0_f32);
    for y in 0..ny {
        for x in 0..nx {
            let [dx, dy] = v[(x, y)];
            let (tx, ty) = (x as f32 + dx, y as f32 + dy);
            let (value, there) = masked_bilinear(to, tx, ty);
            warped[(x, y)] = value;
            if inside(tx, ty) {
                trust[(x, y)] = from.mask[(x, y)] * there;
            }
        }
    }
    let scale = 1.0 / (params.outlier * params.outlier).max(1e-12) as f32;
    let mut normal: Plane<Normal> = Plane::filled(nx, ny, [0.0; 5]);
    for y in 1..ny.saturating_sub(1) {
        for x in 1..nx.saturating_sub(1) {
            // Beside a hole there is no gradient.
            let around = trust[(x - 1, y)]
                .min(trust[(x + 1, y)])
                .min(trust[(x, y - 1)])
                .min(trust[(x, y + 1)]);
            if trust[(x, y)].min(around) <= 0.0 {
                continue;
            }
            // Gradients of both images at the same place: their mean halves the error of the linearisation.
            let side = |plane: &Plane<Channels>, dx: usize, dy: usize, k: usize| {
                0.5 * (plane[(x + dx, y + dy)][k] - plane[(x - dx, y - dy)][k])
            };
            let (mut sum, mut square) = ([0.0_f32; 5], 0.0);
            for k in 0..CHANNELS {
                let gx = 0.5 * (side(&warped, 1, 0, k) + side(&from.values, 1, 0, k));
                let gy = 0.5 * (side(&warped, 0, 1, k) + side(&from.values, 0, 1, k));
                let change = warped[(x, y)][k] - from.values[(x, y)][k];
                square += change * change;
                sum[0] += gx * gx;
                sum[1] += gx * gy;
                sum[2] += gy * gy;
                sum[3] += gx * change;
                sum[4] += gy * change;
            }
            // Charbonnier weight of the whole cell.
            let weight = trust[(x, y)] / (1.0 + square * scale).sqrt();
            normal[(x, y)] = sum.map(|s| s * weight);
        }
    }
    blur(&normal, params.window_cells)
}

/// Channels and mask of an image at a continuous position, holes left out of the mean.
fn masked_bilinear(image: &CylinderImage, x: f32, y: f32) -> (Channels, f32) {
    let (nx, ny) = (image.mask.width(), image.mask.height());
    let x = x.clamp(0.0, (nx - 1) as f32);
    let y = y.clamp(0.0, (ny - 1) as f32);
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(nx - 1), (y0 + 1).min(ny - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let cells = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)];
    let shares = [
        (1.0 - fx) * (1.0 - fy),
        fx * (1.0 - fy),
        (1.0 - fx) * fy,
        fx * fy,
    ];
    let (mut sum, mut trust) = ([0.0_f32; CHANNELS], 0.0);
    for (cell, share) in cells.into_iter().zip(shares) {
        let weight = share * image.mask[cell];
        let value = &image.values[cell];
        for k in 0..CHANNELS {
            sum[k] += value[k] * weight;
        }
        trust += weight;
    }
    if trust > 1e-3 {
        (sum.map(|s| s / trust), trust)
    } else {
        (sum, 0.0)
    }
}

/// Solves the windows' systems with a membrane between neighbours, by successive over-relaxation.
fn relax(v: &mut Plane<[f32; 2]>, normal: &Plane<Normal>, params: &FlowParams) {
    let (nx, ny) = (v.width(), v.height());
    let alpha = params.smoothness as f32;
    // (J + alpha n) v = J start - b + alpha sum of neighbours, solved for v: `fixed + matrix sum`.
    let cells = Plane::from_fn(nx, ny, |x, y| {
        let count = [x > 0, x + 1 < nx, y > 0, y + 1 < ny]
            .iter()
            .filter(|b| **b)
            .count() as f32;
        let [jxx, jxy, jyy, bx, by] = normal[(x, y)];
        let [sx, sy] = v[(x, y)];
        let (axx, ayy) = (jxx + alpha * count, jyy + alpha * count);
        let rx = jxx * sx + jxy * sy - bx;
        let ry = jxy * sx + jyy * sy - by;
        let inverse = 1.0 / (axx * ayy - jxy * jxy);
        let (ixx, ixy, iyy) = (ayy * inverse, -jxy * inverse, axx * inverse);
        [
            ixx * rx + ixy * ry,
            ixy * rx + iyy * ry,
            alpha * ixx,
            alpha * ixy,
            alpha * iyy,
        ]
    });
    for sweep in 0..params.sweeps {
        for row in 0..ny {
            // Alternate the direction, so that information travels both ways equally fast.
            let y = if sweep % 2 == 0 { row } else { ny - 1 - row };
            for column in 0..nx {
                let x = if sweep % 2 == 0 {
                    column
                } else {
                    nx - 1 - column
                };
                let mut sum = [0.0_f32; 2];
                let mut add = |n: [f32; 2]| {
                    sum[0] += n[0];
                    sum[1] += n[1];
                };
                if x > 0 {
                    add(v[(x - 1, y)]);
                }
                if x + 1 < nx {
                    add(v[(x + 1, y)]);
                }
                if y > 0 {
                    add(v[(x, y - 1)]);
                }
                if y + 1 < ny {
                    add(v[(x, y + 1)]);
                }
                let [fx, fy, mxx, mxy, myy] = cells[(x, y)];
                let solved = [
                    fx + mxx * sum[0] + mxy * sum[1],
                    fy + mxy * sum[0] + myy * sum[1],
                ];
                let cell = &mut v[(x, y)];
                for (c, s) in cell.iter_mut().zip(solved) {
                    *c += RELAXATION * (s - *c);
                }
            }
        }
    }
}

/// Solves eq. 3 in each cell alone; cells whose system is not well conditioned stay.
fn solve_alone(v: &mut Plane<[f32; 2]>, normal: &Plane<Normal>) {
    for (cell, n) in v.as_mut_slice().iter_mut().zip(normal.as_slice()) {
        if let Some([dx, dy]) = solve_window(n) {
            cell[0] += dx;
            cell[1] += dy;
        }
    }
}

/// The 2x2 system of eq. 3: `None` unless its smaller eigenvalue is at least a hundredth of the larger.
fn solve_window(&[jxx, jxy, jyy, bx, by]: &Normal) -> Option<[f32; 2]> {
    let (small, large) = eigenvalues(jxx, jxy, jyy);
    if small < 1e-6 || small < 0.01 * large {
        return None;
    }
    let determinant = jxx * jyy - jxy * jxy;
    Some([
        (jxy * by - jyy * bx) / determinant,
        (jxy * bx - jxx * by) / determinant,
    ])
}

fn eigenvalues(xx: f32, xy: f32, yy: f32) -> (f32, f32) {
    let half = 0.5 * (xx + yy);
    let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
    ((half - spread).max(0.0), half + spread)
}

/// Smaller eigenvalue of a window at which half of the displacement counts as its own.
const HALF_DETERMINED: f32 = 0.005;

/// Share of the displacement that the window itself determines.
fn determinacy(&[xx, xy, yy, ..]: &Normal) -> f32 {
    let (small, _) = eigenvalues(xx, xy, yy);
    small / (small + HALF_DETERMINED)
}

#[cfg(test)]
mod tests;
