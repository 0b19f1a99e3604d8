//! Samples of some pixels, drawn: triangles over the pixels, tested against all samples of each that is wanted.
//!
//! The same tests and rules as those of whole images, so samples have the bits of their rays.

use std::cell::Cell;

use super::DEPTH_SLACK;
use super::blocks::{HitBlock, Numbers};
use crate::camera::Camera;
use crate::cutout::{Admit, Solid};
use crate::footprint::{LocalProjection, Projection, Steps, footprints, project_corners};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, lanes_of, run};
use crate::math::{Vec3, vec3_from_point};
use crate::object::Object;
use crate::packet::{ShearBlock, meet_sheared};
use crate::primary::sample_px;
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::scratch;

/// Blocks of samples that are drawn together: bounds the buffers.
const MAX_BLOCKS: usize = 8192;

/// A pixel without samples.
const NO_SLOT: u32 = u32::MAX;

/// Appends what samples at the same offsets in each pixel see; those of a pixel are adjacent.
pub(crate) fn draw(
    scene: &Scene,
    camera: &Camera,
    pixels: &[[u32; 2]],
    offsets: &[[f64; 2]],
    layer: Layer,
    hits: &mut Vec<Hit>,
) {
    let blocks_each = offsets.len().div_ceil(LANES);
    scratch::with(&SCRATCH, |scratch| {
        for pixels in pixels.chunks((MAX_BLOCKS / blocks_each).max(1)) {
            scratch.take_pixels(pixels);
            run(Draw {
                scene,
                camera,
                layer,
                offsets,
                blocks_each,
                scratch,
            });
            for slot in &scratch.slot_of {
                let first = *slot as usize * blocks_each;
                let own = &scratch.blocks[first..first + blocks_each];
                let lanes = own.iter().flat_map(|b| (0..LANES).map(move |k| (b, k)));
                let found = lanes.map(|(block, lane)| block.get(lane, &scratch.numbers));
                hits.extend(found.take(offsets.len()));
            }
        }
    });
}

struct Draw<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    layer: Layer,
    offsets: &'a [[f64; 2]],
    blocks_each: usize,
    scratch: &'a mut Scratch,
}

thread_local! {
    static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
}

/// Buffers of [`draw`].
#[derive(Default)]
struct Scratch {
    /// The wanted pixels, each once, and the number among them of each that was asked for.
    pixels: Vec<[u32; 2]>,
    slot_of: Vec<u32>,
    /// The rectangle around them, and the number of each of its pixels, row by row.
    corner: [u32; 2],
    size: [usize; 2],
    slots: Vec<u32>,
    /// Samples, as many blocks for each pixel, their rays, and the largest distance of each block.
    blocks: Vec<HitBlock>,
    rays: Vec<ShearBlock>,
    furthest: Vec<f32>,
    numbers: Numbers,
    waiting: Vec<Patch>,
}

/// A triangle and the pixels it may touch, both ends included.
#[derive(Clone, Copy)]
struct Patch {
    /// Place in leaf order.
    slot: u32,
    area: [[u32; 2]; 2],
    nearest: f32,
}

impl Scratch {
    fn take_pixels(&mut self, pixels: &[[u32; 2]]) {
        let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
        for pixel in pixels {
            for k in 0..2 {
                low[k] = low[k].min(pixel[k]);
                high[k] = high[k].max(pixel[k] + 1);
            }
        }
        self.corner = low;
        self.size = [0, 1].map(|k| (high[k] - low[k]) as usize);
        self.slots.clear();
        self.slots.resize(self.size[0] * self.size[1], NO_SLOT);
        self.pixels.clear();
        self.slot_of.clear();
        for pixel in pixels {
            let [x, y] = [0, 1].map(|k| (pixel[k] - low[k]) as usize);
            let slot = &mut self.slots[y * self.size[0] + x];
            if *slot == NO_SLOT {
                *slot = self.pixels.len() as u32;
                self.pixels.push(*pixel);
            }
            self.slot_of.push(*slot);
        }
    }
}

impl Kernel for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Scratch {
            pixels,
            corner,
            size,
            slots,
            blocks,
            rays,
            furthest,
            numbers,
            waiting,
            ..
        } = self.scratch;
        let count = pixels.len() * self.blocks_each;
        blocks.clear();
        blocks.resize(count, HitBlock::EMPTY);
        furthest.clear();
        furthest.resize(count, f32::INFINITY);
        numbers.take(self.scene);
        let projection = Projection::of_camera(self.camera);
        let eye = Ray::new(vec3_from_point(self.camera.position()), Vec3::z());
        let steps = Steps {
            count: *size,
            first: corner.map(|v| v as f32),
            is_lattice: false,
        };
        // The object whose frame the rays are in: those of the world serve many
        let mut frame = None;
        for (index, object) in self.scene.objects().iter().enumerate() {
            if !self.layer.sees(object) || object.bvh.is_empty() {
                continue;
            }
            // Posed objects are small and many: only the pixels around one get rays in its frame
            let own = object.world_from_object.is_some().then_some(index);
            let mut posed = None;
            if own.is_some() {
                let bounds = self.camera.pixel_bounds(object.bounds_in_world());
                let Some(bounds) = bounds.filter(|b| is_any_in(pixels, *b)) else {
                    continue;
                };
                posed = Some((object, bounds));
            }
            if frame != Some(own) {
                frame = Some(own);
                shear_samples::<L>(self.camera, posed, pixels, self.offsets, rays);
            }
            let mut canvas = Canvas {
                columns: size[0],
                slots,
                blocks_each: self.blocks_each,
                rays,
                blocks,
                furthest,
                first_number: numbers.of(index),
                origin: object.ray_in_object(&eye).origin,
                corners: &object.bvh.corners,
                ids: &object.bvh.triangle_ids,
            };
            let local = projection.in_frame_of(Some(object), 0.0);
            match &object.cutout {
                None => canvas.draw_all::<L>(&local, &steps, waiting, Solid),
                Some(cutout) => canvas.draw_all::<L>(&local, &steps, waiting, &**cutout),
            }
        }
    }
}

