//! Eight rays through a tree at once.
//!
//! The same tests in the same order of operations as [`crate::triangle`] and [`crate::bvh`], so that each lane gives the
//! bits of the scalar query. A packet's rays share the axis that the watertight test shears along; a [`RayBlock`] makes
//! one packet for each axis that occurs in it.

use crate::bvh::{Bvh, FAR_SLACK, MAX_DEPTH, Node};
use crate::cutout::Admit;
use crate::lanes::{Eight, LANES, LaneMask, Lanes, lanes_of};
use crate::math::Vec3;
use crate::ray::Ray;
use crate::triangle::edge_function;

/// Eight rays in memory, coordinate by coordinate. Lanes without a ray hold any ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayBlock {
    pub(crate) origin: [Eight; 3],
    pub(crate) direction: [Eight; 3],
    pub(crate) t_min: Eight,
    pub(crate) t_max: Eight,
}

impl Default for RayBlock {
    fn default() -> Self {
        Self {
            origin: [Eight::default(); 3],
            direction: [Eight([1.0; LANES]); 3],
            t_min: Eight::default(),
            t_max: Eight::default(),
        }
    }
}

impl RayBlock {
    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, ray: &Ray) {
        for k in 0..3 {
            self.origin[k].0[lane] = ray.origin[k];
            self.direction[k].0[lane] = ray.direction[k];
        }
        self.t_min.0[lane] = ray.t_min;
        self.t_max.0[lane] = ray.t_max;
    }

    pub(crate) fn get(&self, lane: usize) -> Ray {
        Ray {
            origin: Vec3::from_fn(|k, _| self.origin[k].0[lane]),
            direction: Vec3::from_fn(|k, _| self.direction[k].0[lane]),
            t_min: self.t_min.0[lane],
            t_max: self.t_max.0[lane],
        }
    }
}

/// The lanes whose direction is longest along each axis, see [`crate::triangle::dominant_axis`].
#[inline(always)]
fn lanes_by_axis<L: Lanes>(direction: &[Eight; 3]) -> [L::Mask; 3] {
    let zero = L::splat(0.0);
    let [x, y, z] = direction;
    let (x, y, z) = (L::load(x), L::load(y), L::load(z));
    let (x, y, z) = (x.max(zero - x), y.max(zero - y), z.max(zero - z));
    let along_x = y.le(x) & z.le(x);
    let along_y = z.le(y) & !along_x;
    [along_x, along_y, !(along_x | along_y)]
}

/// Eight rays as the triangle test wants them: each sheared along the axis that its direction is longest along.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ShearBlock {
    /// Shear along the first and second axis after the longest one, scale along the longest.
    shear: [Eight; 3],
    /// Rays by longest axis; lanes without a ray are in none.
    pub(crate) by_axis: [u32; 3],
    /// Axes that occur: from, and to without the end.
    range: [u8; 2],
}

impl ShearBlock {
    /// The rays `wanted` of eight.
    #[inline(always)]
    pub(crate) fn new<L: Lanes>(direction: &[Eight; 3], wanted: u32) -> Self {
        let [is_x, is_y, is_z] = lanes_by_axis::<L>(direction);
        let [x, y, z] = direction;
        let (x, y, z) = (L::load(x), L::load(y), L::load(z));
        let along_z = L::select(is_x, x, L::select(is_y, y, z));
        let along_x = L::select(is_x, y, L::select(is_y, z, x));
        let along_y = L::select(is_x, z, L::select(is_y, x, y));
        let scale = L::splat(1.0) / along_z;
        let by_axis = [
            is_x.bits() & wanted,
            is_y.bits() & wanted,
            is_z.bits() & wanted,
        ];
        let first = by_axis.iter().position(|b| *b != 0).unwrap_or(0);
        let end = by_axis.iter().rposition(|b| *b != 0).map_or(0, |k| k + 1);
        Self {
            shear: [
                (along_x * scale).store(),
                (along_y * scale).store(),
                scale.store(),
            ],
            by_axis,
            range: [first as u8, end as u8],
        }
    }

