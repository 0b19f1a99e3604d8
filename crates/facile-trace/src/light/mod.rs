//! Lights.
//!
//! A source of intensity 1 at 1,000 mm lights a white diffuse surface that faces it to 1.0 (point and spot fall off with
//! the square of the distance); directional and ambient sources light it to their intensity, at any distance.

mod source;

use nalgebra::Matrix3;

pub use source::{
    Attach, LightSource, MAX_AREA_SAMPLES, MAX_ENVIRONMENT_SAMPLES, REFERENCE_DISTANCE_MM,
};

use crate::backdrop::turned;
use crate::math::{Rgb, Vec3};

/// A light in the world, ready to shade with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Light {
    Point {
        position: Vec3,
        power: Rgb,
    },
    Spot {
        position: Vec3,
        axis: Vec3,
        cos_inner: f32,
        cos_outer: f32,
        power: Rgb,
    },
    Directional {
        towards: Vec3,
        power: Rgb,
    },
    /// A small piece of an area light.
    Patch {
        position: Vec3,
        /// Unit direction to its front.
        axis: Vec3,
        power: Rgb,
    },
    /// Light without shadows: `power` on a surface across `up`, `power + slope` on one that faces it.
    Ambient {
        power: Rgb,
        slope: Rgb,
        up: Vec3,
    },
    /// Light without shadows by nine functions of the normal, turned about `y` by `turn`.
    Harmonic {
        coefficients: [[f32; 3]; 9],
        turn: f32,
    },
}

/// All light without shadows: channel `k` of what a surface of unit normal `n` gets is `even[k] + slope[k] . n + n . bend[k] n`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AmbientSum {
    pub(crate) even: Rgb,
    pub(crate) slope: [Vec3; 3],
    pub(crate) bend: [Matrix3<f32>; 3],
}

impl AmbientSum {
    pub(crate) fn of(lights: &[Light]) -> Self {
        let mut sum = Self::default();
        for light in lights {
            if let Light::Ambient { power, slope, up } = light {
                sum.even += power;
                for k in 0..3 {
                    sum.slope[k] += up * slope[k];
                }
            }
            if let Light::Harmonic { coefficients, turn } = light {
                sum.add_harmonics(coefficients, *turn);
            }
        }
        sum
    }

    /// What a surface gets.
    #[cfg(test)]
    pub(crate) fn on(&self, normal: Vec3) -> Rgb {
        self.on_without_bend(normal) + self.bend_on(normal)
    }

    /// The part that is linear in the normal.
    pub(crate) fn on_without_bend(&self, normal: Vec3) -> Rgb {
        Rgb::from_fn(|k, _| self.even[k] + self.slope[k].dot(&normal))
    }

    /// The rest, cut where the sum would be negative.
    pub(crate) fn bend_on(&self, normal: Vec3) -> Rgb {
        let bend = Rgb::from_fn(|k, _| normal.dot(&(self.bend[k] * normal)));
        bend.sup(&-self.on_without_bend(normal))
    }

    fn add_harmonics(&mut self, c: &[[f32; 3]; 9], turn: f32) {
        let axes = [Vec3::x(), Vec3::y(), Vec3::z()].map(|axis| turned(axis, turn));
        let world = Matrix3::from_columns(&axes);
        for k in 0..3 {
            let [xy, yz, zx] = [c[4][k] / 2.0, c[5][k] / 2.0, c[6][k] / 2.0];
            let bend = Matrix3::new(c[8][k], xy, zx, xy, -c[8][k], yz, zx, yz, 3.0 * c[7][k]);
            self.even[k] += c[0][k] - c[7][k];
            self.slope[k] += world * Vec3::new(c[1][k], c[2][k], c[3][k]);
            self.bend[k] += world * bend * world.transpose();
        }
    }
}

/// What reaches a point from a light when nothing is in between.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arrival {
    /// Unit direction to the light.
    pub(crate) direction: Vec3,
    /// Light on a surface that faces the source.
    pub(crate) power: Rgb,
}

impl Light {
    /// What reaches `point`; `None` for light without a direction, and outside a spot's cone. The oracle of
    /// [`crate::direct`].
    #[cfg(test)]
    pub(crate) fn arrival(&self, point: Vec3) -> Option<Arrival> {
        match *self {
            Self::Point { position, power } => falling_off(position, power, point),
            Self::Spot {
                position,
                axis,
                cos_inner,
                cos_outer,
                power,
            } => {
                let arrival = falling_off(position, power, point)?;
                let cosine = -arrival.direction.dot(&axis);
                let fade = if cosine >= cos_inner {
                    1.0
                } else if cosine <= cos_outer {
                    return None;
                } else {
                    let x = (cosine - cos_outer) / (cos_inner - cos_outer);
                    x * x * (3.0 - 2.0 * x)
                };
                Some(Arrival {
                    power: arrival.power * fade,
                    ..arrival
                })
            }
            Self::Patch {
                position,
                axis,
                power,
            } => {
                let arrival = falling_off(position, power, point)?;
                let cosine = -arrival.direction.dot(&axis);
                (cosine > 0.0).then(|| Arrival {
                    power: arrival.power * cosine,
                    ..arrival
                })
            }
            Self::Directional { towards, power } => Some(Arrival {
                direction: towards,
                power,
            }),
            Self::Ambient { .. } | Self::Harmonic { .. } => None,
        }
    }

    /// The point that a shadow ray goes to; `None` for light from infinitely far.
    pub(crate) fn position(&self) -> Option<Vec3> {
        match *self {
            Self::Point { position, .. }
            | Self::Spot { position, .. }
            | Self::Patch { position, .. } => Some(position),
            Self::Directional { .. } | Self::Ambient { .. } | Self::Harmonic { .. } => None,
        }
    }
}

#[cfg(test)]
fn falling_off(position: Vec3, power: Rgb, point: Vec3) -> Option<Arrival> {
    let to_light = position - point;
    let squared = to_light.norm_squared();
    (squared > 1e-12).then(|| Arrival {
        direction: to_light / squared.sqrt(),
        power: power / squared,
    })
}

#[cfg(test)]
mod tests;
