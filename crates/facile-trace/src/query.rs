//! Ray queries over a whole scene, many rays at a time.
//!
//! Rays go through each object's tree in packets of eight. The answers are those of the one-ray queries of
//! [`crate::scene`], bit for bit.

use crate::bvh::Node;
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, lanes_of, run};
use crate::math::Rgb;
use crate::object::Object;
use crate::packet::{Packet, RayBlock, for_each_packet};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};

/// An object with its box in the world.
struct Candidate<'a> {
    index: u32,
    object: &'a Object,
    bounds: Node,
    /// Leaf slot of the triangle that blocked last.
    last_blocker: u32,
}

impl Scene {
    fn candidates(&self, keep: impl Fn(&Object) -> bool) -> Vec<Candidate<'_>> {
        self.objects()
            .iter()
            .enumerate()
            .filter(|(_, object)| keep(object))
            .filter_map(|(index, object)| {
                let (min, max) = object.bounds_in_world()?;
                let bounds = Node {
                    min: min.into(),
                    max: max.into(),
                    ..Node::default()
                };
                Some(Candidate {
                    index: index as u32,
                    object,
                    bounds,
                    last_blocker: u32::MAX,
                })
            })
            .collect()
    }

    /// Appends the nearest hit of each ray, [`Hit::MISS`] where there is none.
    pub fn closest_hits(&self, rays: &[Ray], layer: Layer, hits: &mut Vec<Hit>) {
        run(ClosestHits {
            candidates: &self.candidates(|o| layer.sees(o)),
            rays,
            hits,
        });
    }

    /// Sets bit `k` of `blocked[i]` where lane `k` of `blocks[i]` meets anything opaque. The first `count` lanes hold rays.
    fn blocked(&self, blocks: &[RayBlock], count: usize, blocked: &mut Vec<u32>) {
        blocked.clear();
        blocked.resize(blocks.len(), 0);
        run(Blocked {
            candidates: &mut self.candidates(|o| o.is_visible && !o.is_transparent()),
            blocks,
            count,
            blocked,
        });
    }

    /// Sets `shares` to [`Scene::transmittance`] of each ray.
    pub fn transmittances(&self, rays: &[Ray], shares: &mut Vec<Rgb>) {
        shares.clear();
        let mut blocks = vec![RayBlock::default(); rays.len().div_ceil(LANES)];
        for (i, ray) in rays.iter().enumerate() {
            blocks[i / LANES].set(i % LANES, ray);
        }
        let mut blocked = Vec::new();
        self.blocked(&blocks, rays.len(), &mut blocked);
        let has_transparency = self.has_transparency();
        shares.extend(rays.iter().enumerate().map(|(i, ray)| {
            if blocked[i / LANES] >> (i % LANES) & 1 == 1 {
                Rgb::zeros()
            } else if has_transparency {
                self.tint(ray)
            } else {
                Rgb::repeat(1.0)
            }
        }));
    }
}

/// The lanes `bits` of a block that meet an object's box in the world before `ends`.
#[inline(always)]
fn near_box<L: Lanes>(block: &RayBlock, bits: u32, bounds: &Node, ends: L) -> u32 {
    Packet::<L>::new(block, 0, bits)
        .enter(bounds, ends)
        .0
        .bits()
}

/// A block in an object's frame.
#[inline(always)]
pub(crate) fn block_in_object(object: &Object, block: RayBlock, bits: u32) -> RayBlock {
    if object.world_from_object.is_none() {
        return block;
    }
    let mut local = RayBlock::default();
    for k in lanes_of(bits) {
        local.set(k, &object.ray_in_object(&block.get(k)));
    }
    local
}

struct ClosestHits<'a> {
    candidates: &'a [Candidate<'a>],
    rays: &'a [Ray],
    hits: &'a mut Vec<Hit>,
}

impl Kernel for ClosestHits<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        for rays in self.rays.chunks(LANES) {
            let mut block = RayBlock::default();
            for (k, ray) in rays.iter().enumerate() {
                block.set(k, ray);
            }
            let all = 0xFF >> (LANES - rays.len());
            let best = closest_of_block::<L>(self.candidates, &block, all);
            self.hits.extend_from_slice(&best[..rays.len()]);
        }
    }
}

#[inline(always)]
fn closest_of_block<L: Lanes>(
    candidates: &[Candidate<'_>],
    block: &RayBlock,
    all: u32,
) -> [Hit; LANES] {
    let mut best: [Hit; LANES] = [Hit::MISS; LANES];
    let mut nearest: Eight = block.t_max;
    for candidate in candidates {
        let object = candidate.object;
        let local;
        let (block, bits) = if object.world_from_object.is_none() {
            (block, all)
        } else {
            let bits = near_box::<L>(block, all, &candidate.bounds, L::load(&nearest));
            if bits == 0 {
                continue;
            }
            local = block_in_object(object, *block, bits);
            (&local, bits)
        };
        for_each_packet!(L, block, bits, packet => {
            let found = object.bvh.closest_hits(&packet, L::load(&nearest));
            let (t, u, v) = (found.t.store().0, found.u.store().0, found.v.store().0);
            for k in lanes_of(found.found.bits()) {
                nearest.0[k] = t[k];
                best[k] = Hit {
                    t: t[k],
                    object: candidate.index,
                    triangle: found.triangle[k],
                    u: u[k],
                    v: v[k],
                };
            }
        });
    }
    best
}

struct Blocked<'a, 'b> {
    candidates: &'a mut [Candidate<'b>],
    blocks: &'a [RayBlock],
    count: usize,
    blocked: &'a mut [u32],
}

impl Kernel for Blocked<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        if self.candidates.is_empty() {
            return;
        }
        for (index, (block, blocked)) in self.blocks.iter().zip(self.blocked).enumerate() {
            let present = 0xFF >> (LANES - (self.count - index * LANES).min(LANES));
            for candidate in &mut *self.candidates {
                let wanted = !*blocked & present;
                if wanted == 0 {
                    break;
                }
                let object = candidate.object;
                let local;
                let (block, bits) = if object.world_from_object.is_none() {
                    (block, wanted)
                } else {
                    let ends = L::load(&block.t_max);
                    let bits = near_box::<L>(block, wanted, &candidate.bounds, ends);
                    if bits == 0 {
                        continue;
                    }
                    local = block_in_object(object, *block, bits);
                    (&local, bits)
                };
                for_each_packet!(L, block, bits, packet => {
                    let last = &mut candidate.last_blocker;
                    *blocked |= object.bvh.any_hits(&packet, last).bits();
                });
            }
        }
    }
}
