//! Whether points of the face can be seen, and what hides those that cannot.

use facile_core::Point3;

use crate::camera::Camera;
use crate::math::{Vec3, vec3_from_point};
use crate::ray::Ray;
use crate::scene::{Layer, Scene};

/// Why a point is seen or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visibility {
    /// In the image, nothing opaque in front.
    Visible,
    /// Behind the face itself.
    BehindSelf,
    /// The face would show it, an occluder is in front.
    BehindOccluder,
    /// Outside the image, or behind the camera.
    OutsideFrame,
}

impl Visibility {
    /// The name in records: `visible`, `self`, `occluder`, `frame`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Visible => "visible",
            Self::BehindSelf => "self",
            Self::BehindOccluder => "occluder",
            Self::OutsideFrame => "frame",
        }
    }
}

/// How visibility is decided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisibilityParams {
    /// Surfaces within this distance in front of a point belong to it, mm: landmarks lie on skin, not above it. 2 by
    /// default.
    pub tolerance_mm: f32,
    /// A transparent occluder that lets less than this share of light pass hides what is behind it. 0.3 by default, so
    /// that clear lenses do not hide and sunglasses do.
    pub min_transmittance: f32,
}

impl Default for VisibilityParams {
    fn default() -> Self {
        Self {
            tolerance_mm: 2.0,
            min_transmittance: 0.3,
        }
    }
}

/// Decides for each point of a face whether the camera sees it. A point that the face itself hides is
/// [`Visibility::BehindSelf`] whether or not an occluder is there as well.
pub fn point_visibility(
    scene: &Scene,
    camera: &Camera,
    points: &[Point3],
    params: &VisibilityParams,
) -> Vec<Visibility> {
    points
        .iter()
        .map(|point| {
            let projected = camera.project(point).map(|(px, _)| px);
            let Some(px) = projected.filter(|px| camera.contains_px(*px)) else {
                return Visibility::OutsideFrame;
            };
            let eye = camera.ray(px).origin;
            let target = vec3_from_point(point);
            let distance = (target - eye).norm();
            let ray = Ray {
                t_max: 1.0 - params.tolerance_mm / distance,
                ..Ray::between(eye, target)
            };
            if hides(scene, &ray, target, params.tolerance_mm) {
                Visibility::BehindSelf
            } else if occluder_share(scene, &ray) < params.min_transmittance {
                Visibility::BehindOccluder
            } else {
                Visibility::Visible
            }
        })
        .collect()
}

/// Whether the face is in the way: its first surface on the ray is not the one the point is on.
fn hides(scene: &Scene, ray: &Ray, target: Vec3, tolerance: f32) -> bool {
    scene
        .closest_hit(ray, Layer::BehindOccluders)
        .is_some_and(|hit| (ray.at(hit.t) - target).norm() > tolerance)
}

/// Mean share of light that the occluders on a ray let through.
fn occluder_share(scene: &Scene, ray: &Ray) -> f32 {
    let mut share = crate::math::Rgb::repeat(1.0);
    for object in scene
        .objects()
        .iter()
        .filter(|o| o.is_visible && o.is_occluder())
    {
        share.component_mul_assign(&object.transmittance(ray));
    }
    share.mean()
}
