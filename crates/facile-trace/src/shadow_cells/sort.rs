//! Which rays of a light each cell of its image holds.

use super::{Block, Cells, Head, MAX_SIDE, RAYS_PER_CELL, Starts, TILE, UNTOUCHED};
use crate::footprint::LocalProjection;
use crate::lanes::{LANES, LaneMask, Lanes, V3, lanes_of};
use crate::sight::LightRays;

impl Block<'_> {
    /// Sorts the rays into cells, and returns the image in cells.
    #[inline(always)]
    pub(super) fn sort<L: Lanes>(&mut self) -> LocalProjection {
        // Find where the rays appear
        let (low, high) = self.place::<L>();
        let cells = &mut *self.cells;
        // Lay square cells over them
        let size = [0, 1].map(|k| (high[k] - low[k]).max(1e-6));
        let wanted = (self.image.rays / RAYS_PER_CELL).max(1) as f32;
        let across = (wanted * size[0] / size[1]).sqrt().clamp(1.0, MAX_SIDE);
        let columns = across.ceil() as usize;
        let rows = (wanted / across).ceil().clamp(1.0, MAX_SIDE) as usize;
        (cells.columns, cells.rows) = (columns, rows);
        let steps = [columns as f32, rows as f32];
        self.image.projection.fit(low, high, steps);
        let local = self.image.projection.in_frame_of(None, self.reach);
        cells.local = Some(local);
        let scale = [0, 1].map(|k| steps[k] / size[k]);
        cells.count::<L>(self.rays, low, scale, local.is_parallel());
        cells.give_blocks();
        cells.fill(self.rays);
        local
    }

    /// Finds image position and depth of the start of each ray, and the box around them.
    #[inline(always)]
    fn place<L: Lanes>(&mut self) -> ([f32; 2], [f32; 2]) {
        let local = self.image.projection.in_frame_of(None, self.reach);
        let arriving = self.rays.arriving;
        let at = &mut self.cells.at;
        at.clear();
        at.resize(arriving.lit.len(), Starts::default());
        let (far, none) = (L::splat(f32::INFINITY), L::splat(f32::NEG_INFINITY));
        let (mut low, mut high) = ([far; 2], [none; 2]);
        for (index, lit) in arriving.lit.iter().enumerate() {
            if *lit == 0 {
                continue;
            }
            let place = local.project(V3::<L>::load(&arriving.start[index]));
            at[index] = place.store();
            let lit = L::Mask::from_bits(*lit);
            for k in 0..2 {
                low[k] = L::select(lit, place.0[k], far).min(low[k]);
                high[k] = L::select(lit, place.0[k], none).max(high[k]);
            }
        }
        let (low, high) = (
            [low[0].store(), low[1].store()],
            [high[0].store(), high[1].store()],
        );
        (
            low.map(|v| v.0.into_iter().fold(f32::INFINITY, f32::min)),
            high.map(|v| v.0.into_iter().fold(f32::NEG_INFINITY, f32::max)),
        )
    }
}

impl Cells {
    /// Finds the cell of each ray, and how many each cell has.
    #[inline(always)]
    fn count<L: Lanes>(
        &mut self,
        rays: &LightRays<'_>,
        low: [f32; 2],
        scale: [f32; 2],
        is_parallel: bool,
    ) {
        self.next.clear();
        self.next.resize(self.columns * self.rows, 0);
        self.cell_of.clear();
        self.cell_of.resize(rays.lit().len(), [0; LANES]);
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let last = [
            L::splat((self.columns - 1) as f32),
            L::splat((self.rows - 1) as f32),
        ];
        for (index, lit) in rays.lit().iter().enumerate() {
            if *lit == 0 {
                continue;
            }
            let V3([x, y, z]) = V3::<L>::load(&self.at[index]);
            let x = (x - L::splat(low[0])) * L::splat(scale[0]);
            let y = (y - L::splat(low[1])) * L::splat(scale[1]);
            let near = if is_parallel { zero - z } else { one / z };
            self.at[index] = V3([x, y, near]).store();
            let column = x.max(zero).min(last[0]).trunc();
            let row = y.max(zero).min(last[1]).trunc();
            // Whole numbers below 2^24 are exact
            let cell = (row * L::splat(self.columns as f32) + column).to_i32();
            for lane in lanes_of(*lit) {
                self.cell_of[index][lane] = cell[lane] as u32;
                self.next[cell[lane] as usize] += 1;
            }
        }
    }

    /// Gives each cell whole blocks.
    fn give_blocks(&mut self) {
        self.first.clear();
        let mut total = 0;
        for slot in &mut self.next {
            self.first.push(total);
            let blocks = slot.div_ceil(LANES as u32);
            *slot = total * LANES as u32;
            total += blocks;
        }
        self.first.push(total);
    }

    /// Moves the rays to their cells.
    #[inline(always)]
    fn fill(&mut self, rays: &LightRays<'_>) {
        let total = self.first[self.first.len() - 1] as usize;
        let nothing = Head {
            lowest: f32::INFINITY,
            present: 0,
            open: 0,
            block: UNTOUCHED,
        };
        self.blocks.clear();
        self.rays.clear();
        self.rays.resize(total, [0; LANES]);
        self.heads.clear();
        self.heads.resize(total, nothing);
        self.starts.clear();
        self.starts.resize(total, Starts::default());
        self.tile_columns = self.columns.div_ceil(TILE);
        self.tiles.clear();
        self.tiles
            .resize(self.tile_columns * self.rows.div_ceil(TILE), f32::INFINITY);
        for (index, lit) in rays.lit().iter().enumerate() {
            for lane in lanes_of(*lit) {
                let cell = self.cell_of[index][lane] as usize;
                let slot = self.next[cell] as usize;
                self.next[cell] += 1;
                let (block, to) = (slot / LANES, slot % LANES);
                self.rays[block][to] = (index * LANES + lane) as u32;
                for k in 0..3 {
                    self.starts[block][k].0[to] = self.at[index][k].0[lane];
                }
                let near = self.at[index][2].0[lane];
                let head = &mut self.heads[block];
                head.lowest = head.lowest.min(near);
                head.present |= 1 << to;
                head.open = head.present;
            }
        }
        // Find the smallest nearness of each tile
        for row in 0..self.rows {
            let tiles = row / TILE * self.tile_columns;
            for column in 0..self.columns {
                let cell = row * self.columns + column;
                let blocks = self.first[cell] as usize..self.first[cell + 1] as usize;
                let tile = &mut self.tiles[tiles + column / TILE];
                for head in &self.heads[blocks] {
                    *tile = tile.min(head.lowest);
                }
            }
        }
    }
}
