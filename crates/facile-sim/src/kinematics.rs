//! What moves rigidly: the jaw on its hinge, the eyeballs, the tarsal plates.
//!
//! Every cage vertex has a rigid motion: that of the jaw times its jaw weight (the cut between jaw and skull is a band
//! over which the rotation angle blends), and that of its lid. It carries the skull's attachment points and the frame of
//! contact, moves fascia and skin along before the solver starts (section 4.3.2), and turns the rest offsets of eq. 12,
//! without which that term would fight the jaw.

use std::collections::BTreeMap;

use facile_core::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::lids::{LidPose, LidVertex};
use crate::pose::{Gaze, JawPose};
use crate::vector::{IDENTITY, M3, V3, ZERO, add, cross, dot, rotate, scale, sub};

/// A rotation followed by a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rigid {
    pub(crate) rotation: M3,
    pub(crate) translation: V3,
}

impl Rigid {
    pub(crate) const IDENTITY: Self = Self {
        rotation: IDENTITY,
        translation: ZERO,
    };

    /// Rotation by `angle` (rad) about the line through `center` along the unit vector `axis`, then `shift`.
    pub(crate) fn about(center: V3, axis: V3, angle: f64, shift: V3) -> Self {
        let (s, c) = (libm::sin(angle), libm::cos(angle));
        let row = |k: usize| {
            let mut e = ZERO;
            e[k] = 1.0;
            // Row k of Rodrigues' matrix: c e_k + (1 - c) axis_k axis - s (axis x .)_k, transposed cross product.
            let turned = cross(e, axis);
            [0, 1, 2].map(|j| c * e[j] + (1.0 - c) * axis[k] * axis[j] + s * turned[j])
        };
        let rotation = [row(0), row(1), row(2)];
        let translation = add(sub(center, rotate(&rotation, center)), shift);
        Self {
            rotation,
            translation,
        }
    }

    pub(crate) fn apply(&self, p: V3) -> V3 {
        add(rotate(&self.rotation, p), self.translation)
    }
}

/// The hinge of the jaw and the axes of the eyes of a subject.
#[derive(Clone, Debug)]
pub(crate) struct Hinges {
    /// A point on the jaw's axis, mm.
    pub(crate) jaw_center: V3,
    /// Unit vector along the jaw's axis, towards the left.
    pub(crate) jaw_axis: V3,
    /// Forward direction of the skull: that of protrusion.
    pub(crate) forward: V3,
    /// Centres of the eyeballs, mm.
    pub(crate) eyes: [V3; 2],
    /// Jaw weight of each cage vertex.
    pub(crate) jaw: Vec<f64>,
    /// Lid vertices by cage vertex.
    pub(crate) lids: BTreeMap<u32, LidVertex>,
}

/// The rigid motions of a pose.
#[derive(Debug)]
pub(crate) struct Motion<'a> {
    hinges: &'a Hinges,
    jaw: JawPose,
    lids: [LidPose; 2],
}

impl Hinges {
    pub(crate) fn motion(&self, jaw: JawPose, lids: [LidPose; 2]) -> Motion<'_> {
        Motion {
            hinges: self,
            jaw,
            lids,
        }
    }

    /// The jaw's motion: what lower teeth and tongue follow.
    pub(crate) fn jaw_isometry(&self, jaw: &JawPose) -> Isometry3 {
        let rigid = self.jaw(jaw, 1.0);
        let half = 0.5 * jaw.open_rad;
        let axis = scale(self.jaw_axis, libm::sin(half));
        let turn = nalgebra::Quaternion::new(libm::cos(half), axis[0], axis[1], axis[2]);
        let t = rigid.translation;
        Isometry3::from_parts(
            Vector3::new(t[0], t[1], t[2]).into(),
            UnitQuaternion::from_quaternion(turn),
        )
    }

    fn jaw(&self, jaw: &JawPose, weight: f64) -> Rigid {
        let shift = add(
            scale(self.forward, jaw.protrusion_mm * weight),
            scale(self.jaw_axis, jaw.lateral_mm * weight),
        );
        Rigid::about(self.jaw_center, self.jaw_axis, jaw.open_rad * weight, shift)
    }
}

