//! What rendering a scene file took.

use std::time::{Duration, Instant};

use serde::Serialize;

/// Time that the calling thread has had on a processor: what others run meanwhile does not count. Wall clock where the system
/// does not say.
#[derive(Clone, Copy, Debug)]
pub(super) struct ThreadClock {
    wall: Instant,
    on_processor: Option<Duration>,
}

impl ThreadClock {
    /// Starts now, on this thread.
    pub(super) fn start() -> Self {
        Self {
            on_processor: on_processor(),
            wall: Instant::now(),
        }
    }

    /// Time since the start, on the same thread.
    pub(super) fn elapsed(self) -> Duration {
        let wall = self.wall.elapsed();
        match (self.on_processor, on_processor()) {
            (Some(before), Some(now)) => now.saturating_sub(before),
            _ => wall,
        }
    }
}

/// As Linux counts it.
fn on_processor() -> Option<Duration> {
    // The count is brought up to date when threads may change
    std::thread::yield_now();
    let counts = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds = counts.split_ascii_whitespace().next()?.parse().ok()?;
    Some(Duration::from_nanos(nanoseconds)).filter(|d| !d.is_zero())
}

/// Median and spread of a step over frames, ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Half of the frames took less.
    pub median: f64,
    /// Fastest frame.
    pub min: f64,
    /// Slowest frame.
    pub max: f64,
}

impl Spread {
    /// Median, minimum and maximum of a list; zeros for an empty one.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (values.first(), values.last()) else {
            return Self::default();
        };
        let middle = values.len() / 2;
        let median = if values.len().is_multiple_of(2) {
            values[middle - 1].midpoint(values[middle])
        } else {
            values[middle]
        };
        Self { median, min, max }
    }
}

/// Milliseconds of every step, wall clock, one thread.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TimingReport {
    /// Frames rendered.
    pub frames: u32,
    /// Triangles in the scene.
    pub triangles: usize,
    /// Reading meshes and textures.
    pub load_ms: f64,
    /// Building the trees.
    pub build_ms: f64,
    /// Moving vertices and refitting, per frame; zeros without `jitter_mm`.
    pub refit_ms: Spread,
    /// Primary rays and label maps, per frame.
    pub primary_ms: Spread,
    /// Shadow rays, per frame.
    pub shadow_ms: Spread,
    /// Shading without shadow rays, mirror and refraction rays included, per frame.
    pub shade_ms: Spread,
    /// Further samples of uneven pixels, and the mean of samples, per frame.
    pub resolve_ms: Spread,
    /// Encoding the colour image as PNG, per frame.
    pub encode_ms: Spread,
    /// Refit to resolve, per frame.
    pub frame_ms: Spread,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_medians() {
        let odd = Spread::of(vec![3.0, 1.0, 2.0]);
        let expected = Spread {
            median: 2.0,
            min: 1.0,
            max: 3.0,
        };
        assert_eq!(odd, expected);
        let even = Spread::of(vec![4.0, 1.0, 2.0, 3.0]);
        let expected = Spread {
            median: 2.5,
            min: 1.0,
            max: 4.0,
        };
        assert_eq!(even, expected);
        assert_eq!(Spread::of(Vec::new()), Spread::default());
    }
}
