//! A person's head as a scene: skin, eyes, teeth, tongue, with materials and what moves them.

mod parts;

use std::sync::Arc;

use facile_core::{Eye, Isometry3, Point3, ReferenceHead, Segment, Subject};
use nalgebra::{Translation3, UnitQuaternion};

use crate::TraceError;
use crate::aperture::Aperture;
use crate::clothes::ShirtFit;
use crate::cornea;
use crate::geometry::Normals;
use crate::hair::{self, Cards, Hair, HairFit, LashFit, toned_scalp};
use crate::material::Albedo;
use crate::math::{Pose, Rgb, pose_from_isometry};
use crate::object::Object;
use crate::scene::Scene;
use parts::{RimPoint, eye_object, inner_lips, mouth_object, skin_object};

/// Radius of the iris over that of the eyeball, in the reference eye.
pub const IRIS_RADIUS_SHARE: f32 = 6.0 / 15.9;

/// Direction of both eyes, rad: `yaw` to the subject's left, `pitch` up. Zero looks along `+z`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gaze {
    /// Turn to the subject's left, rad.
    pub yaw: f64,
    /// Turn upwards, rad.
    pub pitch: f64,
}

/// A [`Scene`] that starts with a head. Occluders and other things are added behind it.
#[derive(Clone, Debug)]
pub struct HeadScene {
    /// The scene; the head's objects come first.
    pub scene: Scene,
    eyes: [Eye; 2],
    /// Vertices of the eyeballs with the iris on their surface, mm.
    eyeballs: Vec<Vec<Point3>>,
    detail: f32,
    /// Whether the left and the right eye are shown.
    shows_eyes: [bool; 2],
    /// Around the mouth's opening.
    lips: Vec<RimPoint>,
    /// Number of objects of the head, hair and lashes included.
    parts: usize,
    hair: Option<WornHair>,
    /// What moves the lashes, and their index in the scene.
    lashes: Option<(Arc<LashFit>, usize)>,
}

/// Hair of a head.
#[derive(Clone, Debug)]
struct WornHair {
    /// Index in the scene, when nothing is worn over it.
    index: usize,
    cards: Cards,
}

impl HeadScene {
    /// Index of the skin in the scene.
    pub const SKIN: usize = 0;
    /// Index of the left eye; the right one follows.
    pub const LEFT_EYE: usize = 1;
    /// Index of the upper teeth.
    pub const UPPER_TEETH: usize = 3;
    /// Index of the lower teeth.
    pub const LOWER_TEETH: usize = 4;
    /// Index of the tongue.
    pub const TONGUE: usize = 5;
    /// Index of the left eye's cornea; the right one follows.
    pub const LEFT_CORNEA: usize = 6;
    /// Pixels smaller than this on the face, mm, show pores and corneas; those half as large show them fully.
    pub const DETAIL_MM: f64 = 0.45;
    /// The neutral head of a subject, gaze straight on, mouth parts shown.
    ///
    /// # Errors
    /// [`TraceError`] if the subject's positions are not finite or do not fit the reference, or if its eye colour is
    /// unknown.
    pub fn new(
        reference: &ReferenceHead,
        subject: &Subject,
        background: Rgb,
    ) -> Result<Self, TraceError> {
        Self::like(None, reference, subject, background)
    }

