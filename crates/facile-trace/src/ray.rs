//! Rays and hits.

use crate::math::Vec3;

/// A ray `origin + t direction`, `t` in `(t_min, t_max)`. The direction need not have unit length: for a camera's ray
/// `t` is the depth along the optical axis, for a shadow ray 1 is the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start, mm.
    pub origin: Vec3,
    /// Direction, not zero, any length.
    pub direction: Vec3,
    /// Hits at or before this parameter do not count.
    pub t_min: f32,
    /// Hits at or past this parameter do not count.
    pub t_max: f32,
}

impl Ray {
    /// A ray without end.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self {
            origin,
            direction,
            t_min: 0.0,
            t_max: f32::INFINITY,
        }
    }

    /// The segment from `origin` to `target`: `t` runs from 0 to 1.
    pub fn between(origin: Vec3, target: Vec3) -> Self {
        Self {
            origin,
            direction: target - origin,
            t_min: 0.0,
            t_max: 1.0,
        }
    }

    /// The point at parameter `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// Marks a pixel or lane without a hit, see [`Hit::MISS`].
pub const NO_OBJECT: u32 = u32::MAX;

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Index of the object in its scene; [`NO_OBJECT`] for none.
    pub object: u32,
    /// Index of the triangle in its object's mesh.
    pub triangle: u32,
    /// Barycentric weight of the triangle's second corner.
    pub u: f32,
    /// Barycentric weight of the triangle's third corner.
    pub v: f32,
}

impl Hit {
    /// No hit, as stored in packed lists of hits.
    pub const MISS: Self = Self {
        t: f32::INFINITY,
        object: NO_OBJECT,
        triangle: 0,
        u: 0.0,
        v: 0.0,
    };

    /// Whether this is a hit at all.
    pub fn is_some(&self) -> bool {
        self.object != NO_OBJECT
    }

    /// The hit as an option.
    pub fn ok(self) -> Option<Self> {
        self.is_some().then_some(self)
    }

    /// Weights of the three corners.
    pub fn barycentric(&self) -> [f32; 3] {
        [1.0 - self.u - self.v, self.u, self.v]
    }
}
