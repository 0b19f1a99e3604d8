//! Where triangles may appear in an image: the box around each, eight triangles at a time.
//!
//! Boxes are larger than the triangles by far more than any rounding, and whoever draws tests what is in them exactly, so
//! a projection decides what is tested and never what is hit.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::camera::Camera;
use crate::lanes::{Eight, LANES, LaneMask, Lanes, V3};
use crate::math::Vec3;
use crate::object::Object;

/// Distance by which a box grows at least, in steps of the image, and per unit of the numbers it comes from.
const MARGIN: f32 = 1.0 / 64.0;
const MARGIN_SHARE: f32 = 4e-6;

/// From the world to an image: through a point, or along parallel lines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projection {
    /// Where lines meet, or any point for parallel lines, mm.
    origin: Point3<f64>,
    /// Rows give image `x` and `y` (times depth for lines through a point), and depth.
    rows: Matrix3<f64>,
    /// Image position of the origin of parallel lines; `None` for lines through a point.
    parallel: Option<[f32; 2]>,
}

/// A projection in an object's frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalProjection {
    origin: [f32; 3],
    rows: [[f32; 3]; 3],
    parallel: Option<[f32; 2]>,
    margin: f32,
}

impl Projection {
    /// Pixels of a camera.
    pub(crate) fn of_camera(camera: &Camera) -> Self {
        Self {
            origin: *camera.position(),
            rows: camera.intrinsics() * camera.camera_from_world(),
            parallel: None,
        }
    }

    /// An image that a light at `light` casts on a box; see [`Projection::fit`].
    pub(crate) fn through(light: Vec3, min: Vec3, max: Vec3) -> Option<Self> {
        let middle = ((min + max) * 0.5).cast::<f64>();
        let origin = light.cast::<f64>();
        let forward = (middle - origin).try_normalize(1e-9)?;
        Some(Self {
            origin: origin.into(),
            rows: frame(forward),
            parallel: None,
        })
    }

    /// An image along a unit direction.
    pub(crate) fn along(direction: Vec3, min: Vec3, max: Vec3) -> Option<Self> {
        let forward = direction.cast::<f64>().try_normalize(1e-9)?;
        let middle = ((min + max) * 0.5).cast::<f64>();
        Some(Self {
            origin: middle.into(),
            rows: frame(forward),
            parallel: Some([0.0; 2]),
        })
    }

    /// Scales and shifts the image so that `[low, high]` of the present one becomes `[0, size]`.
    pub(crate) fn fit(&mut self, low: [f32; 2], high: [f32; 2], size: [f32; 2]) {
        let depth = self.rows.row(2).into_owned();
        for k in 0..2 {
            let scale = f64::from(size[k]) / f64::from((high[k] - low[k]).max(1e-6));
            let scaled = self.rows.row(k) * scale;
            let shift = -f64::from(low[k]) * scale;
            match &mut self.parallel {
                None => self.rows.set_row(k, &(scaled + depth * shift)),
                Some(at) => {
                    self.rows.set_row(k, &scaled);
                    at[k] = at[k] * scale as f32 + shift as f32;
                }
            }
        }
    }

    /// Where lines meet, or any point for parallel lines, mm.
    pub(crate) fn origin(&self) -> Vec3 {
        self.origin.coords.cast::<f32>()
    }

    /// Whether a box of the world lies in front of the point by enough to be projected. Always for parallel lines.
    pub(crate) fn is_in_front(&self, (min, max): (Vec3, Vec3)) -> bool {
        if self.parallel.is_some() {
            return true;
        }
        let (min, max) = (
            min.cast::<f64>() - self.origin.coords,
            max.cast::<f64>() - self.origin.coords,
        );
        let forward = self.rows.row(2);
        let nearest: f64 = (0..3)
            .map(|k| (min[k] * forward[k]).min(max[k] * forward[k]))
            .sum();
        nearest > 1e-3 * min.abs().sup(&max.abs()).norm()
    }

    /// The projection in an object's frame, or in the world's. `reach` is the largest distance of a projected point from
    /// the origin, mm.
    pub(crate) fn in_frame_of(&self, object: Option<&Object>, reach: f32) -> LocalProjection {
        let (mut origin, mut rows) = (self.origin, self.rows);
        if let Some(pose) = object.and_then(|o| o.world_from_object) {
            let pose = pose.cast::<f64>();
            origin = pose.inverse_transform_point(&origin);
            rows *= pose.rotation.to_rotation_matrix().matrix();
        }
        let largest = rows.row(0).norm().max(rows.row(1).norm()) as f32;
        let magnitude = match self.parallel {
            None => largest,
            Some([x, y]) => largest * reach + x.abs() + y.abs(),
        };
        LocalProjection {
            origin: origin.cast::<f32>().into(),
            rows: [0, 1, 2].map(|r| [0, 1, 2].map(|c| rows[(r, c)] as f32)),
            parallel: self.parallel,
            margin: MARGIN + MARGIN_SHARE * magnitude,
        }
    }
}

/// Rows of a rotation whose third is `forward`.
fn frame(forward: Vector3<f64>) -> Matrix3<f64> {
    let other = if forward.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let right = forward.cross(&other) / forward.cross(&other).norm();
    let down = forward.cross(&right);
    Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()])
}

