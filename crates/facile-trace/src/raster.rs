//! The primary pass without a tree: triangles drawn over blocks of pixels.
//!
//! Every pixel of a triangle's box in the image gets the watertight test of [`crate::triangle`] with the pixel's own ray,
//! by the same operations as a packet's, so hits are those of the rays bit for bit: the boxes only save work. Triangles
//! that face the other way wait until the end, when most of them are found to be hidden.

use crate::camera::Camera;
use crate::footprint::{Projection, Steps, footprints, project_corners};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, lanes_of, run};
use crate::math::{Vec3, vec3_from_point};
use crate::object::Object;
use crate::packet::{ShearBlock, meet_sheared};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::scratch;
use std::cell::Cell;

/// Pixels of a block, in lane order row by row.
const BLOCK_WIDTH: usize = 4;
const BLOCK_HEIGHT: usize = LANES / BLOCK_WIDTH;

/// Blocks along each side of a tile.
const TILE: usize = 4;

/// More triangles per pixel than this, and packets through the tree are faster.
const MAX_TRIANGLES_PER_PIXEL: usize = 8;

/// Share by which a depth must be larger to be hidden for sure.
pub(crate) const DEPTH_SLACK: f32 = 1.0 - 2e-5;

/// Nearest hits of a block of pixels so far.
#[derive(Clone, Copy)]
struct HitBlock {
    t: Eight,
    u: Eight,
    v: Eight,
    /// Bits are the triangle's number, see [`carried`].
    triangle: Eight,
    /// Bits are one more than the object's number, 0 for none.
    object: Eight,
}

impl HitBlock {
    const EMPTY: Self = Self {
        t: Eight([f32::INFINITY; LANES]),
        u: Eight([0.0; LANES]),
        v: Eight([0.0; LANES]),
        triangle: Eight([0.0; LANES]),
        object: Eight([0.0; LANES]),
    };

    /// Lanes with a hit.
    fn hit(&self) -> u32 {
        let object = self.object.0.iter().enumerate();
        object.fold(0, |bits, (lane, v)| {
            bits | u32::from(v.to_bits() != 0) << lane
        })
    }

    /// The hit of a lane, if there is one.
    fn get(&self, lane: usize) -> Option<Hit> {
        let object = self.object.0[lane].to_bits();
        (object != 0).then(|| Hit {
            t: self.t.0[lane],
            object: object - 1,
            triangle: self.triangle.0[lane].to_bits(),
            u: self.u.0[lane],
            v: self.v.0[lane],
        })
    }
}

/// A number in the bits of an `f32`, for lanes that are moved and never computed with.
fn carried(number: u32) -> f32 {
    f32::from_bits(number)
}

/// A rectangle of pixels in blocks.
#[derive(Clone, Copy)]
struct Grid {
    bounds: [usize; 4],
    columns: usize,
    rows: usize,
    /// Where in its pixel each ray passes.
    offset: [f64; 2],
}

/// Whether drawing is possible, and likely faster than rays, for the pixels `[x0, y0, x1, y1)`. Depends on the scene and
/// the camera alone.
pub(crate) fn suits(scene: &Scene, camera: &Camera, layer: Layer, bounds: [usize; 4]) -> bool {
    let pixels = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]);
    let seen = || scene.objects().iter().filter(|o| layer.sees(o));
    let triangles: usize = seen().map(|o| o.geometry.triangles.len()).sum();
    let projection = Projection::of_camera(camera);
    triangles <= MAX_TRIANGLES_PER_PIXEL * pixels
        && seen()
            .filter_map(Object::bounds_in_world)
            .all(|b| projection.is_in_front(b))
}

/// Calls `visit` with each pixel of `[x0, y0, x1, y1)` that shows a surface at `offset` in it, block by block.
pub(crate) fn draw(
    scene: &Scene,
    camera: &Camera,
    layer: Layer,
    bounds: [usize; 4],
    offset: [f64; 2],
    mut visit: impl FnMut([u32; 2], Hit),
) {
    let [x0, y0, x1, y1] = bounds;
    let grid = Grid {
        bounds,
        columns: (x1 - x0).div_ceil(BLOCK_WIDTH),
        rows: (y1 - y0).div_ceil(BLOCK_HEIGHT),
        offset,
    };
    scratch::with(&SCRATCH, |scratch| {
        run(Draw {
            scene,
            camera,
            layer,
            grid,
            scratch,
        });
        for (index, block) in scratch.blocks.iter().enumerate() {
            let corner = grid.corner(index);
            for lane in lanes_of(block.hit()) {
                let pixel = [
                    (corner[0] + lane % BLOCK_WIDTH) as u32,
                    (corner[1] + lane / BLOCK_WIDTH) as u32,
                ];
                if let Some(hit) = block.get(lane) {
                    visit(pixel, hit);
                }
            }
        }
    });
}

