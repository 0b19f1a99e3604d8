//! A user's own mesh in front of a face, fixed to a feature of it.

use std::sync::Arc;

use facile_core::io::Scan;
use facile_core::{Point3, Segment};
use serde::{Deserialize, Serialize};

use super::fit::FaceFit;
use super::hand::clear;
use crate::TraceError;
use crate::geometry::Normals;
use crate::material::{Albedo, Material};
use crate::object::Object;

/// The feature that a model's origin is put on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Anchor {
    /// Tip of the nose.
    #[default]
    Nose,
    /// Between the eyes.
    Eyes,
    /// Middle of the mouth.
    Mouth,
    /// Chin.
    Chin,
    /// Between the brows.
    Forehead,
    /// Where the left ear meets the head.
    LeftEar,
    /// Where the right ear meets the head.
    RightEar,
    /// Middle of the head: the head frame's origin.
    Head,
}

impl Anchor {
    fn point(self, fit: &FaceFit<'_>) -> Point3 {
        let middle = |a: usize, b: usize| {
            Point3::from((fit.landmark(a).coords + fit.landmark(b).coords) / 2.0)
        };
        match self {
            Self::Nose => fit.landmark(30),
            Self::Eyes => fit.landmark(27),
            Self::Mouth => middle(62, 66),
            Self::Chin => fit.landmark(8),
            Self::Forehead => middle(21, 22),
            Self::LeftEar => fit.ear_roots[0],
            Self::RightEar => fit.ear_roots[1],
            Self::Head => Point3::origin(),
        }
    }
}

/// A user's mesh and how it is worn. Records hold its place; the mesh is who wears it's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Model {
    /// File, for records.
    pub file: String,
    /// What it is fixed to: its origin lies there, `y` up, `z` out of the face, `x` to the subject's left.
    pub anchor: Anchor,
    /// Millimetres of one unit of the file.
    pub scale: f64,
    /// Motion from the anchor, mm.
    pub offset_mm: [f64; 3],
    /// Turn about the way the face looks, counter-clockwise for the viewer, degrees.
    pub turn_deg: f64,
    /// Whether it is pushed out until it does not cut into the face.
    pub clear: bool,
    /// The mesh.
    #[serde(skip)]
    pub mesh: Arc<Scan>,
}

impl Model {
    /// The model on a face.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub fn object(&self, fit: &FaceFit<'_>) -> Result<Object, TraceError> {
        let anchor = self.anchor.point(fit);
        let mut mesh = self.mesh.mesh.clone();
        let (sin, cos) = libm::sincos(self.turn_deg.to_radians());
        for p in &mut mesh.positions {
            let v = p.coords * self.scale;
            *p = anchor
                + facile_core::Vector3::new(
                    v.x * cos - v.y * sin + self.offset_mm[0],
                    v.x * sin + v.y * cos + self.offset_mm[1],
                    v.z + self.offset_mm[2],
                );
        }
        if self.clear {
            clear(&mut mesh, fit);
        }
        mesh.segments = vec![Segment::Other; mesh.triangles.len()];
        let albedo = match &self.mesh.texture {
            Some(texture) => Albedo::texture(Arc::new(texture.clone())),
            None if !mesh.colors.is_empty() => Albedo::VertexColor,
            None => Material::default().albedo,
        };
        let material = Material {
            albedo,
            specular: 0.04,
            roughness: 0.5,
            ..Material::default()
        };
        Ok(Object::new(&mesh, Normals::SmoothWelded, material)?.as_occluder())
    }
}