impl LocalProjection {
    /// Whether its lines are parallel.
    pub(crate) fn is_parallel(&self) -> bool {
        self.parallel.is_some()
    }

    /// Image position and depth of eight points.
    #[inline(always)]
    pub(crate) fn project<L: Lanes>(&self, points: V3<L>) -> V3<L> {
        let relative = points - V3::splat(self.origin);
        let x = V3::splat(self.rows[0]).dot(relative);
        let y = V3::splat(self.rows[1]).dot(relative);
        let z = V3::splat(self.rows[2]).dot(relative);
        match self.parallel {
            None => {
                let inverse = L::splat(1.0) / z;
                V3([x * inverse, y * inverse, z])
            }
            Some([sx, sy]) => V3([x + L::splat(sx), y + L::splat(sy), z]),
        }
    }
}

/// The steps of an image that boxes are rounded to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steps {
    /// Number of steps along `x` and `y`.
    pub(crate) count: [usize; 2],
    /// Image position of step 0.
    pub(crate) first: [f32; 2],
    /// Whether only the steps themselves matter, not what lies between a step and the next.
    pub(crate) is_lattice: bool,
}

/// The boxes around eight triangles, in steps; both ends belong to them.
pub(crate) struct Footprints {
    pub(crate) first: [[i32; LANES]; 2],
    pub(crate) last: [[i32; LANES]; 2],
    /// Smallest depth.
    pub(crate) nearest: Eight,
    /// Triangles whose box is not empty.
    pub(crate) present: u32,
    /// Triangles that turn clockwise in the image.
    pub(crate) clockwise: u32,
}

impl Footprints {
    /// First and last step of a triangle along `x` and `y`.
    #[inline(always)]
    pub(crate) fn area(&self, lane: usize) -> [[usize; 2]; 2] {
        [
            [self.first[0][lane] as usize, self.first[1][lane] as usize],
            [self.last[0][lane] as usize, self.last[1][lane] as usize],
        ]
    }
}

/// Image positions and depths of the corners of up to eight triangles; further lanes repeat the last.
#[inline(always)]
pub(crate) fn project_corners<L: Lanes>(
    projection: &LocalProjection,
    triangles: &[[[f32; 3]; 3]],
) -> [V3<L>; 3] {
    let mut rows: [&[f32; LANES]; LANES] = [&[0.0; LANES]; LANES];
    let mut last = Eight::default();
    for lane in 0..LANES {
        // The first eight of nine coordinates are a row; the ninth goes by itself
        let nine = triangles[lane.min(triangles.len() - 1)].as_flattened();
        if let Some(row) = nine.first_chunk() {
            rows[lane] = row;
        }
        last.0[lane] = nine[8];
    }
    let [ax, ay, az, bx, by, bz, cx, cy] = L::transpose(rows);
    [
        projection.project(V3([ax, ay, az])),
        projection.project(V3([bx, by, bz])),
        projection.project(V3([cx, cy, L::load(&last)])),
    ]
}

/// The boxes around the first `count` of eight triangles, given by their corners' image positions and depths.
#[inline(always)]
pub(crate) fn footprints<L: Lanes>(
    projection: &LocalProjection,
    steps: &Steps,
    [a, b, c]: &[V3<L>; 3],
    count: usize,
) -> Footprints {
    let x = span::<L>(projection, steps, 0, [a.0[0], b.0[0], c.0[0]]);
    let y = span::<L>(projection, steps, 1, [a.0[1], b.0[1], c.0[1]]);
    let ([ax, ay, az], [bx, by, bz], [cx, cy, cz]) = (a.0, b.0, c.0);
    let area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    let all = 0xFF >> (LANES - count);
    Footprints {
        first: [x.0.to_i32(), y.0.to_i32()],
        last: [x.1.to_i32(), y.1.to_i32()],
        nearest: az.min(bz).min(cz).store(),
        present: (x.2 & y.2).bits() & all,
        clockwise: L::splat(0.0).lt(area).bits(),
    }
}

/// First and last step along one axis, and where there are any.
#[inline(always)]
fn span<L: Lanes>(
    projection: &LocalProjection,
    steps: &Steps,
    axis: usize,
    at: [L; 3],
) -> (L, L, L::Mask) {
    let low = at[0].min(at[1]).min(at[2]) - L::splat(steps.first[axis]);
    let high = at[0].max(at[1]).max(at[2]) - L::splat(steps.first[axis]);
    let (zero, count) = (L::splat(0.0), L::splat(steps.count[axis] as f32));
    let size = low.max(zero - low).max(high.max(zero - high));
    let margin = L::splat(projection.margin) + L::splat(MARGIN_SHARE) * size;
    let (low, high) = (low - margin, high + margin);
    let is_inside = zero.le(high) & low.le(count);
    let low = low.max(zero).min(count);
    let mut first = low.trunc();
    if steps.is_lattice {
        first = L::select(first.lt(low), first + L::splat(1.0), first);
    }
    let last = high.max(zero).min(count - L::splat(1.0)).trunc();
    (first, last, is_inside & first.le(last))
}
