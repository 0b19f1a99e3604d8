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

/// [`crate::RenderSettings::min_share`] by default.
pub(crate) const MIN_SHARE: f32 = 1e-3;

/// How rays go on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BounceParams {
    /// Mirror and refraction rays in a chain at most.
    pub(crate) max_depth: u32,
    /// Least share of a sample's light for which a ray is followed.
    pub(crate) min_share: f32,
    /// Distance from a surface at which further rays start, mm.
    pub(crate) offset: f32,
    /// [`crate::RenderSettings::smooth_shadows`].
    pub(crate) smooth_shadows: bool,
}

/// Surfaces to shade: sample `i` is lane `i % 8` of block `i / 8`, counted from the block of the first that was added with it.
#[derive(Clone, Debug, Default)]
pub(crate) struct ShadingPoints {
    /// The surfaces of the samples, then those of each bounce; then again, for samples that were added later.
    pub(crate) surfaces: Vec<SurfaceBlock>,
    /// End of the blocks of the samples that were added last.
    pub(crate) primary_blocks: usize,
    bounces: Vec<Bounce>,
}

/// Rays of one bounce: link `i` belongs to lane `i % 8` of block `first_block + i / 8`.
#[derive(Clone, Debug)]
struct Bounce {
    first_block: usize,
    links: Vec<Link>,
}

/// Distances of rays at a parameter of 1, mm: of the samples before number `from`, a multiple of eight, and of the others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spacing {
    pub(crate) from: usize,
    pub(crate) mm: [f32; 2],
}

impl Spacing {
    /// The same for all.
    pub(crate) fn even(mm: f32) -> Self {
        Self {
            from: 0,
            mm: [mm; 2],
        }
    }
}

/// Points from which rays go on, from a block on.
struct Generation<'a> {
    first_block: usize,
    hits: &'a [Hit],
    directions: &'a [[f32; 3]],
    /// Shares of the samples' light that come from there; empty for the samples themselves.
    shares: &'a [f32],
}

/// Rays that go on.
#[derive(Default)]
struct Spawned {
    rays: Vec<Ray>,
    links: Vec<Link>,
    /// Share of the sample's light.
    shares: Vec<f32>,
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
        spacing: Spacing,
        params: BounceParams,
    ) {
        self.clear();
        // Room for bounces too, since growing moves everything
        self.surfaces.reserve(hits.len() / 6 + 64);
        self.add(scene, hits, directions, spacing, params);
    }

    pub(crate) fn clear(&mut self) {
        self.surfaces.clear();
        self.bounces.clear();
    }

    /// Takes more samples, and what they show, behind what is there; the block of the first is returned.
    pub(crate) fn add(
        &mut self,
        scene: &Scene,
        hits: &[Hit],
        directions: &[[f32; 3]],
        spacing: Spacing,
        params: BounceParams,
    ) -> usize {
        let own_block = self.surfaces.len();
        let from = spacing.from.min(hits.len());
        assert_eq!(
            spacing.from % LANES,
            0,
            "another spacing begins with a block"
        );
        for (hits, directions, mm) in [
            (&hits[..from], &directions[..from], spacing.mm[0]),
            (&hits[from..], &directions[from..], spacing.mm[1]),
        ] {
            surface::surfaces(scene, hits, directions, (mm, params), &mut self.surfaces);
        }
        self.primary_blocks = self.surfaces.len();
        let first = Generation {
            first_block: own_block,
            hits,
            directions,
            shares: &[],
        };
        let mut spawned = self.spawned(scene, &first, params);
        for depth in 1..=params.max_depth {
            let Spawned {
                rays,
                links,
                shares,
            } = spawned;
            if rays.is_empty() {
                break;
            }
            let first_block = self.surfaces.len();
            self.bounces.push(Bounce { first_block, links });
            let mut hits = Vec::with_capacity(rays.len());
            scene.closest_hits(&rays, Layer::All, &mut hits);
            let directions: Vec<[f32; 3]> = rays.iter().map(|r| r.direction.into()).collect();
            surface::surfaces(scene, &hits, &directions, (0.0, params), &mut self.surfaces);
            if depth == params.max_depth {
                break;
            }
            let next = Generation {
                first_block,
                hits: &hits,
                directions: &directions,
                shares: &shares,
            };
            spawned = self.spawned(scene, &next, params);
        }
        own_block
    }

    /// Adds to lanes, given block by block, those that mirrors and lenses show them.
    pub(crate) fn follow(&self, lanes: &mut [u32]) {
        for bounce in &self.bounces {
            for (i, link) in bounce.links.iter().enumerate() {
                let from = link.point as usize;
                let is_wanted = lanes[from / LANES] >> (from % LANES) & 1;
                lanes[bounce.first_block + i / LANES] |= is_wanted << (i % LANES);
            }
        }
    }

    /// The rays that a generation of points sends out: those that go through first, then those that are mirrored, so that
    /// packets have one direction.
    fn spawned(&self, scene: &Scene, points: &Generation<'_>, params: BounceParams) -> Spawned {
        let (mut through, mut mirrored) = (Spawned::default(), Spawned::default());
        let blocks = &self.surfaces[points.first_block..];
        for (index, block) in blocks.iter().enumerate() {
            for lane in lanes_of(block.spawns) {
                let i = index * LANES + lane;
                let ray = Ray::new(Vec3::zeros(), Vec3::from(points.directions[i]));
                let point = Interaction::new(scene, &ray, &points.hits[i]);
                let material = point.object.material(point.triangle);
                let number = (points.first_block * LANES + i) as u32;
                let own = points.shares.get(i).copied().unwrap_or(1.0);
                let ways = spawn(&point, material, params.offset);
                for (way, out) in ways.into_iter().zip([&mut through, &mut mirrored]) {
                    let Some((ray, tint, share)) = way else {
                        continue;
                    };
                    let all = own * share * tint.max();
                    if all < params.min_share {
                        continue;
                    }
                    out.rays.push(ray);
                    out.shares.push(all);
                    out.links.push(Link {
                        point: number,
                        tint,
                        share,
                    });
                }
            }
        }
        through.rays.append(&mut mirrored.rays);
        through.links.append(&mut mirrored.links);
        through.shares.append(&mut mirrored.shares);
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
pub(crate) fn spawn(
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
