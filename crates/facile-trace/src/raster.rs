//! The primary pass without a tree: triangles drawn over blocks of pixels.
//!
//! Every pixel of a triangle's box in the image gets the watertight test of [`crate::triangle`] with the pixel's own ray,
//! by the same operations as a packet's, so hits are those of the rays bit for bit: the boxes only save work. Triangles
//! that face the other way wait until the end, when most of them are found to be hidden.

use crate::camera::Camera;
use crate::footprint::{Projection, Steps, footprints};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, lanes_of, run};
use crate::math::{Vec3, vec3_from_point};
use crate::object::Object;
use crate::packet::{ShearBlock, meet_sheared};
use crate::ray::{Hit, NO_OBJECT, Ray};
use crate::scene::{Layer, Scene};

/// Pixels of a block, in lane order row by row.
const BLOCK_WIDTH: usize = 4;
const BLOCK_HEIGHT: usize = LANES / BLOCK_WIDTH;

/// More triangles per pixel than this, and packets through the tree are faster.
const MAX_TRIANGLES_PER_PIXEL: usize = 8;

/// Share by which a depth must be larger to be hidden for sure.
pub(crate) const DEPTH_SLACK: f32 = 1.0 - 2e-5;

/// Nearest hits of a block of pixels so far.
#[derive(Clone, Copy)]
struct HitBlock {
    t: Eight,
    hits: [LaneHit; LANES],
}

/// The rest of a hit.
#[derive(Clone, Copy)]
struct LaneHit {
    u: f32,
    v: f32,
    object: u32,
    triangle: u32,
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
    let blocks = run(Draw {
        scene,
        camera,
        layer,
        grid,
    });
    for (index, block) in blocks.iter().enumerate() {
        let corner = grid.corner(index);
        for (lane, hit) in block.hits.iter().enumerate() {
            if hit.object != NO_OBJECT {
                let pixel = [
                    corner[0] + lane % BLOCK_WIDTH,
                    corner[1] + lane / BLOCK_WIDTH,
                ];
                let hit = Hit {
                    t: block.t.0[lane],
                    object: hit.object,
                    triangle: hit.triangle,
                    u: hit.u,
                    v: hit.v,
                };
                visit(pixel.map(|v| v as u32), hit);
            }
        }
    }
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
    corners: &'a [[Vec3; 3]],
    ids: &'a [u32],
}

impl Kernel for Draw<'_> {
    type Output = Vec<HitBlock>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Vec<HitBlock> {
        let nothing = LaneHit {
            u: 0.0,
            v: 0.0,
            object: NO_OBJECT,
            triangle: 0,
        };
        let empty = HitBlock {
            t: Eight([f32::INFINITY; LANES]),
            hits: [nothing; LANES],
        };
        let grid = &self.grid;
        let mut blocks = vec![empty; grid.columns * grid.rows];
        let all = [0, 0, grid.columns, grid.rows];
        let projection = Projection::of_camera(self.camera);
        let eye = Ray::new(vec3_from_point(self.camera.position()), Vec3::z());
        let (mut in_world, mut in_object) = (Vec::new(), Vec::new());
        let mut waiting = Vec::new();
        let mut furthest = Vec::new();
        for (index, object) in self.scene.objects().iter().enumerate() {
            if !self.layer.sees(object) || object.bvh.is_empty() {
                continue;
            }
            let rays: &[ShearBlock] = if object.world_from_object.is_none() {
                if in_world.is_empty() {
                    in_world.resize(blocks.len(), ShearBlock::default());
                    shear_blocks::<L>(&self, None, all, &mut in_world);
                }
                &in_world
            } else {
                let Some(pixels) = self.camera.pixel_bounds(object.bounds_in_world()) else {
                    continue;
                };
                in_object.clear();
                in_object.resize(blocks.len(), ShearBlock::default());
                shear_blocks::<L>(&self, Some(object), grid.blocks_of(pixels), &mut in_object);
                &in_object
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
                let found = footprints::<L>(&local, &steps, triangles);
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
                        canvas.draw::<L>(&patch, None, &mut blocks);
                    }
                }
            }
            furthest.clear();
            furthest.extend(blocks.iter().map(|b| b.t.0.into_iter().fold(0.0, f32::max)));
            for patch in &waiting {
                canvas.draw::<L>(patch, Some(&furthest), &mut blocks);
            }
        }
        blocks
    }
}

impl Canvas<'_> {
    /// Draws a triangle where it is not behind `furthest`.
    #[inline(always)]
    fn draw<L: Lanes>(&self, patch: &Patch, furthest: Option<&[f32]>, blocks: &mut [HitBlock]) {
        let columns = self.grid.columns;
        let triangle = self.ids[patch.slot as usize];
        let [a, b, c] = self.corners[patch.slot as usize].map(|p| p - self.origin);
        for y in patch.first[1]..=patch.last[1] {
            for x in patch.first[0]..=patch.last[0] {
                let index = y as usize * columns + x as usize;
                if furthest.is_some_and(|f| patch.nearest > f[index]) {
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
                    let near = (met & meeting.t.le(nearest)).bits();
                    if near != 0 {
                        let (t, u, v) = (meeting.t.store(), meeting.v.store(), meeting.w.store());
                        for lane in lanes_of(near) {
                            let old = &block.hits[lane];
                            // Of equal distances the lower object, then the lower triangle wins
                            let is_later = old.object != self.object || old.triangle < triangle;
                            if t.0[lane] >= block.t.0[lane] && is_later {
                                continue;
                            }
                            block.t.0[lane] = t.0[lane];
                            block.hits[lane] = LaneHit {
                                u: u.0[lane],
                                v: v.0[lane],
                                object: self.object,
                                triangle,
                            };
                        }
                    }
                }
            }
        }
    }
}

/// Fills in the rays of the blocks `[x0, y0, x1, y1)` of a grid, in an object's frame or the world's.
#[inline(always)]
fn shear_blocks<L: Lanes>(
    pass: &Draw<'_>,
    object: Option<&Object>,
    [x0, y0, x1, y1]: [usize; 4],
    blocks: &mut [ShearBlock],
) {
    let grid = &pass.grid;
    for by in y0..y1 {
        for bx in x0..x1 {
            let index = by * grid.columns + bx;
            let [x, y] = grid.corner(index);
            let mut direction = [Eight::default(); 3];
            for lane in 0..LANES {
                let px = (x + lane % BLOCK_WIDTH) as f64 + grid.offset[0];
                let py = (y + lane / BLOCK_WIDTH) as f64 + grid.offset[1];
                let mut d = Vec3::from(pass.camera.direction([px, py]));
                if let Some(object) = object {
                    d = object.ray_in_object(&Ray::new(Vec3::zeros(), d)).direction;
                }
                direction[0].0[lane] = d.x;
                direction[1].0[lane] = d.y;
                direction[2].0[lane] = d.z;
            }
            blocks[index] = ShearBlock::new::<L>(&direction, grid.inside([x, y]));
        }
    }
}