    /// As [`Self::new`]; takes the trees of another subject's head and moves them instead of building its own.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn like(
        other: Option<&Self>,
        reference: &ReferenceHead,
        subject: &Subject,
        background: Rgb,
    ) -> Result<Self, TraceError> {
        let of_other = |part: usize| other.and_then(|o| o.scene.objects().get(part));
        let mut scene = Scene::new(background);
        let skin = Arc::new(subject.texture.clone());
        let like = of_other(Self::SKIN);
        scene.add(skin_object(like, reference, &subject.positions, &skin)?);
        let eye_texture = reference
            .eye_textures
            .get(&subject.eye_color)
            .ok_or_else(|| {
                let known: Vec<&str> = reference.eye_textures.keys().map(String::as_str).collect();
                facile_core::CoreError::UnknownName {
                    kind: "eye colour",
                    name: subject.eye_color.clone(),
                    known: known.join(", "),
                }
            })?;
        let eye_texture = Arc::new(eye_texture.clone());
        let labels = [
            (Segment::LeftEye, Segment::LeftIris),
            (Segment::RightEye, Segment::RightIris),
        ];
        for ((eye, own), (segment, iris)) in reference.eyes.iter().zip(&subject.eyes).zip(labels) {
            let like = of_other(scene.objects().len());
            scene.add(eye_object(
                like,
                reference,
                (eye, own),
                (segment, iris),
                &eye_texture,
            )?);
        }
        let mouth = Arc::new(reference.mouth_texture.clone());
        let placed = &subject.skull_from_reference;
        for segment in [Segment::UpperTeeth, Segment::LowerTeeth, Segment::Tongue] {
            let like = of_other(scene.objects().len());
            scene.add(mouth_object(like, reference, segment, placed, &mouth)?);
        }
        let mut eyeballs = Vec::new();
        for ((eye, index), iris) in subject
            .eyes
            .iter()
            .zip(Self::LEFT_EYE..)
            .zip([Segment::LeftIris, Segment::RightIris])
        {
            let positions = scene.objects()[index].geometry().positions().iter();
            eyeballs.push(positions.map(|p| Point3::from(p.cast::<f64>())).collect());
            let dome = cornea::dome(eye.radius, iris);
            let like = of_other(scene.objects().len());
            let mut dome = Object::like(like, &dome, Normals::Smooth, cornea::material())?;
            dome.set_visible(false);
            scene.add(dome);
        }
        let mut head = Self {
            eyeballs,
            detail: 0.0,
            shows_eyes: [true; 2],
            lips: inner_lips(reference)?,
            parts: scene.objects().len(),
            hair: None,
            lashes: None,
            scene,
            eyes: subject.eyes,
        };
        head.set_gaze([Gaze::default(); 2])?;
        head.light_mouth(&subject.positions);
        Ok(head)
    }

    /// Number of the head's own objects, hair and clothes included, which come first in the scene.
    pub fn parts(&self) -> usize {
        self.parts
    }

    /// Left and right eye as placed.
    pub fn eyes(&self) -> &[Eye; 2] {
        &self.eyes
    }

    /// Moves the skin's vertices, mm, head frame.
    ///
    /// # Errors
    /// As [`Object::set_positions`].
    pub fn set_positions(&mut self, positions: &[Point3]) -> Result<(), TraceError> {
        self.scene.objects_mut()[Self::SKIN].set_positions(positions)?;
        if let Some((fit, index)) = &self.lashes {
            self.scene.objects_mut()[*index].set_positions(&fit.positions(positions))?;
        }
        self.light_mouth(positions);
        Ok(())
    }

    /// Lets as much ambient light into the mouth as lips at these positions leave open.
    fn light_mouth(&mut self, positions: &[Point3]) {
        let rim: Vec<Point3> = self
            .lips
            .iter()
            .map(|(corners, weights)| {
                let mut point = Point3::origin();
                for (v, w) in corners.iter().zip(weights) {
                    point += positions[*v as usize].coords * *w;
                }
                point
            })
            .collect();
        let aperture = Aperture::of(&rim);
        let parts = [
            Self::SKIN,
            Self::UPPER_TEETH,
            Self::LOWER_TEETH,
            Self::TONGUE,
        ];
        for part in parts {
            for material in self.scene.objects_mut()[part].materials_mut() {
                if let Some(own) = &mut material.aperture {
                    *own = aperture;
                }
            }
        }
    }

    /// Puts hair on a head at rest, and its colour on the scalp. Comes before anything is put in front of the head.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub fn add_hair(
        &mut self,
        reference: &ReferenceHead,
        subject: &Subject,
        fit: &HairFit,
        hair: &Hair,
    ) -> Result<(), TraceError> {
        self.remove_added();
        let skin = &self.scene.objects()[Self::SKIN];
        let cards = fit.cards(reference, subject, skin, hair.color);
        let color = hair
            .color
            .map(|c| facile_core::color::LINEAR_FROM_SRGB8[usize::from(c)]);
        let toned = Arc::new(toned_scalp(&subject.texture, Rgb::from(color)));
        for material in self.scene.objects_mut()[Self::SKIN].materials_mut() {
            if let Albedo::Texture { texture, .. } = &mut material.albedo {
                texture.clone_from(&toned);
            }
        }
        let index = self.scene.add(cards.object(None)?);
        self.hair = Some(WornHair { index, cards });
        self.parts = self.scene.objects().len();
        Ok(())
    }

    /// Puts a shirt on, in an 8-bit sRGB colour. Comes before anything is put in front of the head.
    ///
    /// # Errors
    /// As [`ShirtFit::object`].
    pub fn add_shirt(
        &mut self,
        reference: &ReferenceHead,
        subject: &Subject,
        fit: &ShirtFit,
        color: [u8; 3],
    ) -> Result<(), TraceError> {
        self.remove_added();
        let skin = &self.scene.objects()[Self::SKIN];
        let object = fit.object(reference, subject, skin, color)?;
        self.scene.add(object);
        self.parts = self.scene.objects().len();
        Ok(())
    }

    /// Presses the hair under something worn over it: the scene's object `worn`, such as a cap.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub fn press_hair(&mut self, worn: usize) -> Result<(), TraceError> {
        let Some(hair) = &self.hair else {
            return Ok(());
        };
        let objects = self.scene.objects();
        let pressed = hair::pressed(&hair.cards, &objects[worn], &objects[Self::SKIN])?;
        self.scene.objects_mut()[hair.index].set_visible(false);
        self.scene.add(pressed);
        Ok(())
    }

    /// Puts lashes on the lids of a face given by its fine vertices, mm. Comes before anything is put in front of the head.
    ///
    /// # Errors
    /// As [`LashFit::object`].
    pub fn add_lashes(
        &mut self,
        fit: &Arc<LashFit>,
        positions: &[Point3],
    ) -> Result<(), TraceError> {
        self.remove_added();
        let index = self.scene.add(fit.object(positions)?);
        self.lashes = Some((fit.clone(), index));
        self.parts = self.scene.objects().len();
        Ok(())
    }

    /// Removes everything that was added behind the head's own parts; hair is as it was.
    pub fn remove_added(&mut self) {
        self.scene.truncate(self.parts);
        if let Some(hair) = &self.hair {
            self.scene.objects_mut()[hair.index].set_visible(true);
        }
    }

    /// Turns the left and the right eye.
    ///
    /// # Errors
    /// [`TraceError::NotFinite`] for angles that are not finite.
    pub fn set_gaze(&mut self, gaze: [Gaze; 2]) -> Result<(), TraceError> {
        for (k, (gaze, eye)) in gaze.iter().zip(&self.eyes).enumerate() {
            let turn = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), gaze.yaw)
                * UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), -gaze.pitch);
            let pose = Isometry3::from_parts(Translation3::from(eye.center.coords), turn);
            let pose = pose_from_isometry(&pose);
            for index in [Self::LEFT_EYE, Self::LEFT_CORNEA] {
                self.scene.objects_mut()[index + k].set_pose(&pose)?;
            }
        }
        Ok(())
    }

    /// Shows what pixels of `mm_per_px` on the face can show: pores, and irises behind corneas. Nothing at
    /// [`Self::DETAIL_MM`] and above, which is how a head starts.
    ///
    /// # Errors
    /// As [`Object::set_positions`].
    pub fn set_closeness(&mut self, mm_per_px: f64) -> Result<(), TraceError> {
        let detail = (2.0 * (1.0 - mm_per_px / Self::DETAIL_MM)).clamp(0.0, 1.0) as f32;
        if detail.to_bits() == self.detail.to_bits() {
            return Ok(());
        }
        for material in self.scene.objects_mut()[Self::SKIN].materials_mut() {
            material.detail = detail;
        }
        if (detail > 0.0) != (self.detail > 0.0) {
            for k in 0..2 {
                let (eyeball, radius) = (&self.eyeballs[k], self.eyes[k].radius);
                let flat;
                let positions = if detail > 0.0 {
                    flat = cornea::with_flat_iris(eyeball, radius);
                    &flat
                } else {
                    eyeball
                };
                let objects = self.scene.objects_mut();
                objects[Self::LEFT_EYE + k].set_positions(positions)?;
            }
        }
        self.detail = detail;
        self.show_eyes(self.shows_eyes);
        Ok(())
    }

    /// Shows or hides the left and the right eye: shut lids need none behind them.
    pub fn show_eyes(&mut self, are_visible: [bool; 2]) {
        self.shows_eyes = are_visible;
        let objects = self.scene.objects_mut();
        for (k, is_visible) in are_visible.into_iter().enumerate() {
            objects[Self::LEFT_EYE + k].set_visible(is_visible);
            objects[Self::LEFT_CORNEA + k].set_visible(is_visible && self.detail > 0.0);
        }
    }

    /// Moves what the jaw carries, lower teeth and tongue, by a motion of the head frame.
    ///
    /// # Errors
    /// [`TraceError::NotFinite`] for a motion that is not finite.
    pub fn set_jaw(&mut self, motion: &Isometry3) -> Result<(), TraceError> {
        let pose: Pose = pose_from_isometry(motion);
        for index in [Self::LOWER_TEETH, Self::TONGUE] {
            self.scene.objects_mut()[index].set_pose(&pose)?;
        }
        Ok(())
    }

    /// Shows or hides teeth and tongue: a closed mouth needs none.
    pub fn show_mouth(&mut self, is_visible: bool) {
        for index in [Self::UPPER_TEETH, Self::LOWER_TEETH, Self::TONGUE] {
            self.scene.objects_mut()[index].set_visible(is_visible);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::IdentityModel;

    /// Radius of the mouth's opening, as each material in the mouth knows it.
    fn radii(head: &HeadScene) -> Vec<f32> {
        let objects = head.scene.objects().iter();
        let materials = objects.flat_map(|o| &o.materials);
        let apertures = materials.filter_map(|m| m.aperture);
        apertures.map(|a| a.radius).collect()
    }

    /// A person and their head.
    fn person() -> (Subject, HeadScene) {
        let reference = ReferenceHead::embedded();
        let subject = IdentityModel::embedded().sample(reference, 1, 0);
        let subject = subject.expect("samples");
        let head = HeadScene::new(reference, &subject, Rgb::zeros()).expect("valid");
        (subject, head)
    }

    #[test]
    fn the_mouth_opens_with_the_lips() {
        let (subject, mut head) = person();
        let closed = radii(&head);
        assert_eq!(closed.len(), 4, "inner mouth, teeth and tongue");
        assert!(closed.iter().all(|r| *r < 3.0), "{closed:?}");
        let reference = ReferenceHead::embedded();
        let scheme = reference.scheme("ibug68").expect("known");
        let lips = scheme.positions(&subject.positions, &reference.mesh.triangles);
        let slit = f64::midpoint(lips[62].y, lips[66].y);
        let opened: Vec<Point3> = subject
            .positions
            .iter()
            .map(|p| Point3::new(p.x, if p.y < slit { p.y - 20.0 } else { p.y }, p.z))
            .collect();
        head.set_positions(&opened).expect("finite");
        let open = radii(&head);
        assert!(open.iter().all(|r| *r > 6.0 && *r == open[0]), "{open:?}");
    }

    #[test]
    fn hidden_eyes_stay_hidden_when_the_view_comes_near() {
        let (_, mut head) = person();
        head.show_eyes([true, false]);
        let shown = |head: &HeadScene| {
            [HeadScene::LEFT_EYE, HeadScene::LEFT_CORNEA]
                .map(|first| [0, 1].map(|k| head.scene.objects()[first + k].is_visible))
        };
        assert_eq!(shown(&head), [[true, false], [false, false]]);
        head.set_closeness(0.1).expect("finite");
        assert_eq!(shown(&head), [[true, false], [true, false]]);
        head.show_eyes([true; 2]);
        assert_eq!(shown(&head), [[true; 2]; 2]);
    }
}
