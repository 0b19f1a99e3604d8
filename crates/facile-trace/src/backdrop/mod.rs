//! What is seen behind the head: a gradient, a picture, a room out of focus, or the surroundings that light it.
//!
//! Gradients and pictures fill the image whatever the camera; surroundings turn with it. A backdrop is looked up where no
//! ray hits, so it changes neither labels nor what was traced; a scene without one has its plain background.

mod room;

use std::sync::Arc;

use facile_core::Texture;

use crate::camera::Camera;
use crate::environment::EnvironmentMap;
use crate::math::{Rgb, Vec3};

pub use room::room;

/// What is seen where nothing is hit.
#[derive(Clone, Debug)]
pub enum Backdrop {
    /// Linear RGB of the top and the bottom of the image.
    Gradient {
        /// At the top.
        top: Rgb,
        /// At the bottom.
        bottom: Rgb,
    },
    /// A picture that fills the image, its longer side cut on both ends.
    Picture {
        /// The picture.
        texture: Arc<Texture>,
        /// Factor on its light.
        gain: f32,
    },
    /// Surroundings, by direction.
    Environment {
        /// The map.
        map: Arc<EnvironmentMap>,
        /// Turn of the map about the vertical axis, to the subject's left, rad.
        turn: f32,
        /// Factor on its light.
        gain: Rgb,
    },
}

impl Backdrop {
    /// Light along a ray of `camera` that hits nothing. Rays that bounced away from the image see its mean.
    pub(crate) fn color(&self, camera: &Camera, direction: Vec3) -> Rgb {
        match self {
            Self::Environment { map, turn, gain } => {
                map.light(turned(direction, -turn)).component_mul(gain)
            }
            Self::Gradient { top, bottom } => match camera.px_of_direction(direction) {
                Some([_, y]) => top.lerp(bottom, (y / camera.height() as f32).clamp(0.0, 1.0)),
                None => (top + bottom) * 0.5,
            },
            Self::Picture { texture, gain } => {
                let size = [camera.width(), camera.height()].map(|v| v as f32);
                let own = [texture.width(), texture.height()].map(|v| v as f32);
                // Picture's texels per pixel: as many as both sides have
                let scale = (own[0] / size[0]).min(own[1] / size[1]);
                let px = camera
                    .px_of_direction(direction)
                    .unwrap_or(size.map(|v| v / 2.0));
                let [x, y] = [0, 1].map(|k| {
                    let px = px[k].clamp(0.0, size[k]);
                    ((px - size[k] / 2.0) * scale + own[k] / 2.0) / own[k]
                });
                Rgb::from(texture.sample([x, 1.0 - y])) * *gain
            }
        }
    }
}

/// A direction turned about `y`, to the subject's left.
pub(crate) fn turned(v: Vec3, angle: f32) -> Vec3 {
    let (sin, cos) = libm::sincosf(angle);
    Vec3::new(v.x * cos + v.z * sin, v.y, v.z * cos - v.x * sin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::{Point3, Vector3};

    fn camera(width: usize, height: usize) -> Camera {
        let eye = Point3::new(0.0, 0.0, 500.0);
        Camera::look_at(width, height, eye, Point3::origin(), Vector3::y(), 0.5).expect("valid")
    }

    #[test]
    fn gradients_run_from_top_to_bottom() {
        let camera = camera(40, 20);
        let ramp = Backdrop::Gradient {
            top: Rgb::repeat(1.0),
            bottom: Rgb::zeros(),
        };
        for y in [0.5, 10.0, 19.5] {
            let direction = Vec3::from(camera.direction([13.0, y]));
            let found = ramp.color(&camera, direction * 3.0).x;
            assert!(
                (found - (1.0 - y as f32 / 20.0)).abs() < 1e-4,
                "{y}: {found}"
            );
        }
        assert_eq!(ramp.color(&camera, Vec3::z()).x, 0.5);
    }

    #[test]
    fn pictures_keep_their_shape() {
        // A square picture of four quarters in a wide image: all of its width, the middle of its height
        let camera = camera(40, 20);
        let texels = (0..64 * 64)
            .map(|i| {
                if i % 64 < 32 {
                    [255, 0, 0]
                } else {
                    [0, 0, if i < 2048 { 255 } else { 128 }]
                }
            })
            .collect();
        let picture = Backdrop::Picture {
            texture: Arc::new(Texture::new(64, 64, texels)),
            gain: 1.0,
        };
        let at = |x: f64, y: f64| picture.color(&camera, Vec3::from(camera.direction([x, y])));
        assert_eq!(at(2.0, 10.0), Rgb::new(1.0, 0.0, 0.0));
        assert_eq!(at(38.0, 2.0), Rgb::new(0.0, 0.0, 1.0));
        assert!(at(38.0, 18.0).z < 0.3);
    }

    #[test]
    fn surroundings_turn() {
        let map =
            EnvironmentMap::new(4, 1, vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]]).expect("fits");
        let map = Arc::new(map);
        let camera = camera(8, 8);
        let at = |turn: f32, direction: Vec3| {
            let gain = Rgb::repeat(1.0);
            let map = map.clone();
            Backdrop::Environment { map, turn, gain }
                .color(&camera, direction)
                .x
        };
        let quarter = std::f32::consts::FRAC_PI_2;
        // What is at +z before a quarter turn to the left is at +x after it
        for d in [Vec3::new(0.6, 0.0, 0.7), Vec3::new(-0.3, 0.1, 0.9)] {
            assert!((at(0.0, d) - at(quarter, turned(d, quarter))).abs() < 1e-4);
        }
    }
}
