//! Three-vectors as plain arrays, for the kernels: they inline and vectorise at every optimisation level.
//!
//! The public vocabulary is `nalgebra`, from [`facile_core::math`]; conversion happens where a model is built and where
//! a result leaves.

use facile_core::{Point3, Vector3};

/// Three coordinates, mm or a force.
pub(crate) type V3 = [f64; 3];
/// Rows of a 3x3 matrix.
pub(crate) type M3 = [V3; 3];

pub(crate) const ZERO: V3 = [0.0; 3];
pub(crate) const IDENTITY: M3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

#[inline]
pub(crate) fn add(a: V3, b: V3) -> V3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline]
pub(crate) fn sub(a: V3, b: V3) -> V3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
pub(crate) fn scale(a: V3, s: f64) -> V3 {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `a b`.
pub(crate) fn product(a: &M3, b: &M3) -> M3 {
    a.map(|row| {
        let terms = [0, 1, 2].map(|k| scale(b[k], row[k]));
        add(add(terms[0], terms[1]), terms[2])
    })
}

/// `m^T`.
pub(crate) fn transpose(m: &M3) -> M3 {
    [0, 1, 2].map(|c| m.map(|row| row[c]))
}

/// `a + s b`.
#[inline]
pub(crate) fn add_scaled(a: V3, b: V3, s: f64) -> V3 {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

#[inline]
pub(crate) fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub(crate) fn cross(a: V3, b: V3) -> V3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[inline]
pub(crate) fn norm(a: V3) -> f64 {
    dot(a, a).sqrt()
}

/// `a / |a|`, or zero for a vector shorter than `1e-12`.
#[inline]
pub(crate) fn unit(a: V3) -> V3 {
    let n = norm(a);
    if n > 1e-12 { scale(a, 1.0 / n) } else { ZERO }
}

/// `m a`.
#[inline]
pub(crate) fn rotate(m: &M3, a: V3) -> V3 {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// `m^T a`.
#[inline]
pub(crate) fn rotate_back(m: &M3, a: V3) -> V3 {
    [
        m[0][0] * a[0] + m[1][0] * a[1] + m[2][0] * a[2],
        m[0][1] * a[0] + m[1][1] * a[1] + m[2][1] * a[2],
        m[0][2] * a[0] + m[1][2] * a[1] + m[2][2] * a[2],
    ]
}

pub(crate) fn from_point(p: &Point3) -> V3 {
    [p.x, p.y, p.z]
}

pub(crate) fn from_vector(p: &Vector3) -> V3 {
    [p.x, p.y, p.z]
}

pub(crate) fn to_point(a: V3) -> Point3 {
    Point3::new(a[0], a[1], a[2])
}

pub(crate) fn to_vector(a: V3) -> Vector3 {
    Vector3::new(a[0], a[1], a[2])
}

/// Numbers in `[-1, 1]` without a pattern, for tests.
#[cfg(test)]
pub(crate) fn noise(k: usize) -> f64 {
    libm::sin(12.9898 * k as f64 + 0.3 * libm::sin(78.233 * k as f64))
}
