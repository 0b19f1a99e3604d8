//! Which vector instructions the kernels use. The choice changes speed only: results are the same bits.

use std::cell::Cell;

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum InstructionSet {
    /// Plain operations, vectors left to the compiler. There on every processor.
    Portable,
    /// Two vectors of four. There on every x86-64 processor.
    Sse2,
    /// One vector of eight.
    Avx2,
    /// One vector of eight, more registers and cheaper masks: AVX-512 with its F, VL, DQ and BW extensions.
    Avx512,
}

thread_local! {
    static LIMIT: Cell<InstructionSet> = const { Cell::new(InstructionSet::Avx512) };
}

impl InstructionSet {
    /// Every set.
    pub const ALL: [Self; 4] = [Self::Portable, Self::Sse2, Self::Avx2, Self::Avx512];

    /// The best set of this processor.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let has_avx2 = has!("avx2");
            let has_avx512 =
                has!("avx512f") && has!("avx512vl") && has!("avx512dq") && has!("avx512bw");
            if has_avx2 && has_avx512 {
                Self::Avx512
            } else if has_avx2 {
                Self::Avx2
            } else {
                Self::Sse2
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        Self::Portable
    }

    /// Whether this processor has the set.
    pub fn is_available(self) -> bool {
        self <= Self::best()
    }

    /// Lower-case name, for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Sse2 => "sse2",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The set that kernels on this thread use now.
    pub fn current() -> Self {
        LIMIT.get().min(Self::best())
    }

    /// Runs `work` with no better set than this one on the calling thread: for tests and benches.
    pub fn limit<T>(self, work: impl FnOnce() -> T) -> T {
        /// Puts the old limit back, whatever `work` does.
        struct Restore(InstructionSet);
        impl Drop for Restore {
            fn drop(&mut self) {
                LIMIT.set(self.0);
            }
        }
        let _restore = Restore(LIMIT.replace(self));
        work()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_end_with_their_scope() {
        let before = InstructionSet::current();
        assert!(before.is_available());
        InstructionSet::Portable.limit(|| {
            assert_eq!(InstructionSet::current(), InstructionSet::Portable);
            InstructionSet::Avx512.limit(|| assert_eq!(InstructionSet::current(), before));
            assert_eq!(InstructionSet::current(), InstructionSet::Portable);
        });
        assert_eq!(InstructionSet::current(), before);
    }
}
