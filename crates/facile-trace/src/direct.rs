//! Direct light on eight surface points at a time, before shadows.
//!
//! The tests hold the scalar form and compare.

use crate::lanes::{Kernel, LANES, LaneMask, Lanes, V3, lanes_of};
use crate::light::{AmbientSum, Light};
use crate::math::{Rgb, power};
use crate::microfacets;
use crate::packet::RayBlock;
use crate::strands;
use crate::surface::{SurfaceBlock, lane};

/// A shadow ray on its way: whose light it carries, and how much if nothing is in between.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PendingShadow {
    pub(crate) sample: u32,
    pub(crate) contribution: Rgb,
    /// What the diffuse layer gets of it, before its colour.
    pub(crate) irradiance: Rgb,
}

/// Shadow rays that wait to be traced: ray `i` is lane `i % 8` of block `i / 8`.
#[derive(Debug, Default)]
pub(crate) struct PendingShadows {
    pub(crate) list: Vec<PendingShadow>,
    pub(crate) blocks: Vec<RayBlock>,
}

impl PendingShadows {
    pub(crate) fn clear(&mut self) {
        self.list.clear();
        self.blocks.clear();
    }
}

/// Adds to `pending` what a light gives each surface.
pub(crate) struct Gather<'a> {
    pub(crate) light: &'a Light,
    pub(crate) offset: f32,
    pub(crate) surfaces: &'a [SurfaceBlock],
    pub(crate) pending: &'a mut PendingShadows,
}

/// What reaches eight points from a light, see [`crate::light::Arrival`].
struct Arrivals<L: Lanes> {
    direction: V3<L>,
    power: V3<L>,
    any: L::Mask,
}

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        for (index, block) in self.surfaces.iter().enumerate() {
            gather::<L>(self.light, self.offset, block, index * LANES, self.pending);
        }
    }
}

