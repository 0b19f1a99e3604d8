//! The pixels whose centres small triangles may hold, row by row, for eight triangles at a time.
//!
//! A triangle is what lies between its three edges; in a row of pixels each edge bounds it on one side. Edges are moved
//! outwards by more than any rounding, so that what is left out is outside for sure: spans decide what is tested and never
//! what is hit.

use crate::footprint::{Footprints, LocalProjection, MARGIN, MARGIN_SHARE, Steps};
use crate::lanes::{LaneMask, Lanes, V3};

/// The spans of eight triangles. A row of pixels has its centres at whole numbers of both axes.
pub(super) struct Spans<L: Lanes> {
    /// Where each edge crosses row `y`: `slope y + shift`.
    slope: [L; 3],
    shift: [L; 3],
    /// Edges that bound from the left, from the right; an edge along the rows does neither.
    is_left: [L::Mask; 3],
    is_right: [L::Mask; 3],
    /// First and last pixel of the triangles' boxes.
    first: [L; 2],
    last: [L; 2],
}

impl<L: Lanes> Spans<L> {
    /// The spans of triangles given by their corners' image positions and their boxes.
    #[inline(always)]
    pub(super) fn new(
        projection: &LocalProjection,
        steps: &Steps,
        [a, b, c]: &[V3<L>; 3],
        found: &Footprints<L>,
    ) -> Self {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let (x0, y0) = (L::splat(steps.first[0]), L::splat(steps.first[1]));
        let xs = [a.0[0] - x0, b.0[0] - x0, c.0[0] - x0];
        let ys = [a.0[1] - y0, b.0[1] - y0, c.0[1] - y0];
        // Rounding of a position: the box's margin without its constant part
        let extent = L::splat(steps.count[0].max(steps.count[1]) as f32);
        let reach = extent + found.size[0] + found.size[1];
        let rounding = L::splat(projection.margin - MARGIN) + L::splat(MARGIN_SHARE) * reach;
        // An edge of rounded corners is off by this much, in units of its edge function, anywhere in the box
        let turned = rounding * (found.size[0] + found.size[1] + L::splat(1.0)) * L::splat(4.0);
        let (mut slope, mut shift) = ([zero; 3], [zero; 3]);
        let (mut is_left, mut is_right) = ([zero.lt(zero); 3], [zero.lt(zero); 3]);
        let turns = zero.lt(found.area);
        for k in 0..3 {
            let next = if k == 2 { 0 } else { k + 1 };
            let (dx, dy) = (xs[next] - xs[k], ys[next] - ys[k]);
            let length = dx.max(zero - dx) + dy.max(zero - dy);
            let slack = (L::splat(MARGIN) + rounding) * length + turned;
            let dx = L::select(turns, dx, zero - dx);
            let dy = L::select(turns, dy, zero - dy);
            let inverse = one / dy;
            slope[k] = dx * inverse;
            shift[k] = xs[k] + slack * inverse - slope[k] * ys[k];
            is_left[k] = dy.lt(zero);
            is_right[k] = zero.lt(dy);
        }
        Self {
            slope,
            shift,
            is_left,
            is_right,
            first: found.first,
            last: found.last,
        }
    }

    /// First and last pixel of each triangle in its row `offset` from its first, and the triangles that have any there.
    #[inline(always)]
    pub(super) fn row(&self, offset: f32) -> (L, L, L::Mask) {
        let y = self.first[1] + L::splat(offset);
        let (mut low, mut high) = (self.first[0], self.last[0]);
        for k in 0..3 {
            let at = self.slope[k] * y + self.shift[k];
            low = L::select(self.is_left[k], at.max(low), low);
            high = L::select(self.is_right[k], at.min(high), high);
        }
        // Stay among the whole numbers
        let low = low.min(self.last[0] + L::splat(1.0));
        let whole = low.trunc();
        let first = L::select(whole.lt(low), whole + L::splat(1.0), whole);
        let is_any = first.le(high) & y.le(self.last[1]);
        (first, high, is_any)
    }

    /// Rows of the tallest of the triangles `lanes`.
    #[inline(always)]
    pub(super) fn rows(&self, lanes: u32) -> u32 {
        let rows = L::select(
            L::Mask::from_bits(lanes),
            self.last[1] - self.first[1] + L::splat(1.0),
            L::splat(0.0),
        );
        rows.store().0.into_iter().fold(0.0, f32::max) as u32
    }
}
