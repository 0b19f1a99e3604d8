//! Lights.
//!
//! A source of intensity 1 at 1,000 mm lights a white diffuse surface that faces it to 1.0 (point and spot fall off with
//! the square of the distance); directional and ambient sources light it to their intensity, at any distance.

use serde::{Deserialize, Serialize};

use crate::TraceError;
use crate::camera::Camera;
use crate::math::{Rgb, Vec3, unit_or, vec3_from_point};

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
    Ambient {
        power: Rgb,
    },
}

/// What reaches a point from a light when nothing is in between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arrival {
    /// Unit direction to the light.
    pub(crate) direction: Vec3,
    /// Light on a surface that faces the source.
    pub(crate) power: Rgb,
}

impl LightSource {
    /// Checks the numbers and moves the light to the world of `camera`.
    pub(crate) fn in_world(&self, camera: &Camera) -> Result<Light, TraceError> {
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
            Self::Ambient { .. } => Light::Ambient { power },
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
    /// What reaches `point`; `None` for light without a direction, and outside a spot's cone.
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
            Self::Point { position, .. } | Self::Spot { position, .. } => Some(position),
            Self::Directional { .. } | Self::Ambient { .. } => None,
        }
    }
}

fn falling_off(position: Vec3, power: Rgb, point: Vec3) -> Option<Arrival> {
    let to_light = position - point;
    let squared = to_light.norm_squared();
    (squared > 1e-12).then(|| Arrival {
        direction: to_light / squared.sqrt(),
        power: power / squared,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use facile_core::{Point3, Vector3};

    fn camera() -> Camera {
        let eye = Point3::new(500.0, 0.0, 0.0);
        Camera::look_at(8, 8, eye, Point3::origin(), Vector3::y(), 0.5).expect("valid")
    }

    #[test]
    fn intensity_one_at_a_metre_is_one() {
        let light = LightSource::Point {
            position: [0.0, 0.0, 1_000.0],
            intensity: 1.0,
            color: WHITE,
            attach: Attach::Head,
        };
        let light = light.in_world(&camera()).expect("valid");
        let near = light.arrival(Vec3::zeros()).expect("lit");
        assert_relative_eq!(near.power, Rgb::repeat(1.0), epsilon = 1e-6);
        let far = light.arrival(Vec3::new(0.0, 0.0, -1_000.0)).expect("lit");
        assert_relative_eq!(far.power, Rgb::repeat(0.25), epsilon = 1e-6);
        assert_relative_eq!(far.direction, Vec3::z());
    }

    #[test]
    fn camera_lights_move_with_the_camera() {
        let light = LightSource::Point {
            position: [10.0, 20.0, 30.0],
            intensity: 1.0,
            color: WHITE,
            attach: Attach::Camera,
        };
        let light = light.in_world(&camera()).expect("valid");
        // The camera looks along -x: right in the image is -z, towards the viewer is +x
        let position = light.position().expect("a place");
        assert_relative_eq!(position, Vec3::new(530.0, 20.0, -10.0), epsilon = 1e-4);
    }

    #[test]
    fn a_spot_fades_to_nothing_at_its_angle() {
        let spot = LightSource::Spot {
            position: [0.0, 0.0, 1_000.0],
            target: [0.0; 3],
            intensity: 1.0,
            angle_deg: 30.0,
            softness: 0.5,
            color: WHITE,
            attach: Attach::Head,
        };
        let light = spot.in_world(&camera()).expect("valid");
        let at = |degrees: f32| {
            let x = 1_000.0 * degrees.to_radians().tan();
            light
                .arrival(Vec3::new(x, 0.0, 0.0))
                .map_or(0.0, |a| a.power.x)
        };
        assert_relative_eq!(at(0.0), 1.0, epsilon = 1e-5);
        assert!(at(14.0) > 0.9 && at(22.0) > 0.1 && at(22.0) < at(16.0));
        assert!(at(31.0) == 0.0);
    }

    #[test]
    fn bad_numbers_are_refused() {
        let directional = |direction, intensity| LightSource::Directional {
            direction,
            intensity,
            color: WHITE,
            attach: Attach::Head,
        };
        assert!(directional([0.0; 3], 1.0).in_world(&camera()).is_err());
        assert!(directional([f32::NAN; 3], 1.0).in_world(&camera()).is_err());
        assert!(directional([1.0; 3], -1.0).in_world(&camera()).is_err());
        assert!(directional([1.0; 3], 1.0).in_world(&camera()).is_ok());
    }

    #[test]
    fn unknown_keys_are_refused() {
        let parse = |text: &str| toml::from_str::<LightSource>(text);
        assert!(parse("kind = 'ambient'\nintensity = 0.2").is_ok());
        assert!(parse("kind = 'ambient'\nintensity = 0.2\npower = 3").is_err());
        assert!(parse("kind = 'lamp'\nintensity = 0.2").is_err());
        let attached = "kind = 'point'\nposition = [1, 2, 3]\nintensity = 1\nattach = 'camera'";
        assert!(parse(attached).is_ok());
    }
}
