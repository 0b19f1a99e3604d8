//! Direct light on eight surface points at a time, before shadows.
//!
//! The tests hold the scalar form and compare.

use crate::lanes::{Eight, Kernel, LaneMask, Lanes, V3, lanes_of};
use crate::light::{AmbientSum, Light};
use crate::math::{Rgb, power};
use crate::microfacets;
use crate::strands;
use crate::surface::{SurfaceBlock, lane};

/// Eight colours, channel by channel.
pub(crate) type ColorBlock = [Eight; 3];

/// What a light gives each surface if nothing is in between, block by block.
#[derive(Debug, Default)]
pub(crate) struct Arriving {
    /// Lanes that get any: a ray to the light finds out whether it arrives. Blocks without such a lane hold nothing of use.
    pub(crate) lit: Vec<u32>,
    /// Where the rays to the light start, mm.
    pub(crate) start: Vec<[Eight; 3]>,
    pub(crate) color: Vec<ColorBlock>,
    /// What the diffuse layer gets of it, before its colour; empty unless asked for.
    pub(crate) irradiance: Vec<ColorBlock>,
}

/// Sets `arriving` to what a light gives each surface.
pub(crate) struct Gather<'a> {
    pub(crate) light: &'a Light,
    /// Distance from the surface at which rays to the light start, mm.
    pub(crate) offset: f32,
    pub(crate) surfaces: &'a [SurfaceBlock],
    /// [`crate::whitted::Wanted::lanes`].
    pub(crate) lanes: Option<&'a [u32]>,
    /// Blocks for which the irradiance is wanted, from the first.
    pub(crate) irradiance: usize,
    /// Whether points that get nothing of the light send it a ray all the same.
    pub(crate) from_everywhere: bool,
    pub(crate) arriving: &'a mut Arriving,
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
        self.arriving.resize(self.surfaces.len(), self.irradiance);
        for (index, block) in self.surfaces.iter().enumerate() {
            let lanes = self.lanes.map_or(0xFF, |lanes| lanes[index]);
            if lanes == 0 {
                self.arriving.lit[index] = 0;
                continue;
            }
            let light = (self.light, self.from_everywhere);
            gather::<L>(light, self.offset, block, index, self.arriving);
            self.arriving.lit[index] &= lanes;
        }
    }
}

impl Arriving {
    fn resize(&mut self, blocks: usize, with_irradiance: usize) {
        let nothing = ColorBlock::default();
        self.lit.resize(blocks, 0);
        self.start.resize(blocks, nothing);
        self.color.resize(blocks, nothing);
        self.irradiance.resize(with_irradiance, nothing);
    }
}

/// Finds the lanes of a block that a light gives anything, and how much.
#[inline(always)]
fn gather<L: Lanes>(
    (light, from_everywhere): (&Light, bool),
    offset: f32,
    block: &SurfaceBlock,
    index: usize,
    out: &mut Arriving,
) {
    out.lit[index] = 0;
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
    let reached = arrival.any & L::Mask::from_bits(block.hit);
    if !(lit.any() || from_everywhere && reached.any()) {
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
    let (mut scale, mut weight) = (cosine, weight);
    let mut above = V3::load(&block.flat_normal).scale(L::splat(offset));
    if let Some(hair) = &block.strands {
        // Hair scatters as cylinders do, and casts soft shadows on itself
        let is_hair = L::Mask::from_bits(hair.lanes);
        let strand = V3::<L>::load(&hair.direction);
        let view = V3::<L>::load(&block.view);
        let albedo = V3::<L>::load(&block.albedo);
        let scattered = strands::scatter(strand, arrival.direction, view, albedo);
        let inside = arrival.direction.scale(L::splat(strands::SOFT_DEPTH_MM));
        share = V3::select(is_hair, scattered, share);
        scale = L::select(is_hair, L::splat(1.0), cosine);
        weight = L::select(is_hair, zero, weight);
        above = V3::select(is_hair, inside, above);
    }
    let [r, g, b] = share.0;
    let lit = lit & zero.lt(r.max(g).max(b));
    let mut color = (share * arrival.power).scale(scale);
    let mut irradiance = arrival.power.scale(weight * cosine);
    out.lit[index] = lit.bits();
    if from_everywhere {
        out.lit[index] = reached.bits();
        color = V3::select(lit, color, V3::splat([0.0; 3]));
        irradiance = V3::select(lit, irradiance, V3::splat([0.0; 3]));
    }
    out.color[index] = color.store();
    if let Some(own) = out.irradiance.get_mut(index) {
        *own = irradiance.store();
    }
    out.start[index] = (lifted + above).store();
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

/// Sets colours to the light of all ambient sources, and to the background where nothing is hit.
pub(crate) struct Ambient<'a> {
    pub(crate) sum: AmbientSum,
    pub(crate) background: Rgb,
    pub(crate) surfaces: &'a [SurfaceBlock],
    /// [`crate::whitted::Wanted::lanes`].
    pub(crate) lanes: Option<&'a [u32]>,
    pub(crate) colors: &'a mut Vec<ColorBlock>,
    /// Light on the diffuse layer, before its colour, of the first `with_irradiance` blocks.
    pub(crate) irradiance: &'a mut Vec<ColorBlock>,
    pub(crate) with_irradiance: usize,
}

impl Kernel for Ambient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        self.colors.clear();
        self.irradiance.clear();
        let background = V3::<L>::splat(self.background.into());
        for (index, block) in self.surfaces.iter().enumerate() {
            if self.lanes.is_some_and(|lanes| lanes[index] == 0) {
                self.colors.push(ColorBlock::default());
                if index < self.with_irradiance {
                    self.irradiance.push(ColorBlock::default());
                }
                continue;
            }
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
            let hit = L::Mask::from_bits(block.hit);
            self.colors.push(V3::select(hit, light, background).store());
            if index < self.with_irradiance {
                self.irradiance.push(sum.scale(share).store());
            }
        }
    }
}

