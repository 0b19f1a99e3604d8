//! What is hidden by something nearer, block by block and tile by tile of blocks.

use super::blocks::HitBlock;
use super::grid::Grid;

/// Blocks along each side of a tile.
const TILE: usize = 4;

/// A triangle and the blocks it may touch, both ends included.
#[derive(Clone, Copy)]
pub(super) struct Patch {
    /// Place in leaf order.
    pub(super) slot: u32,
    pub(super) first: [u32; 2],
    pub(super) last: [u32; 2],
    pub(super) nearest: f32,
}

/// Largest distance of each block's hits at some time before, and of each tile of blocks: what is behind is hidden.
#[derive(Default)]
pub(super) struct Furthest {
    columns: usize,
    pub(super) blocks: Vec<f32>,
    tile_columns: usize,
    tiles: Vec<f32>,
}

impl Furthest {
    /// Nothing is hidden.
    pub(super) fn clear(&mut self, grid: &Grid) {
        (self.columns, self.tile_columns) = (grid.columns, grid.columns.div_ceil(TILE));
        let tiles = self.tile_columns * grid.rows.div_ceil(TILE);
        self.blocks.clear();
        self.blocks.resize(grid.columns * grid.rows, f32::INFINITY);
        self.tiles.clear();
        self.tiles.resize(tiles, f32::INFINITY);
    }

    pub(super) fn update(&mut self, blocks: &[HitBlock]) {
        self.tiles.fill(0.0);
        let rows = blocks.chunks(self.columns);
        let own = self.blocks.chunks_mut(self.columns);
        for (y, (row, own)) in rows.zip(own).enumerate() {
            let tiles = &mut self.tiles[y / TILE * self.tile_columns..];
            let columns = row.chunks(TILE).zip(own.chunks_mut(TILE));
            for ((blocks, own), tile) in columns.zip(tiles) {
                for (block, own) in blocks.iter().zip(own) {
                    let [a, b, c, d, e, f, g, h] = block.t.0;
                    *own = a.max(b).max(c.max(d)).max(e.max(f).max(g.max(h)));
                    *tile = tile.max(*own);
                }
            }
        }
    }

    /// Whether a triangle is hidden everywhere.
    #[inline(always)]
    pub(super) fn hides(&self, patch: &Patch) -> bool {
        let [from, to] = [patch.first, patch.last].map(|at| at.map(|v| v as usize / TILE));
        for y in from[1]..=to[1] {
            let row = y * self.tile_columns;
            let tiles = &self.tiles[row + from[0]..=row + to[0]];
            if tiles.iter().any(|furthest| patch.nearest <= *furthest) {
                return false;
            }
        }
        true
    }
}
