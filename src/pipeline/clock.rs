//! Where a run's time goes: seconds of all threads by stage.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// A stage of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Subjects registered, read from the cache, or drawn, with what moves them.
    People,
    /// Equilibria solved for, or read from the cache.
    Equilibria,
    /// Faces brought into their scenes, with occluders.
    Scenes,
    /// Primary rays.
    Tracing,
    /// Landmarks, boxes, maps.
    Truth,
    /// Light, shadows, anti-aliasing.
    Shading,
    /// Files in memory: images, maps, records.
    Encoding,
    /// Files on disk, with their hashes, and waiting for their turn.
    Writing,
}

impl Work {
    /// Every stage, in the order of the work, with its name.
    pub const ALL: [(Self, &'static str); 8] = [
        (Self::People, "people"),
        (Self::Equilibria, "equilibria"),
        (Self::Scenes, "scenes"),
        (Self::Tracing, "tracing"),
        (Self::Truth, "truth"),
        (Self::Shading, "shading"),
        (Self::Encoding, "encoding"),
        (Self::Writing, "writing"),
    ];
}

/// Adds up the time of each stage, from any thread.
#[derive(Debug, Default)]
pub struct Clock {
    nanoseconds: [AtomicU64; Work::ALL.len()],
    times: [AtomicU64; Work::ALL.len()],
}

impl Clock {
    /// Does some work and counts its time.
    pub fn time<T>(&self, work: Work, f: impl FnOnce() -> T) -> T {
        let begun = Instant::now();
        let result = f();
        let passed = begun.elapsed().as_nanos() as u64;
        self.nanoseconds[work as usize].fetch_add(passed, Ordering::Relaxed);
        self.times[work as usize].fetch_add(1, Ordering::Relaxed);
        result
    }

    /// Nanoseconds of a stage, and how often it was done.
    pub fn get(&self, work: Work) -> [u64; 2] {
        let of = |list: &[AtomicU64; Work::ALL.len()]| list[work as usize].load(Ordering::Relaxed);
        [of(&self.nanoseconds), of(&self.times)]
    }
}
