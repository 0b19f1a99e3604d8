//! The centre line of a muscle in space: a smooth curve with a frame that turns continuously.
//!
//! Section 4.2 contracts a vertex "in the segment reference system" of a polyline, which jumps where the vertex crosses a
//! joint. Here the line is a natural cubic spline, sampled densely, with rotation-minimising frames (Wang et al.,
//! Computation of rotation minimizing frames, 2008), so that the contracted place is continuous in the contraction.

use crate::vector::{
    M3, V3, add, add_scaled, cross, dot, norm, rotate, rotate_back, scale, sub, unit,
};

/// Distance of samples on the line, mm.
const STEP_MM: f64 = 0.75;

/// A curve with frames.
#[derive(Clone, Debug)]
pub(crate) struct Path {
    points: Vec<V3>,
    /// Rows: tangent, normal, binormal.
    frames: Vec<M3>,
    /// Arc length up to each sample, divided by the whole length.
    fraction: Vec<f64>,
    length: f64,
}

/// A point in the frame of its nearest place on the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Local {
    /// Normalised arc length `a` in `[0, 1]` of the nearest place, eq. 5.
    pub(crate) fraction: f64,
    /// Offset from that place, in its frame, mm.
    pub(crate) offset: V3,
    /// Distance to the line, mm.
    pub(crate) distance: f64,
}

impl Path {
    /// The line through at least 2 points, mm. `None` if its length is zero.
    pub(crate) fn through(knots: &[V3]) -> Option<Self> {
        let points = sample_spline(knots)?;
        let mut arc = vec![0.0];
        for w in points.windows(2) {
            arc.push(arc[arc.len() - 1] + norm(sub(w[1], w[0])));
        }
        let length = arc[arc.len() - 1];
        if !length.is_finite() || length < 1e-6 {
            return None;
        }
        let fraction = arc.iter().map(|s| s / length).collect();
        let frames = rotation_minimising(&points);
        Some(Self {
            points,
            frames,
            fraction,
            length,
        })
    }

    /// Length of the line, mm.
    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    /// The nearest place on the line, and the point in its frame. Cost O(samples).
    pub(crate) fn project(&self, p: V3) -> Local {
        let mut best = (f64::INFINITY, 0.0);
        for (k, w) in self.points.windows(2).enumerate() {
            let edge = sub(w[1], w[0]);
            let t = (dot(sub(p, w[0]), edge) / dot(edge, edge)).clamp(0.0, 1.0);
            let away = sub(p, add_scaled(w[0], edge, t));
            let distance = dot(away, away);
            if distance < best.0 {
                let (a, b) = (self.fraction[k], self.fraction[k + 1]);
                best = (distance, a + t * (b - a));
            }
        }
        let (origin, frame) = self.at(best.1);
        Local {
            fraction: best.1,
            offset: rotate(&frame, sub(p, origin)),
            distance: best.0.sqrt(),
        }
    }

    /// Where a point lands that keeps its offset and moves to another place on the line.
    pub(crate) fn place(&self, fraction: f64, offset: V3) -> V3 {
        let (origin, frame) = self.at(fraction);
        add(origin, rotate_back(&frame, offset))
    }

    /// Position and frame at a normalised arc length; linear between samples, axes made orthonormal.
    fn at(&self, fraction: f64) -> (V3, M3) {
        let last = self.fraction.len() - 2;
        let k = self
            .fraction
            .partition_point(|&f| f <= fraction)
            .saturating_sub(1)
            .min(last);
        let (a, b) = (self.fraction[k], self.fraction[k + 1]);
        let t = ((fraction - a) / (b - a)).clamp(0.0, 1.0);
        let mix = |u: V3, v: V3| add_scaled(scale(u, 1.0 - t), v, t);
        let tangent = unit(mix(self.frames[k][0], self.frames[k + 1][0]));
        let normal = mix(self.frames[k][1], self.frames[k + 1][1]);
        let normal = unit(add_scaled(normal, tangent, -dot(normal, tangent)));
        let origin = mix(self.points[k], self.points[k + 1]);
        (origin, [tangent, normal, cross(tangent, normal)])
    }
}

/// Samples of the natural cubic spline over chord length through `knots`.
fn sample_spline(knots: &[V3]) -> Option<Vec<V3>> {
    let n = knots.len();
    if n < 2 {
        return None;
    }
    let chords: Vec<f64> = knots.windows(2).map(|w| norm(sub(w[1], w[0]))).collect();
    if chords.iter().any(|&h| h < 1e-9 || !h.is_finite()) {
        return None;
    }
    let second = natural_second_derivatives(knots, &chords);
    let mut points = vec![knots[0]];
    for k in 0..n - 1 {
        let h = chords[k];
        let steps = (h / STEP_MM).ceil().max(1.0) as usize;
        for s in 1..=steps {
            let b = s as f64 / steps as f64;
            let a = 1.0 - b;
            let cubic = h * h / 6.0;
            let mut p = add_scaled(scale(knots[k], a), knots[k + 1], b);
            p = add_scaled(p, second[k], (a * a * a - a) * cubic);
            p = add_scaled(p, second[k + 1], (b * b * b - b) * cubic);
            points.push(p);
        }
    }
    Some(points)
}

