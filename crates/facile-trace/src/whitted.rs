//! Whitted shading: direct light with hard shadows, reflection, refraction.
//!
//! Paper section 5. Direct light at a point: `albedo (ambient + E cos(theta) visible)` plus the highlight of
//! [`crate::Material::specular`], with `E` as [`crate::light`] says. Shadow rays start on the smooth surface
//! ([`crate::interaction`]); transparent objects tint them. [`Shader::shade`] shades many points at once, eight to a
//! vector: those of the samples and those that mirrors and lenses show them ([`crate::bounces`]), all together, so that
//! each light sorts its rays once. The scalar, recursive form is the oracle of the tests.

use std::time::{Duration, Instant};

use crate::bounces::ShadingPoints;
use crate::camera::Camera;
use crate::direct::{Add, Ambient, Arriving, ColorBlock, Gather, add_bend};
use crate::interaction::Interaction;
use crate::lanes::{Eight, lanes_of, run};
use crate::light::{AmbientSum, Light};
use crate::material::Transmission;
use crate::math::{Vec3, unit_or};
use crate::scene::Scene;
use crate::sight::Sight;
use crate::skips::Skips;
use crate::surface::lane;

/// A scene under lights, ready to shade.
pub(crate) struct Shader<'a> {
    pub(crate) scene: &'a Scene,
    /// Where the backdrop is seen from.
    pub(crate) camera: &'a Camera,
    pub(crate) lights: &'a [Light],
    /// Distance from the surface at which rays to lights start, mm.
    pub(crate) offset: f32,
    pub(crate) skips: Skips,
}

/// What [`Shader::shade`] is to find beside colours.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Wanted<'a> {
    /// [`Shaded::irradiance`].
    pub(crate) irradiance: bool,
    /// [`Shaded::arrived`].
    pub(crate) shadow: bool,
    /// The only lanes of each block that matter; all if `None`.
    pub(crate) lanes: Option<&'a [u32]>,
}

/// Shaded points, and buffers to be kept between calls. Blocks are those of [`ShadingPoints`].
#[derive(Debug, Default)]
pub(crate) struct Shaded {
    /// Colours of the samples, and of what mirrors and lenses show.
    pub(crate) colors: Vec<ColorBlock>,
    /// Light on the diffuse layer of the samples, before its colour.
    pub(crate) irradiance: Vec<ColorBlock>,
    /// Directed light that arrives at the samples, and that would if nothing were in between.
    pub(crate) arrived: Vec<[Eight; 2]>,
    /// Wall clock time of shadow rays so far.
    pub(crate) shadow_time: Duration,
    arriving: Arriving,
    sight: Sight,
}

impl Shader<'_> {
    /// Shades all points.
    pub(crate) fn shade(&self, points: &ShadingPoints, wanted: Wanted<'_>, shaded: &mut Shaded) {
        let with_irradiance = if wanted.irradiance {
            points.primary_blocks
        } else {
            0
        };
        let sum = AmbientSum::of(self.lights);
        run(Ambient {
            sum,
            background: self.scene.background,
            surfaces: &points.surfaces,
            lanes: wanted.lanes,
            colors: &mut shaded.colors,
            irradiance: &mut shaded.irradiance,
            with_irradiance,
        });
        if sum.bend != AmbientSum::default().bend {
            let (colors, irradiance) = (&mut shaded.colors, &mut shaded.irradiance);
            add_bend(&sum, &points.surfaces, wanted.lanes, colors, irradiance);
        }
        self.show_backdrop(points, wanted.lanes, &mut shaded.colors);
        shaded.arrived.clear();
        if wanted.shadow {
            let nothing = [Eight::default(); 2];
            shaded.arrived.resize(points.primary_blocks, nothing);
        }
        for light in self.lights {
            if let Light::Ambient { .. } | Light::Harmonic { .. } = light {
                continue;
            }
            run(Gather {
                light,
                offset: self.offset,
                surfaces: &points.surfaces,
                lanes: wanted.lanes,
                irradiance: with_irradiance,
                from_everywhere: !self.skips.facing_away,
                arriving: &mut shaded.arriving,
            });
            let start = Instant::now();
            self.scene.sight(light, &shaded.arriving, &mut shaded.sight);
            shaded.shadow_time += start.elapsed();
            run(Add {
                arriving: &shaded.arriving,
                blocked: &shaded.sight.blocked,
                touched: &shaded.sight.touched,
                tints: &shaded.sight.tints,
                colors: &mut shaded.colors,
                irradiance: &mut shaded.irradiance,
                arrived: &mut shaded.arrived,
            });
        }
        points.composite(&mut shaded.colors);
    }

    /// Sets the colours of rays that hit nothing, if the scene has more than a plain background.
    fn show_backdrop(
        &self,
        points: &ShadingPoints,
        lanes: Option<&[u32]>,
        colors: &mut [ColorBlock],
    ) {
        let Some(backdrop) = &self.scene.backdrop else {
            return;
        };
        for (index, (block, color)) in points.surfaces.iter().zip(colors).enumerate() {
            let wanted = lanes.map_or(0xFF, |lanes| lanes[index]);
            for k in lanes_of(!block.hit & wanted) {
                let found = backdrop.color(self.camera, -lane(&block.view, k));
                for channel in 0..3 {
                    color[channel].0[k] = found[channel];
                }
            }
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
