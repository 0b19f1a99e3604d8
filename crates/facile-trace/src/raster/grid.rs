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
}

/// The rays of a grid: directions are sums of what the column and what the row gives.
#[derive(Default)]
pub(super) struct Rays {
    columns: Vec<[f64; 4]>,
    rows: Vec<[f64; 4]>,
    /// Rays of whole blocks, those that were asked for, and the frame that they are in.
    blocks: Vec<ShearBlock>,
    frames: Vec<u32>,
}

/// The rays of a grid in the frame of an object.
pub(super) struct LocalRays<'a> {
    pub(super) rays: &'a mut Rays,
    /// The object if it is posed.
    object: Option<&'a Object>,
    /// Number of the frame, from 1 on.
    frame: u32,
}

impl Rays {
    pub(super) fn take(&mut self, grid: &Grid, camera: &Camera) {
        let padded = |[a, b, c]: [f64; 3]| [a, b, c, 0.0];
        let [x0, y0] = [grid.bounds[0], grid.bounds[1]];
        let column = |x: usize| camera.direction_of_column((x0 + x) as f64 + grid.offset[0]);
        let row = |y: usize| camera.direction_of_row((y0 + y) as f64 + grid.offset[1]);
        self.columns.clear();
        self.columns
            .extend((0..grid.columns * BLOCK_WIDTH).map(|x| padded(column(x))));
        self.rows.clear();
        self.rows
            .extend((0..grid.rows * BLOCK_HEIGHT).map(|y| padded(row(y))));
        let count = grid.columns * grid.rows;
        self.blocks.resize(count, ShearBlock::default());
        self.frames.clear();
        self.frames.resize(count, 0);
    }

    /// The rays in the frame of an object, the `index`th of its scene.
    pub(super) fn in_frame_of<'a>(&'a mut self, object: &'a Object, index: usize) -> LocalRays<'a> {
        let is_posed = object.world_from_object.is_some();
        LocalRays {
            rays: self,
            object: is_posed.then_some(object),
            frame: if is_posed { index as u32 + 2 } else { 1 },
        }
    }
}

impl LocalRays<'_> {
    /// Direction of the ray of a pixel, counted from the grid's first, and an idle number.
    #[inline(always)]
    pub(super) fn direction(&self, x: usize, y: usize) -> [f32; 4] {
        let (column, row) = (&self.rays.columns[x], &self.rays.rows[y]);
        let sum = [
            (column[0] + row[0]) as f32,
            (column[1] + row[1]) as f32,
            (column[2] + row[2]) as f32,
            (column[3] + row[3]) as f32,
        ];
        let Some(object) = self.object else {
            return sum;
        };
        let ray = Ray::new(Vec3::zeros(), Vec3::new(sum[0], sum[1], sum[2]));
        let d = object.ray_in_object(&ray).direction;
        [d.x, d.y, d.z, 0.0]
    }

    /// The rays of a block.
    #[inline(always)]
    pub(super) fn block<L: Lanes>(&mut self, grid: &Grid, index: usize) -> ShearBlock {
        if self.rays.frames[index] != self.frame {
            let [x, y] = grid.corner(index);
            let [from_x, from_y] = [x - grid.bounds[0], y - grid.bounds[1]];
            let mut direction = [Eight::default(); 3];
            for lane in 0..LANES {
                let d = self.direction(from_x + lane % BLOCK_WIDTH, from_y + lane / BLOCK_WIDTH);
                for axis in 0..3 {
                    direction[axis].0[lane] = d[axis];
                }
            }
            self.rays.blocks[index] = ShearBlock::new::<L>(&direction, grid.inside([x, y]));
            self.rays.frames[index] = self.frame;
        }
        self.rays.blocks[index]
    }
}
