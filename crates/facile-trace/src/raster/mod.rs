//! The primary pass without a tree: triangles drawn over blocks of pixels.
//!
//! Every pixel of a triangle's box in the image gets the watertight test of [`crate::triangle`] with the pixel's own ray,
//! by the same operations as a packet's, so hits are those of the rays bit for bit: the boxes only save work. Triangles
//! that face the other way wait until the end, when most of them are found to be hidden. What lies behind the nearest
//! surfaces is kept in the same pass if it is wanted: further surfaces in levels ([`blocks`]), and what there is without
//! occluders by drawing those last.

mod blocks;
mod grid;
mod hidden;
pub(crate) mod samples;

use std::cell::Cell;

use crate::camera::Camera;
use crate::cutout::{Admit, Solid};
use crate::footprint::{LocalProjection, Projection, Steps, footprints, project_corners};
use crate::lanes::{Kernel, LANES, LaneMask, Lanes, lanes_of, run};
use crate::math::{Vec3, vec3_from_point};
use crate::object::Object;
use crate::packet::{Meeting, ShearBlock, meet_sheared};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::scratch;
use blocks::{HitBlock, Level, Numbers, carried, insert};
use grid::{BLOCK_HEIGHT, BLOCK_WIDTH, Grid, shear_blocks};
use hidden::{Furthest, Patch};

/// More triangles per sample than this, and packets through the tree are faster.
const MAX_TRIANGLES_PER_SAMPLE: usize = 8;

/// Share by which a depth must be larger to be hidden for sure.
pub(crate) const DEPTH_SLACK: f32 = 1.0 - 2e-5;

/// What is wanted beside the nearest surface of each pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wanted {
    /// The nearest surface that is no occluder's.
    pub(crate) behind_occluders: bool,
    /// Number of further surfaces.
    pub(crate) further: usize,
}

/// What a pixel shows.
pub(crate) struct Seen<'a> {
    pub(crate) pixel: [u32; 2],
    pub(crate) hit: Hit,
    behind_occluders: &'a HitBlock,
    levels: &'a [Level],
    lane: usize,
    numbers: &'a Numbers,
}

impl Seen<'_> {
    /// The hit without occluders, [`Hit::MISS`] where there is nothing else; `hit` unless asked for.
    pub(crate) fn behind_occluders(&self) -> Hit {
        self.behind_occluders.get(self.lane, self.numbers)
    }

    /// Distance, object and triangle of each further surface, nearest first.
    pub(crate) fn further(&self) -> impl Iterator<Item = (f32, [u32; 2])> {
        let found = self.levels.iter().map(|level| level.t.0[self.lane]);
        let number = |k: usize| self.levels[k].number.0[self.lane].to_bits();
        let surface = move |(k, t)| (t, self.numbers.surface(number(k)));
        found
            .take_while(|t| *t < f32::INFINITY)
            .enumerate()
            .map(surface)
    }
}

/// Whether drawing so many samples is possible, which it is for pinholes, and likely faster than rays. Depends on the scene and the camera alone.
pub(crate) fn suits(scene: &Scene, camera: &Camera, samples: usize) -> bool {
    let seen = || scene.objects().iter().filter(|o| Layer::All.sees(o));
    let triangles: usize = seen().map(|o| o.geometry.triangles.len()).sum();
    let projection = Projection::of_camera(camera);
    !camera.is_orthographic()
        && triangles <= MAX_TRIANGLES_PER_SAMPLE * samples
        && seen()
            .filter_map(Object::bounds_in_world)
            .all(|b| projection.is_in_front(b))
}

/// Calls `visit` with each pixel of `[x0, y0, x1, y1)` that shows a surface at `offset` in it, block by block.
pub(crate) fn draw(
    scene: &Scene,
    camera: &Camera,
    bounds: [usize; 4],
    offset: [f64; 2],
    wanted: Wanted,
    mut visit: impl FnMut(&Seen<'_>),
) {
    let grid = Grid::new(bounds, offset);
    scratch::with(&SCRATCH, |scratch| {
        run(Draw {
            scene,
            camera,
            grid,
            wanted,
            scratch,
        });
        let stack = &scratch.stack;
        for (index, block) in stack.blocks.iter().enumerate() {
            let hit = block.hit();
            if hit == 0 {
                continue;
            }
            let corner = grid.corner(index);
            let levels = stack.levels_of(index);
            let behind = stack.behind_occluders.get(index).unwrap_or(block);
            for lane in lanes_of(hit) {
                visit(&Seen {
                    pixel: [
                        (corner[0] + lane % BLOCK_WIDTH) as u32,
                        (corner[1] + lane / BLOCK_WIDTH) as u32,
                    ],
                    hit: block.get(lane, &scratch.numbers),
                    behind_occluders: behind,
                    levels,
                    lane,
                    numbers: &scratch.numbers,
                });
            }
        }
    });
}

struct Draw<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    grid: Grid,
    wanted: Wanted,
    scratch: &'a mut Scratch,
}

/// Buffers of [`draw`].
#[derive(Default)]
struct Scratch {
    stack: Stack,
    numbers: Numbers,
    /// Rays of all blocks in the world, and of some in an object's frame.
    in_world: Vec<ShearBlock>,
    in_object: Vec<ShearBlock>,
    waiting: Vec<Patch>,
    furthest: Furthest,
}

/// What the blocks show.
#[derive(Default)]
struct Stack {
    /// Nearest surfaces.
    blocks: Vec<HitBlock>,
    /// The same before occluders were drawn; empty if there are none, or it is not wanted.
    behind_occluders: Vec<HitBlock>,
    /// Further surfaces, `further` levels for each block, and how many of them hold any.
    further: usize,
    levels: Vec<Level>,
    used: Vec<u8>,
}

