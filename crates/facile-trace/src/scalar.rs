//! Whitted shading of one ray at a time, by recursion: what the batches of [`crate::whitted`] must give bit for bit.

use crate::bounces::{BounceParams, spawn};
use crate::interaction::{Interaction, diffuse_weight, strand_at};
use crate::light::{AmbientSum, Arrival, Light};
use crate::material::Material;
use crate::math::{Rgb, Vec3, power, unit_or};
use crate::microfacets;
use crate::ray::{Hit, Ray};
use crate::scene::Layer;
use crate::strands;
use crate::whitted::Shader;

/// The scalar form of a shader and of how rays go on.
pub(crate) struct Recursion<'a> {
    shader: &'a Shader<'a>,
    params: BounceParams,
}

impl Recursion<'_> {
    /// Light that comes back along a ray, `own` of which the sample gets.
    pub(crate) fn radiance(&self, ray: &Ray, depth: u32, own: f32) -> Rgb {
        let Some(hit) = self.shader.scene.closest_hit(ray, Layer::All) else {
            return match &self.shader.scene.backdrop {
                Some(backdrop) => {
                    let view = unit_or(-ray.direction, Vec3::y());
                    backdrop.color(self.shader.camera, -view)
                }
                None => self.shader.scene.background,
            };
        };
        let point = Interaction::new(self.shader.scene, ray, &hit);
        let material = point.object.material(point.triangle);
        let weight = diffuse_weight(&point, material);
        let mut color = self.ambient(&point, material, weight);
        for light in self.shader.lights {
            if let Some((contribution, ray)) = self.unshadowed(&point, &hit, weight, light) {
                color += contribution.component_mul(&self.shader.scene.transmittance(&ray));
            }
        }
        if material.spawns_rays() {
            self.add_secondary(&point, material, depth, own, &mut color);
        }
        color
    }

    fn ambient(&self, point: &Interaction<'_>, material: &Material, weight: f32) -> Rgb {
        let sum = AmbientSum::of(self.shader.lights);
        let share = weight * material.exposure_at(point.lifted);
        let mut color = point
            .albedo
            .component_mul(&sum.on_without_bend(point.normal))
            * share;
        if sum.bend != AmbientSum::default().bend {
            color += point.albedo.component_mul(&sum.bend_on(point.normal)) * share;
        }
        color
    }

    /// What a light gives if nothing is in between, and the ray that finds out. `None` if the surface faces away.
    fn unshadowed(
        &self,
        point: &Interaction<'_>,
        hit: &Hit,
        weight: f32,
        light: &Light,
    ) -> Option<(Rgb, Ray)> {
        let Arrival { direction, power } = light.arrival(point.lifted)?;
        let material = point.object.material(point.triangle);
        if !point.object.geometry.strands.is_empty() {
            let strand = strand_at(point.object, hit);
            let share = strands::scatter_one(strand, direction, point.view, point.albedo);
            let origin = point.lifted + direction * strands::SOFT_DEPTH_MM;
            let ray = match light.position() {
                Some(position) => Ray::between(origin, position),
                None => Ray::new(origin, direction),
            };
            return Some((share.component_mul(&power), ray));
        }
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
        let origin = point.lifted + point.flat_normal * self.params.offset;
        let ray = match light.position() {
            Some(position) => Ray::between(origin, position),
            None => Ray::new(origin, direction),
        };
        Some((share.component_mul(&power) * cosine, ray))
    }

    /// Adds light through the surface, then by mirror reflection.
    fn add_secondary(
        &self,
        point: &Interaction<'_>,
        material: &Material,
        depth: u32,
        own: f32,
        color: &mut Rgb,
    ) {
        if depth >= self.params.max_depth {
            return;
        }
        for (ray, tint, share) in spawn(point, material, self.params.offset)
            .into_iter()
            .flatten()
        {
            let all = own * share * tint.max();
            if all >= self.params.min_share {
                *color += self.radiance(&ray, depth + 1, all).component_mul(&tint) * share;
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounces::{ShadingPoints, Spacing};
    use crate::lanes::LANES;
    use crate::light::LightSource;
    use crate::material::Transmission;
    use crate::math::Pose;
    use crate::surface;
    use crate::whitted::{Shaded, Wanted};
    use crate::{Backdrop, Camera, Normals, Object, Scene, Skips};
    use approx::assert_relative_eq;
    use facile_core::{Mesh, Point3, Texture, Vector3};
    use std::sync::Arc;

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

    /// A ball of squares about the origin.
    fn ball(radius: f64) -> Mesh {
        let (rows, columns) = (12_u32, 24_u32);
        let mut mesh = Mesh::default();
        for row in 0..=rows {
            for column in 0..columns {
                let (polar, turn) = (
                    std::f64::consts::PI * f64::from(row) / f64::from(rows),
                    std::f64::consts::TAU * f64::from(column) / f64::from(columns),
                );
                let (r, y) = (radius * polar.sin(), radius * polar.cos());
                mesh.positions
                    .push(Point3::new(r * turn.sin(), y, r * turn.cos()));
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let [a, b] = [column, (column + 1) % columns].map(|c| row * columns + c);
                mesh.triangles.push([a, a + columns, b]);
                mesh.triangles.push([b, a + columns, b + columns]);
            }
        }
        mesh
    }

    fn scene() -> Scene {
        let skin = Material::skin(Arc::new(Texture::constant([200, 150, 120])));
        let solid = Transmission::Solid {
            ior: 1.5,
            tint: Rgb::new(0.9, 1.0, 0.95),
        };
        let glass = Material {
            reflectivity: 0.04,
            transmission: Some(solid),
            ..Material::default()
        };
        let lens = Material::thin_glass(Rgb::new(0.8, 0.9, 0.7));
        let shiny = Material {
            reflectivity: 0.3,
            specular: 0.1,
            shininess: 40.0,
            ..Material::default()
        };
        let places = [
            (skin, [0.0, 0.0, 0.0], 60.0),
            (glass, [30.0, 10.0, 110.0], 25.0),
            (lens, [-35.0, -5.0, 100.0], 30.0),
            (shiny, [80.0, -40.0, 20.0], 30.0),
            (Material::mirror(), [-80.0, 50.0, -30.0], 40.0),
        ];
        let mut scene = Scene::new(Rgb::new(0.1, 0.2, 0.3));
        scene.backdrop = Some(Backdrop::Gradient {
            top: Rgb::new(0.1, 0.2, 0.3),
            bottom: Rgb::new(0.5, 0.4, 0.1),
        });
        for (material, place, radius) in places {
            let mut object = Object::new(&ball(radius), Normals::Smooth, material).expect("valid");
            let pose = Pose::new(Vec3::from(place), Vec3::new(0.1, 0.2, 0.0));
            object.set_pose(&pose).expect("finite");
            scene.add(object);
        }
        let mesh = ball(28.0);
        let strands = mesh.positions.iter();
        let strands = strands
            .map(|p| Vec3::new(p.z as f32, 5.0, -p.x as f32))
            .collect();
        let brown = Material::matt(Rgb::new(0.2, 0.1, 0.05));
        let mut hair = Object::new(&mesh, Normals::Smooth, brown)
            .and_then(|o| o.with_strands(strands))
            .expect("valid");
        let pose = Pose::new(Vec3::new(60.0, 60.0, 50.0), Vec3::new(0.3, 0.0, 0.1));
        hair.set_pose(&pose).expect("finite");
        scene.add(hair);
        scene
    }

    #[test]
    fn batches_of_bounces_give_the_bits_of_the_recursion() {
        let scene = scene();
        let eye = Point3::new(20.0, 30.0, 500.0);
        let camera =
            Camera::look_at(61, 47, eye, Point3::origin(), Vector3::y(), 0.5).expect("valid");
        let texts = [
            "kind = 'point'\nposition = [300, 200, 500]\nintensity = 0.3",
            "kind = 'hemisphere'\nintensity = 0.2",
            "kind = 'area'\nposition = [-200, 100, 400]\ntarget = [0, 0, 0]\nsize = [90, 50]\nintensity = 0.1\nsamples = 5",
            "kind = 'spot'\nposition = [0, 300, 300]\ntarget = [0, 0, 0]\nangle_deg = 20\nsoftness = 0.5\nintensity = 0.2",
            "kind = 'directional'\ndirection = [1, -1, -1]\nintensity = 0.2",
            "kind = 'spherical_harmonic'\nintensity = 0.1\ncoefficients = [[0.5,0.4,0.3],[0.1,0,0],[0,0.2,0.1],[0,0,0.1],[0.1,0.1,0],[0,0.1,0],[0.05,0,0],[0.02,0.03,0.01],[0,0.02,0.04]]",
        ];
        let mut lights = Vec::new();
        for text in texts {
            let source: LightSource = toml::from_str(text).expect("valid");
            source.add_to(&mut lights, &camera).expect("valid");
        }
        let shader = Shader {
            scene: &scene,
            camera: &camera,
            lights: &lights,
            offset: 0.05,
            skips: Skips::default(),
        };
        let params = BounceParams {
            max_depth: 4,
            min_share: crate::bounces::MIN_SHARE,
            offset: 0.05,
            smooth_shadows: true,
        };
        let rays: Vec<Ray> = (0..61 * 47)
            .map(|i| camera.ray([f64::from(i % 61) + 0.5, f64::from(i / 61) + 0.5]))
            .collect();
        let mut hits = Vec::new();
        scene.closest_hits(&rays, Layer::All, &mut hits);
        let directions: Vec<[f32; 3]> = rays.iter().map(|r| r.direction.into()).collect();
        let mut points = ShadingPoints::default();
        points.find(&scene, &hits, &directions, Spacing::even(0.0), params);
        let mut shaded = Shaded::default();
        shader.shade(&points, Wanted::default(), &mut shaded);
        let recursion = Recursion {
            shader: &shader,
            params,
        };
        let bits = |c: &Rgb| [c.x, c.y, c.z].map(f32::to_bits);
        let mut spawning = 0;
        for (i, ray) in rays.iter().enumerate() {
            let found = surface::lane(&shaded.colors[i / LANES], i % LANES);
            let expected = recursion.radiance(ray, 0, 1.0);
            assert_eq!(bits(&found), bits(&expected), "{i}: {found:?} {expected:?}");
            spawning += (points.surfaces[i / LANES].spawns >> (i % LANES)) & 1;
        }
        assert!(spawning > 400, "{spawning}");
    }
}