    /// Lanes with a ray.
    #[inline(always)]
    pub(crate) fn present(&self) -> u32 {
        self.by_axis[0] | self.by_axis[1] | self.by_axis[2]
    }

    /// Axes that may occur.
    #[inline(always)]
    pub(crate) fn axes(&self) -> std::ops::Range<usize> {
        usize::from(self.range[0])..usize::from(self.range[1])
    }

    /// The axes that become `x`, `y`, `z` for a longest axis.
    #[inline(always)]
    pub(crate) fn axes_from(axis: usize) -> [usize; 3] {
        const AXES: [[usize; 3]; 3] = [[1, 2, 0], [2, 0, 1], [0, 1, 2]];
        AXES[axis]
    }

    #[inline(always)]
    pub(crate) fn shear<L: Lanes>(&self) -> [L; 3] {
        [
            L::load(&self.shear[0]),
            L::load(&self.shear[1]),
            L::load(&self.shear[2]),
        ]
    }
}

impl RayBlock {
    /// The lanes whose direction is longest along each axis.
    #[inline(always)]
    pub(crate) fn lanes_by_axis<L: Lanes>(&self) -> [u32; 3] {
        let [x, y, z] = lanes_by_axis::<L>(&self.direction);
        [x.bits(), y.bits(), z.bits()]
    }
}

/// Packets of the lanes `bits` of a block: one for each shear axis that occurs.
macro_rules! for_each_packet {
    ($lanes:ident, $block:expr, $bits:expr, $packet:ident => $body:block) => {
        let by_axis = $block.lanes_by_axis::<$lanes>();
        for axis in 0..3 {
            let bits = by_axis[axis] & $bits;
            if bits != 0 {
                let $packet = $crate::packet::Packet::<$lanes>::new($block, axis, bits);
                $body
            }
        }
    };
}
pub(crate) use for_each_packet;

/// Up to eight rays with one shear axis, in registers.
#[derive(Clone, Copy)]
pub(crate) struct Packet<L: Lanes> {
    origin: [L; 3],
    inverse: [L; 3],
    /// The origin along `axes`.
    sheared_origin: [L; 3],
    /// Shear along `x` and `y`, scale along `z`.
    shear: [L; 3],
    /// Axes that become `x`, `y`, `z`.
    axes: [usize; 3],
    t_min: L,
    pub(crate) t_max: L,
    active: L::Mask,
}

/// What the lanes of a packet hit; `t` stays at the ray's end in lanes without a hit.
#[derive(Clone, Copy)]
pub(crate) struct PacketHit<L: Lanes> {
    pub(crate) t: L,
    pub(crate) u: L,
    pub(crate) v: L,
    pub(crate) triangle: [u32; LANES],
    pub(crate) found: L::Mask,
}

/// Lanes that meet a triangle, where, and the weights of its second and third corner.
#[derive(Clone, Copy)]
pub(crate) struct Meeting<L: Lanes> {
    pub(crate) met: L::Mask,
    pub(crate) t: L,
    pub(crate) v: L,
    pub(crate) w: L,
}