impl Stack {
    fn clear(&mut self, blocks: usize, further: usize) {
        self.blocks.clear();
        self.blocks.resize(blocks, HitBlock::EMPTY);
        self.behind_occluders.clear();
        self.further = further;
        self.used.clear();
        if further > 0 {
            self.used.resize(blocks, 0);
            // Levels that are not used may hold anything
            let nothing = Level {
                t: HitBlock::EMPTY.t,
                number: HitBlock::EMPTY.number,
            };
            self.levels.resize(blocks * further, nothing);
        }
    }

    /// The levels of a block that hold any surface.
    fn levels_of(&self, block: usize) -> &[Level] {
        let used = self.used.get(block).map_or(0, |used| usize::from(*used));
        let first = block * self.further;
        self.levels.get(first..first + used).unwrap_or_default()
    }
}

thread_local! {
    static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
}

/// What an object is drawn with.
struct Strokes<'a> {
    local: &'a LocalProjection,
    steps: &'a Steps,
    stack: &'a mut Stack,
    waiting: &'a mut Vec<Patch>,
    furthest: &'a mut Furthest,
}

/// What is being drawn.
struct Canvas<'a> {
    grid: &'a Grid,
    rays: &'a [ShearBlock],
    /// Number of the first triangle.
    first_number: u32,
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
            stack,
            numbers,
            in_world,
            in_object,
            waiting,
            furthest,
        } = self.scratch;
        let count = grid.columns * grid.rows;
        stack.clear(count, self.wanted.further);
        numbers.take(self.scene);
        furthest.clear(grid);
        in_world.clear();
        in_object.clear();
        let all = [0, 0, grid.columns, grid.rows];
        let projection = Projection::of_camera(self.camera);
        let eye = Ray::new(vec3_from_point(self.camera.position()), Vec3::z());
        let seen = |object: &Object| object.is_visible && !object.bvh.is_empty();
        let objects = self.scene.objects().iter().enumerate();
        let (last, first): (Vec<_>, Vec<_>) = objects
            .filter(|(_, object)| seen(object))
            .partition(|(_, object)| self.wanted.behind_occluders && object.is_occluder);
        let first_occluder = first.len();
        for (turn, (index, object)) in first.into_iter().chain(last).enumerate() {
            if turn == first_occluder {
                stack.behind_occluders.extend_from_slice(&stack.blocks);
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
                first_number: numbers.of(index),
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
            let mut strokes = Strokes {
                local: &local,
                steps: &steps,
                stack,
                waiting,
                furthest,
            };
            match &object.cutout {
                None => canvas.draw_all::<L>(&mut strokes, Solid),
                Some(cutout) => canvas.draw_all::<L>(&mut strokes, &**cutout),
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
    /// Draws the object: front faces at once, those that face the other way when most of them are found to be hidden.
    #[inline(always)]
    fn draw_all<L: Lanes>(&self, strokes: &mut Strokes<'_>, admit: impl Admit) {
        strokes.waiting.clear();
        for (eight, triangles) in self.corners.chunks(LANES).enumerate() {
            let corners = project_corners::<L>(strokes.local, triangles);
            let found = footprints::<L>(strokes.local, strokes.steps, &corners, triangles.len());
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
                    strokes.waiting.push(patch);
                } else {
                    self.draw::<L>(&patch, strokes.furthest, admit, strokes.stack);
                }
            }
        }
        // An object of few triangles hides little
        if strokes.stack.further == 0 && self.corners.len() * 16 > strokes.stack.blocks.len() {
            strokes.furthest.update(&strokes.stack.blocks);
        }
        for patch in &*strokes.waiting {
            self.draw::<L>(patch, strokes.furthest, admit, strokes.stack);
        }
    }

    /// Draws a triangle where it is not behind `furthest`.
    #[inline(always)]
    fn draw<L: Lanes>(
        &self,
        patch: &Patch,
        furthest: &Furthest,
        admit: impl Admit,
        stack: &mut Stack,
    ) {
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
                let rays = &self.rays[index];
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
                    self.take::<L>(triangle, &meeting, index, admit, stack);
                }
            }
        }
    }

    /// Takes over what a block meets of a triangle.
    #[inline(always)]
    fn take<L: Lanes>(
        &self,
        triangle: u32,
        meeting: &Meeting<L>,
        index: usize,
        admit: impl Admit,
        stack: &mut Stack,
    ) {
        let block = &mut stack.blocks[index];
        let number = self.first_number + triangle;
        let further = stack.further;
        if further == 0 {
            block.take::<L>(meeting, [triangle, number], admit);
            return;
        }
        // Leave out what is behind all levels before anything is asked about it
        let (t, nearest, none) = (meeting.t, L::load(&block.t), L::splat(f32::INFINITY));
        let levels = &mut stack.levels[index * further..][..further];
        let used = &mut stack.used[index];
        let mut met = meeting.met & L::splat(0.0).lt(t) & t.lt(none);
        if usize::from(*used) == further {
            met = met & t.le(L::load(&levels[further - 1].t));
        }
        let met = admit.admitted::<L>(met, triangle, meeting.v, meeting.w);
        let tied = met & t.eq(nearest);
        let closer = met & t.lt(nearest);
        let own = L::splat(carried(number));
        let onwards = L::select(closer, nearest, t);
        let numbers = L::select(closer, L::load(&block.number), own);
        let is_first = closer & nearest.eq(none);
        let bits = (met & !tied & !is_first).bits();
        if bits != 0 {
            insert(levels, used, (onwards, numbers), bits);
        }
        let meeting = Meeting { met, ..*meeting };
        block.take::<L>(&meeting, [triangle, number], Solid);
    }
}
