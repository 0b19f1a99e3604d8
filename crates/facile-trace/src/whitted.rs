//! Whitted shading: direct light with hard shadows, reflection, refraction.
//!
//! Paper section 5. Direct light at a point: `albedo (ambient + E cos(theta) visible)` plus the Phong highlight of
//! [`Material::specular`], with `E` as [`crate::light`] says. Shadow rays start on the smooth surface
//! ([`crate::interaction`]); transparent objects tint them. [`Shader::shade_batch`] shades many hits at once, eight to a
//! vector and shadow rays in packets; mirrored and refracted rays are traced and shaded in the same way, one bounce after
//! the other. The scalar, recursive form is the oracle of the tests.

use std::time::{Duration, Instant};

use crate::camera::Camera;
use crate::direct::{Ambient, Bend, Gather, PendingShadows};
use crate::interaction::Interaction;
use crate::lanes::{LANES, lanes_of, run};
use crate::light::{AmbientSum, Light};
use crate::material::{Material, Transmission};
use crate::math::{Rgb, Vec3, unit_or};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::surface::{self, SurfaceBlock};

/// A scene under lights, ready to shade.
pub(crate) struct Shader<'a> {
    pub(crate) scene: &'a Scene,
    /// Where the backdrop is seen from.
    pub(crate) camera: &'a Camera,
    pub(crate) lights: &'a [Light],
    /// Mirror and refraction rays in a chain at most.
    pub(crate) max_depth: u32,
    /// Distance from the surface at which secondary rays start, mm.
    pub(crate) offset: f32,
}

/// Buffers of [`Shader::shade_batch`], to be kept between calls.
#[derive(Debug, Default)]
pub(crate) struct ShadeScratch {
    pending: PendingShadows,
    blocked: Vec<u32>,
    touched: Vec<u32>,
    /// Buffers of the next bounce.
    next: Option<Box<Self>>,
    possible: Vec<f32>,
    /// Light on the diffuse layer of each sample of the last batch, before its colour; empty unless `keeps_irradiance`.
    pub(crate) irradiance: Vec<Rgb>,
    pub(crate) keeps_irradiance: bool,
    /// Wall clock time of shadow rays so far.
    pub(crate) shadow_time: Duration,
}

/// Primary samples to shade together: sample `i` is lane `i % 8` of surface block `i / 8`.
#[derive(Clone, Copy)]
pub(crate) struct Samples<'a> {
    pub(crate) surfaces: &'a [SurfaceBlock],
    pub(crate) hits: &'a [Hit],
    /// Directions of the rays that hit.
    pub(crate) directions: &'a [[f32; 3]],
}

/// Rays of one bounce, and what they are for.
#[derive(Default)]
struct Spawned {
    rays: Vec<Ray>,
    links: Vec<Link>,
}

/// How much of a ray's light goes to which sample.
struct Link {
    sample: u32,
    tint: Rgb,
    share: f32,
}

impl Spawned {
    fn push(&mut self, ray: Ray, link: Link) {
        self.rays.push(ray);
        self.links.push(link);
    }
}

