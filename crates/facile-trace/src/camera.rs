//! The camera: a pinhole, a thin lens in its place, or parallel rays.
//!
//! Axes as in `OpenCV`: `x` right, `y` down, `z` forward, `x_in_camera = R x_in_world + t`, pixel = `K x_in_camera`.
//! Pixel `(i, j)` covers `[i, i + 1) x [j, j + 1)` from the upper left corner and its centre is `(i + 0.5, j + 0.5)`.
//! `OpenCV` itself puts pixel centres at whole numbers: subtract 0.5 from `K`'s principal point to compare with it.
//!
//! An orthographic camera is a pinhole whose rays are made parallel: everything appears as large as the pinhole sees it at
//! one depth `d`, so that pixel = `K (x, y, d) / d` for any depth. Backdrops are seen through the pinhole still.

use facile_core::{Matrix3, Point3, Vector3};

use crate::TraceError;
use crate::lens::Lens;
use crate::math::{Vec3, vec3_from_point};
use crate::ray::Ray;

/// A camera and the size of its image.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    width: usize,
    height: usize,
    intrinsics: Matrix3,
    camera_from_world: Matrix3,
    translation: Vector3,
    position: Point3,
    /// Direction of the pixel `(0, 0)`'s corner and the steps per pixel, in the world, depth 1 along the axis.
    corner: Vector3,
    step_x: Vector3,
    step_y: Vector3,
    /// Depth whose scale all depths have, mm, of an orthographic camera.
    parallel_at: Option<f64>,
    lens: Option<Lens>,
}

impl Camera {
    /// A camera from its matrices: `intrinsics` K in px (upper triangular, last row `0 0 1`), `camera_from_world` R a
    /// rotation, `translation` t in mm.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for an empty image, a K that is not one, or an R that is not a rotation to 1e-6.
    pub fn from_matrices(
        width: usize,
        height: usize,
        intrinsics: Matrix3,
        camera_from_world: Matrix3,
        translation: Vector3,
    ) -> Result<Self, TraceError> {
        let bad = |name, expected, got: String| {
            Err(TraceError::Setting {
                name,
                expected,
                got,
            })
        };
        let limit = 1 << 15;
        if !(1..=limit).contains(&width) || !(1..=limit).contains(&height) {
            let expected = "a width and height in 1..=32768 pixels";
            return bad("image size", expected, format!("{width} x {height}"));
        }
        let k = &intrinsics;
        let finite = k.iter().chain(&translation).chain(&camera_from_world);
        let triangular = k[(1, 0)] == 0.0 && k[(2, 0)] == 0.0 && k[(2, 1)] == 0.0;
        if !finite.into_iter().all(|v: &f64| v.is_finite())
            || !triangular
            || (k[(2, 2)] - 1.0).abs() > 0.0
            || k[(0, 0)] <= 0.0
            || k[(1, 1)] <= 0.0
        {
            let expected =
                "fx > 0, fy > 0, zeros below the diagonal and a last row of 0 0 1, finite";
            return bad("camera matrix K", expected, format!("{intrinsics:?}"));
        }
        let r = &camera_from_world;
        if (r * r.transpose() - Matrix3::identity()).abs().max() > 1e-6 || r.determinant() < 0.0 {
            return bad("camera matrix R", "a rotation", format!("{r:?}"));
        }
        let world_from_camera = camera_from_world.transpose();
        let inverse = |px: f64, py: f64| {
            let y = (py - k[(1, 2)]) / k[(1, 1)];
            let x = (px - k[(0, 2)] - k[(0, 1)] * y) / k[(0, 0)];
            world_from_camera * Vector3::new(x, y, 1.0)
        };
        let corner = inverse(0.0, 0.0);
        Ok(Self {
            width,
            height,
            intrinsics,
            camera_from_world,
            translation,
            position: Point3::from(-(world_from_camera * translation)),
            corner,
            step_x: inverse(1.0, 0.0) - corner,
            step_y: inverse(0.0, 1.0) - corner,
            parallel_at: None,
            lens: None,
        })
    }