impl Grid {
    /// First pixel of a block.
    fn corner(&self, index: usize) -> [usize; 2] {
        [
            self.bounds[0] + index % self.columns * BLOCK_WIDTH,
            self.bounds[1] + index / self.columns * BLOCK_HEIGHT,
        ]
    }

    /// Lanes of a block inside the rectangle.
    #[inline(always)]
    fn inside(&self, [x, y]: [usize; 2]) -> u32 {
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
    fn blocks_of(&self, pixels: [usize; 4]) -> [usize; 4] {
        let at = |v: usize, axis: usize, step: usize| v.saturating_sub(self.bounds[axis]) / step;
        [
            at(pixels[0], 0, BLOCK_WIDTH),
            at(pixels[1], 1, BLOCK_HEIGHT),
            (at(pixels[2], 0, BLOCK_WIDTH) + 1).min(self.columns),
            (at(pixels[3], 1, BLOCK_HEIGHT) + 1).min(self.rows),
        ]
    }
}

struct Draw<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    layer: Layer,
    grid: Grid,
    scratch: &'a mut Scratch,
}

/// Buffers of [`draw`].
#[derive(Default)]
struct Scratch {
    blocks: Vec<HitBlock>,
    /// Rays of all blocks in the world, and of some in an object's frame.
    in_world: Vec<ShearBlock>,
    in_object: Vec<ShearBlock>,
    waiting: Vec<Patch>,
    furthest: Furthest,
}

/// Largest distance of each block's hits at some time before, and of each tile of blocks: what is behind is hidden.
#[derive(Default)]
struct Furthest {
    columns: usize,
    blocks: Vec<f32>,
    tile_columns: usize,
    tiles: Vec<f32>,
}

impl Furthest {
    /// Nothing is hidden.
    fn clear(&mut self, grid: &Grid) {
        (self.columns, self.tile_columns) = (grid.columns, grid.columns.div_ceil(TILE));
        let tiles = self.tile_columns * grid.rows.div_ceil(TILE);
        self.blocks.clear();
        self.blocks.resize(grid.columns * grid.rows, f32::INFINITY);
        self.tiles.clear();
        self.tiles.resize(tiles, f32::INFINITY);
    }

    fn update(&mut self, blocks: &[HitBlock]) {
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
    fn hides(&self, patch: &Patch) -> bool {
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

thread_local! {
    static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
}

/// A triangle and the blocks it may touch, both ends included.
#[derive(Clone, Copy)]
struct Patch {
    /// Place in leaf order.
    slot: u32,
    first: [u32; 2],
    last: [u32; 2],
    nearest: f32,
}

/// What is being drawn.
struct Canvas<'a> {
    grid: &'a Grid,
    rays: &'a [ShearBlock],
    object: u32,
    /// Start of the rays in the object's frame.
    origin: Vec3,
    /// Corners and numbers of the triangles, in leaf order: neighbours come together.
    corners: &'a [[[f32; 3]; 3]],
    ids: &'a [u32],
}

impl Kernel for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let grid = &self.grid;
        let Scratch {
            blocks,
            in_world,
            in_object,
            waiting,
            furthest,
        } = self.scratch;
        let count = grid.columns * grid.rows;
        blocks.clear();
        blocks.resize(count, HitBlock::EMPTY);
        furthest.clear(grid);
        in_world.clear();
        in_object.clear();
        let all = [0, 0, grid.columns, grid.rows];
        let projection = Projection::of_camera(self.camera);
        let eye = Ray::new(vec3_from_point(self.camera.position()), Vec3::z());
        for (index, object) in self.scene.objects().iter().enumerate() {
            if !self.layer.sees(object) || object.bvh.is_empty() {
                continue;
            }
            let mut own = None;
            let rays: &[ShearBlock] = if object.world_from_object.is_none() {
                if in_world.is_empty() {
                    in_world.resize(count, ShearBlock::default());
                    shear_blocks::<L>(grid, self.camera, None, all, in_world);
                }
                in_world
            } else {
                let Some(pixels) = self.camera.pixel_bounds(object.bounds_in_world()) else {
                    continue;
                };
                let area = grid.blocks_of(pixels);
                own = Some(area);
                in_object.resize(count, ShearBlock::default());
                shear_blocks::<L>(grid, self.camera, Some(object), area, in_object);
                in_object
            };
            let canvas = Canvas {
                grid,
                rays,
                object: index as u32,
                origin: object.ray_in_object(&eye).origin,
                corners: &object.bvh.corners,
                ids: &object.bvh.triangle_ids,
            };
            let local = projection.in_frame_of(Some(object), 0.0);
            let steps = Steps {
                count: [
                    grid.bounds[2] - grid.bounds[0],
                    grid.bounds[3] - grid.bounds[1],
                ],
                first: [0, 1].map(|k| (grid.bounds[k] as f64 + grid.offset[k]) as f32),
                is_lattice: true,
            };
            waiting.clear();
            for (eight, triangles) in canvas.corners.chunks(LANES).enumerate() {
                let corners = project_corners::<L>(&local, triangles);
                let found = footprints::<L>(&local, &steps, &corners, triangles.len());
                for lane in lanes_of(found.present) {
                    let patch = Patch {
                        slot: (eight * LANES + lane) as u32,
                        first: [
                            found.first[0][lane] as u32 / BLOCK_WIDTH as u32,
                            found.first[1][lane] as u32 / BLOCK_HEIGHT as u32,
                        ],
                        last: [
                            found.last[0][lane] as u32 / BLOCK_WIDTH as u32,
                            found.last[1][lane] as u32 / BLOCK_HEIGHT as u32,
                        ],
                        nearest: found.nearest.0[lane] * DEPTH_SLACK,
                    };
                    // Front faces of a mesh that is wound the usual way turn clockwise, since y points down
                    if found.clockwise >> lane & 1 == 1 {
                        waiting.push(patch);
                    } else {
                        canvas.draw::<L>(&patch, furthest, blocks);
                    }
                }
            }
            // An object of few triangles hides little
            if canvas.corners.len() * 16 > count {
                furthest.update(blocks);
            }
            for patch in &*waiting {
                canvas.draw::<L>(patch, furthest, blocks);
            }
            // Leave no rays to the next object
            if let Some([x0, y0, x1, y1]) = own {
                for y in y0..y1 {
                    let row = y * grid.columns;
                    in_object[row + x0..row + x1].fill(ShearBlock::default());
                }
            }
        }
    }
}

