//! The surface at a hit: what shading needs to know. The scalar form, for secondary rays, and the oracle of
//! [`crate::surface`].

use crate::material::Albedo;
#[cfg(test)]
use crate::material::Material;
use crate::math::{Rgb, Vec3, unit_or};
use crate::object::Object;
use crate::ray::{Hit, Ray};
use crate::scene::Scene;
#[cfg(test)]
use crate::whitted::fresnel;

/// The surface where a ray meets it, in the world. Normals are on the ray's side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interaction<'a> {
    pub(crate) object: &'a Object,
    pub(crate) triangle: u32,
    /// The point, mm.
    pub(crate) position: Vec3,
    /// The point lifted onto the smooth surface that the vertex normals stand for, mm.
    pub(crate) lifted: Vec3,
    /// Unit normal of the triangle.
    pub(crate) flat_normal: Vec3,
    /// Unit shading normal.
    pub(crate) normal: Vec3,
    /// Unit direction back along the ray.
    pub(crate) view: Vec3,
    /// Whether the ray comes from outside.
    pub(crate) is_outside: bool,
    /// Linear RGB.
    #[cfg(test)]
    pub(crate) albedo: Rgb,
}

impl<'a> Interaction<'a> {
    pub(crate) fn new(scene: &'a Scene, ray: &Ray, hit: &Hit) -> Self {
        let object = &scene.objects()[hit.object as usize];
        let geometry = &object.geometry;
        let corners = geometry
            .corners(hit.triangle)
            .map(|p| object.point_in_world(p));
        let weights = hit.barycentric();
        let blend = |v: [Vec3; 3]| v[0] * weights[0] + v[1] * weights[1] + v[2] * weights[2];
        let position = blend(corners);
        let area_vector = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let mut flat_normal = unit_or(area_vector, Vec3::y());
        let is_outside = flat_normal.dot(&ray.direction) <= 0.0;
        let side = if is_outside { 1.0 } else { -1.0 };
        flat_normal *= side;
        let (mut normal, mut lifted) = (flat_normal, position);
        if !geometry.normals.is_empty() {
            let triangle = geometry.triangles[hit.triangle as usize];
            let normals =
                triangle.map(|v| object.vector_in_world(geometry.normals[v as usize]) * side);
            normal = unit_or(blend(normals), flat_normal);
            lifted = lift(position, &corners, &normals, &weights);
        }
        Self {
            object,
            triangle: hit.triangle,
            position,
            lifted,
            flat_normal,
            normal,
            view: unit_or(-ray.direction, flat_normal),
            is_outside,
            #[cfg(test)]
            albedo: albedo(object, hit),
        }
    }
}

/// Share of light that the diffuse layer gets.
#[cfg(test)]
pub(crate) fn diffuse_weight(point: &Interaction<'_>, material: &Material) -> f32 {
    if material.is_transparent() {
        0.0
    } else if material.reflectivity > 0.0 {
        1.0 - fresnel(material.reflectivity, point.normal.dot(&point.view))
    } else {
        1.0
    }
}

/// Lifts a point of a triangle to the smooth surface of its vertex normals, where that lies outside: shadow rays that
/// start there do not see the triangle's neighbours as a staircase at the terminator.
///
/// Source: Hanika, Hacking the Shadow Terminator, Ray Tracing Gems II, 2021.
fn lift(position: Vec3, corners: &[Vec3; 3], normals: &[Vec3; 3], weights: &[f32; 3]) -> Vec3 {
    let mut lifted = position;
    for ((corner, normal), weight) in corners.iter().zip(normals).zip(weights) {
        let depth = (position - corner).dot(normal);
        if depth < 0.0 {
            lifted -= normal * (depth * weight);
        }
    }
    lifted
}

pub(crate) fn albedo(object: &Object, hit: &Hit) -> Rgb {
    let geometry = &object.geometry;
    let [a, b, c] = hit.barycentric();
    match &object.material(hit.triangle).albedo {
        Albedo::Constant(color) => *color,
        Albedo::Texture { texture, tint } => match geometry.texcoords(hit.triangle) {
            Some([p, q, r]) => {
                let uv = [0, 1].map(|k| p[k] * a + q[k] * b + r[k] * c);
                Rgb::from(texture.sample(uv)).component_mul(tint)
            }
            None => Rgb::from(texture.sample([0.5, 0.5])).component_mul(tint),
        },
        Albedo::VertexColor => {
            if geometry.colors.is_empty() {
                return Rgb::repeat(0.5);
            }
            let colors = geometry.triangles[hit.triangle as usize]
                .map(|v| Rgb::from(geometry.colors[v as usize]));
            colors[0] * a + colors[1] * b + colors[2] * c
        }
    }
}