/// The watertight test of [`crate::triangle::intersect`] on corners relative to the rays' origin, along the shear's axes.
/// `t_min` is not compared.
#[inline(always)]
pub(crate) fn meet_sheared<L: Lanes>(
    corners: [[L; 3]; 3],
    shear: &[L; 3],
    active: L::Mask,
) -> Option<Meeting<L>> {
    let [a, b, c] = corners;
    let (ax, ay) = (a[0] - shear[0] * a[2], a[1] - shear[1] * a[2]);
    let (bx, by) = (b[0] - shear[0] * b[2], b[1] - shear[1] * b[2]);
    let (cx, cy) = (c[0] - shear[0] * c[2], c[1] - shear[1] * c[2]);
    let mut u = cx * by - cy * bx;
    let mut v = ax * cy - ay * cx;
    let mut w = bx * ay - by * ax;
    let zero = L::splat(0.0);
    let mixed = u.min(v).min(w).lt(zero) & zero.lt(u.max(v).max(w));
    let mut inside = active & !mixed;
    if !inside.any() {
        return None;
    }
    let on_edge = ((u.eq(zero) | v.eq(zero) | w.eq(zero)) & inside).bits();
    if on_edge != 0 {
        let (mut us, mut vs, mut ws) = (u.store(), v.store(), w.store());
        let [ax, ay, bx, by] = [ax.store().0, ay.store().0, bx.store().0, by.store().0];
        let [cx, cy] = [cx.store().0, cy.store().0];
        for k in lanes_of(on_edge) {
            us.0[k] = edge_function(cx[k], by[k], cy[k], bx[k]);
            vs.0[k] = edge_function(ax[k], cy[k], ay[k], cx[k]);
            ws.0[k] = edge_function(bx[k], ay[k], by[k], ax[k]);
        }
        (u, v, w) = (L::load(&us), L::load(&vs), L::load(&ws));
        let mixed = u.min(v).min(w).lt(zero) & zero.lt(u.max(v).max(w));
        inside = inside & !mixed;
    }
    let determinant = u + v + w;
    let met = inside & !determinant.eq(zero);
    let inverse = L::splat(1.0) / determinant;
    let (az, bz, cz) = (shear[2] * a[2], shear[2] * b[2], shear[2] * c[2]);
    let t = (u * az + v * bz + w * cz) * inverse;
    Some(Meeting {
        met,
        t,
        v: v * inverse,
        w: w * inverse,
    })
}

impl<L: Lanes> Packet<L> {
    /// The packet of the lanes `bits` of a block, all of whose directions are longest along `axis`.
    #[inline(always)]
    pub(crate) fn new(block: &RayBlock, axis: usize, bits: u32) -> Self {
        let axes = ShearBlock::axes_from(axis);
        let one = L::splat(1.0);
        let shear_z = one / L::load(&block.direction[axes[2]]);
        let origin = [
            L::load(&block.origin[0]),
            L::load(&block.origin[1]),
            L::load(&block.origin[2]),
        ];
        Self {
            origin,
            inverse: [
                inverse_direction(L::load(&block.direction[0])),
                inverse_direction(L::load(&block.direction[1])),
                inverse_direction(L::load(&block.direction[2])),
            ],
            sheared_origin: [
                L::load(&block.origin[axes[0]]),
                L::load(&block.origin[axes[1]]),
                L::load(&block.origin[axes[2]]),
            ],
            shear: [
                L::load(&block.direction[axes[0]]) * shear_z,
                L::load(&block.direction[axes[1]]) * shear_z,
                shear_z,
            ],
            axes,
            t_min: L::load(&block.t_min),
            t_max: L::load(&block.t_max),
            active: L::Mask::from_bits(bits),
        }
    }

    /// The lanes `bits` of the packet, from `t` on.
    #[inline(always)]
    pub(crate) fn beyond(self, t: L, bits: u32) -> Self {
        Self {
            t_min: t,
            active: L::Mask::from_bits(bits),
            ..self
        }
    }

    /// Lanes that meet a box before `t_max`, and where they enter.
    #[inline(always)]
    pub(crate) fn enter(&self, node: &Node, t_max: L) -> (L::Mask, L) {
        let (mut near, mut far) = (self.t_min, t_max);
        for k in 0..3 {
            let a = (L::splat(node.min[k]) - self.origin[k]) * self.inverse[k];
            let b = (L::splat(node.max[k]) - self.origin[k]) * self.inverse[k];
            near = a.min(b).max(near);
            far = a.max(b).min(far);
        }
        (near.le(far * L::splat(FAR_SLACK)) & self.active, near)
    }