/// Adds what a light gives the points of `block`, whose first is sample `first`.
#[inline(always)]
fn gather<L: Lanes>(
    light: &Light,
    offset: f32,
    block: &SurfaceBlock,
    first: usize,
    pending: &mut PendingShadows,
) {
    let lifted = V3::<L>::load(&block.lifted);
    let Some(arrival) = arrivals::<L>(light, lifted) else {
        return;
    };
    // Leave out what faces away
    let zero = L::splat(0.0);
    let normal = V3::<L>::load(&block.normal);
    let cosine = normal.dot(arrival.direction);
    let mut lit = arrival.any & zero.lt(cosine) & L::Mask::from_bits(block.hit);
    if let Some(hair) = &block.strands {
        lit = lit | (arrival.any & L::Mask::from_bits(hair.lanes));
    }
    if !lit.any() {
        return;
    }
    // Add the highlight to the diffuse colour
    let weight = L::load(&block.weight);
    let mut share = V3::<L>::load(&block.albedo).scale(weight);
    let specular = L::load(&block.specular);
    if zero.lt(specular).bits() & block.hit != 0 {
        let view = V3::<L>::load(&block.view);
        let roughness = L::load(&block.roughness);
        let is_rough = zero.lt(roughness);
        let mut glow = zero;
        if is_rough.bits() & block.hit != block.hit {
            let mirrored = normal.scale(L::splat(2.0) * cosine) - arrival.direction;
            glow = highlights::<L>(block, mirrored.dot(view));
        }
        if is_rough.bits() & block.hit != 0 {
            let half = (arrival.direction + view).unit_or(normal);
            let cosines = [cosine, normal.dot(view), normal.dot(half), view.dot(half)];
            let rough = microfacets::highlights(specular, roughness, cosines);
            glow = L::select(is_rough, rough, glow);
        }
        let glow = L::select(zero.lt(specular), glow, zero);
        share = share + V3([glow, glow, glow]);
    }
    let mut cosine = cosine;
    let mut irradiance = arrival.power.scale(weight * cosine);
    let mut start = lifted + V3::load(&block.flat_normal).scale(L::splat(offset));
    if let Some(hair) = &block.strands {
        // Hair scatters as cylinders do, and casts soft shadows on itself
        let is_hair = L::Mask::from_bits(hair.lanes);
        let strand = V3::<L>::load(&hair.direction);
        let view = V3::<L>::load(&block.view);
        let albedo = V3::<L>::load(&block.albedo);
        let scattered = strands::scatter(strand, arrival.direction, view, albedo);
        let inside = arrival.direction.scale(L::splat(strands::SOFT_DEPTH_MM));
        share = V3::select(is_hair, scattered, share);
        cosine = L::select(is_hair, L::splat(1.0), cosine);
        irradiance = V3::select(is_hair, V3([zero; 3]), irradiance);
        start = V3::select(is_hair, lifted + inside, start);
    }
    let [r, g, b] = share.0;
    let lit = (lit & zero.lt(r.max(g).max(b))).bits();
    // Send a ray to the light
    let contribution = (share * arrival.power).scale(cosine).store();
    let irradiance = irradiance.store();
    let (direction, t_max) = match light.position() {
        Some(position) => (V3::splat(position.into()) - start, 1.0),
        None => (arrival.direction, f32::INFINITY),
    };
    let (start, direction) = (start.store(), direction.store());
    for k in lanes_of(lit) {
        let slot = pending.list.len() % LANES;
        if slot == 0 {
            pending.blocks.push(RayBlock::default());
        }
        if let Some(rays) = pending.blocks.last_mut() {
            for axis in 0..3 {
                rays.origin[axis].0[slot] = start[axis].0[k];
                rays.direction[axis].0[slot] = direction[axis].0[k];
            }
            rays.t_max.0[slot] = t_max;
        }
        pending.list.push(PendingShadow {
            sample: (first + k) as u32,
            contribution: Rgb::new(
                contribution[0].0[k],
                contribution[1].0[k],
                contribution[2].0[k],
            ),
            irradiance: Rgb::new(irradiance[0].0[k], irradiance[1].0[k], irradiance[2].0[k]),
        });
    }
}

/// As [`Light::arrival`].
#[inline(always)]
fn arrivals<L: Lanes>(light: &Light, points: V3<L>) -> Option<Arrivals<L>> {
    match light {
        Light::Point { position, power } => {
            Some(falling_off((*position).into(), (*power).into(), points))
        }
        Light::Spot {
            position,
            axis,
            cos_inner,
            cos_outer,
            power,
        } => {
            let arrival = falling_off::<L>((*position).into(), (*power).into(), points);
            let cosine = L::splat(0.0) - arrival.direction.dot(V3::splat((*axis).into()));
            let (inner, outer) = (L::splat(*cos_inner), L::splat(*cos_outer));
            let x = (cosine - outer) / (inner - outer);
            let fade = x * x * (L::splat(3.0) - L::splat(2.0) * x);
            let fade = L::select(inner.le(cosine), L::splat(1.0), fade);
            Some(Arrivals {
                power: arrival.power.scale(fade),
                any: arrival.any & (inner.le(cosine) | outer.lt(cosine)),
                ..arrival
            })
        }
        Light::Patch {
            position,
            axis,
            power,
        } => {
            let arrival = falling_off::<L>((*position).into(), (*power).into(), points);
            let cosine = L::splat(0.0) - arrival.direction.dot(V3::splat((*axis).into()));
            Some(Arrivals {
                power: arrival.power.scale(cosine),
                any: arrival.any & L::splat(0.0).lt(cosine),
                ..arrival
            })
        }
        Light::Directional { towards, power } => Some(Arrivals {
            direction: V3::splat((*towards).into()),
            power: V3::splat((*power).into()),
            any: L::Mask::from_bits(0xFF),
        }),
        Light::Ambient { .. } | Light::Harmonic { .. } => None,
    }
}

