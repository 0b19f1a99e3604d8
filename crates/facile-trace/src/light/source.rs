//! Lights as recipes and scene files name them, and what they become in the world of a camera.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Light;
use crate::TraceError;
use crate::backdrop::turned;
use crate::camera::Camera;
use crate::environment::EnvironmentMap;
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

pub(super) const WHITE: [f32; 3] = [1.0; 3];

fn white() -> [f32; 3] {
    WHITE
}

/// A light as recipes and scene files give it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Light that changes smoothly with direction, without shadows: nine numbers a channel.
    SphericalHarmonic {
        /// Factor on all coefficients.
        intensity: f32,
        /// What a white surface of unit normal `n` gets, linear RGB: the constant, then the factors of `x, y, z, xy, yz, zx,
        /// 3 z^2 - 1, x^2 - y^2` of `n`. Their sum is cut at 0.
        coefficients: [[f32; 3]; 9],
        /// Turn about the head's vertical axis, to the subject's left, degrees.
        #[serde(default)]
        turn_deg: f32,
    },
    /// A picture of the surroundings that shines from all directions.
    Environment {
        /// The picture's file, for records.
        file: String,
        /// The picture; loaded by who reads the file's name.
        #[serde(skip)]
        map: Option<Arc<EnvironmentMap>>,
        /// Factor on the picture's light.
        intensity: f32,
        /// Linear RGB, white by default.
        #[serde(default = "white")]
        color: [f32; 3],
        /// Turn of the surroundings about the head's vertical axis, to the subject's left, degrees.
        #[serde(default)]
        turn_deg: f32,
        /// Lamps that stand for the picture, each with its shadows; 32 by default. 0 for smooth light without shadows.
        #[serde(default = "environment_samples")]
        samples: u32,
    },
}

/// Lamps of an environment at most.
pub const MAX_ENVIRONMENT_SAMPLES: u32 = 1024;

fn environment_samples() -> u32 {
    32
}

/// Points of an area light at most.
pub const MAX_AREA_SAMPLES: u32 = 256;

fn area_samples() -> u32 {
    16
}

fn earth() -> [f32; 3] {
    [0.25, 0.2, 0.16]
}

impl LightSource {
    /// Checks the numbers and adds the light, in the world of `camera`, to `lights`: an area light as many patches.
    pub(crate) fn add_to(
        &self,
        lights: &mut Vec<Light>,
        camera: &Camera,
    ) -> Result<(), TraceError> {
        match self {
            Self::Area { .. } => return self.add_patches(lights, camera),
            Self::Environment { .. } => return self.add_environment(lights),
            Self::SphericalHarmonic { .. } => lights.push(self.harmonic()?),
            _ => lights.push(self.in_world(camera)?),
        }
        Ok(())
    }

    fn harmonic(&self) -> Result<Light, TraceError> {
        let Self::SphericalHarmonic {
            intensity,
            coefficients,
            turn_deg,
        } = self
        else {
            return Err(unexpected());
        };
        let scaled = coefficients.map(|c| c.map(|v| v * intensity));
        if !scaled.iter().flatten().all(|v| v.is_finite()) || !turn_deg.is_finite() {
            return Err(TraceError::Setting {
                name: "spherical harmonic intensity and coefficients",
                expected: "finite numbers",
                got: format!("{intensity} and {coefficients:?}"),
            });
        }
        Ok(Light::Harmonic {
            coefficients: scaled,
            turn: turn_deg.to_radians(),
        })
    }

    /// An environment as lamps far away, or as smooth light.
    fn add_environment(&self, lights: &mut Vec<Light>) -> Result<(), TraceError> {
        let Self::Environment {
            file,
            map,
            intensity,
            color,
            turn_deg,
            samples,
        } = self
        else {
            return Err(unexpected());
        };
        let gain = Rgb::from(*color) * *intensity;
        let is_gain = gain.iter().all(|v| v.is_finite() && *v >= 0.0);
        if !is_gain || !turn_deg.is_finite() || *samples > MAX_ENVIRONMENT_SAMPLES {
            return Err(TraceError::Setting {
                name: "environment intensity, color, turn_deg and samples",
                expected: "finite numbers of at least 0, a finite turn and at most 1024 samples",
                got: format!("{intensity}, {color:?}, {turn_deg} and {samples}"),
            });
        }
        let Some(map) = map else {
            return Err(TraceError::Setting {
                name: "environment file",
                expected: "a picture that was loaded",
                got: file.clone(),
            });
        };
        let turn = turn_deg.to_radians();
        if *samples == 0 {
            let coefficients = map.harmonics().map(|c| {
                let c = Rgb::from(c).component_mul(&gain);
                [c.x, c.y, c.z]
            });
            lights.push(Light::Harmonic { coefficients, turn });
            return Ok(());
        }
        let patches = map.patches(*samples as usize).into_iter();
        lights.extend(patches.map(|patch| Light::Directional {
            towards: unit_or(turned(patch.towards, turn), Vec3::y()),
            power: patch.power.component_mul(&gain),
        }));
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
    pub(super) fn in_world(&self, camera: &Camera) -> Result<Light, TraceError> {
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
        | Self::Ambient { intensity, color }) = *self
        else {
            return Err(unexpected());
        };
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
            } => hemisphere(power, ground, intensity)?,
            Self::SphericalHarmonic { .. } | Self::Environment { .. } => return Err(unexpected()),
        })
    }
}

/// A sky that lights a surface facing upwards to `power`, and its ground.
fn hemisphere(power: Rgb, ground: [f32; 3], intensity: f32) -> Result<Light, TraceError> {
    let ground = Rgb::from(ground) * intensity;
    if !ground.iter().all(|v| v.is_finite() && *v >= 0.0) {
        return Err(TraceError::Setting {
            name: "hemisphere ground",
            expected: "finite numbers of at least 0",
            got: format!("{ground:?}"),
        });
    }
    Ok(Light::Ambient {
        power: (power + ground) * 0.5,
        slope: (power - ground) * 0.5,
        up: Vec3::y(),
    })
}

/// A source that another function turns into lights: our own mistake, not the user's.
fn unexpected() -> TraceError {
    TraceError::Setting {
        name: "light source",
        expected: "a single lamp",
        got: "light from all around".to_owned(),
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
