//! Eight vectors of three coordinates at a time.

use std::ops::{Add, Mul, Sub};

use super::{Eight, Lanes};

/// Eight vectors in registers. Sums run from `x` to `z`, as `nalgebra`'s do.
#[derive(Clone, Copy)]
pub(crate) struct V3<L>(pub(crate) [L; 3]);

impl<L: Lanes> V3<L> {
    #[inline(always)]
    pub(crate) fn splat(v: [f32; 3]) -> Self {
        Self([L::splat(v[0]), L::splat(v[1]), L::splat(v[2])])
    }

    #[inline(always)]
    pub(crate) fn load(v: &[Eight; 3]) -> Self {
        Self([L::load(&v[0]), L::load(&v[1]), L::load(&v[2])])
    }

    #[inline(always)]
    pub(crate) fn store(self) -> [Eight; 3] {
        [self.0[0].store(), self.0[1].store(), self.0[2].store()]
    }

    #[inline(always)]
    pub(crate) fn scale(self, by: L) -> Self {
        Self([self.0[0] * by, self.0[1] * by, self.0[2] * by])
    }

    #[inline(always)]
    pub(crate) fn divide(self, by: L) -> Self {
        Self([self.0[0] / by, self.0[1] / by, self.0[2] / by])
    }

    #[inline(always)]
    pub(crate) fn negate(self) -> Self {
        self.scale(L::splat(-1.0))
    }

    #[inline(always)]
    pub(crate) fn dot(self, other: Self) -> L {
        let ([ax, ay, az], [bx, by, bz]) = (self.0, other.0);
        ax * bx + ay * by + az * bz
    }

    /// The sum of the coordinates.
    #[inline(always)]
    pub(crate) fn sum(self) -> L {
        self.0[0] + self.0[1] + self.0[2]
    }

    #[inline(always)]
    pub(crate) fn cross(self, other: Self) -> Self {
        let ([ax, ay, az], [bx, by, bz]) = (self.0, other.0);
        Self([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    }

    #[inline(always)]
    pub(crate) fn select(mask: L::Mask, yes: Self, no: Self) -> Self {
        Self([
            L::select(mask, yes.0[0], no.0[0]),
            L::select(mask, yes.0[1], no.0[1]),
            L::select(mask, yes.0[2], no.0[2]),
        ])
    }

    /// As [`crate::math::unit_or`].
    #[inline(always)]
    pub(crate) fn unit_or(self, fallback: Self) -> Self {
        let squared = self.dot(self);
        let unit = self.divide(squared.sqrt());
        Self::select(L::splat(1e-30).lt(squared), unit, fallback)
    }
}

impl<L: Lanes> Add for V3<L> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] + b[0], a[1] + b[1], a[2] + b[2]])
    }
}

impl<L: Lanes> Sub for V3<L> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] - b[0], a[1] - b[1], a[2] - b[2]])
    }
}

/// Coordinate by coordinate.
impl<L: Lanes> Mul for V3<L> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([a[0] * b[0], a[1] * b[1], a[2] * b[2]])
    }
}