/// Adds the part of ambient light that is not linear in the normal: nothing for most scenes, so a pass of its own.
pub(crate) fn add_bend(
    sum: &AmbientSum,
    surfaces: &[SurfaceBlock],
    lanes: Option<&[u32]>,
    colors: &mut [ColorBlock],
    irradiance: &mut [ColorBlock],
) {
    for (index, (block, color)) in surfaces.iter().zip(colors).enumerate() {
        let wanted = lanes.map_or(0xFF, |lanes| lanes[index]);
        for k in lanes_of(block.hit & wanted) {
            let share = block.weight.0[k] * block.exposure.0[k];
            let light = sum.bend_on(lane(&block.normal, k));
            let own = lane(&block.albedo, k).component_mul(&light) * share;
            for channel in 0..3 {
                color[channel].0[k] += own[channel];
            }
            if let Some(irradiance) = irradiance.get_mut(index) {
                for channel in 0..3 {
                    irradiance[channel].0[k] += light[channel] * share;
                }
            }
        }
    }
}

/// Adds what arrives of a light, and says how much of what could.
pub(crate) struct Add<'a> {
    pub(crate) arriving: &'a Arriving,
    /// Lanes that something opaque hides from the light.
    pub(crate) blocked: &'a [u32],
    /// Lanes whose light is tinted, see `tints`; empty for none.
    pub(crate) touched: &'a [u32],
    /// Tints of the blocks with touched lanes, in order.
    pub(crate) tints: &'a [ColorBlock],
    pub(crate) colors: &'a mut [ColorBlock],
    /// As many blocks as are wanted.
    pub(crate) irradiance: &'a mut [ColorBlock],
    /// Sum of the channels of what arrives, and of what would if nothing were in between; as many blocks as are wanted.
    pub(crate) arrived: &'a mut [[Eight; 2]],
}

impl Kernel for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let mut tints = self.tints.iter();
        for (index, lit) in self.arriving.lit.iter().enumerate() {
            let is_touched = self.touched.get(index).is_some_and(|t| *t != 0);
            let tint = is_touched.then(|| tints.next()).flatten();
            if *lit == 0 {
                continue;
            }
            let none = V3::splat([0.0; 3]);
            let open = L::Mask::from_bits(lit & !self.blocked[index]);
            let full = V3::<L>::load(&self.arriving.color[index]);
            let mut color = full;
            if let Some(tint) = tint {
                color = color * V3::load(tint);
            }
            let color = V3::select(open, color, none);
            let own = &mut self.colors[index];
            *own = (V3::<L>::load(own) + color).store();
            if let Some(own) = self.irradiance.get_mut(index) {
                let mut light = V3::<L>::load(&self.arriving.irradiance[index]);
                if let Some(tint) = tint {
                    light = light * V3::load(tint);
                }
                *own = (V3::<L>::load(own) + V3::select(open, light, none)).store();
            }
            if let Some([arrived, possible]) = self.arrived.get_mut(index) {
                let full = V3::select(L::Mask::from_bits(*lit), full, none);
                *arrived = (L::load(arrived) + color.sum()).store();
                *possible = (L::load(possible) + full.sum()).store();
            }
        }
    }
}
