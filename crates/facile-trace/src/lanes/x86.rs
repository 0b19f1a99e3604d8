//! Lanes in the registers of x86-64: one AVX2 register, or two of SSE2.
#![expect(
    unsafe_code,
    reason = "intrinsics; frame_256 of the bench `trace` takes twice as long with plain arrays"
)]
#![allow(
    clippy::wildcard_imports,
    reason = "all of it is instructions; tests build without the lint"
)]

use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Not, Sub};

use super::{Eight, Kernel, LANES, LaneMask, Lanes};

/// Runs a kernel with AVX2.
///
/// # Panics
/// If the processor has no AVX2.
pub(super) fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    assert!(
        std::arch::is_x86_feature_detected!("avx2"),
        "the set was chosen because the processor has it"
    );
    // SAFETY: the processor has AVX2.
    unsafe { compiled_for_avx2(kernel) }
}

#[target_feature(enable = "avx2")]
fn compiled_for_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2>()
}

/// Eight numbers in one register. Only [`run_avx2`] gives this type to a kernel.
#[derive(Clone, Copy)]
pub(super) struct Avx2(pub(super) __m256);

/// Eight numbers in two registers.
#[derive(Clone, Copy)]
pub(super) struct Sse2(__m128, __m128);

macro_rules! operators {
    ($($trait:ident, $method:ident: $wide:ident, $narrow:ident;)*) => {$(
        impl $trait for Avx2 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: values of this type occur only behind the check of `run_avx2`.
                Self(unsafe { $wide(self.0, other.0) })
            }
        }
        impl $trait for Sse2 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: every x86-64 processor has SSE2.
                unsafe { Self($narrow(self.0, other.0), $narrow(self.1, other.1)) }
            }
        }
    )*};
}

operators! {
    Add, add: _mm256_add_ps, _mm_add_ps;
    Sub, sub: _mm256_sub_ps, _mm_sub_ps;
    Mul, mul: _mm256_mul_ps, _mm_mul_ps;
    Div, div: _mm256_div_ps, _mm_div_ps;
    BitAnd, bitand: _mm256_and_ps, _mm_and_ps;
    BitOr, bitor: _mm256_or_ps, _mm_or_ps;
}

impl Not for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        // SAFETY: values of this type occur only behind the check of `run_avx2`.
        unsafe {
            Self(_mm256_xor_ps(
                self.0,
                _mm256_castsi256_ps(_mm256_set1_epi32(-1)),
            ))
        }
    }
}

impl Not for Sse2 {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        // SAFETY: every x86-64 processor has SSE2.
        unsafe {
            let ones = _mm_castsi128_ps(_mm_set1_epi32(-1));
            Self(_mm_xor_ps(self.0, ones), _mm_xor_ps(self.1, ones))
        }
    }
}

macro_rules! two_to_one {
    ($($method:ident: $wide:expr, $narrow:ident;)*) => {
        impl Avx2 {$(
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: values of this type occur only behind the check of `run_avx2`.
                Self(unsafe { $wide(self.0, other.0) })
            }
        )*}
        impl Sse2 {$(
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: every x86-64 processor has SSE2.
                unsafe { Self($narrow(self.0, other.0), $narrow(self.1, other.1)) }
            }
        )*}
    };
}

two_to_one! {
    smaller: _mm256_min_ps, _mm_min_ps;
    larger: _mm256_max_ps, _mm_max_ps;
    less: _mm256_cmp_ps::<_CMP_LT_OQ>, _mm_cmplt_ps;
    at_most: _mm256_cmp_ps::<_CMP_LE_OQ>, _mm_cmple_ps;
    equal: _mm256_cmp_ps::<_CMP_EQ_OQ>, _mm_cmpeq_ps;
}