    /// Lanes that meet a triangle past `t_min`.
    #[inline(always)]
    fn meet(&self, corners: &[[f32; 3]; 3]) -> Option<Meeting<L>> {
        let [x, y, z] = self.axes;
        let [ox, oy, oz] = self.sheared_origin;
        let [a, b, c] = corners;
        let meeting = meet_sheared(
            [
                [
                    L::splat(a[x]) - ox,
                    L::splat(a[y]) - oy,
                    L::splat(a[z]) - oz,
                ],
                [
                    L::splat(b[x]) - ox,
                    L::splat(b[y]) - oy,
                    L::splat(b[z]) - oz,
                ],
                [
                    L::splat(c[x]) - ox,
                    L::splat(c[y]) - oy,
                    L::splat(c[z]) - oz,
                ],
            ],
            &self.shear,
            self.active,
        )?;
        Some(Meeting {
            met: meeting.met & self.t_min.lt(meeting.t),
            ..meeting
        })
    }
}

/// As [`crate::bvh::inverse_direction`].
#[inline(always)]
fn inverse_direction<L: Lanes>(d: L) -> L {
    let zero = L::splat(0.0);
    let is_small = d.max(zero - d).lt(L::splat(1e-25));
    let large = L::select(d.lt(zero), L::splat(-1e25), L::splat(1e25));
    L::select(is_small, large, L::splat(1.0) / d)
}

/// The smallest lane where `mask` is set, infinity where it is nowhere.
#[inline(always)]
fn smallest<L: Lanes>(v: L, mask: L::Mask) -> f32 {
    let v = L::select(mask, v, L::splat(f32::INFINITY)).store().0;
    let lower = |a: f32, b: f32| if a < b { a } else { b };
    let (ab, cd) = (lower(v[0], v[1]), lower(v[2], v[3]));
    let (ef, gh) = (lower(v[4], v[5]), lower(v[6], v[7]));
    lower(lower(ab, cd), lower(ef, gh))
}

/// The largest lane where `mask` is set, minus infinity where it is nowhere.
#[inline(always)]
fn largest<L: Lanes>(v: L, mask: L::Mask) -> f32 {
    -smallest(L::splat(0.0) - v, mask)
}