impl Shader<'_> {
    /// Shades primary samples into `colors`; `shadow` gets the share of directed light that arrives, 1 without any.
    pub(crate) fn shade_batch(
        &self,
        samples: Samples<'_>,
        colors: &mut [Rgb],
        shadow: Option<&mut [f32]>,
        scratch: &mut ShadeScratch,
    ) {
        self.shade_bounce(samples, 0, colors, shadow, scratch);
    }

    /// [`Shader::shade_batch`] of samples that `depth` mirrors or lenses lead to.
    fn shade_bounce(
        &self,
        samples: Samples<'_>,
        depth: u32,
        colors: &mut [Rgb],
        mut shadow: Option<&mut [f32]>,
        scratch: &mut ShadeScratch,
    ) {
        assert_eq!(samples.hits.len(), colors.len(), "one colour per sample");
        scratch.pending.clear();
        scratch.possible.clear();
        scratch.irradiance.clear();
        if scratch.keeps_irradiance {
            let sum = AmbientSum::of(self.lights);
            scratch.irradiance.extend((0..samples.hits.len()).map(|i| {
                let (block, k) = (&samples.surfaces[i / LANES], i % LANES);
                let share = block.weight.0[k] * block.exposure.0[k];
                sum.on(surface::lane(&block.normal, k)) * share
            }));
        }
        if let Some(shadow) = shadow.as_deref_mut() {
            shadow.fill(0.0);
            scratch.possible.resize(samples.hits.len(), 0.0);
        }
        self.shade_unshadowed(samples, colors);
        self.add_secondary(samples, depth, colors, scratch);
        for light in self.lights {
            run(Gather {
                light,
                offset: self.offset,
                surfaces: samples.surfaces,
                pending: &mut scratch.pending,
            });
            self.resolve_shadows(light, colors, shadow.as_deref_mut(), scratch);
        }
        for (arrived, possible) in shadow.into_iter().flatten().zip(&scratch.possible) {
            *arrived = if *possible > 0.0 {
                *arrived / possible
            } else {
                1.0
            };
        }
    }

    /// Sets the colours to the light that needs no shadow ray.
    fn shade_unshadowed(&self, samples: Samples<'_>, colors: &mut [Rgb]) {
        let sum = AmbientSum::of(self.lights);
        run(Ambient {
            sum,
            background: self.scene.background,
            surfaces: samples.surfaces,
            colors: &mut *colors,
        });
        if sum.bend != AmbientSum::default().bend {
            run(Bend {
                sum,
                surfaces: samples.surfaces,
                colors: &mut *colors,
            });
        }
        let Some(backdrop) = &self.scene.backdrop else {
            return;
        };
        for ((hit, direction), color) in samples.hits.iter().zip(samples.directions).zip(colors) {
            if !hit.is_some() {
                *color = backdrop.color(self.camera, Vec3::from(*direction));
            }
        }
    }

    /// Adds what comes by mirror reflection and through surfaces: all rays of one bounce together, which are shaded as
    /// primary samples are.
    fn add_secondary(
        &self,
        samples: Samples<'_>,
        depth: u32,
        colors: &mut [Rgb],
        scratch: &mut ShadeScratch,
    ) {
        if depth >= self.max_depth {
            return;
        }
        let mut spawned = Spawned::default();
        for (index, block) in samples.surfaces.iter().enumerate() {
            for lane in lanes_of(block.spawns) {
                let i = index * LANES + lane;
                let ray = Ray::new(Vec3::zeros(), Vec3::from(samples.directions[i]));
                let point = Interaction::new(self.scene, &ray, &samples.hits[i]);
                let material = point.object.material(point.triangle);
                self.spawn(&point, material, i as u32, &mut spawned);
            }
        }
        if spawned.rays.is_empty() {
            return;
        }
        let Spawned { rays, links } = &spawned;
        let (mut hits, mut surfaces) = (Vec::with_capacity(rays.len()), Vec::new());
        self.scene.closest_hits(rays, Layer::All, &mut hits);
        let directions: Vec<[f32; 3]> = rays.iter().map(|r| r.direction.into()).collect();
        surface::surfaces(self.scene, &hits, &directions, &mut surfaces);
        let behind = Samples {
            surfaces: &surfaces,
            hits: &hits,
            directions: &directions,
        };
        let mut found = vec![Rgb::zeros(); rays.len()];
        let next = scratch.next.get_or_insert_default();
        next.shadow_time = Duration::ZERO;
        self.shade_bounce(behind, depth + 1, &mut found, None, next);
        scratch.shadow_time += next.shadow_time;
        // The links of a sample are neighbours
        let mut from = 0;
        while let Some(first) = links.get(from) {
            let mut sum = Rgb::zeros();
            while let Some(link) = links.get(from).filter(|l| l.sample == first.sample) {
                sum += found[from].component_mul(&link.tint) * link.share;
                from += 1;
            }
            let color = &mut colors[first.sample as usize];
            *color = sum + *color;
        }
    }

    /// Traces the pending shadow rays and adds what arrives.
    fn resolve_shadows(
        &self,
        light: &Light,
        colors: &mut [Rgb],
        mut shadow: Option<&mut [f32]>,
        scratch: &mut ShadeScratch,
    ) {
        let start = Instant::now();
        let pending = &scratch.pending;
        let count = pending.list.len();
        self.scene
            .blocked(Some(light), &pending.blocks, count, &mut scratch.blocked);
        self.scene
            .touched(&pending.blocks, count, &mut scratch.touched);
        for (i, shadowed) in pending.list.iter().enumerate() {
            let sample = shadowed.sample as usize;
            if let Some(possible) = scratch.possible.get_mut(sample) {
                *possible += shadowed.contribution.sum();
            }
            if scratch.blocked[i / LANES] >> (i % LANES) & 1 == 1 {
                continue;
            }
            let (mut arrived, mut irradiance) = (shadowed.contribution, shadowed.irradiance);
            let is_tinted = scratch.touched.get(i / LANES);
            if is_tinted.is_some_and(|bits| bits >> (i % LANES) & 1 == 1) {
                let ray = pending.blocks[i / LANES].get(i % LANES);
                let tint = self.scene.tint(&ray);
                arrived.component_mul_assign(&tint);
                irradiance.component_mul_assign(&tint);
            }
            colors[sample] += arrived;
            if let Some(own) = scratch.irradiance.get_mut(sample) {
                *own += irradiance;
            }
            if let Some(shadow) = shadow.as_deref_mut() {
                shadow[sample] += arrived.sum();
            }
        }
        scratch.pending.clear();
        scratch.shadow_time += start.elapsed();
    }

    /// The rays that a surface sends out: through it, then mirrored.
    fn spawn(&self, point: &Interaction<'_>, material: &Material, sample: u32, out: &mut Spawned) {
        let mut reflected_share = fresnel(material.reflectivity, point.normal.dot(&point.view));
        if let Some(transmission) = &material.transmission {
            match transmitted(point, transmission) {
                Some(direction) => {
                    let origin = point.position - point.flat_normal * self.offset;
                    let link = Link {
                        sample,
                        tint: transmission.tint(),
                        share: 1.0 - reflected_share,
                    };
                    out.push(Ray::new(origin, direction), link);
                }
                None => reflected_share = 1.0,
            }
        }
        if reflected_share > 0.0 {
            let direction = reflect(point.view, point.normal);
            let origin = point.lifted + point.flat_normal * self.offset;
            let link = Link {
                sample,
                tint: Rgb::repeat(1.0),
                share: reflected_share,
            };
            out.push(Ray::new(origin, direction), link);
        }
    }
}