macro_rules! shared_methods {
    () => {
        type Mask = Self;

        #[inline(always)]
        fn min(self, other: Self) -> Self {
            self.smaller(other)
        }

        #[inline(always)]
        fn max(self, other: Self) -> Self {
            self.larger(other)
        }

        #[inline(always)]
        fn lt(self, other: Self) -> Self {
            self.less(other)
        }

        #[inline(always)]
        fn le(self, other: Self) -> Self {
            self.at_most(other)
        }

        #[inline(always)]
        fn eq(self, other: Self) -> Self {
            self.equal(other)
        }
    };
}

impl Lanes for Avx2 {
    shared_methods!();

    #[inline(always)]
    fn splat(v: f32) -> Self {
        // SAFETY: only kernels that `run_avx2` runs make values of this type.
        Self(unsafe { _mm256_set1_ps(v) })
    }

    #[inline(always)]
    fn load(v: &Eight) -> Self {
        // SAFETY: as for `splat`; `Eight` holds eight numbers and is aligned to 32 bytes.
        Self(unsafe { _mm256_load_ps(v.0.as_ptr()) })
    }

    #[inline(always)]
    fn store(self) -> Eight {
        let mut out = Eight::default();
        // SAFETY: as for `splat`; `Eight` holds eight numbers and is aligned to 32 bytes.
        unsafe { _mm256_store_ps(out.0.as_mut_ptr(), self.0) };
        out
    }

    #[inline(always)]
    fn load_from(v: &[f32]) -> Self {
        let v = &v[..LANES];
        // SAFETY: as for `splat`; the slice holds eight numbers.
        Self(unsafe { _mm256_loadu_ps(v.as_ptr()) })
    }

    #[inline(always)]
    fn store_to(self, v: &mut [f32]) {
        let v = &mut v[..LANES];
        // SAFETY: as for `splat`; the slice holds eight numbers.
        unsafe { _mm256_storeu_ps(v.as_mut_ptr(), self.0) };
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: values of this type occur only behind the check of `run_avx2`.
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn to_i32(self) -> [i32; LANES] {
        let mut out = [0; LANES];
        // SAFETY: as for `splat`; `out` holds the eight numbers of an unaligned store.
        unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), _mm256_cvttps_epi32(self.0)) };
        out
    }

    #[inline(always)]
    fn trunc(self) -> Self {
        // SAFETY: values of this type occur only behind the check of `run_avx2`.
        Self(unsafe { _mm256_cvtepi32_ps(_mm256_cvttps_epi32(self.0)) })
    }

    #[inline(always)]
    fn prefetch<T>(v: &T) {
        // SAFETY: every x86-64 processor has SSE; a prefetch touches no memory that the program can see.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(v).cast()) }
    }

    #[inline(always)]
    fn transpose(rows: [&[f32; LANES]; LANES]) -> [Self; LANES] {
        // SAFETY: as for `splat`; every row holds eight numbers.
        unsafe {
            let [a, b, c, d, e, f, g, h] = [
                _mm256_loadu_ps(rows[0].as_ptr()),
                _mm256_loadu_ps(rows[1].as_ptr()),
                _mm256_loadu_ps(rows[2].as_ptr()),
                _mm256_loadu_ps(rows[3].as_ptr()),
                _mm256_loadu_ps(rows[4].as_ptr()),
                _mm256_loadu_ps(rows[5].as_ptr()),
                _mm256_loadu_ps(rows[6].as_ptr()),
                _mm256_loadu_ps(rows[7].as_ptr()),
            ];
            // Transpose each half of four rows, then put the halves together
            let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
            let (ef, gh) = (_mm256_unpacklo_ps(e, f), _mm256_unpacklo_ps(g, h));
            let (first, first_low) = (
                _mm256_shuffle_ps::<0x44>(ab, cd),
                _mm256_shuffle_ps::<0x44>(ef, gh),
            );
            let (second, second_low) = (
                _mm256_shuffle_ps::<0xEE>(ab, cd),
                _mm256_shuffle_ps::<0xEE>(ef, gh),
            );
            let (ab, cd) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
            let (ef, gh) = (_mm256_unpackhi_ps(e, f), _mm256_unpackhi_ps(g, h));
            let (third, third_low) = (
                _mm256_shuffle_ps::<0x44>(ab, cd),
                _mm256_shuffle_ps::<0x44>(ef, gh),
            );
            let (fourth, fourth_low) = (
                _mm256_shuffle_ps::<0xEE>(ab, cd),
                _mm256_shuffle_ps::<0xEE>(ef, gh),
            );
            [
                Self(_mm256_permute2f128_ps::<0x20>(first, first_low)),
                Self(_mm256_permute2f128_ps::<0x20>(second, second_low)),
                Self(_mm256_permute2f128_ps::<0x20>(third, third_low)),
                Self(_mm256_permute2f128_ps::<0x20>(fourth, fourth_low)),
                Self(_mm256_permute2f128_ps::<0x31>(first, first_low)),
                Self(_mm256_permute2f128_ps::<0x31>(second, second_low)),
                Self(_mm256_permute2f128_ps::<0x31>(third, third_low)),
                Self(_mm256_permute2f128_ps::<0x31>(fourth, fourth_low)),
            ]
        }
    }

    #[inline(always)]
    fn select(mask: Self, yes: Self, no: Self) -> Self {
        // SAFETY: values of this type occur only behind the check of `run_avx2`.
        Self(unsafe { _mm256_blendv_ps(no.0, yes.0, mask.0) })
    }
}

