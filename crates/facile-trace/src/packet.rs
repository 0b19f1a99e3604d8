//! Eight rays through a tree at once.
//!
//! The same tests in the same order of operations as [`crate::triangle`] and [`crate::bvh`], so that each lane gives the
//! bits of the scalar query. A packet's rays share the axis that the watertight test shears along; [`split`] sorts rays
//! into packets by it.
#![expect(
    clippy::inline_always,
    reason = "the kernels must become one function to stay in vector registers"
)]

use crate::bvh::{Bvh, FAR_SLACK, MAX_DEPTH, Node, inverse_direction};
use crate::lanes::{F8, LANES, M8};
use crate::math::Vec3;
use crate::ray::Ray;
use crate::triangle::{RayShear, dominant_axis, edge_function};

/// Up to eight rays with one shear axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packet {
    origin: [F8; 3],
    inverse: [F8; 3],
    /// Shear along `x` and `y`, scale along `z`.
    shear: [F8; 3],
    /// Axes that become `x`, `y`, `z`.
    axes: [usize; 3],
    t_min: F8,
    t_max: F8,
    active: M8,
}

/// What the lanes of a packet hit; `t` stays at the ray's end in lanes without a hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PacketHit {
    pub(crate) t: F8,
    pub(crate) u: F8,
    pub(crate) v: F8,
    pub(crate) triangle: [u32; LANES],
    pub(crate) found: M8,
}

impl Packet {
    /// The packet of at most eight rays, as many of them as share the shear axis of the first one whose lane is set in
    /// `wanted`. Lanes of other rays are inactive.
    pub(crate) fn new(rays: &[Ray], wanted: M8) -> Option<Self> {
        let first = (0..rays.len()).find(|&k| wanted.0[k] != 0)?;
        let z = dominant_axis(rays[first].direction);
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let idle = Ray::new(Vec3::zeros(), Vec3::repeat(1.0));
        let is_active =
            |k: usize| k < rays.len() && wanted.0[k] != 0 && dominant_axis(rays[k].direction) == z;
        let lane = |k: usize| if is_active(k) { &rays[k] } else { &idle };
        let shears: [RayShear; LANES] = std::array::from_fn(|k| {
            let shear = RayShear::new(lane(k).direction);
            if shear.axes == axes {
                shear
            } else {
                RayShear {
                    axes,
                    shear_x: 0.0,
                    shear_y: 0.0,
                    shear_z: 1.0,
                }
            }
        });
        let inverses: [Vec3; LANES] = std::array::from_fn(|k| inverse_direction(lane(k).direction));
        let gather = |f: &dyn Fn(usize) -> f32| F8(std::array::from_fn(f));
        Some(Self {
            origin: std::array::from_fn(|axis| gather(&|k| lane(k).origin[axis])),
            inverse: std::array::from_fn(|axis| gather(&|k| inverses[k][axis])),
            shear: [
                gather(&|k| shears[k].shear_x),
                gather(&|k| shears[k].shear_y),
                gather(&|k| shears[k].shear_z),
            ],
            axes,
            t_min: gather(&|k| lane(k).t_min),
            t_max: gather(&|k| lane(k).t_max),
            active: M8(std::array::from_fn(
                |k| if is_active(k) { u32::MAX } else { 0 },
            )),
        })
    }

    pub(crate) fn active(&self) -> M8 {
        self.active
    }

    /// Lanes that meet a box before `t_max`.
    #[inline(always)]
    pub(crate) fn meets(&self, node: &Node, t_max: F8) -> M8 {
        self.enter(node, t_max).0
    }

    /// Lanes that meet a box before `t_max`, and where they enter.
    #[inline(always)]
    fn enter(&self, node: &Node, t_max: F8) -> (M8, F8) {
        let (mut near, mut far) = (self.t_min, t_max);
        for k in 0..3 {
            let a = (F8::splat(node.min[k]) - self.origin[k]) * self.inverse[k];
            let b = (F8::splat(node.max[k]) - self.origin[k]) * self.inverse[k];
            near = a.min(b).max(near);
            far = a.max(b).min(far);
        }
        (near.le(far * F8::splat(FAR_SLACK)) & self.active, near)
    }