/// The direction in which light goes on behind a surface, seen against the ray; `None` for total reflection.
pub(crate) fn transmitted(point: &Interaction<'_>, transmission: &Transmission) -> Option<Vec3> {
    match transmission {
        Transmission::Thin { .. } => Some(-point.view),
        Transmission::Solid { ior, .. } => {
            let ratio = if point.is_outside { 1.0 / ior } else { *ior };
            refract(point.view, point.normal, ratio)
        }
    }
}

/// Schlick's approximation of Fresnel reflection; 0 for a surface that does not mirror at all.
pub(crate) fn fresnel(at_normal: f32, cosine: f32) -> f32 {
    if at_normal <= 0.0 {
        return 0.0;
    }
    let x = 1.0 - cosine.clamp(0.0, 1.0);
    let x2 = x * x;
    at_normal + (1.0 - at_normal) * x2 * x2 * x
}

/// The mirror image of the unit direction `view` about the unit `normal`; both point away from the surface.
pub(crate) fn reflect(view: Vec3, normal: Vec3) -> Vec3 {
    normal * (2.0 * normal.dot(&view)) - view
}

/// The direction in which light that comes against `view` goes on behind the surface; `ratio` is the index on the
/// ray's side over the other. `None` for total reflection. Source: Snell's law in vector form.
pub(crate) fn refract(view: Vec3, normal: Vec3, ratio: f32) -> Option<Vec3> {
    let cosine = normal.dot(&view).clamp(-1.0, 1.0);
    let squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine);
    (squared >= 0.0).then(|| {
        unit_or(
            normal * (ratio * cosine - squared.sqrt()) - view * ratio,
            -view,
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn mirror_angle_equals_incident_angle() {
        let view = Vec3::new(0.6, 0.8, 0.0);
        assert_relative_eq!(
            reflect(view, Vec3::y()),
            Vec3::new(-0.6, 0.8, 0.0),
            epsilon = 1e-6
        );
    }

    #[test]
    fn refraction_obeys_snell() {
        for degrees in [0.0_f32, 20.0, 55.0, 80.0] {
            let angle = degrees.to_radians();
            let view = Vec3::new(angle.sin(), angle.cos(), 0.0);
            let inside = refract(view, Vec3::y(), 1.0 / 1.5).expect("into the denser medium");
            assert_relative_eq!(-inside.x * 1.5, angle.sin(), epsilon = 1e-5);
            assert!(inside.y < 0.0);
            assert_relative_eq!(inside.norm(), 1.0, epsilon = 1e-5);
            // And back out the way it came
            let outside = refract(inside, -Vec3::y(), 1.5);
            if let Some(outside) = outside {
                assert_relative_eq!(outside, view, epsilon = 1e-4);
            }
        }
        let critical = (1.0_f32 / 1.5).asin();
        let beyond = critical + 0.01;
        let view = Vec3::new(beyond.sin(), beyond.cos(), 0.0);
        assert!(refract(view, Vec3::y(), 1.5).is_none());
    }

    #[test]
    fn fresnel_runs_from_normal_to_grazing() {
        assert_relative_eq!(fresnel(0.04, 1.0), 0.04);
        assert_relative_eq!(fresnel(0.04, 0.0), 1.0);
        assert_eq!(fresnel(0.0, 0.1), 0.0);
    }
}
