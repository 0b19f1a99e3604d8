//! All surfaces that samples show: those that their rays hit, and those that mirrors and lenses show them.
//!
//! No light is needed to find them, so one set serves every light setting. Rays of one bounce are traced together, one
//! bounce after the other; [`ShadingPoints::composite`] brings their light back the same way.

use crate::direct::ColorBlock;
use crate::interaction::Interaction;
use crate::lanes::{LANES, lanes_of};
use crate::material::Material;
use crate::math::{Rgb, Vec3};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::surface::{self, SurfaceBlock};
use crate::whitted::{fresnel, reflect, transmitted};

/// How rays go on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BounceParams {
    /// Mirror and refraction rays in a chain at most.
    pub(crate) max_depth: u32,
    /// Distance from a surface at which further rays start, mm.
    pub(crate) offset: f32,
}

/// Surfaces to shade: sample `i` is lane `i % 8` of block `i / 8`.
#[derive(Clone, Debug, Default)]
pub(crate) struct ShadingPoints {
    /// The surfaces of the samples, then those of each bounce.
    pub(crate) surfaces: Vec<SurfaceBlock>,
    /// Blocks of the samples themselves.
    pub(crate) primary_blocks: usize,
    bounces: Vec<Bounce>,
}

/// Rays of one bounce: link `i` belongs to lane `i % 8` of block `first_block + i / 8`.
#[derive(Clone, Debug)]
struct Bounce {
    first_block: usize,
    links: Vec<Link>,
}

/// How much of a ray's light goes to which point of the bounce before; the links of a point are neighbours.
#[derive(Clone, Copy, Debug)]
struct Link {
    /// Number of the point: its block times eight and its lane.
    point: u32,
    tint: Rgb,
    share: f32,
}

impl ShadingPoints {
    /// Takes the samples' hits, with the directions of their rays, and follows the rays that they send out.
    pub(crate) fn find(
        &mut self,
        scene: &Scene,
        hits: &[Hit],
        directions: &[[f32; 3]],
        params: &BounceParams,
    ) {
        self.surfaces.clear();
        self.bounces.clear();
        surface::surfaces(scene, hits, directions, &mut self.surfaces);
        self.primary_blocks = self.surfaces.len();
        let mut first_block = 0;
        let (mut hits, mut directions) = (hits.to_vec(), directions.to_vec());
        for _ in 0..params.max_depth {
            let (rays, links) = self.spawned(scene, first_block, &hits, &directions, params.offset);
            if rays.is_empty() {
                break;
            }
            first_block = self.surfaces.len();
            self.bounces.push(Bounce { first_block, links });
            hits.clear();
            scene.closest_hits(&rays, Layer::All, &mut hits);
            directions.clear();
            directions.extend(rays.iter().map(|r| <[f32; 3]>::from(r.direction)));
            surface::surfaces(scene, &hits, &directions, &mut self.surfaces);
        }
    }

    /// The rays that the blocks from `first_block` on send out.
    fn spawned(
        &self,
        scene: &Scene,
        first_block: usize,
        hits: &[Hit],
        directions: &[[f32; 3]],
        offset: f32,
    ) -> (Vec<Ray>, Vec<Link>) {
        let (mut rays, mut links) = (Vec::new(), Vec::new());
        for (index, block) in self.surfaces[first_block..].iter().enumerate() {
            for lane in lanes_of(block.spawns) {
                let i = index * LANES + lane;
                let ray = Ray::new(Vec3::zeros(), Vec3::from(directions[i]));
                let point = Interaction::new(scene, &ray, &hits[i]);
                let material = point.object.material(point.triangle);
                let number = (first_block * LANES + i) as u32;
                spawn(&point, material, offset, |ray, tint, share| {
                    rays.push(ray);
                    links.push(Link {
                        point: number,
                        tint,
                        share,
                    });
                });
            }
        }
        (rays, links)
    }

    /// Adds to the colour of each point what comes to it by mirror reflection and through it, the last bounce first.
    pub(crate) fn composite(&self, colors: &mut [ColorBlock]) {
        let at = |colors: &[ColorBlock], point: usize| {
            Rgb::from_fn(|k, _| colors[point / LANES][k].0[point % LANES])
        };
        for bounce in self.bounces.iter().rev() {
            let mut from = 0;
            while let Some(first) = bounce.links.get(from) {
                let mut sum = Rgb::zeros();
                while let Some(link) = bounce.links.get(from).filter(|l| l.point == first.point) {
                    let color = at(colors, bounce.first_block * LANES + from);
                    sum += color.component_mul(&link.tint) * link.share;
                    from += 1;
                }
                let point = first.point as usize;
                for k in 0..3 {
                    colors[point / LANES][k].0[point % LANES] += sum[k];
                }
            }
        }
    }
}

/// The rays that a surface sends out: through it, then mirrored; `push` gets each with its tint and its share.
fn spawn(
    point: &Interaction<'_>,
    material: &Material,
    offset: f32,
    mut push: impl FnMut(Ray, Rgb, f32),
) {
    let mut reflected_share = fresnel(material.reflectivity, point.normal.dot(&point.view));
    if let Some(transmission) = &material.transmission {
        match transmitted(point, transmission) {
            Some(direction) => {
                let origin = point.position - point.flat_normal * offset;
                let share = 1.0 - reflected_share;
                push(Ray::new(origin, direction), transmission.tint(), share);
            }
            None => reflected_share = 1.0,
        }
    }
    if reflected_share > 0.0 {
        let direction = reflect(point.view, point.normal);
        let origin = point.lifted + point.flat_normal * offset;
        push(
            Ray::new(origin, direction),
            Rgb::repeat(1.0),
            reflected_share,
        );
    }
}