    /// Lanes that meet a triangle, where, and the weights of its second and third corner.
    #[inline(always)]
    fn meet(&self, corners: &[Vec3; 3]) -> (M8, F8, F8, F8) {
        let [x, y, z] = self.axes;
        let sheared = corners.map(|corner| {
            let px = F8::splat(corner[x]) - self.origin[x];
            let py = F8::splat(corner[y]) - self.origin[y];
            let pz = F8::splat(corner[z]) - self.origin[z];
            (
                px - self.shear[0] * pz,
                py - self.shear[1] * pz,
                self.shear[2] * pz,
            )
        });
        let [(ax, ay, az), (bx, by, bz), (cx, cy, cz)] = sheared;
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        let zero = F8::splat(0.0);
        let on_edge = (u.eq(zero) | v.eq(zero) | w.eq(zero)) & self.active;
        if on_edge.any() {
            for k in (0..LANES).filter(|&k| on_edge.0[k] != 0) {
                u.0[k] = edge_function(cx.0[k], by.0[k], cy.0[k], bx.0[k]);
                v.0[k] = edge_function(ax.0[k], cy.0[k], ay.0[k], cx.0[k]);
                w.0[k] = edge_function(bx.0[k], ay.0[k], by.0[k], ax.0[k]);
            }
        }
        let negative = u.lt(zero) | v.lt(zero) | w.lt(zero);
        let positive = zero.lt(u) | zero.lt(v) | zero.lt(w);
        let determinant = u + v + w;
        let inside = !(negative & positive) & !determinant.eq(zero) & self.active;
        let inverse = determinant.recip();
        let t = (u * az + v * bz + w * cz) * inverse;
        (inside & self.t_min.lt(t), t, v * inverse, w * inverse)
    }
}

impl Bvh {
    /// [`Bvh::closest_hit`] of eight rays. Hits at or past `t_max` do not count.
    #[inline(always)]
    pub(crate) fn closest_hits(&self, packet: &Packet, t_max: F8) -> PacketHit {
        let mut best = PacketHit {
            t: t_max,
            u: F8::splat(0.0),
            v: F8::splat(0.0),
            triangle: [0; LANES],
            found: M8([0; LANES]),
        };
        let Some(root) = self.nodes.first() else {
            return best;
        };
        let (met, near) = packet.enter(root, t_max);
        if !met.any() {
            return best;
        }
        let mut stack = [(0_u32, 0.0_f32); MAX_DEPTH + 1];
        stack[0] = (0, near.smallest(met));
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
                let mut any = false;
                for slot in node.first as usize..(node.first + node.count) as usize {
                    let (met, t, u, v) = packet.meet(&self.corners[slot]);
                    if !met.any() {
                        continue;
                    }
                    let id = [self.triangle_ids[slot]; LANES];
                    let lower = M8(std::array::from_fn(|k| {
                        if id[k] < best.triangle[k] {
                            u32::MAX
                        } else {
                            0
                        }
                    }));
                    let closer = met & (t.lt(best.t) | (t.eq(best.t) & lower));
                    best.t = closer.select(t, best.t);
                    best.u = closer.select(u, best.u);
                    best.v = closer.select(v, best.v);
                    best.triangle = closer.select_u32(id, best.triangle);
                    best.found = best.found | closer;
                    any = true;
                }
                if any {
                    let idle = packet.active.select(best.t, F8::splat(f32::NEG_INFINITY));
                    furthest = idle
                        .0
                        .iter()
                        .fold(f32::NEG_INFINITY, |a, b| if a > *b { a } else { *b })
                        * FAR_SLACK;
                }
                continue;
            }
            let (first, second) = (node.first as usize, node.first as usize + 1);
            let (left_met, left_near) = packet.enter(&self.nodes[first], best.t);
            let (right_met, right_near) = packet.enter(&self.nodes[second], best.t);
            let left = left_near.smallest(left_met);
            let right = right_near.smallest(right_met);
            let order = if left <= right {
                [(second as u32, right), (first as u32, left)]
            } else {
                [(first as u32, left), (second as u32, right)]
            };
            for child in order {
                if child.1 < f32::INFINITY {
                    stack[height] = child;
                    height += 1;
                }
            }
        }
        best
    }

    /// [`Bvh::any_hit`] of eight rays; lanes of `done` need no answer.
    #[inline(always)]
    pub(crate) fn any_hits(&self, packet: &Packet, done: M8) -> M8 {
        let mut packet = *packet;
        let mut found = M8([0; LANES]);
        packet.active = packet.active & !done;
        let mut stack = [0_u32; MAX_DEPTH + 1];
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let node = &self.nodes[stack[height] as usize];
            if !packet.enter(node, packet.t_max).0.any() {
                continue;
            }
            if !node.is_leaf() {
                stack[height] = node.first;
                stack[height + 1] = node.first + 1;
                height += 2;
                continue;
            }
            for slot in node.first as usize..(node.first + node.count) as usize {
                let (met, t, ..) = packet.meet(&self.corners[slot]);
                found = found | (met & t.lt(packet.t_max));
            }
            packet.active = packet.active & !found;
            if !packet.active.any() {
                break;
            }
        }
        found
    }
}
