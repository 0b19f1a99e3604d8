//! A person's head as a scene: skin, eyes, teeth, tongue, with materials and what moves them.

use std::sync::Arc;

use facile_core::{Eye, Isometry3, Point3, ReferenceHead, Segment, Similarity3, Subject, Texture};
use nalgebra::{Translation3, UnitQuaternion};

use crate::TraceError;
use crate::geometry::Normals;
use crate::material::Material;
use crate::math::{Pose, Rgb, Vec3, pose_from_isometry, vec3_from_point};
use crate::object::{Object, SegmentCap};
use crate::scene::Scene;

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
    /// The scene; objects `0..HeadScene::PARTS` are the head's.
    pub scene: Scene,
    eyes: [Eye; 2],
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
    /// Number of objects of a head.
    pub const PARTS: usize = 6;

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
        let mut head = Self {
            scene,
            eyes: subject.eyes,
        };
        head.set_gaze([Gaze::default(); 2])?;
        Ok(head)
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
        self.scene.objects_mut()[Self::SKIN].set_positions(positions)
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
            self.scene.objects_mut()[Self::LEFT_EYE + k].set_pose(&pose_from_isometry(&pose))?;
        }
        Ok(())
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

fn skin_object(
    like: Option<&Object>,
    reference: &ReferenceHead,
    positions: &[Point3],
    texture: &Arc<Texture>,
) -> Result<Object, TraceError> {
    let mut mesh = reference.mesh.clone();
    positions.clone_into(&mut mesh.positions);
    let skin = Material::skin(texture.clone());
    let lips = Material {
        roughness: 0.32,
        ..skin.clone()
    };
    let nose = Material {
        roughness: 0.38,
        ..skin.clone()
    };
    let mouth = Material {
        roughness: 0.25,
        exposure: 0.25,
        ..skin.clone()
    };
    let socket = Material {
        exposure: 0.5,
        ..skin.clone()
    };
    let is_lip = |s| matches!(s, Segment::UpperLip | Segment::LowerLip);
    Ok(Object::like(like, &mesh, Normals::Smooth, skin)?
        .with_material(lips, is_lip)
        .with_material(nose, |s| s == Segment::Nose)
        .with_material(mouth, |s| s == Segment::InnerMouth)
        .with_material(socket, |s| s == Segment::EyeSocket))
}

fn part(reference: &ReferenceHead, segment: Segment) -> Result<&facile_core::Part, TraceError> {
    reference
        .parts
        .iter()
        .find(|p| p.segment == segment)
        .ok_or_else(|| {
            TraceError::Core(facile_core::CoreError::UnknownName {
                kind: "part of the reference head",
                name: segment.name().to_owned(),
                known: reference
                    .parts
                    .iter()
                    .map(|p| p.segment.name())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
        })
}

/// An eyeball about its own centre, so that a pose turns it.
fn eye_object(
    like: Option<&Object>,
    reference: &ReferenceHead,
    (from, to): (&Eye, &Eye),
    (segment, iris): (Segment, Segment),
    texture: &Arc<Texture>,
) -> Result<Object, TraceError> {
    let mut mesh = part(reference, segment)?.mesh.clone();
    let scale = to.radius / from.radius;
    for p in &mut mesh.positions {
        *p = Point3::from((*p - from.center) * scale);
    }
    let cap = SegmentCap {
        center: vec3_from_point(&Point3::origin()),
        axis: Vec3::z(),
        cos_angle: (1.0 - IRIS_RADIUS_SHARE * IRIS_RADIUS_SHARE).sqrt(),
        segment: iris,
    };
    let material = Material::wet(texture.clone());
    Ok(Object::like(like, &mesh, Normals::Smooth, material)?.with_cap(cap))
}

fn mouth_object(
    like: Option<&Object>,
    reference: &ReferenceHead,
    segment: Segment,
    placed: &Similarity3,
    texture: &Arc<Texture>,
) -> Result<Object, TraceError> {
    let mut mesh = part(reference, segment)?.mesh.clone();
    for p in &mut mesh.positions {
        *p = placed * *p;
    }
    // Enamel and mucosa, wet
    let material = Material {
        specular: 0.03,
        roughness: 0.22,
        scatter_mm: Rgb::repeat(0.3),
        exposure: 0.5,
        ..Material::skin(texture.clone())
    };
    Object::like(like, &mesh, Normals::Smooth, material)
}