impl Motion<'_> {
    /// The rigid motion of what lies under a cage vertex.
    pub(crate) fn of(&self, cage: u32) -> Rigid {
        self.blend(self.hinges.jaw[cage as usize], self.rise(cage))
    }

    /// Rotation of an element whose corners lie under these cage vertices: that of their mean weights.
    pub(crate) fn element_rotation(&self, cage: [u32; 3]) -> M3 {
        let weight = cage
            .iter()
            .map(|&v| self.hinges.jaw[v as usize])
            .sum::<f64>()
            / 3.0;
        let rises = cage.map(|v| self.rise(v));
        let mean = rises.iter().flatten().map(|r| r.1).sum::<f64>() / 3.0;
        let rise = rises.iter().flatten().next().map(|r| (r.0, mean));
        self.blend(weight, rise).rotation
    }

    fn rise(&self, cage: u32) -> Option<(usize, f64)> {
        let lid = self.hinges.lids.get(&cage)?;
        let rise = lid.rise(&self.lids[lid.eye]);
        (rise != 0.0).then_some((lid.eye, rise))
    }

    fn blend(&self, jaw_weight: f64, rise: Option<(usize, f64)>) -> Rigid {
        if let Some((eye, rise)) = rise {
            // Turning about +x lowers what looks along +z.
            return Rigid::about(self.hinges.eyes[eye], [1.0, 0.0, 0.0], -rise, ZERO);
        }
        if jaw_weight == 0.0 || self.jaw == JawPose::default() {
            return Rigid::IDENTITY;
        }
        self.hinges.jaw(&self.jaw, jaw_weight)
    }
}

/// Rotation of an eyeball that looks along `+z` at rest.
pub(crate) fn eye_rotation(gaze: &Gaze) -> UnitQuaternion {
    let half = |angle: f64| (libm::sin(0.5 * angle), libm::cos(0.5 * angle));
    let ((sy, cy), (sp, cp)) = (half(gaze.yaw_rad), half(-gaze.pitch_rad));
    let yaw = nalgebra::Quaternion::new(cy, 0.0, sy, 0.0);
    let pitch = nalgebra::Quaternion::new(cp, sp, 0.0, 0.0);
    UnitQuaternion::from_quaternion(yaw * pitch)
}

/// The jaw's axis through both condyles: its middle and its unit direction, or `None` if they coincide.
pub(crate) fn hinge_axis(left: &Point3, right: &Point3) -> Option<(V3, V3)> {
    let (l, r) = ([left.x, left.y, left.z], [right.x, right.y, right.z]);
    let along = sub(l, r);
    let length = dot(along, along).sqrt();
    (length > 1e-6).then(|| (scale(add(l, r), 0.5), scale(along, 1.0 / length)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn hinges() -> Hinges {
        Hinges {
            jaw_center: [0.0, -20.0, 0.0],
            jaw_axis: [1.0, 0.0, 0.0],
            forward: [0.0, 0.0, 1.0],
            eyes: [[30.0, 0.0, 60.0], [-30.0, 0.0, 60.0]],
            jaw: vec![0.0, 0.5, 1.0],
            lids: BTreeMap::new(),
        }
    }

    #[test]
    fn opening_lowers_the_chin_on_a_circle_around_the_hinge() {
        let hinges = hinges();
        let jaw = JawPose {
            open_rad: 0.5,
            ..JawPose::default()
        };
        let motion = hinges.motion(jaw, [LidPose::default(); 2]);
        let chin = motion.of(2).apply([0.0, -20.0, 80.0]);
        assert_relative_eq!(chin[1], -20.0 - 80.0 * libm::sin(0.5), epsilon = 1e-12);
        assert_relative_eq!(chin[2], 80.0 * libm::cos(0.5), epsilon = 1e-12);
        let half = motion.of(1).apply([0.0, -20.0, 80.0]);
        assert_relative_eq!(half[1], -20.0 - 80.0 * libm::sin(0.25), epsilon = 1e-12);
        assert_eq!(motion.of(0), Rigid::IDENTITY);
    }

    #[test]
    fn the_isometry_agrees_with_the_motion_of_full_weight() {
        let hinges = hinges();
        let jaw = JawPose {
            open_rad: 0.3,
            protrusion_mm: 4.0,
            lateral_mm: -2.0,
        };
        let a = hinges
            .motion(jaw, [LidPose::default(); 2])
            .of(2)
            .apply([5.0, -90.0, 70.0]);
        let b = hinges.jaw_isometry(&jaw) * Point3::new(5.0, -90.0, 70.0);
        for k in 0..3 {
            assert_relative_eq!(a[k], b[k], epsilon = 1e-12);
        }
    }

    #[test]
    fn eyes_look_where_they_are_told() {
        let gaze = Gaze {
            yaw_rad: 0.3,
            pitch_rad: 0.2,
        };
        let d = eye_rotation(&gaze) * Vector3::z();
        assert_relative_eq!(d.y, libm::sin(0.2), epsilon = 1e-12);
        assert_relative_eq!(d.x, libm::sin(0.3) * libm::cos(0.2), epsilon = 1e-12);
    }
}