    /// A camera at `position` that looks at `target`, both in mm, with `up` upwards in the image. `fov_y` is the
    /// angle that the image's height spans, rad, in `(0, pi)`. The principal point is the image's middle.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for an empty image, an angle out of range, or an `up` along the line of sight.
    pub fn look_at(
        width: usize,
        height: usize,
        position: Point3,
        target: Point3,
        up: Vector3,
        fov_y: f64,
    ) -> Result<Self, TraceError> {
        if !(fov_y > 0.0 && fov_y < std::f64::consts::PI) {
            return Err(TraceError::Setting {
                name: "camera fov_y",
                expected: "an angle between 0 and 180 degrees",
                got: format!("{} degrees", fov_y.to_degrees()),
            });
        }
        let axes = (target - position)
            .try_normalize(1e-12)
            .and_then(|forward| Some((forward, forward.cross(&up).try_normalize(1e-9)?)));
        let Some((forward, right)) = axes else {
            return Err(TraceError::Setting {
                name: "camera orientation",
                expected: "a target away from the position and an up direction off the line of sight",
                got: format!(
                    "position {position}, target {target}, up {:?}",
                    up.as_slice()
                ),
            });
        };
        let down = forward.cross(&right);
        let rotation =
            Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
        let focal = height as f64 / (2.0 * libm::tan(fov_y / 2.0));
        let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
        let intrinsics = Matrix3::new(focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0);
        let translation = -(rotation * position.coords);
        Self::from_matrices(width, height, intrinsics, rotation, translation)
    }

    /// The same camera with parallel rays, which start at its position's depth: everything appears as large as it does at
    /// `depth_z`, mm.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for a depth that is not a length, or with a lens.
    pub fn orthographic(mut self, depth_z: f64) -> Result<Self, TraceError> {
        if !(depth_z > 0.0 && depth_z.is_finite()) || self.lens.is_some() {
            return Err(TraceError::Setting {
                name: "orthographic camera",
                expected: "a depth over 0 and no lens",
                got: format!("a depth of {depth_z} and lens {:?}", self.lens),
            });
        }
        self.parallel_at = Some(depth_z);
        Ok(self)
    }

    /// The same camera with a lens instead of a pinhole. Images need more than one sample, the same number in each pixel.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for a lens that is none, or with parallel rays.
    pub fn with_lens(mut self, lens: Lens) -> Result<Self, TraceError> {
        if self.parallel_at.is_some() {
            return Err(TraceError::Setting {
                name: "lens",
                expected: "a camera that is not orthographic",
                got: "an orthographic one".to_owned(),
            });
        }
        self.lens = Some(lens.check()?);
        Ok(self)
    }

    /// The lens; `None` for a pinhole.
    pub fn lens(&self) -> Option<Lens> {
        self.lens
    }

    /// Whether rays are parallel.
    pub fn is_orthographic(&self) -> bool {
        self.parallel_at.is_some()
    }

    /// Depth at which a pinhole sees things as large as this camera does at `depth_z`, mm.
    pub fn scale_depth(&self, depth_z: f64) -> f64 {
        self.parallel_at.unwrap_or(depth_z)
    }

    /// Number of pixel columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of pixel rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// K, px.
    pub fn intrinsics(&self) -> &Matrix3 {
        &self.intrinsics
    }

    /// R.
    pub fn camera_from_world(&self) -> &Matrix3 {
        &self.camera_from_world
    }

    /// t, mm.
    pub fn translation(&self) -> &Vector3 {
        &self.translation
    }

    /// Centre of projection in the world, mm.
    pub fn position(&self) -> &Point3 {
        &self.position
    }

    /// Line of sight in the world, unit length.
    pub fn forward(&self) -> Vector3 {
        self.camera_from_world.row(2).transpose()
    }

