//! Action units of the Facial Action Coding System as muscles, jaw and gaze.
//!
//! Source: Ekman, Friesen and Hager, Facial Action Coding System, 2002: the muscular basis of each unit. An intensity of
//! 1 is FACS intensity E, the strongest that a person can show. Units add up; contractions saturate at 1.

use std::collections::BTreeMap;

use crate::SimError;
use crate::muscle::MuscleSet;
use crate::pose::{Pose, in_range};

/// An action unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionUnit {
    /// Its number in FACS.
    pub number: u8,
    /// Its name in FACS.
    pub name: &'static str,
    muscles: &'static [(&'static str, f64)],
    jaw_deg: f64,
    gaze_deg: [f64; 2],
}

const fn unit(
    number: u8,
    name: &'static str,
    muscles: &'static [(&'static str, f64)],
) -> ActionUnit {
    ActionUnit {
        number,
        name,
        muscles,
        jaw_deg: 0.0,
        gaze_deg: [0.0; 2],
    }
}

const fn jaw(number: u8, name: &'static str, jaw_deg: f64) -> ActionUnit {
    ActionUnit {
        jaw_deg,
        ..unit(number, name, &[])
    }
}

const fn gaze(number: u8, name: &'static str, yaw: f64, pitch: f64) -> ActionUnit {
    ActionUnit {
        gaze_deg: [yaw, pitch],
        ..unit(number, name, &[])
    }
}

/// Every action unit that the model knows, by number.
pub const ACTION_UNITS: &[ActionUnit] = &[
    unit(1, "inner brow raiser", &[("frontalis_inner", 1.0)]),
    unit(2, "outer brow raiser", &[("frontalis_outer", 1.0)]),
    unit(4, "brow lowerer", &[("corrugator", 1.0), ("procerus", 0.6)]),
    unit(5, "upper lid raiser", &[("levator_palpebrae", 1.0)]),
    unit(6, "cheek raiser", &[("orbicularis_oculi_orbital", 1.0)]),
    unit(7, "lid tightener", &[("orbicularis_oculi_palpebral", 0.45)]),
    unit(
        9,
        "nose wrinkler",
        &[
            ("levator_labii_superioris_alaeque_nasi", 1.0),
            ("procerus", 0.5),
            ("nasalis", 0.5),
        ],
    ),
    unit(10, "upper lip raiser", &[("levator_labii_superioris", 1.0)]),
    unit(11, "nasolabial deepener", &[("zygomatic_minor", 1.0)]),
    unit(12, "lip corner puller", &[("zygomatic_major", 1.0)]),
    unit(13, "sharp lip puller", &[("caninus", 1.0)]),
    unit(14, "dimpler", &[("buccinator", 1.0)]),
    unit(
        15,
        "lip corner depressor",
        &[("depressor_anguli_oris", 1.0)],
    ),
    unit(
        16,
        "lower lip depressor",
        &[("depressor_labii_inferioris", 1.0)],
    ),
    unit(17, "chin raiser", &[("mentalis", 1.0)]),
    unit(18, "lip pucker", &[("orbicularis_oris", 0.8)]),
    unit(20, "lip stretcher", &[("risorius", 1.0), ("platysma", 0.3)]),
    unit(21, "neck tightener", &[("platysma", 1.0)]),
    unit(
        22,
        "lip funneler",
        &[
            ("orbicularis_oris_upper_peripheral", 0.9),
            ("orbicularis_oris_lower_peripheral", 0.9),
        ],
    ),
    unit(
        23,
        "lip tightener",
        &[
            ("orbicularis_oris_upper_marginal", 0.5),
            ("orbicularis_oris_lower_marginal", 0.5),
        ],
    ),
    unit(
        24,
        "lip pressor",
        &[
            ("orbicularis_oris_upper_marginal", 0.35),
            ("orbicularis_oris_lower_marginal", 0.35),
            ("mentalis", 0.3),
            ("buccinator", 0.2),
        ],
    ),
    ActionUnit {
        jaw_deg: 2.0,
        ..unit(
            25,
            "lips part",
            &[
                ("depressor_labii_inferioris", 0.35),
                ("levator_labii_superioris", 0.15),
            ],
        )
    },
    jaw(26, "jaw drop", 12.0),
    jaw(27, "mouth stretch", 26.0),
    unit(43, "eyes closed", &[("orbicularis_oculi_palpebral", 1.0)]),
    unit(45, "blink", &[("orbicularis_oculi_palpebral", 1.0)]),
    unit(46, "wink", &[("orbicularis_oculi_palpebral", 1.0)]),
    gaze(61, "eyes turn left", 30.0, 0.0),
    gaze(62, "eyes turn right", -30.0, 0.0),
    gaze(63, "eyes up", 0.0, 25.0),
    gaze(64, "eyes down", 0.0, -25.0),
];

