//! Eight `f32` at a time, in plain Rust that the compiler turns into vector instructions.
//!
//! Every operation is one IEEE operation per lane, never fused, so results are the same bits at any vector width.
#![expect(
    clippy::inline_always,
    reason = "the kernels must become one function to stay in vector registers"
)]

use std::array::from_fn;
use std::ops::{Add, BitAnd, BitOr, Mul, Not, Sub};

/// Rays in a packet.
pub(crate) const LANES: usize = 8;

/// Eight numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub(crate) struct F8(pub(crate) [f32; LANES]);

/// Eight truth values: all bits of a lane are set, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(32))]
pub(crate) struct M8(pub(crate) [u32; LANES]);

macro_rules! lanewise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for F8 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(from_fn(|k| self.0[k] $op other.0[k]))
            }
        }
    };
}

lanewise!(Add, add, +);
lanewise!(Sub, sub, -);
lanewise!(Mul, mul, *);

impl F8 {
    #[inline(always)]
    pub(crate) fn splat(v: f32) -> Self {
        Self([v; LANES])
    }

    /// The smaller of each lane; the second where either is NaN.
    #[inline(always)]
    pub(crate) fn min(self, other: Self) -> Self {
        Self(from_fn(|k| {
            if self.0[k] < other.0[k] {
                self.0[k]
            } else {
                other.0[k]
            }
        }))
    }

    /// The larger of each lane; the second where either is NaN.
    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        Self(from_fn(|k| {
            if self.0[k] > other.0[k] {
                self.0[k]
            } else {
                other.0[k]
            }
        }))
    }

    #[inline(always)]
    pub(crate) fn recip(self) -> Self {
        Self(self.0.map(|v| 1.0 / v))
    }

    #[inline(always)]
    pub(crate) fn lt(self, other: Self) -> M8 {
        M8(from_fn(
            |k| if self.0[k] < other.0[k] { u32::MAX } else { 0 },
        ))
    }

    #[inline(always)]
    pub(crate) fn le(self, other: Self) -> M8 {
        M8(from_fn(
            |k| if self.0[k] <= other.0[k] { u32::MAX } else { 0 },
        ))
    }

    #[inline(always)]
    pub(crate) fn eq(self, other: Self) -> M8 {
        M8(from_fn(
            |k| if self.0[k] == other.0[k] { u32::MAX } else { 0 },
        ))
    }

    /// The smallest lane where `mask` is set, infinity where it is nowhere.
    #[inline(always)]
    pub(crate) fn smallest(self, mask: M8) -> f32 {
        let v = mask.select(self, Self::splat(f32::INFINITY)).0;
        let half: [f32; 4] = from_fn(|k| if v[k] < v[k + 4] { v[k] } else { v[k + 4] });
        let pair: [f32; 2] = from_fn(|k| {
            if half[k] < half[k + 2] {
                half[k]
            } else {
                half[k + 2]
            }
        });
        if pair[0] < pair[1] { pair[0] } else { pair[1] }
    }
}

impl M8 {
    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        self.0.iter().fold(0, |all, lane| all | lane) != 0
    }

    #[inline(always)]
    pub(crate) fn select(self, yes: F8, no: F8) -> F8 {
        F8(from_fn(|k| if self.0[k] != 0 { yes.0[k] } else { no.0[k] }))
    }

    #[inline(always)]
    pub(crate) fn select_u32(self, yes: [u32; LANES], no: [u32; LANES]) -> [u32; LANES] {
        from_fn(|k| if self.0[k] != 0 { yes[k] } else { no[k] })
    }
}

impl BitAnd for M8 {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(from_fn(|k| self.0[k] & other.0[k]))
    }
}

impl BitOr for M8 {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(from_fn(|k| self.0[k] | other.0[k]))
    }
}

impl Not for M8 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(self.0.map(|v| !v))
    }
}
