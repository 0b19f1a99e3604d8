//! How near to a light eight triangles are over its image: which rays they can block, before the exact test.

use crate::lanes::{Eight, Lanes, V3};

/// Share of a nearness by which another must be smaller to be behind for sure.
const NEARNESS_SLACK: f32 = 1e-5;

/// Rounding of image positions as a share of their size, and at least, in cells.
const POSITION_SHARE: f32 = 4e-6;
const POSITION_ROUNDING: f32 = 1e-4;

/// Distance from a triangle's box within which rays may meet it, in cells.
const BOX_MARGIN: f32 = 1.0 / 64.0;

/// Eight triangles in the light's image: their nearness is `a x + b y + c`, margin included.
///
/// Nearness is what grows towards the light and is linear over the image: one over the depth, or for parallel light the
/// depth's negative.
pub(crate) struct Slopes {
    pub(crate) a: Eight,
    pub(crate) b: Eight,
    pub(crate) c: Eight,
    /// Box around the triangle, in cells.
    pub(crate) low: [Eight; 2],
    pub(crate) high: [Eight; 2],
}

impl Slopes {
    /// The slopes of eight triangles, given by their corners' image positions and depths.
    #[inline(always)]
    pub(crate) fn new<L: Lanes>(corners: &[V3<L>; 3], is_parallel: bool, reach: f32) -> Self {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let [V3([ax, ay, az]), V3([bx, by, bz]), V3([cx, cy, cz])] = *corners;
        let near = [
            if is_parallel { zero - az } else { one / az },
            if is_parallel { zero - bz } else { one / bz },
            if is_parallel { zero - cz } else { one / cz },
        ];
        let (dx, dy, dn) = (bx - ax, by - ay, near[1] - near[0]);
        let (ex, ey, en) = (cx - ax, cy - ay, near[2] - near[0]);
        let area = dx * ey - dy * ex;
        let inverse = one / area;
        let slope_x = (dn * ey - en * dy) * inverse;
        let slope_y = (dx * en - ex * dn) * inverse;
        // Rounding of the positions as a share of the triangle's height
        let size_x = ax.max(bx).max(cx) - ax.min(bx).min(cx);
        let size_y = ay.max(by).max(cy) - ay.min(by).min(cy);
        let largest = magnitude(ax).max(magnitude(ay)) + size_x + size_y;
        let rounding = largest * L::splat(POSITION_SHARE) + L::splat(POSITION_ROUNDING);
        let share = rounding * (size_x + size_y) / magnitude(area);
        let steepness =
            magnitude(slope_x) * (size_x + rounding) + magnitude(slope_y) * (size_y + rounding);
        let slack = slack(near[0].max(near[1]).max(near[2]), is_parallel, reach);
        let margin = slack
            + steepness * share * L::splat(4.0)
            + (magnitude(slope_x) + magnitude(slope_y)) * rounding * L::splat(4.0);
        // A triangle seen from its edge may be anywhere
        let is_flat = share.lt(L::splat(0.1));
        Self {
            a: L::select(is_flat, slope_x, zero).store(),
            b: L::select(is_flat, slope_y, zero).store(),
            c: L::select(
                is_flat,
                near[0] - slope_x * ax - slope_y * ay + margin,
                L::splat(f32::INFINITY),
            )
            .store(),
            low: [
                (ax.min(bx).min(cx) - L::splat(BOX_MARGIN) - rounding).store(),
                (ay.min(by).min(cy) - L::splat(BOX_MARGIN) - rounding).store(),
            ],
            high: [
                (ax.max(bx).max(cx) + L::splat(BOX_MARGIN) + rounding).store(),
                (ay.max(by).max(cy) + L::splat(BOX_MARGIN) + rounding).store(),
            ],
        }
    }
}

/// How near eight triangles come to the light, margin included, given by their smallest depths.
#[inline(always)]
pub(crate) fn nearest<L: Lanes>(depth: L, is_parallel: bool, reach: f32) -> Eight {
    let near = if is_parallel {
        L::splat(0.0) - depth
    } else {
        L::splat(1.0) / depth
    };
    (near + slack(near, is_parallel, reach)).store()
}

#[inline(always)]
fn slack<L: Lanes>(nearest: L, is_parallel: bool, reach: f32) -> L {
    if is_parallel {
        L::splat(NEARNESS_SLACK * reach)
    } else {
        nearest * L::splat(NEARNESS_SLACK)
    }
}

#[inline(always)]
fn magnitude<L: Lanes>(v: L) -> L {
    v.max(L::splat(0.0) - v)
}