impl LaneMask for Avx2 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        // SAFETY: only kernels that `run_avx2` runs make values of this type.
        unsafe {
            let lane = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let own = _mm256_and_si256(_mm256_set1_epi32(bits as i32), lane);
            Self(_mm256_castsi256_ps(_mm256_cmpeq_epi32(own, lane)))
        }
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        // SAFETY: values of this type occur only behind the check of `run_avx2`.
        unsafe { _mm256_movemask_ps(self.0) as u32 }
    }
}

impl Lanes for Sse2 {
    shared_methods!();

    #[inline(always)]
    fn splat(v: f32) -> Self {
        // SAFETY: every x86-64 processor has SSE2.
        let half = unsafe { _mm_set1_ps(v) };
        Self(half, half)
    }

    #[inline(always)]
    fn load(v: &Eight) -> Self {
        // SAFETY: `Eight` holds eight numbers and is aligned to 32 bytes.
        unsafe { Self(_mm_load_ps(v.0.as_ptr()), _mm_load_ps(v.0.as_ptr().add(4))) }
    }

    #[inline(always)]
    fn store(self) -> Eight {
        let mut out = Eight::default();
        // SAFETY: `Eight` holds eight numbers and is aligned to 32 bytes.
        unsafe {
            _mm_store_ps(out.0.as_mut_ptr(), self.0);
            _mm_store_ps(out.0.as_mut_ptr().add(4), self.1);
        }
        out
    }

    #[inline(always)]
    fn load_from(v: &[f32]) -> Self {
        let v = &v[..LANES];
        // SAFETY: the slice holds eight numbers.
        unsafe { Self(_mm_loadu_ps(v.as_ptr()), _mm_loadu_ps(v.as_ptr().add(4))) }
    }

    #[inline(always)]
    fn store_to(self, v: &mut [f32]) {
        let v = &mut v[..LANES];
        // SAFETY: the slice holds eight numbers.
        unsafe {
            _mm_storeu_ps(v.as_mut_ptr(), self.0);
            _mm_storeu_ps(v.as_mut_ptr().add(4), self.1);
        }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: every x86-64 processor has SSE2.
        unsafe { Self(_mm_sqrt_ps(self.0), _mm_sqrt_ps(self.1)) }
    }

