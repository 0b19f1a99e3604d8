//! Whitted shading: direct light with hard shadows, reflection, refraction.
//!
//! Paper section 5. Direct light at a point: `albedo (ambient + E cos(theta) visible)` plus the Phong highlight of
//! [`Material::specular`], with `E` as [`crate::light`] says. Shadow rays start on the smooth surface
//! ([`crate::interaction`]); transparent objects tint them. [`Shader::shade_batch`] shades many primary hits at once, eight
//! to a vector and shadow rays in packets; [`Shader::radiance`] is the scalar, recursive form for secondary rays.

use std::time::{Duration, Instant};

use crate::direct::{Ambient, Gather, PendingShadows};
use crate::interaction::{Interaction, diffuse_weight};
use crate::lanes::{LANES, lanes_of, run};
use crate::light::{AmbientSum, Arrival, Light};
use crate::material::{Material, Transmission};
use crate::math::{Rgb, Vec3, power, unit_or};
use crate::microfacets;
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::surface::{self, SurfaceBlock};

/// A scene under lights, ready to shade.
pub(crate) struct Shader<'a> {
    pub(crate) scene: &'a Scene,
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

impl Shader<'_> {
    /// Shades primary samples into `colors`; `shadow` gets the share of directed light that arrives, 1 without any.
    pub(crate) fn shade_batch(
        &self,
        samples: Samples<'_>,
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
        run(Ambient {
            sum: AmbientSum::of(self.lights),
            background: self.scene.background,
            surfaces: samples.surfaces,
            colors,
        });
        for (index, block) in samples.surfaces.iter().enumerate() {
            for lane in lanes_of(block.spawns) {
                let i = index * LANES + lane;
                let ray = Ray::new(Vec3::zeros(), Vec3::from(samples.directions[i]));
                let point = Interaction::new(self.scene, &ray, &samples.hits[i]);
                let material = point.object.material(point.triangle);
                colors[i] = self.secondary(&point, material, 0) + colors[i];
            }
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
        let has_transparency = self.scene.has_transparency();
        for (i, shadowed) in pending.list.iter().enumerate() {
            let sample = shadowed.sample as usize;
            if let Some(possible) = scratch.possible.get_mut(sample) {
                *possible += shadowed.contribution.sum();
            }
            if scratch.blocked[i / LANES] >> (i % LANES) & 1 == 1 {
                continue;
            }
            let (mut arrived, mut irradiance) = (shadowed.contribution, shadowed.irradiance);
            if has_transparency {
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

    /// Light that comes back along a ray.
    pub(crate) fn radiance(&self, ray: &Ray, depth: u32) -> Rgb {
        let Some(hit) = self.scene.closest_hit(ray, Layer::All) else {
            return self.scene.background;
        };
        let point = Interaction::new(self.scene, ray, &hit);
        let material = point.object.material(point.triangle);
        let weight = diffuse_weight(&point, material);
        let mut color = if material.spawns_rays() {
            self.secondary(&point, material, depth)
        } else {
            Rgb::zeros()
        };
        color += self.ambient(&point, material, weight);
        for light in self.lights {
            if let Some((contribution, ray)) = self.unshadowed(&point, material, weight, light) {
                color += contribution.component_mul(&self.scene.transmittance(&ray));
            }
        }
        color
    }

    fn ambient(&self, point: &Interaction<'_>, material: &Material, weight: f32) -> Rgb {
        let light = AmbientSum::of(self.lights).on(point.normal);
        point.albedo.component_mul(&light) * (weight * material.exposure)
    }

    /// What a light gives if nothing is in between, and the ray that finds out. `None` if the surface faces away.
    fn unshadowed(
        &self,
        point: &Interaction<'_>,
        material: &Material,
        weight: f32,
        light: &Light,
    ) -> Option<(Rgb, Ray)> {
        let Arrival { direction, power } = light.arrival(point.lifted)?;
        let cosine = point.normal.dot(&direction);
        if cosine <= 0.0 {
            return None;
        }
        let mut share = point.albedo * weight;
        if material.specular > 0.0 {
            share += Rgb::repeat(if material.roughness > 0.0 {
                rough_highlight(material, point, direction, cosine)
            } else {
                let mirrored = point.normal * (2.0 * cosine) - direction;
                highlight(material, mirrored.dot(&point.view))
            });
        }
        if share.max() <= 0.0 {
            return None;
        }
        let origin = point.lifted + point.flat_normal * self.offset;
        let ray = match light.position() {
            Some(position) => Ray::between(origin, position),
            None => Ray::new(origin, direction),
        };
        Some((share.component_mul(&power) * cosine, ray))
    }

    /// Light by mirror reflection and through the surface.
    fn secondary(&self, point: &Interaction<'_>, material: &Material, depth: u32) -> Rgb {
        if depth >= self.max_depth {
            return Rgb::zeros();
        }
        let mut reflected_share = fresnel(material.reflectivity, point.normal.dot(&point.view));
        let mut color = Rgb::zeros();
        if let Some(transmission) = &material.transmission {
            let direction = match transmission {
                Transmission::Thin { .. } => Some(-point.view),
                Transmission::Solid { ior, .. } => {
                    let ratio = if point.is_outside { 1.0 / ior } else { *ior };
                    refract(point.view, point.normal, ratio)
                }
            };
            match direction {
                Some(direction) => {
                    let origin = point.position - point.flat_normal * self.offset;
                    let behind = self.radiance(&Ray::new(origin, direction), depth + 1);
                    color += behind.component_mul(&transmission.tint()) * (1.0 - reflected_share);
                }
                None => reflected_share = 1.0,
            }
        }
        if reflected_share > 0.0 {
            let direction = reflect(point.view, point.normal);
            let origin = point.lifted + point.flat_normal * self.offset;
            color += self.radiance(&Ray::new(origin, direction), depth + 1) * reflected_share;
        }
        color
    }
}

fn rough_highlight(
    material: &Material,
    point: &Interaction<'_>,
    direction: Vec3,
    cosine: f32,
) -> f32 {
    let half = unit_or(direction + point.view, point.normal);
    let cosines = [
        cosine,
        point.normal.dot(&point.view),
        point.normal.dot(&half),
        point.view.dot(&half),
    ];
    microfacets::highlight(material.specular, material.roughness, cosines)
}

fn highlight(material: &Material, cos_alpha: f32) -> f32 {
    if cos_alpha <= 0.0 {
        return 0.0;
    }
    material.specular * (material.shininess + 2.0) * 0.5 * power(cos_alpha, material.shininess)
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

    #[test]
    fn highlights_of_any_sharpness_carry_the_same_energy() {
        for shininess in [5.0, 24.0, 300.0] {
            let material = Material {
                specular: 1.0,
                shininess,
                ..Material::default()
            };
            // Integral over the hemisphere about the mirrored direction of lobe times cosine, divided by pi
            let n = 20_000;
            let sum: f64 = (0..n)
                .map(|i| {
                    let angle = (f64::from(i) + 0.5) / f64::from(n) * std::f64::consts::FRAC_PI_2;
                    let lobe = f64::from(highlight(&material, angle.cos() as f32));
                    lobe * angle.cos() * angle.sin() * 2.0
                })
                .sum::<f64>()
                * std::f64::consts::FRAC_PI_2
                / f64::from(n);
            assert_relative_eq!(sum, 1.0, epsilon = 2e-3);
        }
    }
}
