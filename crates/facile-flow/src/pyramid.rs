//! Gaussian pyramid of a cylinder image: half the cells a level, holes left out of every average.

use facile_core::Plane;

use crate::channels::{CHANNELS, CylinderImage};

/// Weights of the four cells along one axis that make one cell of the next level.
const TAPS: [f32; 4] = [0.125, 0.375, 0.375, 0.125];

/// Levels from fine to coarse; level 0 is the image itself.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// Images, finest first.
    pub levels: Vec<CylinderImage>,
}

impl Pyramid {
    /// Halves `image` until `levels` images exist or one side would fall below 12 cells.
    pub fn new(image: CylinderImage, levels: usize) -> Self {
        let mut all = vec![image];
        while let Some(last) = all.last().filter(|_| all.len() < levels) {
            if last.mask.width().min(last.mask.height()) < 24 {
                break;
            }
            let next = halve(last);
            all.push(next);
        }
        Self { levels: all }
    }
}

/// One level coarser: cell `X` lies between cells `2X` and `2X + 1`.
fn halve(image: &CylinderImage) -> CylinderImage {
    let (nx, ny) = (image.mask.width(), image.mask.height());
    let (half_x, half_y) = (nx.div_ceil(2), ny.div_ceil(2));
    let mut values = Plane::filled(half_x, half_y, [0.0_f32; CHANNELS]);
    let mut mask = Plane::filled(half_x, half_y, 0.0_f32);
    for y in 0..half_y {
        for x in 0..half_x {
            let (mut sum, mut plain, mut trust) = ([0.0_f32; CHANNELS], [0.0_f32; CHANNELS], 0.0);
            for (j, wy) in TAPS.iter().enumerate() {
                let row = (2 * y + j).saturating_sub(1).min(ny - 1);
                for (i, wx) in TAPS.iter().enumerate() {
                    let column = (2 * x + i).saturating_sub(1).min(nx - 1);
                    let weight = wx * wy;
                    let trusted = weight * image.mask[(column, row)];
                    let value = &image.values[(column, row)];
                    for k in 0..CHANNELS {
                        sum[k] += value[k] * trusted;
                        plain[k] += value[k] * weight;
                    }
                    trust += trusted;
                }
            }
            // Where nothing is trusted, the smooth filling goes on.
            values[(x, y)] = if trust > 1e-3 {
                sum.map(|s| s / trust)
            } else {
                plain
            };
            mask[(x, y)] = trust;
        }
    }
    CylinderImage { values, mask }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_stays_a_ramp_and_holes_do_not_leak() {
        let values = Plane::from_fn(64, 48, |x, y| {
            let ramp = 0.5 * x as f32 + 0.25 * y as f32;
            [if (20..24).contains(&x) { 1e3 } else { ramp }; CHANNELS]
        });
        let mask = Plane::from_fn(64, 48, |x, _| if (20..24).contains(&x) { 0.0 } else { 1.0 });
        let pyramid = Pyramid::new(CylinderImage { values, mask }, 3);
        assert_eq!(pyramid.levels.len(), 3);
        let level = &pyramid.levels[1];
        for y in 2..20 {
            for x in 15..30 {
                let expected = 0.5 * (2 * x) as f32 + 0.25 + 0.25 * (2 * y) as f32 + 0.125;
                assert!((level.values[(x, y)][0] - expected).abs() < 1e-3);
            }
            assert!(level.values[(9, y)][0] < 20.0, "no leak beside the hole");
            assert!(level.mask[(10, y)] < 0.2);
        }
    }
}
