//! A thin lens: what lies before or behind the distance in focus is blurred.
//!
//! A sample's ray starts somewhere on the lens and goes through the point in focus that the ray through the lens's middle
//! goes through (Cook, Porter, Carpenter, Distributed Ray Tracing, SIGGRAPH 1984). Only the image knows of the lens; labels
//! are those of the rays through its middle, the pinhole.

use crate::TraceError;
use crate::camera::Camera;
use crate::math::vec3_from_point;
use crate::primary::sample_px;
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};

/// Turn from a point of the lens to the next, rad: the golden angle, which spreads any number evenly.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// Rays that are traced together: bounds the buffers.
const BATCH: usize = 4096;

/// A round lens at the camera's position, across its axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Radius of the opening, mm.
    pub radius_mm: f64,
    /// Depth that is in focus, mm.
    pub focus_mm: f64,
}

impl Lens {
    pub(crate) fn check(self) -> Result<Self, TraceError> {
        let is_length = |v: f64| v > 0.0 && v.is_finite();
        if is_length(self.radius_mm) && is_length(self.focus_mm) {
            return Ok(self);
        }
        Err(TraceError::Setting {
            name: "lens",
            expected: "a radius and a focus over 0",
            got: format!("{self:?}"),
        })
    }

    /// Diameter of the disc that a point at a depth becomes, mm at a depth of 1 mm: times the focal length in px, px.
    pub fn blur(&self, depth_z: f64) -> f64 {
        2.0 * self.radius_mm * (1.0 / depth_z - 1.0 / self.focus_mm).abs()
    }
}

/// The rays of `count` samples of a pixel through a lens.
pub(crate) struct LensRays<'a> {
    camera: &'a Camera,
    lens: Lens,
    /// Places on the lens, mm, before they are turned.
    places: Vec<[f64; 2]>,
    /// From a sample of a pixel to the place of the next, so that places do not follow the order of samples.
    step: usize,
}

impl<'a> LensRays<'a> {
    /// `None` for a pinhole.
    pub(crate) fn of(camera: &'a Camera, count: usize) -> Option<Self> {
        let lens = camera.lens()?;
        let places = (0..count).map(|i| {
            let radius = lens.radius_mm * libm::sqrt((i as f64 + 0.5) / count as f64);
            let (sin, cos) = libm::sincos(GOLDEN_ANGLE * i as f64);
            [radius * cos, radius * sin]
        });
        let coprime = |step: &usize| greatest_divisor(*step, count) == 1;
        let near = (count as f64 * 0.618) as usize;
        Some(Self {
            camera,
            lens,
            places: places.collect(),
            step: (near.max(1)..=count).find(coprime).unwrap_or(1),
        })
    }

    /// The ray of sample `k` at an image position in a pixel; its parameter is the depth, as that of [`Camera::ray`].
    pub(crate) fn ray(&self, pixel: [u32; 2], offset: [f64; 2], k: usize) -> Ray {
        // Each pixel has its own turn and order, else the lens would show as so many sharp images
        let mixed = mix(pixel);
        let count = self.places.len();
        let [x, y] = self.places[(k * self.step + (mixed >> 32) as usize) % count];
        let turn = std::f64::consts::TAU * f64::from(mixed as u32) / 4_294_967_296.0;
        let (sin, cos) = libm::sincos(turn);
        let rotation = self.camera.camera_from_world();
        let right = rotation.row(0).transpose() * (x * cos - y * sin);
        let down = rotation.row(1).transpose() * (x * sin + y * cos);
        let aside = right + down;
        let middle = self.camera.direction(sample_px(pixel, offset));
        let start = self.camera.position() + aside;
        let direction =
            facile_core::Vector3::from(middle.map(f64::from)) - aside / self.lens.focus_mm;
        Ray::new(vec3_from_point(&start), direction.cast::<f32>())
    }

    /// Traces the samples at `offsets` of each pixel; the hits of a pixel are adjacent.
    pub(crate) fn trace(
        &self,
        scene: &Scene,
        pixels: &[[u32; 2]],
        offsets: &[[f64; 2]],
        hits: &mut Vec<Hit>,
    ) {
        hits.clear();
        hits.reserve(pixels.len() * offsets.len());
        let mut rays: Vec<Ray> = Vec::with_capacity(BATCH);
        for chunk in pixels.chunks(BATCH.div_ceil(offsets.len())) {
            rays.clear();
            for &pixel in chunk {
                let of_pixel = offsets.iter().enumerate();
                rays.extend(of_pixel.map(|(k, offset)| self.ray(pixel, *offset, k)));
            }
            scene.closest_hits(&rays, Layer::All, hits);
        }
    }
}

fn greatest_divisor(a: usize, b: usize) -> usize {
    if b == 0 {
        a
    } else {
        greatest_divisor(b, a % b)
    }
}

/// Bits of a pixel, thoroughly mixed. Source: Steele, Lea, Flood, Fast Splittable Pseudorandom Number Generators, 2014.
fn mix([x, y]: [u32; 2]) -> u64 {
    let mut z = (u64::from(x) << 32 | u64::from(y)).wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ z >> 31
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use facile_core::{Point3, Vector3};

    fn camera() -> Camera {
        let (eye, target) = (
            Point3::new(120.0, -40.0, 600.0),
            Point3::new(5.0, 10.0, 20.0),
        );
        let lens = Lens {
            radius_mm: 8.0,
            focus_mm: 500.0,
        };
        Camera::look_at(64, 48, eye, target, Vector3::y(), 0.4)
            .and_then(|c| c.with_lens(lens))
            .expect("valid")
    }

    #[test]
    fn rays_of_a_sample_meet_in_focus_and_fill_the_lens() {
        let camera = camera();
        for count in [2, 7, 16, 64] {
            let rays = LensRays::of(&camera, count).expect("a lens");
            let (pixel, offset) = ([40, 11], [0.3, 0.8]);
            let middle = camera.ray(sample_px(pixel, offset));
            let mut sum = crate::math::Vec3::zeros();
            let mut places = std::collections::BTreeSet::new();
            for k in 0..count {
                let ray = rays.ray(pixel, offset, k);
                assert_relative_eq!(ray.at(500.0), middle.at(500.0), epsilon = 1e-3);
                let aside = ray.origin - middle.origin;
                assert!(aside.norm() < 8.0);
                assert!(aside.dot(&camera.forward().cast::<f32>()).abs() < 1e-3);
                // The parameter is the depth
                let depth = camera
                    .point_in_camera(&Point3::from(ray.at(321.0).cast::<f64>()))
                    .z;
                assert_relative_eq!(depth, 321.0, epsilon = 1e-3);
                places.insert([0, 1, 2].map(|k| (aside[k] * 1e3) as i32));
                sum += aside;
            }
            assert_eq!(places.len(), count);
            if count >= 7 {
                assert!(sum.norm() / (count as f32) < 1.6, "{count}: {sum}");
            }
        }
    }

    #[test]
    fn a_pinhole_has_no_lens_and_impossible_lenses_are_refused() {
        let eye = Point3::new(0.0, 0.0, 600.0);
        let camera =
            Camera::look_at(8, 8, eye, Point3::origin(), Vector3::y(), 0.4).expect("valid");
        assert!(LensRays::of(&camera, 4).is_none());
        for (radius_mm, focus_mm) in [
            (0.0, 9.0),
            (1.0, f64::NAN),
            (1.0, -3.0),
            (f64::INFINITY, 1.0),
        ] {
            let lens = Lens {
                radius_mm,
                focus_mm,
            };
            assert!(camera.clone().with_lens(lens).is_err(), "{lens:?}");
        }
    }
}
