//! From a deformed face to views of a scene (paper section 5).

use facile_core::color::LINEAR_FROM_SRGB8;
use facile_core::{Eye, Point3, Vector3};
use facile_sim::{Pose, Side};
use facile_trace::math::Rgb;
use facile_trace::occluder::FaceFit;
use facile_trace::{
    Camera, HeadScene, Lens, Object, RenderSettings, Truth as TraceTruth, View as TracedView,
};

use super::{Face, Person, Pipeline, hair};
use crate::Error;
use crate::recipe::file::Truth;
use crate::recipe::{ImageSettings, Occluder, Optics, View};

/// Surfaces of a pixel that the truth `layers` tells of.
const LAYERS: u32 = 4;
/// Nearest depth that a lens focuses on by itself, mm.
const LEAST_FOCUS_MM: f64 = 10.0;

/// Linear light of an sRGB colour.
pub(super) fn linear(srgb: [u8; 3]) -> Rgb {
    Rgb::from(srgb.map(|c| LINEAR_FROM_SRGB8[usize::from(c)]))
}

impl Pipeline {
    /// The scene of a person's head at rest, without occluders. `last` is that of someone else, whose trees it takes.
    ///
    /// # Errors
    /// [`Error::Trace`] for a subject that cannot be rendered.
    pub fn head_scene(
        &self,
        person: &Person,
        last: Option<&HeadScene>,
    ) -> Result<HeadScene, Error> {
        let background = linear(self.recipe().image.background);
        let (reference, subject) = (self.reference(), &person.subject);
        let last = last.filter(|_| self.skips().moved_scenes);
        let mut scene = HeadScene::like(last, reference, subject, background)?;
        let settings = &self.recipe().hair;
        if settings.lashes && hair::is_for(settings, person.kind) {
            scene.add_lashes(self.wardrobe.lashes(reference)?, &subject.positions)?;
        }
        if let Some(color) = person.clothes {
            scene.add_shirt(reference, subject, self.wardrobe.shirt(reference), color)?;
        }
        if let Some(hair) = &person.hair {
            let fit = self.wardrobe.style(reference, &hair.style)?;
            scene.add_hair(reference, subject, fit, hair)?;
        }
        Ok(scene)
    }

    /// Brings the head of a scene into an expression.
    ///
    /// # Errors
    /// [`Error::Trace`] for positions that are not finite.
    pub fn show_face(&self, scene: &mut HeadScene, pose: &Pose, face: &Face) -> Result<(), Error> {
        scene.set_positions(&face.positions)?;
        scene.set_gaze(face.gaze)?;
        scene.set_jaw(&face.jaw)?;
        // A face at rest has its lips together: what is behind them is left out.
        scene.show_mouth(face.certificate.is_some() || !self.skips().closed_mouths);
        // Shut lids likewise.
        let shows = |side| !(self.skips().closed_eyes && pose.shuts_eye(self.muscles(), side));
        scene.show_eyes(Side::BOTH.map(shows));
        Ok(())
    }

    /// What an occluder puts in front of the face of a scene.
    ///
    /// # Errors
    /// [`Error::Trace`] if it does not fit.
    pub fn occluder_objects(
        &self,
        scene: &HeadScene,
        occluder: &Occluder,
    ) -> Result<Vec<Object>, Error> {
        let fit = || FaceFit::new(self.reference(), scene);
        Ok(match occluder {
            Occluder::None => Vec::new(),
            Occluder::Glasses(style) | Occluder::Sunglasses(style) => {
                style.objects(&fit()?)?.into()
            }
            Occluder::Prop(prop) => vec![prop.object(&fit()?)?],
            Occluder::Model(model) => vec![model.object(&fit()?)?],
        })
    }

    /// Size of a pixel on the face, mm.
    pub(super) fn mm_per_px(&self, view: &View) -> f64 {
        2.0 * view.distance * libm::tan(view.fov_y / 2.0) / f64::from(self.recipe().image.height)
    }

    /// Traces a view.
    ///
    /// # Errors
    /// [`Error::Trace`] for an impossible camera.
    pub fn trace(&self, scene: &HeadScene, view: &View) -> Result<TracedView, Error> {
        let image = &self.recipe().image;
        let camera = camera(view, image, scene.eyes())?;
        let wants = |t| image.wants(t) || !self.skips().unasked_truth;
        let settings = RenderSettings {
            samples: image.samples,
            skips: facile_trace::Skips {
                screen_bounds: self.skips().screen_bounds,
                facing_away: self.skips().facing_away,
            },
            truth: TraceTruth {
                depth_z: wants(Truth::Depth),
                normal_in_camera: wants(Truth::Normals),
                segment: wants(Truth::Segments),
                occlusion: wants(Truth::Occlusion)
                    || wants(Truth::Visibility)
                    || wants(Truth::Amodal),
                coverage: wants(Truth::Coverage),
                layers: if wants(Truth::Layers) { LAYERS } else { 0 },
                hit: wants(Truth::Instances) || wants(Truth::Reference),
                albedo: wants(Truth::Albedo),
                shadow: wants(Truth::Shadow),
                ..TraceTruth::default()
            },
            ..RenderSettings::default()
        };
        Ok(facile_trace::trace_view(&scene.scene, &camera, &settings)?)
    }
}

