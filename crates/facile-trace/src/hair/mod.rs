//! Hair on a person: a style's cards are carried from the reference head to the person's, and pushed out where they would
//! cut into the skin.
//!
//! A [`HairFit`] holds what does not depend on the person: each vertex of a style follows nearby vertices of the reference
//! head, the nearest most, and keeps its distance from the surface on the ray from the middle of the head. Hair stays
//! where it is on the neutral head; lashes ([`LashFit`]) move with the lids.

mod lashes;
mod press;
mod scalp;
mod streaks;

use std::sync::Arc;

use facile_core::{HairStyle, Mesh, Point3, ReferenceHead, Segment, Subject, Texture, Vector3};
use serde::{Deserialize, Serialize};

use crate::TraceError;
use crate::cutout::Cutout;
use crate::geometry::Normals;
use crate::material::{Albedo, Material};
use crate::math::{Rgb, Vec3, unit_or, vec3_from_point, vec3_from_vector};
use crate::object::Object;
use crate::ray::Ray;

pub use lashes::LashFit;
pub(crate) use press::pressed;
pub use scalp::toned_scalp;

/// Vertices of the head that a vertex of hair follows.
pub(crate) const ANCHORS: usize = 24;
/// Hair follows the head within this distance, mm, and within this share of its own distance from the head.
const REACH_MM: f64 = 6.0;
const REACH_SHARE: f64 = 0.35;
/// Least distance of cards from the skin, mm, unless they are closer on the reference head.
const CLEARANCE_MM: f64 = 1.2;
/// How far outside the head probes start, mm.
const OUTSIDE_MM: f64 = 400.0;
/// Share of ambient light that hair gets: fibres hide the sky from each other.
const EXPOSURE: f32 = 0.75;

/// The hair of a person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hair {
    /// Name of a [`HairStyle`].
    pub style: String,
    /// 8-bit sRGB mean colour of the strands.
    pub color: [u8; 3],
}

/// A style on the reference head, ready for any person.
#[derive(Clone, Debug)]
pub struct HairFit {
    style: &'static HairStyle,
    cutout: Arc<Cutout>,
    light: Arc<Texture>,
    /// Mean of the light where there are strands.
    mean_light: f32,
    anchors: Vec<[(u32, f64); ANCHORS]>,
    /// Distance of each vertex from the reference head's skin, mm; infinite where no skin is behind it.
    gaps: Vec<f64>,
}

impl HairFit {
    /// A style on a reference head. Cost O(vertices of both), some 0.1 s: to be kept.
    ///
    /// # Errors
    /// [`TraceError::Core`] for an unknown style.
    pub fn new(reference: &ReferenceHead, style: &str) -> Result<Self, TraceError> {
        let style = HairStyle::embedded(style)?;
        let candidates = outer_vertices(reference);
        let skin = Object::new(&reference.mesh, Normals::Flat, Material::default())?;
        let positions = &style.mesh.positions;
        let light = streaks::streaked(style);
        Ok(Self {
            style,
            cutout: Arc::new(Cutout::new(&style.mesh, style.size(), style.cover.clone())?),
            mean_light: style.mean_light_of(&light),
            light: Arc::new(light),
            anchors: positions.iter().map(|p| anchors(p, &candidates)).collect(),
            gaps: positions
                .iter()
                .map(|p| Outwards::to(p).gap(&skin).unwrap_or(f64::INFINITY))
                .collect(),
        })
    }

    /// The hair of a person whose skin at rest is `skin`, in an 8-bit sRGB colour.
    pub(crate) fn cards(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
        skin: &Object,
        color: [u8; 3],
    ) -> Cards {
        Cards {
            mesh: Mesh {
                positions: self.positions(reference, subject, skin),
                ..self.style.mesh.clone()
            },
            strands: self.style.strands.clone(),
            material: self.material(color),
            style: self.style,
            cutout: self.cutout.clone(),
        }
    }

