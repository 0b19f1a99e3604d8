//! Ray queries over a whole scene, many rays at a time.
//!
//! Rays go through each object's tree in packets of eight. The answers are those of the one-ray queries of
//! [`crate::scene`], bit for bit.
#![expect(
    clippy::inline_always,
    reason = "the kernels must become one function to stay in vector registers"
)]

use crate::bvh::Node;
use crate::lanes::{F8, LANES, M8};
use crate::math::Rgb;
use crate::object::Object;
use crate::packet::Packet;
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};

/// An object with its box in the world.
struct Candidate<'a> {
    index: u32,
    object: &'a Object,
    bounds: Node,
}

/// Packets of up to eight rays: one for each shear axis that occurs.
struct Packets([Option<Packet>; 3]);

impl Packets {
    #[inline(always)]
    fn new(rays: &[Ray], mut wanted: M8) -> Self {
        let mut packets = [None; 3];
        for slot in &mut packets {
            *slot = Packet::new(rays, wanted);
            match slot {
                Some(packet) => wanted = wanted & !packet.active(),
                None => break,
            }
        }
        Self(packets)
    }

    #[inline(always)]
    fn iter(&self) -> impl Iterator<Item = &Packet> {
        self.0.iter().flatten()
    }
}

fn lanes_of(rays: &[Ray]) -> M8 {
    M8(std::array::from_fn(|k| {
        if k < rays.len() { u32::MAX } else { 0 }
    }))
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
                })
            })
            .collect()
    }

    /// Appends the nearest hit of each ray, [`Hit::MISS`] where there is none.
    pub fn closest_hits(&self, rays: &[Ray], layer: Layer, hits: &mut Vec<Hit>) {
        let candidates = self.candidates(|o| layer.sees(o));
        for rays in rays.chunks(LANES) {
            let best = closest_of_eight(&candidates, rays);
            hits.extend_from_slice(&best[..rays.len()]);
        }
    }

    /// Sets `shares` to [`Scene::transmittance`] of each ray.
    pub fn transmittances(&self, rays: &[Ray], shares: &mut Vec<Rgb>) {
        shares.clear();
        let opaque = self.candidates(|o| o.is_visible && !o.is_transparent());
        let has_transparency = self.has_transparency();
        for rays in rays.chunks(LANES) {
            let blocked = blocked_of_eight(&opaque, rays);
            for (ray, blocked) in rays.iter().zip(blocked.0) {
                shares.push(if blocked != 0 {
                    Rgb::zeros()
                } else if has_transparency {
                    self.tint(ray)
                } else {
                    Rgb::repeat(1.0)
                });
            }
        }
    }
}

#[inline(always)]
fn closest_of_eight(candidates: &[Candidate<'_>], rays: &[Ray]) -> [Hit; LANES] {
    let in_world = Packets::new(rays, lanes_of(rays));
    let mut best: [Hit; LANES] = std::array::from_fn(|k| Hit {
        t: rays.get(k).map_or(0.0, |r| r.t_max),
        ..Hit::MISS
    });
    for candidate in candidates {
        let t_best = F8(best.map(|hit| hit.t));
        let mut visit = |packet: &Packet| {
            let found = candidate.object.bvh.closest_hits(packet, t_best);
            for (k, hit) in best.iter_mut().enumerate() {
                if found.found.0[k] != 0 {
                    *hit = Hit {
                        t: found.t.0[k],
                        object: candidate.index,
                        triangle: found.triangle[k],
                        u: found.u.0[k],
                        v: found.v.0[k],
                    };
                }
            }
        };
        match &candidate.object.world_from_object {
            None => in_world.iter().for_each(&mut visit),
            Some(_) => {
                let near = in_world.iter().fold(M8([0; LANES]), |m, p| {
                    m | p.meets(&candidate.bounds, t_best)
                });
                if near.any() {
                    let local: [Ray; LANES] = std::array::from_fn(|k| {
                        candidate.object.ray_in_object(&rays[k.min(rays.len() - 1)])
                    });
                    Packets::new(&local, near).iter().for_each(&mut visit);
                }
            }
        }
    }
    best.map(|hit| if hit.is_some() { hit } else { Hit::MISS })
}

#[inline(always)]
fn blocked_of_eight(opaque: &[Candidate<'_>], rays: &[Ray]) -> M8 {
    let in_world = Packets::new(rays, lanes_of(rays));
    let mut blocked = M8([0; LANES]);
    let all = lanes_of(rays);
    for candidate in opaque {
        match &candidate.object.world_from_object {
            None => {
                for packet in in_world.iter() {
                    blocked = blocked | candidate.object.bvh.any_hits(packet, blocked);
                }
            }
            Some(_) => {
                let ends = F8(std::array::from_fn(|k| {
                    rays.get(k).map_or(0.0, |r| r.t_max)
                }));
                let near = in_world
                    .iter()
                    .fold(M8([0; LANES]), |m, p| m | p.meets(&candidate.bounds, ends));
                let near = near & !blocked;
                if near.any() {
                    let local: [Ray; LANES] = std::array::from_fn(|k| {
                        candidate.object.ray_in_object(&rays[k.min(rays.len() - 1)])
                    });
                    for packet in Packets::new(&local, near).iter() {
                        blocked = blocked | candidate.object.bvh.any_hits(packet, blocked);
                    }
                }
            }
        }
        if blocked == all {
            break;
        }
    }
    blocked
}