/// The camera of a view of a head with these eyes: on a sphere around its target, turned about its own axis.
fn camera(view: &View, image: &ImageSettings, eyes: &[Eye; 2]) -> Result<Camera, Error> {
    let target = Point3::from(view.target);
    let (yaw_sin, yaw_cos) = libm::sincos(view.yaw);
    let (pitch_sin, pitch_cos) = libm::sincos(view.pitch);
    let backward = Vector3::new(pitch_cos * yaw_sin, pitch_sin, pitch_cos * yaw_cos);
    let right = Vector3::new(yaw_cos, 0.0, -yaw_sin);
    let (roll_sin, roll_cos) = libm::sincos(view.roll);
    // The camera turns clockwise for the head to turn counter-clockwise in its image.
    let up = backward.cross(&right) * roll_cos + right * roll_sin;
    let position = target + backward * view.distance;
    let (width, height) = (image.width as usize, image.height as usize);
    let mut camera = Camera::look_at(width, height, position, target, up, view.fov_y)?;
    if view.shift != [0.0; 2] {
        let mut intrinsics = *camera.intrinsics();
        intrinsics[(0, 2)] += view.shift[0] * f64::from(image.height);
        intrinsics[(1, 2)] += view.shift[1] * f64::from(image.height);
        let (rotation, translation) = (*camera.camera_from_world(), *camera.translation());
        camera = Camera::from_matrices(width, height, intrinsics, rotation, translation)?;
    }
    Ok(match view.optics {
        Optics::Pinhole => camera,
        Optics::Orthographic => camera.orthographic(view.distance)?,
        Optics::Lens { aperture, focus } => {
            // Photographers focus on the nearer eye
            let near = |eye: &Eye| camera.point_in_camera(&eye.center).z - eye.radius;
            let nearer = eyes.iter().map(near).fold(f64::INFINITY, f64::min);
            let focus_mm = focus.unwrap_or_else(|| nearer.max(LEAST_FOCUS_MM));
            let radius_mm = aperture / 2.0;
            camera.with_lens(Lens {
                radius_mm,
                focus_mm,
            })?
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::HeadPose;
    use approx::assert_relative_eq;

    fn pose_of(yaw: f64, pitch: f64, roll: f64) -> HeadPose {
        let view = View {
            yaw: yaw.to_radians(),
            pitch: pitch.to_radians(),
            roll: roll.to_radians(),
            fov_y: 0.3,
            distance: 900.0,
            target: [1.0, -20.0, 5.0],
            shift: [0.0; 2],
            optics: Optics::Pinhole,
        };
        let image = ImageSettings {
            width: 64,
            height: 48,
            encoding: crate::recipe::file::Encoding::Png,
            quality: 90,
            truth: Vec::new(),
            landmarks: Vec::new(),
            samples: facile_trace::Samples::Count(1),
            background: [0; 3],
            box_margin: 0.0,
        };
        let eyes = facile_core::ReferenceHead::embedded().eyes;
        let camera = camera(&view, &image, &eyes).expect("possible");
        let (px, depth) = camera
            .project(&Point3::new(1.0, -20.0, 5.0))
            .expect("in front");
        assert_relative_eq!(px[0], 32.0, epsilon = 1e-9);
        assert_relative_eq!(px[1], 24.0, epsilon = 1e-9);
        assert_relative_eq!(depth, 900.0, epsilon = 1e-9);
        HeadPose::of(camera.camera_from_world())
    }

    #[test]
    fn the_head_turns_against_the_camera() {
        let frontal = pose_of(0.0, 0.0, 0.0);
        assert_eq!(
            (frontal.yaw_deg, frontal.pitch_deg, frontal.roll_deg),
            (0.0, 0.0, 0.0)
        );
        // A camera on the subject's left sees the face look to the image's left, a camera above sees it look down.
        let turned = pose_of(30.0, 20.0, 10.0);
        assert_relative_eq!(turned.pitch_deg, -20.0, epsilon = 5.0);
        assert!(turned.yaw_deg > 20.0 && turned.yaw_deg < 40.0);
        for (yaw, pitch, roll) in [(25.0, 0.0, 0.0), (0.0, 35.0, 0.0), (0.0, 0.0, 15.0)] {
            let pose = pose_of(yaw, pitch, roll);
            assert_relative_eq!(pose.yaw_deg, yaw, epsilon = 1e-3);
            assert_relative_eq!(pose.pitch_deg, -pitch, epsilon = 1e-3);
            assert_relative_eq!(pose.roll_deg, roll, epsilon = 1e-3);
        }
    }
}