    fn material(&self, color: [u8; 3]) -> Material {
        let color = color.map(|c| facile_core::color::LINEAR_FROM_SRGB8[usize::from(c)]);
        Material {
            albedo: Albedo::Texture {
                texture: self.light.clone(),
                tint: Rgb::from(color) / self.mean_light.max(1e-3),
            },
            exposure: EXPOSURE,
            ..Material::default()
        }
    }

    /// The cards' vertices on a person, mm.
    fn positions(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
        skin: &Object,
    ) -> Vec<Point3> {
        let (from, to) = (&reference.mesh.positions, &subject.positions);
        let vertices = self.style.mesh.positions.iter().zip(&self.anchors);
        vertices
            .zip(&self.gaps)
            .map(|((p, anchors), gap)| {
                let moved = anchors.iter().fold(Vector3::zeros(), |sum, (v, weight)| {
                    sum + (to[*v as usize] - from[*v as usize]) * *weight
                });
                pushed_out(p + moved, gap.min(CLEARANCE_MM), skin)
            })
            .collect()
    }
}

/// The cards of a person.
#[derive(Clone, Debug)]
pub(crate) struct Cards {
    mesh: Mesh,
    /// Direction at each vertex.
    strands: Vec<Vector3>,
    material: Material,
    style: &'static HairStyle,
    cutout: Arc<Cutout>,
}

impl Cards {
    /// The cards as an object, with a cutout of their own if their triangles are not those of the style.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub(crate) fn object(&self, cutout: Option<Arc<Cutout>>) -> Result<Object, TraceError> {
        let normals = volume_normals(&self.mesh);
        let strands = self.strands.iter().map(vec3_from_vector).collect();
        Object::new(&self.mesh, Normals::Smooth, self.material.clone())?
            .with_vertex_normals(normals)?
            .with_strands(strands)?
            .with_cutout(cutout.unwrap_or_else(|| self.cutout.clone()))
    }
}

/// A point at least `gap` mm outside the skin.
pub(crate) fn pushed_out(p: Point3, gap: f64, skin: &Object) -> Point3 {
    let ray = Outwards::to(&p);
    match ray.gap(skin) {
        Some(found) if found < gap => p + ray.out * (gap - found),
        _ => p,
    }
}

/// Signed distance of a point from the outermost skin towards the middle of the head, ears left out, mm.
#[cfg(test)]
pub(crate) fn gap_from_skin(p: &Point3, skin: &Object) -> Option<f64> {
    Outwards::to(p).gap(skin)
}

/// The way from the middle of the head to a point.
struct Outwards {
    middle: Point3,
    p: Point3,
    out: Vector3,
}

impl Outwards {
    fn to(p: &Point3) -> Self {
        // A segment through the middle of head and neck
        let middle = Point3::new(0.0, p.y.clamp(-150.0, 60.0), -14.0);
        let out = (p - middle).try_normalize(1e-6).unwrap_or_else(Vector3::z);
        Self { middle, p: *p, out }
    }

    /// Signed distance of the point from the outermost skin, ears left out, mm. `None` where there is none.
    fn gap(&self, skin: &Object) -> Option<f64> {
        let start = self.p + self.out * OUTSIDE_MM;
        let mut ray = Ray::new(vec3_from_point(&start), vec3_from_vector(&-self.out));
        // As deep inside as cards ever are
        ray.t_max = (OUTSIDE_MM + 60.0) as f32;
        loop {
            let hit = skin.closest_hit(&ray)?;
            let segment = skin.geometry().segment(hit.triangle);
            if !matches!(segment, Segment::LeftEar | Segment::RightEar) {
                return Some(f64::from(hit.t) - OUTSIDE_MM);
            }
            ray.t_min = hit.t;
        }
    }
}

