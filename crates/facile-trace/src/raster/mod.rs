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
mod small;
mod spans;

use std::cell::Cell;

use crate::camera::Camera;
use crate::cutout::{Admit, Solid};
use crate::footprint::{
    Footprints, LocalProjection, Projection, Steps, footprints, project_corners,
};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, V3, lanes_of, run};
use crate::math::{Vec3, vec3_from_point};
use crate::object::Object;
use crate::packet::{ShearBlock, meet_sheared};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::scratch;
use blocks::{Level, Nearest, Numbers, Place, insert};
use grid::{BLOCK_WIDTH, Grid, LocalRays, Rays};
use hidden::{Furthest, Patch};
use small::{Queue, Slots};
use spans::Spans;

/// More triangles per sample than this, and packets through the tree are faster.
const MAX_TRIANGLES_PER_SAMPLE: usize = 8;

/// Pixels of a triangle's box up to which its pixels are tested eight of any triangles at a time, and not block by block.
const MAX_SMALL: f32 = 40.0;

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
    behind_occluders: &'a Nearest,
    levels: &'a [Level],
    block: usize,
    lane: usize,
    numbers: &'a Numbers,
}

impl Seen<'_> {
    /// The hit without occluders, [`Hit::MISS`] where there is nothing else; `hit` unless asked for.
    pub(crate) fn behind_occluders(&self) -> Hit {
        let place = self.block * LANES + self.lane;
        self.behind_occluders.get(place, self.numbers)
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
        let behind_occluders = stack.behind_occluders.as_ref().unwrap_or(&stack.nearest);
        for (block, t) in stack.nearest.t.as_chunks::<LANES>().0.iter().enumerate() {
            if t.iter().all(|t| *t == f32::INFINITY) {
                continue;
            }
            let corner = grid.corner(block);
            let levels = stack.levels_of(block);
            for (lane, t) in t.iter().enumerate() {
                if *t == f32::INFINITY {
                    continue;
                }
                visit(&Seen {
                    pixel: [
                        (corner[0] + lane % BLOCK_WIDTH) as u32,
                        (corner[1] + lane / BLOCK_WIDTH) as u32,
                    ],
                    hit: stack.nearest.get(block * LANES + lane, &scratch.numbers),
                    behind_occluders,
                    levels,
                    block,
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
    rays: Rays,
    waiting: Vec<Patch>,
    furthest: Furthest,
}

/// What the pixels show.
#[derive(Default)]
struct Stack {
    nearest: Nearest,
    /// The same before occluders were drawn; `None` if there are none, or it is not wanted.
    behind_occluders: Option<Nearest>,
    /// Further surfaces, `further` levels for each block, and how many of them hold any.
    further: usize,
    levels: Vec<Level>,
    used: Vec<u8>,
}

impl Stack {
    fn clear(&mut self, blocks: usize, further: usize) {
        self.nearest.clear(blocks);
        self.behind_occluders = None;
        self.further = further;
        self.used.clear();
        if further > 0 {
            self.used.resize(blocks, 0);
            // Levels that are not used may hold anything
            let nothing = Level {
                t: Eight([f32::INFINITY; LANES]),
                number: Eight::default(),
            };
            self.levels.resize(blocks * further, nothing);
        }
    }

    /// Takes over what the ray of a pixel, the block's place times eight and the lane, meets of a triangle.
    #[inline(always)]
    fn take(&mut self, pixel: usize, hit: (f32, Place), triangle: u32, admit: impl Admit) {
        if self.further == 0 {
            self.nearest.take(pixel, hit, triangle, admit);
            return;
        }
        // Leave out what is behind all levels before anything is asked about it
        let (t, place) = hit;
        let (block, lane) = (pixel / LANES, pixel % LANES);
        let levels = &mut self.levels[block * self.further..][..self.further];
        let used = &mut self.used[block];
        let is_full = usize::from(*used) == self.further;
        let is_behind = is_full && levels[self.further - 1].t.0[lane] < t;
        let is_ahead = 0.0 < t && t < f32::INFINITY;
        if !is_ahead || is_behind || !admit.admits(triangle, place.u, place.v) {
            return;
        }
        let (nearest, number) = (self.nearest.t[pixel], self.nearest.places[pixel].number);
        self.nearest.take(pixel, hit, triangle, Solid);
        if t > nearest {
            insert(levels, used, lane, (t, place.number));
        } else if t < nearest && nearest < f32::INFINITY {
            insert(levels, used, lane, (nearest, number));
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
    rays: LocalRays<'a>,
    stack: &'a mut Stack,
    waiting: &'a mut Vec<Patch>,
    furthest: &'a mut Furthest,
}

/// What is being drawn.
struct Canvas<'a> {
    grid: &'a Grid,
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
            rays,
            waiting,
            furthest,
        } = self.scratch;
        let count = grid.columns * grid.rows;
        stack.clear(count, self.wanted.further);
        numbers.take(self.scene);
        furthest.clear(grid);
        rays.take(grid, self.camera);
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
                stack.behind_occluders = Some(stack.nearest.clone());
            }
            let canvas = Canvas {
                grid,
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
                rays: rays.in_frame_of(object, index),
                stack,
                waiting,
                furthest,
            };
            match &object.cutout {
                None => canvas.draw_all::<L>(&mut strokes, Solid),
                Some(cutout) => canvas.draw_all::<L>(&mut strokes, &**cutout),
            }
        }
    }
}

impl Canvas<'_> {
    /// Draws the object: front faces at once, those that face the other way when most of them are found to be hidden.
    #[inline(always)]
    fn draw_all<L: Lanes>(&self, strokes: &mut Strokes<'_>, admit: impl Admit) {
        strokes.waiting.clear();
        let mut queue = Queue::default();
        for (eight, triangles) in self.corners.chunks(LANES).enumerate() {
            let corners = project_corners::<L>(strokes.local, triangles);
            let found = footprints::<L>(strokes.local, strokes.steps, &corners, triangles.len());
            if found.present == 0 {
                continue;
            }
            // Front faces of a mesh that is wound the usual way turn clockwise, since y points down
            let waiting = found.present & found.clockwise();
            if waiting != 0 {
                let (areas, nearest) = (found.areas(), found.nearest.store());
                for lane in lanes_of(waiting) {
                    let slot = (eight * LANES + lane) as u32;
                    let patch = Patch::new(slot, areas.of(lane), nearest.0[lane]);
                    strokes.waiting.push(patch);
                }
            }
            let slots = Slots::from((eight * LANES) as u32);
            let here = found.present & !waiting;
            self.draw_eight::<L>(strokes, &mut queue, (&corners, &found, here), &slots, admit);
        }
        self.finish::<L>(&mut queue, &strokes.rays, strokes.stack, admit);
        // An object of few triangles hides little
        if strokes.stack.further == 0 && self.corners.len() * 2 > strokes.stack.nearest.t.len() {
            strokes.furthest.update(&strokes.stack.nearest.t);
        }
        let waiting = std::mem::take(strokes.waiting);
        let mut slots = Slots::default();
        let mut count = 0;
        for patch in &waiting {
            if strokes.furthest.hides(patch) {
                continue;
            }
            slots.0[count] = patch.slot;
            count += 1;
            if count == LANES {
                self.draw_slots::<L>(strokes, &mut queue, &slots, count, admit);
                count = 0;
            }
        }
        if count > 0 {
            self.draw_slots::<L>(strokes, &mut queue, &slots, count, admit);
        }
        self.finish::<L>(&mut queue, &strokes.rays, strokes.stack, admit);
        *strokes.waiting = waiting;
    }

    /// Draws the first `count` of eight triangles anywhere in leaf order.
    #[inline(always)]
    fn draw_slots<L: Lanes>(
        &self,
        strokes: &mut Strokes<'_>,
        queue: &mut Queue,
        slots: &Slots,
        count: usize,
        admit: impl Admit,
    ) {
        let mut triangles = [[[0.0; 3]; 3]; LANES];
        for (own, slot) in triangles.iter_mut().zip(&slots.0[..count]) {
            *own = self.corners[*slot as usize];
        }
        let corners = project_corners::<L>(strokes.local, &triangles[..count]);
        let found = footprints::<L>(strokes.local, strokes.steps, &corners, count);
        let here = found.present;
        self.draw_eight::<L>(strokes, queue, (&corners, &found, here), slots, admit);
    }

    /// Draws the triangles `here` of eight: large ones over blocks of pixels, the pixels of small ones go to the queue.
    #[inline(always)]
    fn draw_eight<L: Lanes>(
        &self,
        strokes: &mut Strokes<'_>,
        queue: &mut Queue,
        (corners, found, here): (&[V3<L>; 3], &Footprints<L>, u32),
        slots: &Slots,
        admit: impl Admit,
    ) {
        if here == 0 {
            return;
        }
        let one = L::splat(1.0);
        let width = found.last[0] - found.first[0] + one;
        let height = found.last[1] - found.first[1] + one;
        let small = (width * height).le(L::splat(MAX_SMALL)).bits();
        let nearest = (found.nearest * L::splat(DEPTH_SLACK)).store();
        if here & !small != 0 {
            let areas = found.areas();
            for lane in lanes_of(here & !small) {
                let patch =
                    Patch::new(slots.0[lane], areas.of(lane), found.nearest.store().0[lane]);
                self.draw::<L>(&patch, strokes, admit);
            }
        }
        let small = here & small;
        if small == 0 {
            return;
        }
        let spans = Spans::new(strokes.local, strokes.steps, corners, found);
        let top = found.first[1].to_i32();
        for row in 0..spans.rows(small) {
            let (first, last, is_any) = spans.row(row as f32);
            let here = is_any.bits() & small;
            if here == 0 {
                continue;
            }
            let (first, last) = (first.to_i32(), last.to_i32());
            for lane in lanes_of(here) {
                let y = top[lane] as u32 + row;
                for x in first[lane]..=last[lane] {
                    let pixel = [x as u32, y];
                    let triangle = (slots.0[lane], nearest.0[lane]);
                    self.offer::<L>(queue, &strokes.rays, strokes.stack, triangle, pixel, admit);
                }
            }
        }
    }

    /// Draws a large triangle where it is not hidden.
    #[inline(always)]
    fn draw<L: Lanes>(&self, patch: &Patch, strokes: &mut Strokes<'_>, admit: impl Admit) {
        if strokes.furthest.hides(patch) {
            return;
        }
        let triangle = self.ids[patch.slot as usize];
        let number = self.first_number + triangle;
        let [a, b, c] = self.corners[patch.slot as usize].map(|p| Vec3::from(p) - self.origin);
        for y in patch.first[1]..=patch.last[1] {
            for x in patch.first[0]..=patch.last[0] {
                let index = y as usize * self.grid.columns + x as usize;
                if patch.nearest > strokes.furthest.blocks[index] {
                    continue;
                }
                let rays = strokes.rays.block::<L>(self.grid, index);
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
                    let (t, u, v) = (meeting.t.store(), meeting.v.store(), meeting.w.store());
                    for lane in lanes_of(meeting.met.bits()) {
                        let (u, v) = (u.0[lane], v.0[lane]);
                        let hit = (t.0[lane], Place { number, u, v });
                        strokes
                            .stack
                            .take(index * LANES + lane, hit, triangle, admit);
                    }
                }
            }
        }
    }
}
