//! Lanes in registers of AVX-512: eight to a register still, with twice the registers and truth values in registers of
//! their own.
#![expect(
    unsafe_code,
    reason = "intrinsics; see the rows of `facile bench trace` for what each set gains"
)]
#![allow(
    clippy::wildcard_imports,
    reason = "all of it is instructions; tests build without the lint"
)]

use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Not, Sub};

use super::x86::Avx2;
use super::{Eight, Kernel, LANES, LaneMask, Lanes};
use crate::InstructionSet;

/// Runs a kernel with AVX-512.
///
/// # Panics
/// If the processor has none.
pub(super) fn run_avx512<K: Kernel>(kernel: K) -> K::Output {
    assert!(
        InstructionSet::Avx512.is_available(),
        "the set was chosen because the processor has it"
    );
    // SAFETY: the processor has these extensions.
    unsafe { compiled_for_avx512(kernel) }
}

#[target_feature(enable = "avx2,avx512f,avx512vl,avx512dq,avx512bw")]
fn compiled_for_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx512>()
}

/// Eight numbers in one register. Only [`run_avx512`] gives this type to a kernel.
#[derive(Clone, Copy)]
pub(super) struct Avx512(__m256);

/// Eight truth values.
#[derive(Clone, Copy)]
pub(super) struct Mask(__mmask8);

macro_rules! operators {
    ($($trait:ident, $method:ident: $instruction:ident;)*) => {$(
        impl $trait for Avx512 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: values of this type occur only behind the check of `run_avx512`.
                Self(unsafe { $instruction(self.0, other.0) })
            }
        }
    )*};
}

operators! {
    Add, add: _mm256_add_ps;
    Sub, sub: _mm256_sub_ps;
    Mul, mul: _mm256_mul_ps;
    Div, div: _mm256_div_ps;
}

impl BitAnd for Mask {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOr for Mask {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Not for Mask {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self(!self.0)
    }
}

impl LaneMask for Mask {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        Self(bits as u8)
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        u32::from(self.0)
    }
}

/// Methods that are those of AVX2.
macro_rules! as_avx2 {
    ($($method:ident;)*) => {$(
        #[inline(always)]
        fn $method(self, other: Self) -> Self {
            Self(Avx2(self.0).$method(Avx2(other.0)).0)
        }
    )*};
}

impl Lanes for Avx512 {
    type Mask = Mask;

    as_avx2! {
        min;
        max;
    }

    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(Avx2::splat(v).0)
    }

    #[inline(always)]
    fn load(v: &Eight) -> Self {
        Self(Avx2::load(v).0)
    }

    #[inline(always)]
    fn store(self) -> Eight {
        Avx2(self.0).store()
    }

    #[inline(always)]
    fn load_from(v: &[f32]) -> Self {
        Self(Avx2::load_from(v).0)
    }

    #[inline(always)]
    fn store_to(self, v: &mut [f32]) {
        Avx2(self.0).store_to(v);
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(Avx2(self.0).sqrt().0)
    }

    #[inline(always)]
    fn to_i32(self) -> [i32; LANES] {
        Avx2(self.0).to_i32()
    }

    #[inline(always)]
    fn trunc(self) -> Self {
        Self(Avx2(self.0).trunc().0)
    }

    #[inline(always)]
    fn lt(self, other: Self) -> Mask {
        // SAFETY: values of this type occur only behind the check of `run_avx512`.
        Mask(unsafe { _mm256_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
    }

    #[inline(always)]
    fn le(self, other: Self) -> Mask {
        // SAFETY: as for `lt`.
        Mask(unsafe { _mm256_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) })
    }

    #[inline(always)]
    fn eq(self, other: Self) -> Mask {
        // SAFETY: as for `lt`.
        Mask(unsafe { _mm256_cmp_ps_mask::<_CMP_EQ_OQ>(self.0, other.0) })
    }

    #[inline(always)]
    fn prefetch<T>(v: &T) {
        Avx2::prefetch(v);
    }

    #[inline(always)]
    fn transpose(rows: [&[f32; LANES]; LANES]) -> [Self; LANES] {
        let [a, b, c, d, e, f, g, h] = Avx2::transpose(rows);
        [
            Self(a.0),
            Self(b.0),
            Self(c.0),
            Self(d.0),
            Self(e.0),
            Self(f.0),
            Self(g.0),
            Self(h.0),
        ]
    }

    #[inline(always)]
    fn select(mask: Mask, yes: Self, no: Self) -> Self {
        // SAFETY: as for `lt`.
        Self(unsafe { _mm256_mask_blend_ps(mask.0, no.0, yes.0) })
    }
}
