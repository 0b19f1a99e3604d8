//! Lights.
//!
//! A source of intensity 1 at 1,000 mm lights a white diffuse surface that faces it to 1.0 (point and spot fall off with
//! the square of the distance); directional and ambient sources light it to their intensity, at any distance.

use serde::{Deserialize, Serialize};

use crate::TraceError;
use crate::camera::Camera;
use crate::math::{Rgb, Vec3, unit_or, vec3_from_point};
use crate::sampling::lattice_offsets;

/// Distance at which a point source of intensity 1 lights a facing surface to 1, mm.
pub const REFERENCE_DISTANCE_MM: f32 = 1_000.0;

/// In whose frame a light's position and direction are given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Attach {
    /// The head's frame, which is the world: `x` to the subject's left, `y` up, `z` out of the face.
    #[default]
    Head,
    /// The camera's frame, mm: `x` right and `y` up in the image, `z` towards the viewer; the origin is the camera.
    Camera,
}

const WHITE: [f32; 3] = [1.0; 3];

fn white() -> [f32; 3] {
    WHITE
}

/// A light as recipes and scene files give it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum LightSource {
    /// A point that shines in all directions.
    Point {
        /// Place, mm.
        position: [f32; 3],
        /// Strength, see the [module](self).
        intensity: f32,
        /// Linear RGB, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
        /// Frame of the position.
        #[serde(default)]
        attach: Attach,
    },
    /// A point that shines in a cone.
    Spot {
        /// Place, mm.
        position: [f32; 3],
        /// Where the middle of the cone goes, mm.
        target: [f32; 3],
        /// Strength in the middle of the cone, see the [module](self).
        intensity: f32,
        /// Angle between the middle and the end of the cone, degrees, in `(0, 90]`.
        angle_deg: f32,
        /// Share of the angle over which the light fades to 0, in `[0, 1]`.
        #[serde(default)]
        softness: f32,
        /// Linear RGB, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
        /// Frame of position and target.
        #[serde(default)]
        attach: Attach,
    },
    /// Parallel light.
    Directional {
        /// Direction in which the light travels, any length.
        direction: [f32; 3],
        /// Strength, see the [module](self).
        intensity: f32,
        /// Linear RGB, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
        /// Frame of the direction.
        #[serde(default)]
        attach: Attach,
    },
    /// The same light from everywhere, without shadows.
    Ambient {
        /// Strength, see the [module](self).
        intensity: f32,
        /// Linear RGB, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
    },
    /// A sky above and a ground below, without shadows: what a surface gets runs evenly from the sky's light, where it
    /// faces upwards, to the ground's.
    Hemisphere {
        /// Strength on a surface that faces upwards, see the [module](self).
        intensity: f32,
        /// Linear RGB of the sky, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
        /// Linear RGB of the ground, dark brown by default.
        #[serde(default = "earth")]
        ground: [f32; 3],
    },
    /// A rectangle that shines to its front: soft shadows.
    Area {
        /// Middle, mm.
        position: [f32; 3],
        /// What it faces, mm.
        target: [f32; 3],
        /// Width and height, mm.
        size: [f32; 2],
        /// Strength, see the [module](self): that of a point, seen from far in front.
        intensity: f32,
        /// Linear RGB, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
        /// Points that stand for the rectangle, spread evenly over it; 16 by default. Shadows have as many steps.
        #[serde(default = "area_samples")]
        samples: u32,
        /// Frame of position and target.
        #[serde(default)]
        attach: Attach,
    },
}

/// Points of an area light at most.
pub const MAX_AREA_SAMPLES: u32 = 256;

fn area_samples() -> u32 {
    16
}

fn earth() -> [f32; 3] {
    [0.25, 0.2, 0.16]
}

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
}

