//! What a camera does to light: blur, exposure, white balance, noise. The last step of an image; labels never pass here.
//!
//! In this order, on linear light: a Gaussian blur of the lens, the gain of exposure and white balance, the noise of
//! photons and read-out, then 8-bit sRGB with what is too bright cut off. The noise of a channel of value `v`, after the
//! gain, is normal with variance `photon_noise v + read_noise^2`: source: Foi, Trimeche, Katkovnik, Egiazarian, Practical
//! Poissonian-Gaussian Noise Modeling and Fitting for Single-Image Raw-Data, IEEE TIP 17(10), 2008.

use facile_core::Plane;
use facile_core::rng::RandomStream;
use serde::{Deserialize, Serialize};

use crate::TraceError;
use crate::math::Rgb;
use crate::srgb::srgb8;

/// A camera's sensor and lens. The default changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sensor {
    /// Brightness in stops: each doubles the light, in `[-10, 10]`.
    pub exposure_stops: f32,
    /// Gain of each linear RGB channel, in `[0, 10]`.
    pub white_balance: [f32; 3],
    /// Standard deviation of the blur, px, in `[0, 20]`.
    pub blur_px: f32,
    /// Variance of the noise over the value, in `[0, 1]`: 0.0005 a phone in daylight, 0.005 in a dim room.
    pub photon_noise: f32,
    /// Standard deviation of the noise in the dark, in `[0, 1]`, of a white of 1.
    pub read_noise: f32,
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            exposure_stops: 0.0,
            white_balance: [1.0; 3],
            blur_px: 0.0,
            photon_noise: 0.0,
            read_noise: 0.0,
        }
    }
}

impl Sensor {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for one out of the range that its field states.
    pub fn check(&self) -> Result<(), TraceError> {
        let [red, green, blue] = self.white_balance;
        let numbers = [
            ("exposure_stops", self.exposure_stops, -10.0..=10.0),
            ("white_balance", red, 0.0..=10.0),
            ("white_balance", green, 0.0..=10.0),
            ("white_balance", blue, 0.0..=10.0),
            ("blur_px", self.blur_px, 0.0..=20.0),
            ("photon_noise", self.photon_noise, 0.0..=1.0),
            ("read_noise", self.read_noise, 0.0..=1.0),
        ];
        match numbers.into_iter().find(|(_, v, range)| !range.contains(v)) {
            Some((name, v, range)) => Err(TraceError::Setting {
                name,
                expected: "a number in the range that the documentation states",
                got: format!("{v}, not in {range:?}"),
            }),
            None => Ok(()),
        }
    }

    /// The 8-bit sRGB image of linear light. The noise is that of `stream`, which is not touched without noise.
    pub fn develop(&self, color: &Plane<Rgb>, stream: &mut RandomStream) -> Plane<[u8; 3]> {
        if *self == Self::default() {
            return srgb8(color);
        }
        let mut image = if self.blur_px > 0.0 {
            blurred(color, self.blur_px)
        } else {
            color.clone()
        };
        let stops = libm::exp2f(self.exposure_stops);
        let gain = Rgb::from(self.white_balance) * stops;
        let has_noise = self.photon_noise > 0.0 || self.read_noise > 0.0;
        let read = self.read_noise * self.read_noise;
        for pixel in image.as_mut_slice() {
            pixel.component_mul_assign(&gain);
            if has_noise {
                for v in pixel.iter_mut() {
                    let variance = self.photon_noise * v.max(0.0) + read;
                    *v += variance.sqrt() * stream.normal() as f32;
                }
            }
        }
        srgb8(&image)
    }
}

