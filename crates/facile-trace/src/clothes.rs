//! A shirt on a person: carried from the reference head as hair is.

use facile_core::{Mesh, Point3, ReferenceHead, Subject, Vector3, clothes};

use crate::TraceError;
use crate::geometry::Normals;
use crate::hair::{ANCHORS, anchors, outer_vertices, pushed_out};
use crate::material::{Albedo, Material};
use crate::math::Rgb;
use crate::object::Object;

/// Least distance of cloth from the skin, mm.
const CLEARANCE_MM: f64 = 2.5;

/// The shirt on a reference head, ready for any person.
#[derive(Clone, Debug)]
pub struct ShirtFit {
    anchors: Vec<[(u32, f64); ANCHORS]>,
}

impl ShirtFit {
    /// The shirt of a reference head. Cost O(vertices of both), some 0.1 s: to be kept.
    pub fn new(reference: &ReferenceHead) -> Self {
        let candidates = outer_vertices(reference);
        let positions = &clothes::shirt().positions;
        Self {
            anchors: positions.iter().map(|p| anchors(p, &candidates)).collect(),
        }
    }

    /// The shirt of a person whose skin at rest is `skin`, in an 8-bit sRGB colour.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub fn object(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
        skin: &Object,
        color: [u8; 3],
    ) -> Result<Object, TraceError> {
        let mesh = Mesh {
            positions: self.positions(reference, subject, skin),
            ..clothes::shirt().clone()
        };
        let color = color.map(|c| facile_core::color::LINEAR_FROM_SRGB8[usize::from(c)]);
        let cloth = Material {
            albedo: Albedo::Constant(Rgb::from(color)),
            specular: 0.02,
            roughness: 0.85,
            ..Material::default()
        };
        Object::new(&mesh, Normals::Smooth, cloth)
    }

    fn positions(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
        skin: &Object,
    ) -> Vec<Point3> {
        let (from, to) = (&reference.mesh.positions, &subject.positions);
        let vertices = clothes::shirt().positions.iter().zip(&self.anchors);
        vertices
            .map(|(p, anchors)| {
                let moved = anchors.iter().fold(Vector3::zeros(), |sum, (v, weight)| {
                    sum + (to[*v as usize] - from[*v as usize]) * *weight
                });
                pushed_out(p + moved, CLEARANCE_MM, skin)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::IdentityModel;

    #[test]
    fn the_collar_goes_around_every_neck() {
        let reference = ReferenceHead::embedded();
        let fit = ShirtFit::new(reference);
        for index in 0..4 {
            let subject = IdentityModel::embedded()
                .sample(reference, 5, index)
                .expect("draws");
            let mesh = subject.mesh(reference);
            let skin = Object::new(&mesh, Normals::Flat, Material::default()).expect("valid");
            let own = fit.positions(reference, &subject, &skin);
            // Whatever of the neck is as low as the collar's lowest rim is inside the shirt's outline
            for p in own.iter().filter(|p| p.y > -170.0) {
                assert!(
                    (pushed_out(*p, CLEARANCE_MM, &skin) - p).norm() < 0.2,
                    "{p}"
                );
            }
        }
    }
}