/// Second derivatives of the natural cubic spline at its knots: a tridiagonal solve.
fn natural_second_derivatives(knots: &[V3], chords: &[f64]) -> Vec<V3> {
    let n = knots.len();
    let mut second = vec![[0.0; 3]; n];
    let mut upper = vec![0.0; n];
    for k in 1..n - 1 {
        let (left, right) = (chords[k - 1], chords[k]);
        let slope_right = scale(sub(knots[k + 1], knots[k]), 6.0 / right);
        let slope_left = scale(sub(knots[k], knots[k - 1]), 6.0 / left);
        let pivot = 2.0 * (left + right) - left * upper[k - 1];
        upper[k] = right / pivot;
        let rhs = add_scaled(sub(slope_right, slope_left), second[k - 1], -left);
        second[k] = scale(rhs, 1.0 / pivot);
    }
    for k in (1..n - 1).rev() {
        second[k] = add_scaled(second[k], second[k + 1], -upper[k]);
    }
    second
}

fn rotation_minimising(points: &[V3]) -> Vec<M3> {
    let n = points.len();
    let tangent = |k: usize| unit(sub(points[(k + 1).min(n - 1)], points[k.saturating_sub(1)]));
    let t0 = tangent(0);
    let axis = if t0[1].abs() < 0.9 {
        [0.0, 1.0, 0.0]
    } else {
        [1.0, 0.0, 0.0]
    };
    let mut frames = Vec::with_capacity(n);
    let mut normal = unit(add_scaled(axis, t0, -dot(axis, t0)));
    frames.push([t0, normal, cross(t0, normal)]);
    for k in 1..n {
        // Double reflection: first in the bisecting plane of the two samples, then onto the new tangent.
        let v = sub(points[k], points[k - 1]);
        let reflect = |u: V3, v: V3| add_scaled(u, v, -2.0 * dot(u, v) / dot(v, v));
        let (t, r) = (reflect(frames[k - 1][0], v), reflect(normal, v));
        let t1 = tangent(k);
        let w = sub(t1, t);
        normal = if dot(w, w) < 1e-24 { r } else { reflect(r, w) };
        normal = unit(add_scaled(normal, t1, -dot(normal, t1)));
        frames.push([t1, normal, cross(t1, normal)]);
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn arc() -> Path {
        let knots: Vec<V3> = (0..9)
            .map(|k| {
                let t = f64::from(k) * 0.25;
                [30.0 * libm::cos(t), 30.0 * libm::sin(t), 2.0 * t]
            })
            .collect();
        Path::through(&knots).expect("has a length")
    }

    #[test]
    fn a_straight_line_scales_towards_its_origin() {
        let path = Path::through(&[[0.0; 3], [10.0, 0.0, 0.0]]).expect("has a length");
        let local = path.project([6.0, 2.0, 1.0]);
        assert_relative_eq!(local.fraction, 0.6, epsilon = 1e-12);
        assert_relative_eq!(local.distance, 5f64.sqrt(), epsilon = 1e-12);
        let moved = path.place(0.5 * local.fraction, local.offset);
        for (got, want) in moved.iter().zip([3.0, 2.0, 1.0]) {
            assert_relative_eq!(*got, want, epsilon = 1e-12);
        }
    }

    #[test]
    fn the_length_of_an_arc_is_right() {
        let helix = (30f64 * 30.0 + 4.0).sqrt() * 2.0;
        assert_relative_eq!(arc().length(), helix, max_relative = 2e-3);
    }

    #[test]
    fn a_point_returns_to_where_it_was() {
        let path = arc();
        for p in [[28.0, 8.0, 3.0], [40.0, -3.0, 0.0], [-10.0, 31.0, 2.0]] {
            let local = path.project(p);
            let back = path.place(local.fraction, local.offset);
            assert!(norm(sub(back, p)) < 1e-12);
        }
    }

    #[test]
    fn the_place_is_continuous_along_the_line() {
        let path = arc();
        let mut before = path.place(0.0, [0.0, 4.0, 3.0]);
        for k in 1..=1000 {
            let now = path.place(f64::from(k) / 1000.0, [0.0, 4.0, 3.0]);
            assert!(norm(sub(now, before)) < 1.5 * path.length() / 1000.0);
            before = now;
        }
    }

    #[test]
    fn coincident_points_are_refused() {
        assert!(Path::through(&[[1.0; 3], [1.0; 3]]).is_none());
    }
}
