//! Small triangles: each pixel that may show one waits until eight do, whichever triangles they are of, and eight triangles
//! are tested at a time, each against its own pixel's ray.

use super::blocks::Place;
use super::grid::{BLOCK_HEIGHT, BLOCK_WIDTH, LocalRays};
use super::{Canvas, Stack};
use crate::cutout::Admit;
use crate::lanes::{Eight, LANES, LaneMask, Lanes, V3, lanes_of};
use crate::packet::{ShearBlock, lanes_by_axis, meet_sheared};

/// Places of eight triangles in leaf order.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slots(pub(super) [u32; LANES]);

impl Slots {
    /// Eight in a row.
    #[inline(always)]
    pub(super) fn from(first: u32) -> Self {
        let mut slots = [first; LANES];
        for (slot, k) in slots.iter_mut().zip(0..) {
            *slot += k;
        }
        Self(slots)
    }
}

/// Triangles and the pixels that they wait to be tested against.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Queue {
    count: usize,
    slots: Slots,
    /// Pixels, counted from the grid's first.
    x: [u32; LANES],
    y: [u32; LANES],
    /// Block times eight and lane.
    places: [u32; LANES],
}

impl Canvas<'_> {
    /// Puts a triangle and a pixel of its box in the queue unless something nearer is there; `nearest` is no depth of the
    /// triangle's nearer than its own.
    #[inline(always)]
    pub(super) fn offer<L: Lanes>(
        &self,
        queue: &mut Queue,
        rays: &LocalRays<'_>,
        stack: &mut Stack,
        (slot, nearest): (u32, f32),
        [x, y]: [u32; 2],
        admit: impl Admit,
    ) {
        const WIDTH: u32 = BLOCK_WIDTH as u32;
        const HEIGHT: u32 = BLOCK_HEIGHT as u32;
        let block = y / HEIGHT * self.grid.columns as u32 + x / WIDTH;
        let place = block * LANES as u32 + y % HEIGHT * WIDTH + x % WIDTH;
        if nearest > stack.nearest.t[place as usize] && stack.further == 0 {
            return;
        }
        let next = queue.count % LANES;
        queue.slots.0[next] = slot;
        queue.x[next] = x;
        queue.y[next] = y;
        queue.places[next] = place;
        queue.count = next + 1;
        if queue.count == LANES {
            queue.count = 0;
            self.test::<L>(queue, LANES, rays, stack, admit);
        }
    }

    /// Tests what still waits.
    #[inline(always)]
    pub(super) fn finish<L: Lanes>(
        &self,
        queue: &mut Queue,
        rays: &LocalRays<'_>,
        stack: &mut Stack,
        admit: impl Admit,
    ) {
        let count = std::mem::take(&mut queue.count);
        if count > 0 {
            self.test::<L>(queue, count, rays, stack, admit);
        }
    }

    /// Tests the first `count` of a queue.
    #[inline(always)]
    fn test<L: Lanes>(
        &self,
        queue: &Queue,
        count: usize,
        rays: &LocalRays<'_>,
        stack: &mut Stack,
        admit: impl Admit,
    ) {
        // Gather corners and rays
        let mut rows: [&[f32; LANES]; LANES] = [&[0.0; LANES]; LANES];
        let mut others = [Eight::default(); LANES];
        for lane in 0..LANES {
            let from = lane.min(count - 1);
            let nine = self.corners[queue.slots.0[from] as usize].as_flattened();
            if let Some(row) = nine.first_chunk() {
                rows[lane] = row;
            }
            let [x, y, z, idle] = rays.direction(queue.x[from] as usize, queue.y[from] as usize);
            others[lane] = Eight([x, y, z, idle, nine[8], 0.0, 0.0, 0.0]);
        }
        let [ax, ay, az, bx, by, bz, cx, cy] = L::transpose(rows);
        let [o0, o1, o2, o3, o4, o5, o6, o7] = &others;
        let [dx, dy, dz, _, cz, ..] =
            L::transpose([&o0.0, &o1.0, &o2.0, &o3.0, &o4.0, &o5.0, &o6.0, &o7.0]);
        let origin = V3::splat(self.origin.into());
        let a = (V3([ax, ay, az]) - origin).0;
        let b = (V3([bx, by, bz]) - origin).0;
        let c = (V3([cx, cy, cz]) - origin).0;
        // Test each triangle against its own ray, the rays of one longest axis at a time
        let direction = [dx, dy, dz];
        let by_axis = lanes_by_axis(&direction);
        let all = 0xFF >> (LANES - count);
        for axis in 0..3 {
            let wanted = by_axis[axis].bits() & all;
            if wanted == 0 {
                continue;
            }
            let [i, j, k] = ShearBlock::axes_from(axis);
            let scale = L::splat(1.0) / direction[k];
            let Some(meeting) = meet_sheared(
                [[a[i], a[j], a[k]], [b[i], b[j], b[k]], [c[i], c[j], c[k]]],
                &[direction[i] * scale, direction[j] * scale, scale],
                L::Mask::from_bits(wanted),
            ) else {
                continue;
            };
            // Two may be of the same pixel, so they go in one after the other
            let (t, u, v) = (meeting.t.store(), meeting.v.store(), meeting.w.store());
            for lane in lanes_of(meeting.met.bits()) {
                let triangle = self.ids[queue.slots.0[lane] as usize];
                let place = Place {
                    number: self.first_number + triangle,
                    u: u.0[lane],
                    v: v.0[lane],
                };
                let pixel = queue.places[lane] as usize;
                stack.take(pixel, (t.0[lane], place), triangle, admit);
            }
        }
    }
}
