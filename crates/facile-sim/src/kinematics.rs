//! What moves rigidly: the jaw (see `mandible`), the eyeballs, the tarsal plates.
//!
//! Every cage vertex has a rigid motion: that of the jaw times its jaw weight (the cut between jaw and skull is a band
//! over which angles and shift blend), and that of its lid. It carries the skull's attachment points and the frame of
//! contact, moves fascia and skin along before the solver starts (section 4.3.2), and turns the rest offsets of eq. 12,
//! without which that term would fight the jaw.

use std::collections::BTreeMap;

use facile_core::UnitQuaternion;

use crate::lids::{LidPose, LidVertex};
use crate::mandible::{JawMotion, Mandible};
use crate::pose::{Gaze, JawPose};
use crate::vector::{IDENTITY, M3, V3, ZERO, add, cross, rotate, sub};

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
        Self::turning(center, [row(0), row(1), row(2)], shift)
    }

    /// A rotation about a point, then `shift`.
    pub(crate) fn turning(center: V3, rotation: M3, shift: V3) -> Self {
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

/// The jaw, the axes of the eyes, and what follows them.
#[derive(Clone, Debug)]
pub(crate) struct Hinges {
    pub(crate) mandible: Mandible,
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
    /// `None` at rest.
    jaw: Option<JawMotion<'a>>,
    lids: [LidPose; 2],
}

impl Hinges {
    pub(crate) fn motion(&self, jaw: JawPose, lids: [LidPose; 2]) -> Motion<'_> {
        Motion {
            hinges: self,
            jaw: (jaw != JawPose::default()).then(|| self.mandible.motion(&jaw)),
            lids,
        }
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
        match &self.jaw {
            Some(jaw) if jaw_weight != 0.0 => jaw.of(jaw_weight),
            _ => Rigid::IDENTITY,
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use facile_core::{Point3, Vector3};

    #[test]
    fn what_lies_over_the_cut_turns_by_a_part() {
        let (left, right) = (
            Point3::new(50.0, -20.0, 0.0),
            Point3::new(-50.0, -20.0, 0.0),
        );
        let hinges = Hinges {
            mandible: Mandible::new(&left, &right, 1.0).expect("apart"),
            eyes: [[30.0, 0.0, 60.0], [-30.0, 0.0, 60.0]],
            jaw: vec![0.0, 0.5, 1.0],
            lids: BTreeMap::new(),
        };
        let jaw = JawPose {
            open_rad: 0.5,
            ..JawPose::default()
        };
        let motion = hinges.motion(jaw, [LidPose::default(); 2]);
        // From the hinge, which goes along the condyles' path, to the chin.
        let way = |v: u32| {
            sub(
                motion.of(v).apply([0.0, -20.0, 80.0]),
                motion.of(v).apply([0.0, -20.0, 0.0]),
            )
        };
        let (whole, half) = (way(2), way(1));
        assert_relative_eq!(whole[1], -80.0 * libm::sin(0.5), epsilon = 1e-12);
        assert_relative_eq!(whole[2], 80.0 * libm::cos(0.5), epsilon = 1e-12);
        assert_relative_eq!(half[1], -80.0 * libm::sin(0.25), epsilon = 1e-12);
        assert_eq!(motion.of(0), Rigid::IDENTITY);
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
