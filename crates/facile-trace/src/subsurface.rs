//! Light that spreads under the skin: shadow borders soften and redden.
//!
//! What the diffuse layer of a pixel gets is mixed with what its neighbours get, over a distance on the surface of its own
//! for each channel ([`crate::Material::scatter_mm`]), in two passes along the image's rows and columns. The weights are
//! positive and sum to 1, so no pixel gets more than the brightest around it. A neighbour's distance counts in depth too,
//! which keeps the light of the nose off the cheek behind it. The kernel is Tukey's biweight of the wanted variance: a
//! Gaussian to the eye, without its exponential. Source: Jimenez, Sundstedt, Gutierrez, Screen-Space Perceptual Rendering
//! of Human Skin, ACM TAP 6(4), 2009.
//!
//! Works on pixel centres: what further samples of a pixel add is kept, and the difference that spreading makes at its
//! centre is added to their mean.

use facile_core::Plane;

use crate::camera::Camera;
use crate::math::Rgb;

/// Support of the biweight kernel over its standard deviation, the square root of 7.
const SUPPORT: f32 = 2.645_751_3;

/// Neighbours on either side at most: bounds the cost of close-ups.
const MAX_RADIUS: usize = 40;

/// A pixel whose light spreads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SkinPixel {
    pub(crate) at: [u32; 2],
    /// Depth along the axis, mm.
    pub(crate) depth_z: f32,
    /// Standard deviations, mm.
    pub(crate) scatter_mm: Rgb,
    /// Light on the diffuse layer.
    pub(crate) irradiance: Rgb,
}

/// What spreading adds to the light of each pixel.
pub(crate) fn spread(camera: &Camera, pixels: &[SkinPixel]) -> Vec<Rgb> {
    let mut number = Plane::filled(camera.width(), camera.height(), u32::MAX);
    for (i, pixel) in pixels.iter().enumerate() {
        number[(pixel.at[0] as usize, pixel.at[1] as usize)] = i as u32;
    }
    let k = camera.intrinsics();
    let focal = [k[(0, 0)] as f32, k[(1, 1)] as f32];
    let mut light: Vec<Rgb> = pixels.iter().map(|p| p.irradiance).collect();
    for axis in 0..2 {
        let mixed = pixels.iter().zip(&light).map(|(pixel, own)| {
            let pass = Pass {
                pixels,
                number: &number,
                light: &light,
                axis,
                mm_per_px: pixel.depth_z / focal[axis],
            };
            pass.mix(pixel, *own)
        });
        light = mixed.collect();
    }
    for (light, pixel) in light.iter_mut().zip(pixels) {
        *light -= pixel.irradiance;
    }
    light
}

/// One pass along an axis of the image.
struct Pass<'a> {
    pixels: &'a [SkinPixel],
    number: &'a Plane<u32>,
    light: &'a [Rgb],
    axis: usize,
    mm_per_px: f32,
}

impl Pass<'_> {
    /// Mixes a pixel's light with its neighbours'.
    fn mix(&self, pixel: &SkinPixel, own: Rgb) -> Rgb {
        let support = pixel.scatter_mm * SUPPORT;
        let inverse = support.map(|r| {
            if r > 0.0 {
                1.0 / (r * r)
            } else {
                f32::INFINITY
            }
        });
        let radius = ((support.max() / self.mm_per_px) as usize).min(MAX_RADIUS);
        let (mut sum, mut total) = (own, Rgb::repeat(1.0));
        let at = pixel.at.map(|v| v as usize);
        let size = [self.number.width(), self.number.height()];
        for step in 1..=radius {
            let places = [
                at[self.axis].checked_sub(step),
                Some(at[self.axis] + step).filter(|v| *v < size[self.axis]),
            ];
            for place in places.into_iter().flatten() {
                let mut there = at;
                there[self.axis] = place;
                let index = self.number[(there[0], there[1])] as usize;
                let Some(other) = self.pixels.get(index) else {
                    continue;
                };
                let across = step as f32 * self.mm_per_px;
                let deeper = other.depth_z - pixel.depth_z;
                let squared = across * across + deeper * deeper;
                for k in 0..3 {
                    let left = 1.0 - squared * inverse[k];
                    if left > 0.0 {
                        let weight = left * left;
                        sum[k] += self.light[index][k] * weight;
                        total[k] += weight;
                    }
                }
            }
        }
        sum.component_div(&total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::{Point3, Vector3};

    fn camera() -> Camera {
        let eye = Point3::new(0.0, 0.0, 500.0);
        // 0.5 mm per pixel at a depth of 500 mm
        let fov = 2.0 * (16.0_f64 / 500.0).atan();
        Camera::look_at(64, 64, eye, Point3::origin(), Vector3::y(), fov).expect("valid")
    }

    fn sheet(depth_z: impl Fn(u32) -> f32, light: impl Fn(u32) -> f32) -> Vec<SkinPixel> {
        let pixel = |i: u32| SkinPixel {
            at: [i % 64, i / 64],
            depth_z: depth_z(i % 64),
            scatter_mm: Rgb::new(1.2, 0.4, 0.0),
            irradiance: Rgb::repeat(light(i % 64)),
        };
        (0..64 * 64).map(pixel).collect()
    }

    #[test]
    fn even_light_stays_and_shadow_borders_redden() {
        let even = spread(&camera(), &sheet(|_| 500.0, |_| 0.7));
        assert!(even.iter().all(|d| d.abs().max() < 1e-6));
        let step = sheet(|_| 500.0, |x| if x < 32 { 0.0 } else { 1.0 });
        let added = spread(&camera(), &step);
        let at = |x: usize| added[30 * 64 + x];
        // Dark side: red comes over, then green, never blue; the bright side loses as much
        assert!(at(31).x > 0.2 && at(31).x < 0.5 && at(30).x > at(30).y && at(31).y > 0.02);
        assert_eq!(at(31).z, 0.0);
        for k in 0..6 {
            assert!((at(31 - k) + at(32 + k)).abs().max() < 1e-5);
        }
        // The slope in the middle of red's border is the kernel's peak, 15 / (16 support)
        let slope = (1.0 + at(32).x - at(31).x) / 0.5;
        let expected = 15.0 / (16.0 * 1.2 * SUPPORT);
        assert!((slope / expected - 1.0).abs() < 0.02, "{slope} {expected}");
        let total = |light: &dyn Fn(usize) -> f32| (0..64).map(light).sum::<f32>();
        assert!(total(&|x| at(x).x).abs() < 1e-3);
    }

    #[test]
    fn light_stays_on_its_side_of_a_gap_in_depth() {
        let cliff = sheet(
            |x| if x < 32 { 500.0 } else { 510.0 },
            |x| if x < 32 { 0.0 } else { 1.0 },
        );
        assert!(
            spread(&camera(), &cliff)
                .iter()
                .all(|d| d.abs().max() < 1e-6)
        );
        assert!(spread(&camera(), &[]).is_empty());
    }
}