/// The action unit of a FACS number.
pub fn action_unit(number: u8) -> Option<&'static ActionUnit> {
    ACTION_UNITS.iter().find(|u| u.number == number)
}

impl ActionUnit {
    /// Its key in recipes, such as `AU12`.
    pub fn key(&self) -> String {
        format!("AU{}", self.number)
    }

    /// The pose at intensity 1, on both sides or on one: `suffix` is empty, `.left` or `.right`.
    fn pose(&self, muscles: &MuscleSet, suffix: &str) -> Result<Pose, SimError> {
        let mut pose = Pose::default();
        if !suffix.is_empty() && self.muscles.is_empty() {
            return Err(SimError::NoSides { name: self.key() });
        }
        for (name, contraction) in self.muscles {
            match pose.set(muscles, &format!("{name}{suffix}"), *contraction) {
                // A muscle of the mid-plane works along at half its strength when one side is asked for.
                Err(SimError::NoSides { .. }) => pose.set(muscles, name, 0.5 * contraction)?,
                other => other?,
            }
        }
        pose.jaw.open_rad = self.jaw_deg.to_radians();
        pose.gaze.yaw_rad = self.gaze_deg[0].to_radians();
        pose.gaze.pitch_rad = self.gaze_deg[1].to_radians();
        Ok(pose)
    }
}

/// The pose of several action units: keys such as `AU12` or `AU12.left`, intensities in `[0, 1]`.
///
/// AU46, the wink, is the right eye's unless a side is given.
///
/// # Errors
/// [`SimError::UnknownName`] for an unknown unit, [`SimError::NoSides`] for one side of a unit without sides,
/// [`SimError::OutOfRange`] for an intensity.
pub fn action_units(
    muscles: &MuscleSet,
    intensities: &BTreeMap<String, f64>,
) -> Result<Pose, SimError> {
    let mut pose = Pose::default();
    for (key, &intensity) in intensities {
        let (name, suffix) = match key.split_once('.') {
            Some((name, "left")) => (name, ".left"),
            Some((name, "right")) => (name, ".right"),
            _ => (key.as_str(), ""),
        };
        let unit = name
            .strip_prefix("AU")
            .and_then(|n| n.parse().ok())
            .and_then(action_unit)
            .ok_or_else(|| unknown(key))?;
        in_range(|| format!("intensity of `{key}`"), intensity, 0.0, 1.0)?;
        let suffix = if unit.number == 46 && suffix.is_empty() {
            ".right"
        } else {
            suffix
        };
        pose = pose.combined(&unit.pose(muscles, suffix)?.scaled(intensity));
    }
    Ok(pose)
}

fn unknown(key: &str) -> SimError {
    SimError::UnknownName {
        kind: "action unit",
        name: key.to_owned(),
        known: ACTION_UNITS
            .iter()
            .map(ActionUnit::key)
            .collect::<Vec<_>>()
            .join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_unit_is_a_pose_of_known_muscles() {
        let muscles = MuscleSet::embedded();
        for unit in ACTION_UNITS {
            let pose = unit.pose(muscles, "").expect("known muscles");
            assert!(!pose.is_neutral(), "{}", unit.key());
            pose.check(muscles).expect("in range");
        }
        assert!(ACTION_UNITS.is_sorted_by_key(|u| u.number));
    }

    #[test]
    fn units_add_up_and_have_sides() {
        let muscles = MuscleSet::embedded();
        let ask = |pairs: &[(&str, f64)]| {
            let map = pairs.iter().map(|(k, v)| ((*k).to_owned(), *v)).collect();
            action_units(muscles, &map)
        };
        let pose = ask(&[("AU12.left", 0.5), ("AU26", 0.5)]).expect("known");
        let sides = pose.contractions["zygomatic_major"];
        assert_eq!((sides.left, sides.right), (0.5, 0.0));
        assert!((pose.jaw.open_rad - 6f64.to_radians()).abs() < 1e-12);
        let wink = ask(&[("AU46", 1.0)]).expect("known");
        assert!(wink.contractions["orbicularis_oculi_palpebral"].left.abs() < 1e-12);
        assert!(ask(&[("AU3", 1.0)]).is_err());
        assert!(ask(&[("AU61.left", 1.0)]).is_err());
        assert!(ask(&[("AU12", 1.2)]).is_err());
    }
}