/// All light without shadows: channel `k` of what a surface of unit normal `n` gets is `even[k] + slope[k] . n`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AmbientSum {
    pub(crate) even: Rgb,
    pub(crate) slope: [Vec3; 3],
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
        }
        sum
    }

    /// What a surface gets.
    #[cfg(test)]
    pub(crate) fn on(&self, normal: Vec3) -> Rgb {
        Rgb::from_fn(|k, _| self.even[k] + self.slope[k].dot(&normal))
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

impl LightSource {
    /// Checks the numbers and adds the light, in the world of `camera`, to `lights`: an area light as many patches.
    pub(crate) fn add_to(
        &self,
        lights: &mut Vec<Light>,
        camera: &Camera,
    ) -> Result<(), TraceError> {
        if let Self::Area { .. } = self {
            return self.add_patches(lights, camera);
        }
        lights.push(self.in_world(camera)?);
        Ok(())
    }

    /// The patches of an area light, each in the middle of its share of the rectangle.
    fn add_patches(&self, lights: &mut Vec<Light>, camera: &Camera) -> Result<(), TraceError> {
        let Self::Area {
            target,
            size,
            samples,
            attach,
            ..
        } = *self
        else {
            return Ok(());
        };
        let is_size = size.iter().all(|v| *v >= 0.0 && v.is_finite());
        if !is_size || !(1..=MAX_AREA_SAMPLES).contains(&samples) {
            return Err(TraceError::Setting {
                name: "area light size and samples",
                expected: "finite lengths of at least 0 and 1 to 256 samples",
                got: format!("{size:?} and {samples}"),
            });
        }
        let Light::Point { position, power } = self.in_world(camera)? else {
            return Ok(());
        };
        let axis = direction(point_in_world(target, attach, camera)? - position)?;
        // Width runs level, unless the rectangle lies flat
        let level = unit_or(Vec3::y().cross(&axis), Vec3::x());
        let upwards = axis.cross(&level);
        for [x, y] in lattice_offsets(samples) {
            let across = level * ((x as f32 - 0.5) * size[0]);
            let along = upwards * ((y as f32 - 0.5) * size[1]);
            lights.push(Light::Patch {
                position: position + across + along,
                axis,
                power: power / samples as f32,
            });
        }
        Ok(())
    }

    /// Checks the numbers and moves the light to the world of `camera`; an area light as the point in its middle.
    fn in_world(&self, camera: &Camera) -> Result<Light, TraceError> {
        let bad = |name, expected, got: String| {
            Err(TraceError::Setting {
                name,
                expected,
                got,
            })
        };
        let (Self::Point {
            intensity, color, ..
        }
        | Self::Spot {
            intensity, color, ..
        }
        | Self::Directional {
            intensity, color, ..
        }
        | Self::Area {
            intensity, color, ..
        }
        | Self::Hemisphere {
            intensity, color, ..
        }
        | Self::Ambient { intensity, color }) = *self;
        let power = Rgb::from(color) * intensity;
        if !power.iter().all(|v| v.is_finite() && *v >= 0.0) {
            let got = format!("{intensity} and {color:?}");
            return bad(
                "light intensity and color",
                "finite numbers of at least 0",
                got,
            );
        }
        Ok(match *self {
            Self::Point {
                position, attach, ..
            }
            | Self::Area {
                position, attach, ..
            } => Light::Point {
                position: point_in_world(position, attach, camera)?,
                power: power * (REFERENCE_DISTANCE_MM * REFERENCE_DISTANCE_MM),
            },
            Self::Spot {
                position,
                target,
                angle_deg,
                softness,
                attach,
                ..
            } => {
                if !(angle_deg > 0.0 && angle_deg <= 90.0 && (0.0..=1.0).contains(&softness)) {
                    let got = format!("{angle_deg} and {softness}");
                    let expected = "an angle in (0, 90] degrees and a softness in [0, 1]";
                    return bad("spot angle_deg and softness", expected, got);
                }
                let position = point_in_world(position, attach, camera)?;
                let target = point_in_world(target, attach, camera)?;
                let cosine = |degrees: f32| libm::cosf(degrees.to_radians());
                Light::Spot {
                    position,
                    axis: direction(target - position)?,
                    cos_inner: cosine(angle_deg * (1.0 - softness)),
                    cos_outer: cosine(angle_deg),
                    power: power * (REFERENCE_DISTANCE_MM * REFERENCE_DISTANCE_MM),
                }
            }
            Self::Directional {
                direction: travels,
                attach,
                ..
            } => {
                let travels = vector_in_world(Vec3::from(travels), attach, camera);
                Light::Directional {
                    towards: -direction(travels)?,
                    power,
                }
            }
            Self::Ambient { .. } => Light::Ambient {
                power,
                slope: Rgb::zeros(),
                up: Vec3::y(),
            },
            Self::Hemisphere {
                intensity, ground, ..
            } => {
                let ground = Rgb::from(ground) * intensity;
                if !ground.iter().all(|v| v.is_finite() && *v >= 0.0) {
                    let got = format!("{ground:?}");
                    return bad("hemisphere ground", "finite numbers of at least 0", got);
                }
                Light::Ambient {
                    power: (power + ground) * 0.5,
                    slope: (power - ground) * 0.5,
                    up: Vec3::y(),
                }
            }
        })
    }
}

fn vector_in_world(v: Vec3, attach: Attach, camera: &Camera) -> Vec3 {
    match attach {
        Attach::Head => v,
        Attach::Camera => {
            let world_from_camera = camera.camera_from_world().transpose().cast::<f32>();
            world_from_camera * Vec3::new(v.x, -v.y, -v.z)
        }
    }
}

fn point_in_world(point: [f32; 3], attach: Attach, camera: &Camera) -> Result<Vec3, TraceError> {
    let point = Vec3::from(point);
    if !point.iter().all(|v| v.is_finite()) {
        return Err(TraceError::NotFinite {
            what: "light position",
            index: 0,
            value: format!("{:?}", point.as_slice()),
        });
    }
    Ok(match attach {
        Attach::Head => point,
        Attach::Camera => {
            vec3_from_point(camera.position()) + vector_in_world(point, attach, camera)
        }
    })
}

fn direction(v: Vec3) -> Result<Vec3, TraceError> {
    let unit = unit_or(v, Vec3::zeros());
    if unit.norm_squared() > 0.5 && unit.norm_squared() < 2.0 {
        Ok(unit)
    } else {
        Err(TraceError::Setting {
            name: "light direction",
            expected: "a finite direction that is not zero",
            got: format!("{:?}", v.as_slice()),
        })
    }
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
            Self::Ambient { .. } => None,
        }
    }

    /// The point that a shadow ray goes to; `None` for light from infinitely far.
    pub(crate) fn position(&self) -> Option<Vec3> {
        match *self {
            Self::Point { position, .. }
            | Self::Spot { position, .. }
            | Self::Patch { position, .. } => Some(position),
            Self::Directional { .. } | Self::Ambient { .. } => None,
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
