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

/// How much of a ray's light goes to which point of the bounce before.
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
        params: BounceParams,
    ) {
        self.surfaces.clear();
        self.bounces.clear();
        // Room for bounces too, since growing moves everything
        self.surfaces.reserve(hits.len() / 6 + 64);
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
        // Rays that go through come first, then those that are mirrored: packets of one direction
        let mut through = (Vec::new(), Vec::new());
        let mut mirrored = (Vec::new(), Vec::new());
        for (index, block) in self.surfaces[first_block..].iter().enumerate() {
            for lane in lanes_of(block.spawns) {
                let i = index * LANES + lane;
                let ray = Ray::new(Vec3::zeros(), Vec3::from(directions[i]));
                let point = Interaction::new(scene, &ray, &hits[i]);
                let material = point.object.material(point.triangle);
                let number = (first_block * LANES + i) as u32;
                let ways = spawn(&point, material, offset);
                for (way, (rays, links)) in ways.into_iter().zip([&mut through, &mut mirrored]) {
                    if let Some((ray, tint, share)) = way {
                        rays.push(ray);
                        links.push(Link {
                            point: number,
                            tint,
                            share,
                        });
                    }
                }
            }
        }
        through.0.append(&mut mirrored.0);
        through.1.append(&mut mirrored.1);
        through
    }

    /// Adds to the colour of each point what comes to it by mirror reflection and through it, the last bounce first.
    pub(crate) fn composite(&self, colors: &mut [ColorBlock]) {
        for bounce in self.bounces.iter().rev() {
            for (i, link) in bounce.links.iter().enumerate() {
                let from = bounce.first_block * LANES + i;
                let to = link.point as usize;
                for k in 0..3 {
                    let found = colors[from / LANES][k].0[from % LANES];
                    colors[to / LANES][k].0[to % LANES] += found * link.tint[k] * link.share;
                }
            }
        }
    }
}

/// The rays that a surface sends out, through it and mirrored, each with its tint and its share.
fn spawn(
    point: &Interaction<'_>,
    material: &Material,
    offset: f32,
) -> [Option<(Ray, Rgb, f32)>; 2] {
    let (mut through, mut mirrored) = (None, None);
    let mut reflected_share = fresnel(material.reflectivity, point.normal.dot(&point.view));
    if let Some(transmission) = &material.transmission {
        match transmitted(point, transmission) {
            Some(direction) => {
                let origin = point.position - point.flat_normal * offset;
                let share = 1.0 - reflected_share;
                through = Some((Ray::new(origin, direction), transmission.tint(), share));
            }
            None => reflected_share = 1.0,
        }
    }
    if reflected_share > 0.0 {
        let direction = reflect(point.view, point.normal);
        let origin = point.lifted + point.flat_normal * offset;
        let white = Rgb::repeat(1.0);
        mirrored = Some((Ray::new(origin, direction), white, reflected_share));
    }
    [through, mirrored]
}