/// What is being drawn.
struct Canvas<'a> {
    columns: usize,
    slots: &'a [u32],
    blocks_each: usize,
    rays: &'a [ShearBlock],
    blocks: &'a mut [HitBlock],
    furthest: &'a mut [f32],
    /// Number of the first triangle.
    first_number: u32,
    /// Start of the rays in the object's frame.
    origin: Vec3,
    /// Corners and numbers of the triangles, in leaf order.
    corners: &'a [[[f32; 3]; 3]],
    ids: &'a [u32],
}

impl Canvas<'_> {
    /// Draws the object, front faces first.
    #[inline(always)]
    fn draw_all<L: Lanes>(
        &mut self,
        local: &LocalProjection,
        steps: &Steps,
        waiting: &mut Vec<Patch>,
        admit: impl Admit,
    ) {
        waiting.clear();
        for (eight, triangles) in self.corners.chunks(LANES).enumerate() {
            let corners = project_corners::<L>(local, triangles);
            let found = footprints::<L>(local, steps, &corners, triangles.len());
            for lane in lanes_of(found.present) {
                let area = found.area(lane).map(|at| at.map(|v| v as u32));
                if !self.wants(area) {
                    continue;
                }
                let patch = Patch {
                    slot: (eight * LANES + lane) as u32,
                    area,
                    nearest: found.nearest.0[lane] * DEPTH_SLACK,
                };
                if found.clockwise >> lane & 1 == 1 {
                    waiting.push(patch);
                } else {
                    self.draw::<L>(&patch, admit);
                }
            }
        }
        for patch in &*waiting {
            self.draw::<L>(patch, admit);
        }
    }

    /// Whether any pixel of an area has samples.
    #[inline(always)]
    fn wants(&self, [first, last]: [[u32; 2]; 2]) -> bool {
        (first[1]..=last[1]).any(|y| {
            let row = y as usize * self.columns;
            let own = &self.slots[row + first[0] as usize..=row + last[0] as usize];
            own.iter().any(|slot| *slot != NO_SLOT)
        })
    }

    #[inline(always)]
    fn draw<L: Lanes>(&mut self, patch: &Patch, admit: impl Admit) {
        let triangle = self.ids[patch.slot as usize];
        let number = self.first_number + triangle;
        let [a, b, c] = self.corners[patch.slot as usize].map(|p| Vec3::from(p) - self.origin);
        let [first, last] = patch.area;
        for y in first[1]..=last[1] {
            for x in first[0]..=last[0] {
                let slot = self.slots[y as usize * self.columns + x as usize];
                if slot == NO_SLOT {
                    continue;
                }
                let from = slot as usize * self.blocks_each;
                for index in from..from + self.blocks_each {
                    if patch.nearest > self.furthest[index] {
                        continue;
                    }
                    let (rays, block) = (&self.rays[index], &mut self.blocks[index]);
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
                        if block.take::<L>(&meeting, [triangle, number], admit) {
                            self.furthest[index] = block.furthest(rays.present());
                        }
                    }
                }
            }
        }
    }
}

/// Whether a pixel is one of `[x0, y0, x1, y1)`.
fn is_in([x, y]: [u32; 2], [x0, y0, x1, y1]: [usize; 4]) -> bool {
    (x0..x1).contains(&(x as usize)) && (y0..y1).contains(&(y as usize))
}

fn is_any_in(pixels: &[[u32; 2]], bounds: [usize; 4]) -> bool {
    pixels.iter().any(|pixel| is_in(*pixel, bounds))
}

/// Sets rays to those of the samples of pixels, in the world or, for the pixels of a rectangle, in an object's frame; the
/// others are then none.
#[inline(always)]
fn shear_samples<L: Lanes>(
    camera: &Camera,
    posed: Option<(&Object, [usize; 4])>,
    pixels: &[[u32; 2]],
    offsets: &[[f64; 2]],
    rays: &mut Vec<ShearBlock>,
) {
    rays.clear();
    for pixel in pixels {
        if posed.is_some_and(|(_, bounds)| !is_in(*pixel, bounds)) {
            let blocks = rays.len() + offsets.len().div_ceil(LANES);
            rays.resize(blocks, ShearBlock::default());
            continue;
        }
        for offsets in offsets.chunks(LANES) {
            let mut direction = [Eight([1.0; LANES]); 3];
            for (lane, offset) in offsets.iter().enumerate() {
                let mut d = camera.direction(sample_px(*pixel, *offset));
                if let Some((object, _)) = posed {
                    let ray = Ray::new(Vec3::zeros(), d.into());
                    d = object.ray_in_object(&ray).direction.into();
                }
                for k in 0..3 {
                    direction[k].0[lane] = d[k];
                }
            }
            let all = 0xFF >> (LANES - offsets.len());
            rays.push(ShearBlock::new::<L>(&direction, all));
        }
    }
}
