//! The pixels to draw on, in blocks of one vector each, and their rays.

use crate::camera::Camera;
use crate::lanes::{Eight, LANES, Lanes};
use crate::math::Vec3;
use crate::object::Object;
use crate::packet::ShearBlock;
use crate::ray::Ray;

/// Pixels of a block, in lane order row by row.
pub(super) const BLOCK_WIDTH: usize = 4;
pub(super) const BLOCK_HEIGHT: usize = LANES / BLOCK_WIDTH;

/// A rectangle of pixels in blocks.
#[derive(Clone, Copy)]
pub(super) struct Grid {
    pub(super) bounds: [usize; 4],
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Where in its pixel each ray passes.
    pub(super) offset: [f64; 2],
}

impl Grid {
    /// The grid of the pixels `[x0, y0, x1, y1)`, whose rays pass at `offset` in them.
    pub(super) fn new(bounds: [usize; 4], offset: [f64; 2]) -> Self {
        let [x0, y0, x1, y1] = bounds;
        Self {
            bounds,
            columns: (x1 - x0).div_ceil(BLOCK_WIDTH),
            rows: (y1 - y0).div_ceil(BLOCK_HEIGHT),
            offset,
        }
    }

    /// First pixel of a block.
    pub(super) fn corner(&self, index: usize) -> [usize; 2] {
        [
            self.bounds[0] + index % self.columns * BLOCK_WIDTH,
            self.bounds[1] + index / self.columns * BLOCK_HEIGHT,
        ]
    }

    /// Lanes of a block inside the rectangle.
    #[inline(always)]
    pub(super) fn inside(&self, [x, y]: [usize; 2]) -> u32 {
        if x + BLOCK_WIDTH <= self.bounds[2] && y + BLOCK_HEIGHT <= self.bounds[3] {
            return 0xFF;
        }
        (0..LANES).fold(0, |bits, lane| {
            let is_inside =
                x + lane % BLOCK_WIDTH < self.bounds[2] && y + lane / BLOCK_WIDTH < self.bounds[3];
            bits | u32::from(is_inside) << lane
        })
    }

    /// Blocks `[x0, y0, x1, y1)` that pixels can touch.
    pub(super) fn blocks_of(&self, pixels: [usize; 4]) -> [usize; 4] {
        let at = |v: usize, axis: usize, step: usize| v.saturating_sub(self.bounds[axis]) / step;
        [
            at(pixels[0], 0, BLOCK_WIDTH),
            at(pixels[1], 1, BLOCK_HEIGHT),
            (at(pixels[2], 0, BLOCK_WIDTH) + 1).min(self.columns),
            (at(pixels[3], 1, BLOCK_HEIGHT) + 1).min(self.rows),
        ]
    }
}

/// Fills in the rays of the blocks `[x0, y0, x1, y1)` of a grid, in an object's frame or the world's.
#[inline(always)]
pub(super) fn shear_blocks<L: Lanes>(
    grid: &Grid,
    camera: &Camera,
    object: Option<&Object>,
    [x0, y0, x1, y1]: [usize; 4],
    blocks: &mut [ShearBlock],
) {
    // Directions are sums of what the column and what the row gives
    let columns: Vec<[f64; 3]> = (0..grid.columns * BLOCK_WIDTH)
        .map(|x| camera.direction_of_column((grid.bounds[0] + x) as f64 + grid.offset[0]))
        .collect();
    for by in y0..y1 {
        let rows: [[f64; 3]; BLOCK_HEIGHT] = std::array::from_fn(|k| {
            let y = grid.bounds[1] + by * BLOCK_HEIGHT + k;
            camera.direction_of_row(y as f64 + grid.offset[1])
        });
        for bx in x0..x1 {
            let index = by * grid.columns + bx;
            let [x, y] = grid.corner(index);
            let mut direction = [Eight::default(); 3];
            let own = &columns[bx * BLOCK_WIDTH..(bx + 1) * BLOCK_WIDTH];
            for axis in 0..3 {
                for k in 0..BLOCK_HEIGHT {
                    for (lane, column) in own.iter().enumerate() {
                        let sum = (column[axis] + rows[k][axis]) as f32;
                        direction[axis].0[k * BLOCK_WIDTH + lane] = sum;
                    }
                }
            }
            if let Some(object) = object {
                for lane in 0..LANES {
                    let d = Vec3::from_fn(|k, _| direction[k].0[lane]);
                    let d = object.ray_in_object(&Ray::new(Vec3::zeros(), d)).direction;
                    direction[0].0[lane] = d.x;
                    direction[1].0[lane] = d.y;
                    direction[2].0[lane] = d.z;
                }
            }
            blocks[index] = ShearBlock::new::<L>(&direction, grid.inside([x, y]));
        }
    }
}