#[inline(always)]
fn falling_off<L: Lanes>(position: [f32; 3], power: [f32; 3], points: V3<L>) -> Arrivals<L> {
    let to_light = V3::splat(position) - points;
    let squared = to_light.dot(to_light);
    Arrivals {
        direction: to_light.divide(squared.sqrt()),
        power: V3::splat(power).divide(squared),
        any: L::splat(1e-12).lt(squared),
    }
}

/// The highlights of a block's materials, 0 where `cos_alpha` is not positive.
#[inline(always)]
fn highlights<L: Lanes>(block: &SurfaceBlock, cos_alpha: L) -> L {
    let shininess = block.shininess.0;
    let mut lanes = lanes_of(block.hit);
    let first = lanes.next().map_or(0.0, |k| shininess[k]);
    let is_one = lanes.all(|k| shininess[k] == first);
    let powers = if is_one && (0.0..=65_536.0).contains(&first) && first.fract() == 0.0 {
        whole_power(cos_alpha, first as u32)
    } else {
        let mut powers = cos_alpha.store();
        for k in lanes_of(block.hit) {
            powers.0[k] = power(powers.0[k], shininess[k]);
        }
        L::load(&powers)
    };
    let scale =
        L::load(&block.specular) * (L::load(&block.shininess) + L::splat(2.0)) * L::splat(0.5);
    let zero = L::splat(0.0);
    L::select(zero.lt(cos_alpha), scale * powers, zero)
}

/// As [`power`] for whole numbers.
#[inline(always)]
fn whole_power<L: Lanes>(x: L, n: u32) -> L {
    let (mut result, mut square, mut rest) = (L::splat(1.0), x, n);
    while rest > 0 {
        if rest & 1 == 1 {
            result = result * square;
        }
        square = square * square;
        rest >>= 1;
    }
    result
}

/// Adds the part of ambient light that is not linear in the normal: nothing for most scenes, so a pass of its own.
pub(crate) struct Bend<'a> {
    pub(crate) sum: AmbientSum,
    pub(crate) surfaces: &'a [SurfaceBlock],
    pub(crate) colors: &'a mut [Rgb],
}

impl Kernel for Bend<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        for (block, colors) in self.surfaces.iter().zip(self.colors.chunks_mut(LANES)) {
            for k in lanes_of(block.hit & (0xFF >> (LANES - colors.len()))) {
                let share = block.weight.0[k] * block.exposure.0[k];
                let light = self.sum.bend_on(lane(&block.normal, k));
                colors[k] += lane(&block.albedo, k).component_mul(&light) * share;
            }
        }
    }
}

/// Sets colours to the light of all ambient sources, and to the background where nothing is hit.
pub(crate) struct Ambient<'a> {
    pub(crate) sum: AmbientSum,
    pub(crate) background: Rgb,
    pub(crate) surfaces: &'a [SurfaceBlock],
    pub(crate) colors: &'a mut [Rgb],
}

impl Kernel for Ambient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        for (block, colors) in self.surfaces.iter().zip(self.colors.chunks_mut(LANES)) {
            let share = L::load(&block.weight) * L::load(&block.exposure);
            let normal = V3::<L>::load(&block.normal);
            let [r, g, b] = &self.sum.slope;
            let sum = V3::splat(self.sum.even.into())
                + V3([
                    V3::splat((*r).into()).dot(normal),
                    V3::splat((*g).into()).dot(normal),
                    V3::splat((*b).into()).dot(normal),
                ]);
            let light = (V3::<L>::load(&block.albedo) * sum).scale(share);
            let [r, g, b] = light.store();
            for (k, color) in colors.iter_mut().enumerate() {
                *color = if block.hit >> k & 1 == 1 {
                    Rgb::new(r.0[k], g.0[k], b.0[k])
                } else {
                    self.background
                };
            }
        }
    }
}