    /// A point of the world in the camera's frame, mm.
    pub fn point_in_camera(&self, point: &Point3) -> Point3 {
        Point3::from(self.camera_from_world * point.coords + self.translation)
    }

    /// Where a point of the world appears, px, and its depth along the axis, mm. `None` at or behind the camera.
    pub fn project(&self, point: &Point3) -> Option<([f64; 2], f64)> {
        let p = self.point_in_camera(point);
        (p.z > 1e-9).then(|| {
            let scale = self.scale_depth(p.z);
            let image = self.intrinsics * Vector3::new(p.x, p.y, scale);
            ([image.x / scale, image.y / scale], p.z)
        })
    }

    /// Where something infinitely far in a direction of the world appears through the pinhole, px. `None` beside and behind the camera.
    pub(crate) fn px_of_direction(&self, direction: Vec3) -> Option<[f32; 2]> {
        let d = self.camera_from_world * direction.cast::<f64>();
        (d.z > 1e-3 * d.norm()).then(|| {
            let image = self.intrinsics * d;
            [(image.x / d.z) as f32, (image.y / d.z) as f32]
        })
    }

    /// Whether an image position lies in the image.
    pub fn contains_px(&self, [x, y]: [f64; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64
    }

    /// The ray through an image position, px. Its parameter `t` is the depth along the optical axis in mm.
    pub fn ray(&self, px: [f64; 2]) -> Ray {
        let Some(depth_z) = self.parallel_at else {
            let origin = vec3_from_point(&self.position);
            return Ray::new(origin, Vec3::from(self.direction(px)));
        };
        let [column, row] = [
            self.direction_of_column(px[0]),
            self.direction_of_row(px[1]),
        ];
        let through = Vector3::from(column) + Vector3::from(row);
        let origin = self.position + (through - self.forward()) * depth_z;
        Ray::new(vec3_from_point(&origin), self.forward().cast::<f32>())
    }

    /// Direction in which the camera sees a surface at an image position, or the backdrop if there is none.
    #[inline(always)]
    pub(crate) fn sight(&self, px: [f64; 2], is_surface: bool) -> [f32; 3] {
        if self.parallel_at.is_some() && is_surface {
            return self.forward().cast::<f32>().into();
        }
        self.direction(px)
    }

    /// Direction from the pinhole through an image position: that of [`Camera::ray`] unless rays are parallel.
    #[inline(always)]
    pub(crate) fn direction(&self, [x, y]: [f64; 2]) -> [f32; 3] {
        let (column, row) = (self.direction_of_column(x), self.direction_of_row(y));
        [
            (column[0] + row[0]) as f32,
            (column[1] + row[1]) as f32,
            (column[2] + row[2]) as f32,
        ]
    }

    /// Distance of two pixels' rays at a depth of 1 mm, mm; the smaller one of pixels that are not square.
    pub(crate) fn pixel_spacing(&self) -> f32 {
        (1.0 / self.intrinsics[(0, 0)].max(self.intrinsics[(1, 1)])) as f32
    }

    /// What [`Camera::direction`] adds up, for the image's `x`.
    #[inline(always)]
    pub(crate) fn direction_of_column(&self, x: f64) -> [f64; 3] {
        let along = |k: usize| self.corner[k] + self.step_x[k] * x;
        [along(0), along(1), along(2)]
    }

    /// What [`Camera::direction`] adds up, for the image's `y`.
    #[inline(always)]
    pub(crate) fn direction_of_row(&self, y: f64) -> [f64; 3] {
        [self.step_y[0] * y, self.step_y[1] * y, self.step_y[2] * y]
    }

    /// Pixels `[x0, x1) x [y0, y1)` that the boxes can cover, each given by its smallest and largest corner in the
    /// world, mm. `None` if all boxes lie outside the image. The whole image if a box reaches behind the camera.
    pub fn pixel_bounds(
        &self,
        boxes: impl IntoIterator<Item = (Vec3, Vec3)>,
    ) -> Option<[usize; 4]> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for (min, max) in boxes {
            let corners: [_; 8] = std::array::from_fn(|corner| {
                let pick = |k: usize| if corner >> k & 1 == 0 { min[k] } else { max[k] };
                self.project(&Point3::new(pick(0).into(), pick(1).into(), pick(2).into()))
            });
            let blur = |depth_z: f64, k: usize| {
                let disc = self.lens.map_or(0.0, |lens| lens.blur(depth_z));
                disc / 2.0 * self.intrinsics[(k, k)]
            };
            // A box behind the camera shows nowhere, one around the camera everywhere
            if corners.iter().all(Option::is_none) {
                continue;
            }
            for corner in corners {
                let Some((px, depth_z)) = corner else {
                    return Some([0, 0, self.width, self.height]);
                };
                low = std::array::from_fn(|k| low[k].min(px[k] - blur(depth_z, k)));
                high = std::array::from_fn(|k| high[k].max(px[k] + blur(depth_z, k)));
            }
        }
        // A pixel of margin pays for the rounding of rays to f32
        let first = |v: f64| (v - 1.0).floor().max(0.0) as usize;
        let last = |v: f64, n: usize| ((v + 1.0).ceil().max(0.0) as usize).min(n);
        let bounds = [
            first(low[0]),
            first(low[1]),
            last(high[0], self.width),
            last(high[1], self.height),
        ];
        (low[0] <= high[0] && bounds[0] < bounds[2] && bounds[1] < bounds[3]).then_some(bounds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn camera() -> Camera {
        Camera::look_at(
            320,
            200,
            Point3::new(120.0, -40.0, 600.0),
            Point3::new(5.0, 10.0, 20.0),
            Vector3::y(),
            0.4,
        )
        .expect("valid")
    }

    #[test]
    fn rays_go_through_the_points_that_project_there() {
        let camera = camera();
        for point in [
            Point3::new(30.0, 40.0, 50.0),
            Point3::new(-70.0, -90.0, 10.0),
        ] {
            let (px, depth) = camera.project(&point).expect("in front");
            let ray = camera.ray(px);
            let found = ray.at(depth as f32);
            assert_relative_eq!(found, vec3_from_point(&point), epsilon = 2e-4);
        }
    }

    #[test]
    fn the_target_is_in_the_middle_and_up_is_up() {
        let camera = camera();
        let (middle, _) = camera
            .project(&Point3::new(5.0, 10.0, 20.0))
            .expect("in front");
        assert_relative_eq!(middle[0], 160.0, epsilon = 1e-9);
        assert_relative_eq!(middle[1], 100.0, epsilon = 1e-9);
        let (above, _) = camera
            .project(&Point3::new(5.0, 30.0, 20.0))
            .expect("in front");
        assert!(above[1] < middle[1]);
        assert!(camera.project(&Point3::new(120.0, -40.0, 900.0)).is_none());
    }

    #[test]
    fn skew_and_offsets_of_k_are_honoured() {
        let k = Matrix3::new(500.0, 3.0, 20.0, 0.0, 400.0, 70.0, 0.0, 0.0, 1.0);
        let camera =
            Camera::from_matrices(64, 128, k, Matrix3::identity(), Vector3::new(1.0, 2.0, 3.0))
                .expect("valid");
        let point = Point3::new(10.0, -20.0, 300.0);
        let (px, depth) = camera.project(&point).expect("in front");
        assert_relative_eq!(depth, 303.0);
        assert_relative_eq!(
            px[0],
            (500.0 * 11.0 + 3.0 * -18.0) / 303.0 + 20.0,
            epsilon = 1e-12
        );
        assert_relative_eq!(px[1], 400.0 * -18.0 / 303.0 + 70.0, epsilon = 1e-12);
        assert_relative_eq!(
            camera.ray(px).at(303.0),
            vec3_from_point(&point),
            epsilon = 1e-3
        );
    }

    #[test]
    fn parallel_rays_scale_everything_alike() {
        let camera = camera().orthographic(500.0).expect("valid");
        // The formula with its own numbers: focal length 100 px over the tangent of 0.2
        let focal = 100.0 / 0.2_f64.tan();
        for point in [
            Point3::new(30.0, 40.0, 50.0),
            Point3::new(-70.0, -90.0, 10.0),
            Point3::new(-70.0, -90.0, 310.0),
        ] {
            let in_camera = camera.camera_from_world() * point.coords + camera.translation();
            let (px, depth) = camera.project(&point).expect("in front");
            assert_relative_eq!(px[0], 160.0 + focal * in_camera.x / 500.0, epsilon = 1e-9);
            assert_relative_eq!(px[1], 100.0 + focal * in_camera.y / 500.0, epsilon = 1e-9);
            assert_relative_eq!(depth, in_camera.z, epsilon = 1e-9);
            let found = camera.ray(px).at(depth as f32);
            assert_relative_eq!(found, vec3_from_point(&point), epsilon = 2e-4);
        }
        assert!(camera.project(&Point3::new(120.0, -40.0, 900.0)).is_none());
        assert!(camera.orthographic(0.0).is_err());
    }

    #[test]
    fn bounds_hold_what_a_lens_blurs() {
        let sharp = camera();
        let lens = Lens {
            radius_mm: 10.0,
            focus_mm: 300.0,
        };
        let soft = sharp.clone().with_lens(lens).expect("valid");
        let (min, max) = (Vec3::new(-20.0, -10.0, -20.0), Vec3::new(30.0, 10.0, 40.0));
        let [a, b] = [&sharp, &soft].map(|c| c.pixel_bounds([(min, max)]).expect("in the image"));
        // At a depth of 590 mm and focus at 300 the disc's radius is 10 (1/300 - 1/590) focal lengths of 493 px: 8 px
        for k in 0..2 {
            assert!((6..11).contains(&(a[k] - b[k])) && (6..11).contains(&(b[k + 2] - a[k + 2])));
        }
        assert!(soft.orthographic(500.0).is_err());
    }

    #[test]
    fn impossible_cameras_are_refused() {
        let eye = Point3::new(0.0, 0.0, 9.0);
        let make = |w, target, up, fov| Camera::look_at(w, 9, eye, target, up, fov).is_err();
        assert!(make(0, Point3::origin(), Vector3::y(), 0.5));
        assert!(make(9, eye, Vector3::y(), 0.5));
        assert!(make(9, Point3::origin(), Vector3::z(), 0.5));
        assert!(make(9, Point3::origin(), Vector3::y(), 4.0));
        assert!(make(9, Point3::origin(), Vector3::y(), f64::NAN));
        let mirrored = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        let k = Matrix3::identity();
        assert!(Camera::from_matrices(9, 9, k, mirrored, Vector3::zeros()).is_err());
    }

    #[test]
    fn bounds_hold_every_point_of_a_box() {
        let camera = camera();
        let (min, max) = (Vec3::new(-20.0, -10.0, -20.0), Vec3::new(30.0, 10.0, 40.0));
        let [x0, y0, x1, y1] = camera.pixel_bounds([(min, max)]).expect("in the image");
        assert!(x1 - x0 < 160 && y1 - y0 < 120);
        let (px, _) = camera
            .project(&Point3::new(30.0, 10.0, 40.0))
            .expect("in front");
        assert!((x0..x1).contains(&(px[0] as usize)) && (y0..y1).contains(&(px[1] as usize)));
        let away = (Vec3::new(9_000.0, 0.0, 0.0), Vec3::new(9_010.0, 1.0, 1.0));
        assert_eq!(camera.pixel_bounds([away]), None);
        assert_eq!(camera.pixel_bounds([]), None);
        let around = (Vec3::repeat(-1e4), Vec3::repeat(1e4));
        assert_eq!(camera.pixel_bounds([around]), Some([0, 0, 320, 200]));
    }
}
