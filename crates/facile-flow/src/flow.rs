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
use relax::relax;

mod relax;

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
    /// Sweeps of line relaxation per warp.
    pub sweeps: usize,
}

impl Default for FlowParams {
    fn default() -> Self {
        Self {
            levels: 4,
            warps: 3,
            window_cells: 1.5,
            smoothness: 0.25,
            outlier: 0.3,
            sweeps: 14,
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

/// Computes the field that carries `source` onto `target`; both pyramids have the same shape.
pub fn displacement_field(
    source: &Pyramid,
    target: &Pyramid,
    params: &FlowParams,
) -> DisplacementField {
    field_down_to(source, target, params, 0)
}

/// As [`displacement_field`], from the coarsest level down to level `finest` only: a quarter of the time a level. The
/// field has the cells of level 0 all the same.
pub(crate) fn field_down_to(
    source: &Pyramid,
    target: &Pyramid,
    params: &FlowParams,
    finest: usize,
) -> DisplacementField {
    let count = source.levels.len().min(target.levels.len());
    let finest = finest.min(count - 1);
    let mut field: Option<Plane<[f32; 2]>> = None;
    let mut confidence = Plane::filled(1, 1, [0.0_f32]);
    for level in (finest..count).rev() {
        let (from, to) = (&source.levels[level], &target.levels[level]);
        let (nx, ny) = (from.mask.width(), from.mask.height());
        let mut v = match field {
            Some(coarse) => refine(&coarse, nx, ny),
            None => Plane::filled(nx, ny, [0.0; 2]),
        };
        let slopes = slopes(&from.values);
        for warp in 0..params.warps.max(1) {
            let normal = accumulate(from, &slopes, to, &v, params);
            if params.smoothness > 0.0 {
                relax(&mut v, &normal, params.smoothness as f32, params.sweeps);
            } else {
                solve_alone(&mut v, &normal);
            }
            if level == finest && warp + 1 == params.warps.max(1) {
                // A slope over a cell of level 1 is twice that over a cell of level 0.
                let scale = 0.25_f32.powi(level as i32);
                confidence = normal.map(|n| [determinacy(&n.map(|v| v * scale))]);
            }
        }
        field = Some(v);
    }
    let mut cells = field.unwrap_or_else(|| Plane::filled(1, 1, [0.0; 2]));
    for level in (0..finest).rev() {
        let mask = &source.levels[level].mask;
        cells = refine(&cells, mask.width(), mask.height());
        confidence = enlarge(&confidence, mask.width(), mask.height());
    }
    DisplacementField {
        cells,
        confidence: confidence.map(|c| c[0]),
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
    enlarge(coarse, nx, ny).map(|v| v.map(|c| 2.0 * c))
}

/// A plane of the next finer level.
fn enlarge<const N: usize>(coarse: &Plane<[f32; N]>, nx: usize, ny: usize) -> Plane<[f32; N]> {
    Plane::from_fn(nx, ny, |x, y| {
        bilinear(coarse, 0.5 * x as f32 - 0.25, 0.5 * y as f32 - 0.25)
    })
}

/// Half the central differences along columns and rows; 0 on the border.
fn slopes(values: &Plane<Channels>) -> Plane<[Channels; 2]> {
    let (nx, ny) = (values.width(), values.height());
    let mut slopes = Plane::filled(nx, ny, [[0.0; CHANNELS]; 2]);
    for y in 1..ny.saturating_sub(1) {
        let (down, row, up) = (values.row(y - 1), values.row(y), values.row(y + 1));
        let out = slopes.row_mut(y);
        for x in 1..nx.saturating_sub(1) {
            for k in 0..CHANNELS {
                out[x][0][k] = 0.25 * (row[x + 1][k] - row[x - 1][k]);
                out[x][1][k] = 0.25 * (up[x][k] - down[x][k]);
            }
        }
    }
    slopes
}

/// Gathers eq. 3 in every window, for the increment of `v`.
fn accumulate(
    from: &CylinderImage,
    from_slopes: &Plane<[Channels; 2]>,
    to: &CylinderImage,
    v: &Plane<[f32; 2]>,
    params: &FlowParams,
) -> Plane<Normal> {
    let (nx, ny) = (v.width(), v.height());
    let (last_x, last_y) = ((nx - 1) as f32, (ny - 1) as f32);
    let mut warped: Plane<Channels> = Plane::filled(nx, ny, [0.0; CHANNELS]);
    let mut trust = Plane::filled(nx, ny, 0.0_f32);
    for y in 0..ny {
        let (field, mask) = (v.row(y), from.mask.row(y));
        let (out, trusted) = (warped.row_mut(y), trust.row_mut(y));
        for x in 0..nx {
            let [dx, dy] = field[x];
            let (tx, ty) = (x as f32 + dx, y as f32 + dy);
            let (value, there) = masked_bilinear(to, tx, ty);
            out[x] = value;
            if tx >= 0.0 && tx <= last_x && ty >= 0.0 && ty <= last_y {
                trusted[x] = mask[x] * there;
            }
        }
    }
    let scale = 1.0 / (params.outlier * params.outlier).max(1e-12) as f32;
    let mut normal: Plane<Normal> = Plane::filled(nx, ny, [0.0; 5]);
    for y in 1..ny.saturating_sub(1) {
        let (below, here, above) = (trust.row(y - 1), trust.row(y), trust.row(y + 1));
        let (down, row, up) = (warped.row(y - 1), warped.row(y), warped.row(y + 1));
        let (source, slopes) = (from.values.row(y), from_slopes.row(y));
        let out = normal.row_mut(y);
        for x in 1..nx.saturating_sub(1) {
            // Beside a hole there is no gradient.
            let around = here[x - 1].min(here[x + 1]).min(below[x]).min(above[x]);
            if here[x].min(around) <= 0.0 {
                continue;
            }
            // Gradients of both images at the same place: their mean halves the error of the linearisation.
            let (mut sum, mut square) = ([0.0_f32; 5], 0.0);
            for k in 0..CHANNELS {
                let gx = 0.25 * (row[x + 1][k] - row[x - 1][k]) + slopes[x][0][k];
                let gy = 0.25 * (up[x][k] - down[x][k]) + slopes[x][1][k];
                let change = row[x][k] - source[x][k];
                square += change * change;
                sum[0] += gx * gx;
                sum[1] += gx * gy;
                sum[2] += gy * gy;
                sum[3] += gx * change;
                sum[4] += gy * change;
            }
            // Charbonnier weight of the whole cell.
            let weight = here[x] / (1.0 + square * scale).sqrt();
            out[x] = sum.map(|s| s * weight);
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
    let (row0, row1) = (image.values.row(y0), image.values.row(y1));
    let (mask0, mask1) = (image.mask.row(y0), image.mask.row(y1));
    let corners = [
        (&row0[x0], mask0[x0] * (1.0 - fx) * (1.0 - fy)),
        (&row0[x1], mask0[x1] * fx * (1.0 - fy)),
        (&row1[x0], mask1[x0] * (1.0 - fx) * fy),
        (&row1[x1], mask1[x1] * fx * fy),
    ];
    let (mut sum, mut trust) = ([0.0_f32; CHANNELS], 0.0);
    for (value, weight) in corners {
        for k in 0..CHANNELS {
            sum[k] += value[k] * weight;
        }
        trust += weight;
    }
    if trust > 1e-3 {
        let scale = 1.0 / trust;
        (sum.map(|s| s * scale), trust)
    } else {
        (sum, 0.0)
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