    #[inline(always)]
    fn to_i32(self) -> [i32; LANES] {
        let mut out = [0_i32; LANES];
        // SAFETY: `out` holds the eight numbers of two unaligned stores.
        unsafe {
            _mm_storeu_si128(out.as_mut_ptr().cast(), _mm_cvttps_epi32(self.0));
            _mm_storeu_si128(out.as_mut_ptr().add(4).cast(), _mm_cvttps_epi32(self.1));
        }
        out
    }

    #[inline(always)]
    fn trunc(self) -> Self {
        // SAFETY: every x86-64 processor has SSE2.
        unsafe {
            Self(
                _mm_cvtepi32_ps(_mm_cvttps_epi32(self.0)),
                _mm_cvtepi32_ps(_mm_cvttps_epi32(self.1)),
            )
        }
    }

    #[inline(always)]
    fn prefetch<T>(v: &T) {
        // SAFETY: every x86-64 processor has SSE; a prefetch touches no memory that the program can see.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(v).cast()) }
    }

    #[inline(always)]
    fn transpose(rows: [&[f32; LANES]; LANES]) -> [Self; LANES] {
        let [a, b, c, d] = [
            transposed_quarter([rows[0], rows[1], rows[2], rows[3]], 0),
            transposed_quarter([rows[4], rows[5], rows[6], rows[7]], 0),
            transposed_quarter([rows[0], rows[1], rows[2], rows[3]], 4),
            transposed_quarter([rows[4], rows[5], rows[6], rows[7]], 4),
        ];
        [
            Self(a[0], b[0]),
            Self(a[1], b[1]),
            Self(a[2], b[2]),
            Self(a[3], b[3]),
            Self(c[0], d[0]),
            Self(c[1], d[1]),
            Self(c[2], d[2]),
            Self(c[3], d[3]),
        ]
    }

    #[inline(always)]
    fn select(mask: Self, yes: Self, no: Self) -> Self {
        // SAFETY: every x86-64 processor has SSE2.
        unsafe {
            Self(
                _mm_or_ps(_mm_and_ps(mask.0, yes.0), _mm_andnot_ps(mask.0, no.0)),
                _mm_or_ps(_mm_and_ps(mask.1, yes.1), _mm_andnot_ps(mask.1, no.1)),
            )
        }
    }
}

/// Numbers `from..from + 4` of four rows, transposed.
#[inline(always)]
fn transposed_quarter(rows: [&[f32; LANES]; 4], from: usize) -> [__m128; 4] {
    let rows = rows.map(|row| &row[from..from + 4]);
    // SAFETY: every x86-64 processor has SSE2; every row holds four numbers.
    unsafe {
        let (a, b) = (
            _mm_loadu_ps(rows[0].as_ptr()),
            _mm_loadu_ps(rows[1].as_ptr()),
        );
        let (c, d) = (
            _mm_loadu_ps(rows[2].as_ptr()),
            _mm_loadu_ps(rows[3].as_ptr()),
        );
        let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
        let (ab_high, cd_high) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
        [
            _mm_movelh_ps(ab, cd),
            _mm_movehl_ps(cd, ab),
            _mm_movelh_ps(ab_high, cd_high),
            _mm_movehl_ps(cd_high, ab_high),
        ]
    }
}

impl LaneMask for Sse2 {
    #[inline(always)]
    fn from_bits(bits: u32) -> Self {
        // SAFETY: every x86-64 processor has SSE2.
        unsafe {
            let half = |lane: __m128i| {
                let own = _mm_and_si128(_mm_set1_epi32(bits as i32), lane);
                _mm_castsi128_ps(_mm_cmpeq_epi32(own, lane))
            };
            Self(
                half(_mm_setr_epi32(1, 2, 4, 8)),
                half(_mm_setr_epi32(16, 32, 64, 128)),
            )
        }
    }

    #[inline(always)]
    fn bits(self) -> u32 {
        // SAFETY: every x86-64 processor has SSE2.
        unsafe { (_mm_movemask_ps(self.0) | _mm_movemask_ps(self.1) << 4) as u32 }
    }
}