/// Cage vertices of the outer skin, with their places.
pub(crate) fn outer_vertices(reference: &ReferenceHead) -> Vec<(u32, Point3)> {
    let mesh = &reference.mesh;
    let mut is_outer = vec![false; reference.cage.positions.len()];
    for (triangle, segment) in mesh.triangles.iter().zip(&mesh.segments) {
        if matches!(
            segment,
            Segment::Skin | Segment::Scalp | Segment::Neck | Segment::LeftEar | Segment::RightEar
        ) {
            for &v in triangle {
                if let Some(flag) = is_outer.get_mut(v as usize) {
                    *flag = true;
                }
            }
        }
    }
    (0..is_outer.len() as u32)
        .filter(|v| is_outer[*v as usize])
        .map(|v| (v, mesh.positions[v as usize]))
        .collect()
}

/// What a point follows, weights summing to 1.
pub(crate) fn anchors(p: &Point3, candidates: &[(u32, Point3)]) -> [(u32, f64); ANCHORS] {
    let mut near: Vec<(f64, u32)> = candidates
        .iter()
        .map(|(v, q)| ((p - q).norm_squared(), *v))
        .collect();
    let order = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let count = ANCHORS.min(near.len());
    near.select_nth_unstable_by(count - 1, order);
    near.truncate(count);
    near.sort_unstable_by(order);
    let nearest = near[0].0;
    let reach = REACH_MM + REACH_SHARE * libm::sqrt(nearest);
    let weight = |squared: f64| libm::exp((nearest - squared) / (2.0 * reach * reach));
    let total: f64 = near.iter().map(|(d, _)| weight(*d)).sum();
    std::array::from_fn(|k| match near.get(k) {
        Some((d, v)) => (*v, weight(*d) / total),
        None => (near[0].1, 0.0),
    })
}

/// Normals of hair as a volume: mostly away from the middle of the head, a little the card's own, on the side that the
/// card's corners turn about.
fn volume_normals(mesh: &Mesh) -> Vec<Vec3> {
    let own = mesh.vertex_normals();
    let vertices = mesh.positions.iter().zip(own);
    vertices
        .map(|(p, own)| {
            let out = Outwards::to(p).out;
            let side = if own.dot(&out) < 0.0 { -1.0 } else { 1.0 };
            let mixed = out * side + own * 0.4;
            unit_or(vec3_from_vector(&mixed), Vec3::y())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::IdentityModel;

    #[test]
    fn hair_of_the_reference_stays_and_that_of_others_clears_their_skin() {
        let reference = ReferenceHead::embedded();
        let fit = HairFit::new(reference, "short02").expect("ships");
        let mut subject = IdentityModel::embedded()
            .sample(reference, 3, 1)
            .expect("draws");
        let skin = |subject: &Subject| {
            Object::new(&subject.mesh(reference), Normals::Flat, Material::default())
                .expect("valid")
        };
        let own = fit.positions(reference, &subject, &skin(&subject));
        // Apart from what is deeper in the reference head, nothing is nearer to the skin than the clearance
        let object = skin(&subject);
        let mut moved = 0.0_f64;
        for ((p, gap), from) in own.iter().zip(&fit.gaps).zip(&fit.style.mesh.positions) {
            let found = Outwards::to(p).gap(&object).unwrap_or(f64::INFINITY);
            assert!(
                found > gap.min(CLEARANCE_MM) - 0.3,
                "{p}: {found} for {gap}"
            );
            moved = moved.max((p - from).norm());
        }
        assert!(moved > 3.0, "a person is not the reference: {moved}");
        subject.positions.clone_from(&reference.mesh.positions);
        let same = fit.positions(reference, &subject, &skin(&subject));
        for (p, from) in same.iter().zip(&fit.style.mesh.positions) {
            assert!((p - from).norm() < 1e-2, "{p} {from}");
        }
    }

    #[test]
    fn weights_sum_to_one_and_hair_moves_with_the_head() {
        let reference = ReferenceHead::embedded();
        let fit = HairFit::new(reference, "bob02").expect("ships");
        for anchors in &fit.anchors {
            let sum: f64 = anchors.iter().map(|(_, w)| w).sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
        assert!(HairFit::new(reference, "mohawk").is_err());
    }
}
