//! Eight `f32` at a time, by the processor's best instructions.
//!
//! A [`Kernel`] is written once over [`Lanes`] and [`run`] picks the instructions. Every operation is one IEEE operation
//! per lane, never fused, so all sets give the same bits. Inside a kernel everything is `inline(always)` and lanes do not
//! go through closures: what is not inlined is compiled without the vector instructions.

#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;
mod vector;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Not, Sub};

pub(crate) use portable::Portable;
pub(crate) use vector::V3;

/// Rays in a packet, pixels in a block.
pub(crate) const LANES: usize = 8;

/// Eight numbers, lane 0 first.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Eight(pub(crate) [f32; LANES]);

/// Eight numbers in registers.
pub(crate) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Eight truth values.
    type Mask: LaneMask;

    fn splat(v: f32) -> Self;
    fn load(v: &Eight) -> Self;
    fn store(self) -> Eight;
    /// The first eight of a slice, which has as many.
    fn load_from(v: &[f32]) -> Self;
    /// Writes the first eight of a slice, which has as many.
    fn store_to(self, v: &mut [f32]);
    /// The smaller of each lane; `other` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger of each lane; `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    fn sqrt(self) -> Self;
    /// Without the fraction, for lanes within `i32`.
    fn to_i32(self) -> [i32; LANES];
    /// The number without its fraction, for lanes within `i32`.
    fn trunc(self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    fn eq(self, other: Self) -> Self::Mask;
    /// Asks for a value that is wanted soon.
    #[inline(always)]
    fn prefetch<T>(_: &T) {}
    /// Number `k` of row `j` becomes lane `j` of vector `k`.
    fn transpose(rows: [&[f32; LANES]; LANES]) -> [Self; LANES];
    /// `yes` where the mask is set, `no` elsewhere: bits are moved, so a lane may hold any.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
}

/// Eight truth values in registers.
pub(crate) trait LaneMask:
    Copy + BitAnd<Output = Self> + BitOr<Output = Self> + Not<Output = Self>
{
    /// Bit `k` is lane `k`.
    fn from_bits(bits: u32) -> Self;
    /// Bit `k` is lane `k`; the bits from 8 on are 0.
    fn bits(self) -> u32;

    #[inline(always)]
    fn any(self) -> bool {
        self.bits() != 0
    }
}

/// Work that is the same for every instruction set.
pub(crate) trait Kernel {
    type Output;
    /// To be marked `inline(always)`.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Runs a kernel with the instructions of [`crate::InstructionSet::current`].
#[cfg(target_arch = "x86_64")]
pub(crate) fn run<K: Kernel>(kernel: K) -> K::Output {
    use crate::InstructionSet;
    match InstructionSet::current() {
        InstructionSet::Avx512 => avx512::run_avx512(kernel),
        InstructionSet::Avx2 => x86::run_avx2(kernel),
        InstructionSet::Sse2 => kernel.run::<x86::Sse2>(),
        InstructionSet::Portable => kernel.run::<Portable>(),
    }
}

/// Runs a kernel with the instructions of [`crate::InstructionSet::current`].
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Portable>()
}

/// The lanes of a set of bits, lowest first.
#[inline(always)]
pub(crate) fn lanes_of(bits: u32) -> impl Iterator<Item = usize> {
    let mut rest = bits;
    std::iter::from_fn(move || {
        (rest != 0).then(|| {
            let lane = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            lane
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::InstructionSet;

    /// Every operation on two vectors, as bits.
    struct Everything(Eight, Eight);

    impl Kernel for Everything {
        type Output = Vec<u32>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u32> {
            let (a, b) = (L::load(&self.0), L::load(&self.1));
            let (lt, le, eq) = (a.lt(b), a.le(b), a.eq(b));
            let numbers = [
                a + b,
                a - b,
                a * b,
                a / b,
                a.min(b),
                a.max(b),
                a.sqrt(),
                a.max(L::splat(-9.5)).min(L::splat(1e9)).trunc(),
                L::select(lt, a, b),
                L::select(L::Mask::from_bits(0b1010_0110), L::splat(7.0), b),
            ];
            let whole = b.max(L::splat(-9.5)).min(L::splat(1e9)).to_i32();
            let masks = [lt, le, eq, lt & le, le | eq, !lt, L::Mask::from_bits(0xC5)];
            let mut bits: Vec<u32> = whole.map(|v| v as u32).into();
            let rows: [[f32; LANES]; LANES] =
                std::array::from_fn(|j| std::array::from_fn(|k| (10 * j + k) as f32));
            for v in L::transpose(rows.each_ref()) {
                bits.extend(v.store().0.map(f32::to_bits));
            }
            for v in numbers {
                bits.extend(v.store().0.map(|v| {
                    // Which NaN comes out is nobody's promise
                    if v.is_nan() { f32::NAN } else { v }.to_bits()
                }));
            }
            for mask in masks {
                bits.push(mask.bits());
                bits.push(u32::from(mask.any()));
            }
            bits
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let tricky = [
            0.0,
            -0.0,
            1.0,
            f32::NAN,
            f32::INFINITY,
            1e-40,
            -3.25,
            f32::MAX,
        ];
        for shift in 0..LANES {
            let a = Eight(tricky);
            let b = Eight(std::array::from_fn(|k| tricky[(k + shift) % LANES]));
            let expected = Everything(a, b).run::<Portable>();
            for set in InstructionSet::ALL.into_iter().filter(|s| s.is_available()) {
                let found = set.limit(|| run(Everything(a, b)));
                assert_eq!(found, expected, "{set:?}, shift {shift}");
            }
        }
    }

    #[test]
    fn bits_name_their_lanes() {
        assert_eq!(lanes_of(0b1000_0101).collect::<Vec<_>>(), [0, 2, 7]);
        assert_eq!(lanes_of(0).count(), 0);
    }
}
