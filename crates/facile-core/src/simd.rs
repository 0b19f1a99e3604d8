//! One copy of a kernel for every processor, one for those with AVX2, one for those with AVX-512, the same bits from all.
//!
//! Kernels are plain Rust over small arrays of lanes or plain rows; the compiler turns them into registers of whatever width
//! is allowed. The wide sets are enabled without FMA and nothing reassociates, so every operation rounds the same way on
//! all paths. Closures inside a kernel stay compiled for the baseline: write loops.

#![expect(
    unsafe_code,
    reason = "a function with a target feature can only be called so; factoring and solving take 1.7 times as long without it"
)]

/// Work that may run with wide registers. `run` must be `#[inline(always)]`, or it stays compiled for the baseline.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Runs a kernel with the widest registers of this processor.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f") {
        // SAFETY: the processor has AVX-512, as just checked.
        return unsafe { with_avx512(kernel) };
    }
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2, as just checked.
        return unsafe { with_avx2(kernel) };
    }
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn with_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}