impl Canvas<'_> {
    /// Draws a triangle where it is not behind `furthest`.
    #[inline(always)]
    fn draw<L: Lanes>(&self, patch: &Patch, furthest: &Furthest, blocks: &mut [HitBlock]) {
        if furthest.hides(patch) {
            return;
        }
        let columns = self.grid.columns;
        let triangle = self.ids[patch.slot as usize];
        let [a, b, c] = self.corners[patch.slot as usize].map(|p| Vec3::from(p) - self.origin);
        for y in patch.first[1]..=patch.last[1] {
            for x in patch.first[0]..=patch.last[0] {
                let index = y as usize * columns + x as usize;
                if patch.nearest > furthest.blocks[index] {
                    continue;
                }
                let (rays, block) = (&self.rays[index], &mut blocks[index]);
                let shear = rays.shear::<L>();
                for axis in rays.axes() {
                    let [i, j, k] = ShearBlock::axes_from(axis);
                    let Some(meeting) = meet_sheared(
                        [
                            [L::splat(a[i]), L::splat(a[j]), L::splat(a[k])],
                            [L::splat(b[i]), L::splat(b[j]), L::splat(b[k])],
                            [L::splat(c[i]), L::splat(c[j]), L::splat(c[k])],
                        ],
                        &shear,
                        L::Mask::from_bits(rays.by_axis[axis]),
                    ) else {
                        continue;
                    };
                    let nearest = L::load(&block.t);
                    let met = meeting.met & L::splat(0.0).lt(meeting.t);
                    let mut closer = met & meeting.t.lt(nearest);
                    // Of equal distances the lower object, then the lower triangle wins
                    let tied = (met & meeting.t.eq(nearest)).bits();
                    if tied != 0 {
                        let is_lower = |lane: &usize| {
                            let old = block.get(*lane);
                            old.is_some_and(|h| h.object == self.object && triangle < h.triangle)
                        };
                        let lower = lanes_of(tied).filter(is_lower);
                        let lower = lower.fold(0, |bits, lane| bits | 1 << lane);
                        closer = closer | L::Mask::from_bits(lower);
                    }
                    if !closer.any() {
                        continue;
                    }
                    block.t = L::select(closer, meeting.t, nearest).store();
                    block.u = L::select(closer, meeting.v, L::load(&block.u)).store();
                    block.v = L::select(closer, meeting.w, L::load(&block.v)).store();
                    let own = L::splat(carried(triangle));
                    block.triangle = L::select(closer, own, L::load(&block.triangle)).store();
                    let own = L::splat(carried(self.object + 1));
                    block.object = L::select(closer, own, L::load(&block.object)).store();
                }
            }
        }
    }
}

/// Fills in the rays of the blocks `[x0, y0, x1, y1)` of a grid, in an object's frame or the world's.
#[inline(always)]
fn shear_blocks<L: Lanes>(
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