/// The image under a Gaussian of standard deviation `sigma` px; its border goes on outside.
fn blurred(image: &Plane<Rgb>, sigma: f32) -> Plane<Rgb> {
    let radius = libm::ceilf(3.0 * sigma) as usize;
    let weight = |i: usize| libm::expf(-0.5 * (i as f32 / sigma) * (i as f32 / sigma));
    let mut weights: Vec<f32> = (0..=radius).map(weight).collect();
    let total = weights[0] + 2.0 * weights[1..].iter().sum::<f32>();
    for w in &mut weights {
        *w /= total;
    }
    let (width, height) = (image.width(), image.height());
    let mix = |at: &dyn Fn(usize) -> Rgb, place: usize, count: usize| {
        let mut sum = at(place) * weights[0];
        for (step, weight) in weights.iter().enumerate().skip(1) {
            let (before, after) = (place.saturating_sub(step), (place + step).min(count - 1));
            sum += (at(before) + at(after)) * *weight;
        }
        sum
    };
    let across = Plane::from_fn(width, height, |x, y| mix(&|x| image[(x, y)], x, width));
    Plane::from_fn(width, height, |x, y| mix(&|y| across[(x, y)], y, height))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn develop(sensor: &Sensor, image: &Plane<Rgb>) -> Plane<[u8; 3]> {
        sensor.check().expect("in range");
        sensor.develop(image, &mut RandomStream::new(1, 2))
    }

    #[test]
    fn a_perfect_sensor_changes_nothing() {
        let image = Plane::from_fn(9, 5, |x, y| Rgb::new(x as f32 / 9.0, y as f32 / 5.0, 0.5));
        assert_eq!(develop(&Sensor::default(), &image), srgb8(&image));
    }

    #[test]
    fn gains_are_stops_and_channels() {
        let image = Plane::filled(2, 2, Rgb::repeat(0.1));
        let sensor = Sensor {
            exposure_stops: 1.0,
            white_balance: [1.0, 0.5, 2.0],
            ..Sensor::default()
        };
        let expected = srgb8(&Plane::filled(2, 2, Rgb::new(0.2, 0.1, 0.4)));
        assert_eq!(develop(&sensor, &image), expected);
    }

    #[test]
    fn noise_has_the_stated_variance_and_repeats() {
        let sensor = Sensor {
            photon_noise: 0.002,
            read_noise: 0.01,
            ..Sensor::default()
        };
        for level in [0.1_f32, 0.5] {
            let image = Plane::filled(128, 128, Rgb::repeat(level));
            let noisy = develop(&sensor, &image);
            assert_eq!(noisy, develop(&sensor, &image));
            let linear = |c: u8| f64::from(facile_core::color::LINEAR_FROM_SRGB8[usize::from(c)]);
            let values: Vec<f64> = noisy
                .as_slice()
                .iter()
                .flatten()
                .map(|c| linear(*c))
                .collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
            let expected = 0.002 * f64::from(level) + 1e-4;
            assert!((mean - f64::from(level)).abs() < 2e-3, "{mean}");
            assert!(
                (variance / expected - 1.0).abs() < 0.05,
                "{variance} {expected}"
            );
        }
    }

    #[test]
    fn blur_keeps_light_and_has_the_stated_width() {
        let mut image = Plane::filled(41, 41, Rgb::zeros());
        image[(20, 20)] = Rgb::repeat(1.0);
        let out = blurred(&image, 2.0);
        let sum: f32 = out.as_slice().iter().map(|c| c.x).sum();
        assert!((sum - 1.0).abs() < 1e-4);
        let spread: f32 = (0..41)
            .flat_map(|y| (0..41).map(move |x| (x, y)))
            .map(|at| out[at].x * (at.0 as f32 - 20.0).powi(2))
            .sum();
        assert!((spread - 4.0).abs() < 0.15, "{spread}");
        let even = blurred(&Plane::filled(7, 3, Rgb::repeat(0.3)), 5.0);
        assert!(even.as_slice().iter().all(|c| (c.x - 0.3).abs() < 1e-5));
    }

    #[test]
    fn impossible_sensors_are_refused() {
        for sensor in [
            Sensor {
                blur_px: -1.0,
                ..Sensor::default()
            },
            Sensor {
                photon_noise: f32::NAN,
                ..Sensor::default()
            },
            Sensor {
                exposure_stops: 99.0,
                ..Sensor::default()
            },
        ] {
            assert!(sensor.check().is_err());
        }
    }
}
