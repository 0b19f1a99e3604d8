//! What lies between surface points and a light: opaque objects block its rays, transparent ones tint them.
//!
//! Rays are sorted into the light's image ([`crate::shadow_cells`]); triangles of most objects are drawn over it. Rays that
//! may meet one of the others, by its box in that image, go through its tree in packets. The answers are those of
//! [`Scene::transmittance`], bit for bit.

use crate::direct::{Arriving, ColorBlock};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, V3, lanes_of, run};
use crate::light::Light;
use crate::math::Rgb;
use crate::object::Object;
use crate::packet::{Packet, RayBlock, for_each_packet};
use crate::query::block_in_object;
use crate::scene::Scene;
use crate::shadow_cells::{self, Cells};

/// What the rays of one light meet, block by block, and buffers to be kept between calls.
#[derive(Debug, Default)]
pub(crate) struct Sight {
    /// Lanes that something opaque hides from the light.
    pub(crate) blocked: Vec<u32>,
    /// Lanes that [`Sight::tints`] hold for; empty if nothing is transparent.
    pub(crate) touched: Vec<u32>,
    /// Shares of light that come through, for each block with a touched lane.
    pub(crate) tints: Vec<ColorBlock>,
    wanted: Vec<u32>,
    cells: Cells,
}

/// Rays from the lanes that a light gives anything to the light.
#[derive(Clone, Copy)]
pub(crate) struct LightRays<'a> {
    pub(crate) light: &'a Light,
    pub(crate) arriving: &'a Arriving,
}

impl LightRays<'_> {
    /// Lanes with a ray.
    pub(crate) fn lit(&self) -> &[u32] {
        &self.arriving.lit
    }

    /// Rays with an end: the light's place.
    pub(crate) fn t_max(&self) -> f32 {
        self.light.position().map_or(f32::INFINITY, |_| 1.0)
    }

    /// Directions of the rays from eight points.
    #[inline(always)]
    pub(crate) fn directions<L: Lanes>(&self, start: V3<L>) -> V3<L> {
        match *self.light {
            Light::Directional { towards, .. } => V3::splat(towards.into()),
            _ => V3::splat(self.light.position().unwrap_or_default().into()) - start,
        }
    }

    #[inline(always)]
    fn block<L: Lanes>(&self, index: usize) -> RayBlock {
        let origin = self.arriving.start[index];
        RayBlock {
            origin,
            direction: self.directions(V3::<L>::load(&origin)).store(),
            t_min: Eight::default(),
            t_max: Eight([self.t_max(); LANES]),
        }
    }
}

impl Scene {
    /// Finds what lies between the lit points and a light.
    pub(crate) fn sight(&self, light: &Light, arriving: &Arriving, sight: &mut Sight) {
        let rays = LightRays { light, arriving };
        let Sight {
            blocked,
            touched,
            tints,
            wanted,
            cells,
        } = sight;
        blocked.clear();
        blocked.resize(rays.lit().len(), 0);
        touched.clear();
        tints.clear();
        let objects = || self.objects().iter().filter(|o| o.is_visible);
        let image = shadow_cells::image_of(&rays);
        let suits =
            |o: &Object| image.is_some_and(|i| shadow_cells::suits(o, &i.projection, i.rays));
        if let Some(image) = &image {
            let boxes = objects().filter_map(Object::bounds_in_world);
            let drawn: Vec<&Object> = objects()
                .filter(|o| !o.is_transparent() && suits(o))
                .collect();
            cells.block(&drawn, image, boxes, &rays, blocked);
        }
        let find_near = |object: &Object, wanted: &mut Vec<u32>, blocked: &[u32]| {
            wanted.clear();
            match (&image, object.bounds_in_world()) {
                (_, None) => wanted.resize(blocked.len(), 0),
                (Some(image), Some(bounds)) if image.projection.is_in_front(bounds) => {
                    wanted.resize(blocked.len(), 0);
                    cells.near(bounds, wanted);
                }
                _ => wanted.extend_from_slice(rays.lit()),
            }
            for (wanted, blocked) in wanted.iter_mut().zip(blocked) {
                *wanted &= !blocked;
            }
        };
        for object in objects().filter(|o| !o.is_transparent() && !suits(o)) {
            find_near(object, wanted, blocked);
            run(Block {
                object,
                rays,
                wanted,
                blocked,
            });
        }
        if !self.has_transparency() {
            return;
        }
        touched.resize(blocked.len(), 0);
        for object in objects().filter(|o| o.is_transparent()) {
            find_near(object, wanted, blocked);
            for (touched, wanted) in touched.iter_mut().zip(&*wanted) {
                *touched |= wanted;
            }
        }
        tints.resize(
            touched.iter().filter(|t| **t != 0).count(),
            [Eight([1.0; LANES]); 3],
        );
        for object in objects().filter(|o| o.is_transparent()) {
            run(Tint {
                object,
                rays,
                touched,
                tints,
            });
        }
    }
}

/// Sets the bits of `blocked` where a wanted ray meets an object.
struct Block<'a> {
    object: &'a Object,
    rays: LightRays<'a>,
    wanted: &'a [u32],
    blocked: &'a mut [u32],
}

impl Kernel for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let mut last = u32::MAX;
        for (index, (wanted, blocked)) in self.wanted.iter().zip(self.blocked).enumerate() {
            if *wanted == 0 {
                continue;
            }
            let block = block_in_object(self.object, self.rays.block::<L>(index), *wanted);
            for_each_packet!(L, &block, *wanted, packet => {
                *blocked |= self.object.bvh.any_hits(&packet, &mut last).bits();
            });
        }
    }
}

/// Multiplies tints by what an object lets through.
struct Tint<'a> {
    object: &'a Object,
    rays: LightRays<'a>,
    touched: &'a [u32],
    tints: &'a mut [ColorBlock],
}

impl Kernel for Tint<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let touched = self.touched.iter().enumerate().filter(|(_, t)| **t != 0);
        for ((index, touched), tints) in touched.zip(self.tints) {
            let block = block_in_object(self.object, self.rays.block::<L>(index), *touched);
            let mut shares = [Rgb::repeat(1.0); LANES];
            for_each_packet!(L, &block, *touched, packet => {
                pass::<L>(self.object, packet, &mut shares);
            });
            for lane in lanes_of(*touched) {
                for k in 0..3 {
                    tints[k].0[lane] *= shares[lane][k];
                }
            }
        }
    }
}

/// As [`Object::transmittance`]: goes from surface to surface.
#[inline(always)]
fn pass<L: Lanes>(object: &Object, mut packet: Packet<L>, shares: &mut [Rgb; LANES]) {
    loop {
        let found = object.bvh.closest_hits(&packet, packet.t_max);
        let mut onwards = 0;
        for lane in lanes_of(found.found.bits()) {
            match &object.material(found.triangle[lane]).transmission {
                Some(transmission) => shares[lane].component_mul_assign(&transmission.tint()),
                None => shares[lane] = Rgb::zeros(),
            }
            onwards |= u32::from(shares[lane].max() > 0.0) << lane;
        }
        if onwards == 0 {
            return;
        }
        packet = packet.beyond(found.t, onwards);
    }
}
