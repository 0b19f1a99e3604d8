//! The parts of a head as objects with materials.

use std::sync::Arc;

use facile_core::{Eye, Point3, ReferenceHead, Segment, Similarity3, SurfacePoint, Texture};

use super::IRIS_RADIUS_SHARE;
use crate::TraceError;
use crate::aperture::Aperture;
use crate::geometry::Normals;
use crate::material::{Albedo, Material};
use crate::math::{Rgb, Vec3, vec3_from_point};
use crate::object::{Object, SegmentCap};

/// A point of the skin: corners of a triangle, and their weights.
pub(super) type RimPoint = ([u32; 3], [f64; 3]);

/// The inner border of the lips in order.
pub(super) fn inner_lips(reference: &ReferenceHead) -> Result<Vec<RimPoint>, TraceError> {
    let scheme = reference.scheme("ibug68")?;
    let points = scheme.points.get(60..68).unwrap_or_default();
    let corners = |p: &SurfacePoint| reference.mesh.triangles[p.triangle as usize];
    Ok(points.iter().map(|p| (corners(p), p.barycentric)).collect())
}

pub(super) fn skin_object(
    like: Option<&Object>,
    reference: &ReferenceHead,
    positions: &[Point3],
    texture: &Arc<Texture>,
) -> Result<Object, TraceError> {
    let mut mesh = reference.mesh.clone();
    positions.clone_into(&mut mesh.positions);
    let skin = Material::skin(texture.clone());
    let lips = Material {
        roughness: 0.4,
        ..skin.clone()
    };
    let nose = Material {
        roughness: 0.38,
        ..skin.clone()
    };
    let mouth = Material {
        roughness: 0.25,
        aperture: Some(Aperture::default()),
        ..skin.clone()
    };
    // What is painted there is cropped hair, or its roots
    let scalp = Material {
        specular: 0.015,
        roughness: 0.75,
        ..skin.clone()
    };
    let socket = Material {
        exposure: 0.5,
        ..skin.clone()
    };
    let is_lip = |s| matches!(s, Segment::UpperLip | Segment::LowerLip);
    Ok(Object::like(like, &mesh, Normals::Smooth, skin)?
        .with_material(lips, is_lip)
        .with_material(nose, |s| s == Segment::Nose)
        .with_material(scalp, |s| s == Segment::Scalp)
        .with_material(mouth, |s| s == Segment::InnerMouth)
        .with_material(socket, |s| s == Segment::EyeSocket))
}

fn part(reference: &ReferenceHead, segment: Segment) -> Result<&facile_core::Part, TraceError> {
    reference
        .parts
        .iter()
        .find(|p| p.segment == segment)
        .ok_or_else(|| {
            TraceError::Core(facile_core::CoreError::UnknownName {
                kind: "part of the reference head",
                name: segment.name().to_owned(),
                known: reference
                    .parts
                    .iter()
                    .map(|p| p.segment.name())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
        })
}

/// A wet eyeball in the shade of lids and lashes: the white of an eye is not white.
fn eye_material(texture: &Arc<Texture>) -> Material {
    Material {
        albedo: Albedo::Texture {
            texture: texture.clone(),
            tint: Rgb::new(0.8, 0.75, 0.73),
        },
        exposure: 0.7,
        ..Material::wet(texture.clone())
    }
}

/// An eyeball about its own centre, so that a pose turns it.
pub(super) fn eye_object(
    like: Option<&Object>,
    reference: &ReferenceHead,
    (from, to): (&Eye, &Eye),
    (segment, iris): (Segment, Segment),
    texture: &Arc<Texture>,
) -> Result<Object, TraceError> {
    let mut mesh = part(reference, segment)?.mesh.clone();
    let scale = to.radius / from.radius;
    for p in &mut mesh.positions {
        *p = Point3::from((*p - from.center) * scale);
    }
    let cap = SegmentCap {
        center: vec3_from_point(&Point3::origin()),
        axis: Vec3::z(),
        cos_angle: (1.0 - IRIS_RADIUS_SHARE * IRIS_RADIUS_SHARE).sqrt(),
        segment: iris,
    };
    let material = eye_material(texture);
    Ok(Object::like(like, &mesh, Normals::Smooth, material)?.with_cap(cap))
}

pub(super) fn mouth_object(
    like: Option<&Object>,
    reference: &ReferenceHead,
    segment: Segment,
    placed: &Similarity3,
    texture: &Arc<Texture>,
) -> Result<Object, TraceError> {
    let mut mesh = part(reference, segment)?.mesh.clone();
    for p in &mut mesh.positions {
        *p = placed * *p;
    }
    // Enamel and mucosa, wet
    let material = Material {
        specular: 0.03,
        roughness: 0.22,
        scatter_mm: Rgb::repeat(0.3),
        aperture: Some(Aperture::default()),
        ..Material::skin(texture.clone())
    };
    Object::like(like, &mesh, Normals::Smooth, material)
}