impl Bvh {
    /// [`Bvh::closest_hit`] of eight rays. Hits at or past `t_max` do not count.
    #[inline(always)]
    pub(crate) fn closest_hits<L: Lanes>(
        &self,
        packet: &Packet<L>,
        t_max: L,
        admit: impl Admit,
    ) -> PacketHit<L> {
        let mut best = PacketHit {
            t: t_max,
            u: L::splat(0.0),
            v: L::splat(0.0),
            triangle: [0; LANES],
            found: L::Mask::from_bits(0),
        };
        let Some(root) = self.nodes.first() else {
            return best;
        };
        let (met, near) = packet.enter(root, t_max);
        if !met.any() {
            return best;
        }
        let mut stack = [(0_u32, 0.0_f32); MAX_DEPTH + 1];
        stack[0] = (0, smallest(near, met));
        let mut height = 1;
        // Furthest of the lanes' nearest hits: what lies behind it matters to none
        let mut furthest = f32::INFINITY;
        while height > 0 {
            height -= 1;
            let (index, near) = stack[height];
            if near > furthest {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.is_leaf() {
                if self.closest_in_leaf(packet, node, admit, &mut best) {
                    furthest = largest(best.t, packet.active) * FAR_SLACK;
                }
                continue;
            }
            let (first, second) = (node.first as usize, node.first as usize + 1);
            let (left_met, left_near) = packet.enter(&self.nodes[first], best.t);
            let (right_met, right_near) = packet.enter(&self.nodes[second], best.t);
            let (in_left, in_right) = (left_met.any(), right_met.any());
            if in_left && in_right {
                let left = smallest(left_near, left_met);
                let right = smallest(right_near, right_met);
                let order = if left <= right {
                    [(second as u32, right), (first as u32, left)]
                } else {
                    [(first as u32, left), (second as u32, right)]
                };
                stack[height] = order[0];
                stack[height + 1] = order[1];
                height += 2;
            } else if in_left || in_right {
                // An only child is visited at once
                let child = if in_left { first } else { second };
                stack[height] = (child as u32, f32::NEG_INFINITY);
                height += 1;
            }
        }
        best
    }

    /// Takes over what is hit nearer in a leaf; whether anything is.
    #[inline(always)]
    fn closest_in_leaf<L: Lanes>(
        &self,
        packet: &Packet<L>,
        node: &Node,
        admit: impl Admit,
        best: &mut PacketHit<L>,
    ) -> bool {
        let mut is_any = false;
        for slot in node.first as usize..(node.first + node.count) as usize {
            let Some(Meeting { met, t, v, w }) = packet.meet(&self.corners[slot]) else {
                continue;
            };
            let id = self.triangle_ids[slot];
            let mut closer = met & t.lt(best.t);
            // Of equal distances the lower triangle wins
            let tied = (met & t.eq(best.t)).bits();
            if tied != 0 {
                let lower = lanes_of(tied)
                    .filter(|&k| id < best.triangle[k])
                    .fold(0, |bits, k| bits | 1 << k);
                closer = closer | L::Mask::from_bits(lower);
            }
            let closer = admit.admitted::<L>(closer, id, v, w);
            let bits = closer.bits();
            if bits == 0 {
                continue;
            }
            best.t = L::select(closer, t, best.t);
            best.u = L::select(closer, v, best.u);
            best.v = L::select(closer, w, best.v);
            best.found = best.found | closer;
            for k in lanes_of(bits) {
                best.triangle[k] = id;
            }
            is_any = true;
        }
        is_any
    }

    /// [`Bvh::any_hit`] of eight rays. `last` is the leaf slot of a triangle to try first: a hint, set to the last one
    /// that blocked.
    #[inline(always)]
    pub(crate) fn any_hits<L: Lanes>(
        &self,
        packet: &Packet<L>,
        last: &mut u32,
        admit: impl Admit,
    ) -> L::Mask {
        let mut packet = *packet;
        let mut found = L::Mask::from_bits(0);
        let Some(root) = self.nodes.first() else {
            return found;
        };
        if let Some(corners) = self.corners.get(*last as usize)
            && let Some(Meeting { met, t, v, w }) = packet.meet(corners)
        {
            let id = self.triangle_ids[*last as usize];
            found = admit.admitted::<L>(met & t.lt(packet.t_max), id, v, w);
            packet.active = packet.active & !found;
            if !packet.active.any() {
                return found;
            }
        }
        if !packet.enter(root, packet.t_max).0.any() {
            return found;
        }
        let mut stack = [0_u32; MAX_DEPTH + 1];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let node = &self.nodes[stack[height] as usize];
            if node.is_leaf() {
                for slot in node.first as usize..(node.first + node.count) as usize {
                    let Some(Meeting { met, t, v, w }) = packet.meet(&self.corners[slot]) else {
                        continue;
                    };
                    let id = self.triangle_ids[slot];
                    let blocked = admit.admitted::<L>(met & t.lt(packet.t_max), id, v, w);
                    if blocked.any() {
                        *last = slot as u32;
                        found = found | blocked;
                        packet.active = packet.active & !blocked;
                    }
                }
                if !packet.active.any() {
                    break;
                }
                continue;
            }
            for child in [node.first + 1, node.first] {
                if packet
                    .enter(&self.nodes[child as usize], packet.t_max)
                    .0
                    .any()
                {
                    stack[height] = child;
                    height += 1;
                }
            }
        }
        found
    }
}
