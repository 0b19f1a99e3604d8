//! Lanes in plain Rust: the oracle of the others, and the way on processors without them.

use std::array::from_fn;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Not, Sub};

use super::{Eight, LANES, LaneMask, Lanes};

/// Eight numbers as an array.
#[derive(Clone, Copy)]
pub(crate) struct Portable([f32; LANES]);

/// Eight truth values as an array.
#[derive(Clone, Copy)]
pub(crate) struct PortableMask([bool; LANES]);

macro_rules! lanewise {
    ($type:ty, $trait:ident, $method:ident, $op:tt) => {
        impl $trait for $type {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(from_fn(|k| self.0[k] $op other.0[k]))
            }
        }
    };
}

lanewise!(Portable, Add, add, +);
lanewise!(Portable, Sub, sub, -);
lanewise!(Portable, Mul, mul, *);
lanewise!(Portable, Div, div, /);
lanewise!(PortableMask, BitAnd, bitand, &);
lanewise!(PortableMask, BitOr, bitor, |);

impl Not for PortableMask {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(self.0.map(|v| !v))
    }
}

impl Lanes for Portable {
    type Mask = PortableMask;

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self([v; LANES])
    }

    #[inline(always)]
    fn load(v: &Eight) -> Self {
        Self(v.0)
    }

    #[inline(always)]
    fn store(self) -> Eight {
        Eight(self.0)
    }

    #[inline(always)]
    fn load_from(v: &[f32]) -> Self {
        Self(from_fn(|k| v[..LANES][k]))
    }

    #[inline(always)]
    fn store_to(self, v: &mut [f32]) {
        v[..LANES].copy_from_slice(&self.0);
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(self.lt(other), self, other)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(other.lt(self), self, other)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }

    #[inline(always)]
    fn to_i32(self) -> [i32; LANES] {
        self.0.map(|v| v as i32)
    }

    #[inline(always)]
    fn trunc(self) -> Self {
        Self(self.0.map(|v| v as i32 as f32))
    }

    #[inline(always)]
    fn lt(self, other: Self) -> PortableMask {
        PortableMask(from_fn(|k| self.0[k] < other.0[k]))
    }

    #[inline(always)]
    fn le(self, other: Self) -> PortableMask {
        PortableMask(from_fn(|k| self.0[k] <= other.0[k]))
    }

    #[inline(always)]
    fn eq(self, other: Self) -> PortableMask {
        PortableMask(from_fn(|k| self.0[k] == other.0[k]))
    }

    #[inline(always)]
    fn transpose(rows: [&[f32; LANES]; LANES]) -> [Self; LANES] {
        from_fn(|k| Self(from_fn(|j| rows[j][k])))
    }

    #[inline(always)]
    fn select(mask: PortableMask, yes: Self, no: Self) -> Self {
        Self(from_fn(|k| if mask.0[k] { yes.0[k] } else { no.0[k] }))
    }
}

impl LaneMask for PortableMask {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        Self(from_fn(|k| bits >> k & 1 == 1))
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        (0..LANES).fold(0, |bits, k| bits | u32::from(self.0[k]) << k)
    }
}
