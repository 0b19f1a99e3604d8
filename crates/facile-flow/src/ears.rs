//! Where the ears are on the cylinder: by comparing blocks, since they lie further from the mean head's than the flow can
//! follow.
//!
//! An ear is a small, strong pattern at the end of smooth cheeks. People's ears lie up to 2 cm from the mean head's after
//! pose and size are right, more than an ear's folds are wide, so the flow finds a wrong fold. Here the block that
//! shows the head's ear is shifted over the scan's image, and the shift with the best correlation of all channels is
//! taken, if it is clear.

use facile_core::Plane;

use crate::channels::{CHANNELS, CylinderImage};

/// Furthest shift that is tried along either axis, mm.
const FURTHEST: f64 = 21.0;
/// Standard deviation of the shifts that people show, mm: breaks ties between folds.
const USUAL: f64 = 12.0;
/// What the prior of a shift counts against the correlation.
const PRIOR: f64 = 0.1;
/// Least correlation of an ear that is believed.
const LEAST: f64 = 0.5;
/// Surroundings that belong to the block, mm.
const MARGIN: f64 = 6.0;
/// Least share of the block that the scan must show.
const SHOWN: f64 = 0.7;

/// The shift in cells that carries the cells of `ear` from `head` to `scan`. `None` if none is clear.
pub(crate) fn find(
    head: &CylinderImage,
    scan: &CylinderImage,
    ear: &Plane<bool>,
    cell_mm: f64,
) -> Option<[f64; 2]> {
    let (nx, ny) = (ear.width() as i32, ear.height() as i32);
    let block = block(ear, (MARGIN / cell_mm).round() as i32)?;
    let reach = (FURTHEST / cell_mm).round() as i32;
    // Every second cell is enough, the same from left and right: the channels are smooth.
    let cells: Vec<(i32, i32)> = (block.rows.0..=block.rows.1)
        .flat_map(|y| (block.columns.0..=block.columns.1).map(move |x| (x, y)))
        .filter(|(x, y)| ((*x).min(nx - 1 - x) + y) % 2 == 0)
        .filter(|&(x, y)| head.mask[(x as usize, y as usize)] > 0.0)
        .collect();
    let mut best: Option<(f64, [f64; 2])> = None;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let (mut hs, mut hh, mut ss, mut shown) = (0.0_f32, 1e-9_f32, 1e-9_f32, 0);
            for &(x, y) in &cells {
                let (u, v) = (x + dx, y + dy);
                if u < 0 || v < 0 || u >= nx || v >= ny {
                    continue;
                }
                let at = (u as usize, v as usize);
                if scan.mask[at] <= 0.0 {
                    continue;
                }
                shown += 1;
                let (h, s) = (&head.values[(x as usize, y as usize)], &scan.values[at]);
                for k in 0..CHANNELS {
                    hs += h[k] * s[k];
                    hh += h[k] * h[k];
                    ss += s[k] * s[k];
                }
            }
            if f64::from(shown) < SHOWN * cells.len() as f64 {
                continue;
            }
            let correlation = f64::from(hs / (hh * ss).sqrt());
            let square = f64::from(dx * dx + dy * dy) * cell_mm * cell_mm;
            let score = correlation - PRIOR * square / (USUAL * USUAL);
            if correlation > LEAST && best.is_none_or(|b| score > b.0) {
                best = Some((score, [f64::from(dx), f64::from(dy)]));
            }
        }
    }
    best.map(|b| b.1)
}

/// Columns and rows, first and last, of a block.
struct Block {
    columns: (i32, i32),
    rows: (i32, i32),
}

/// The cells around those that are set. `None` if none is.
fn block(set: &Plane<bool>, margin: i32) -> Option<Block> {
    let (nx, ny) = (set.width() as i32, set.height() as i32);
    let (mut columns, mut rows) = ((nx, -1), (ny, -1));
    for y in 0..ny {
        for x in 0..nx {
            if set[(x as usize, y as usize)] {
                columns = (columns.0.min(x), columns.1.max(x));
                rows = (rows.0.min(y), rows.1.max(y));
            }
        }
    }
    (columns.1 >= 0).then(|| Block {
        columns: (
            (columns.0 - margin).max(0),
            (columns.1 + margin).min(nx - 1),
        ),
        rows: ((rows.0 - margin).max(0), (rows.1 + margin).min(ny - 1)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ear_elsewhere_is_found_and_none_where_there_is_none() {
        let pattern = |x: f32, y: f32| {
            let r = (x - 30.0).hypot(y - 40.0);
            [if r < 10.0 { (0.9 * r).cos() } else { 0.0 }; CHANNELS]
        };
        let image = |dx: f32, dy: f32| CylinderImage {
            values: Plane::from_fn(80, 80, |x, y| pattern(x as f32 - dx, y as f32 - dy)),
            mask: Plane::filled(80, 80, 1.0_f32),
        };
        let ear = Plane::from_fn(80, 80, |x, y| {
            (x as f32 - 30.0).hypot(y as f32 - 40.0) < 8.0
        });
        let head = image(0.0, 0.0);
        assert_eq!(find(&head, &image(7.0, -9.0), &ear, 1.5), Some([7.0, -9.0]));
        let smooth = CylinderImage {
            values: Plane::from_fn(80, 80, |x, _| [x as f32 * 0.01 - 0.4; CHANNELS]),
            mask: Plane::filled(80, 80, 1.0_f32),
        };
        assert_eq!(find(&head, &smooth, &ear, 1.5), None);
    }
}
