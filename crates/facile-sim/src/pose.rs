//! What a face is asked to do: contractions, jaw, gaze.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::SimError;
use crate::muscle::{LidDrive, MuscleSet, Side};

/// Largest opening of the jaw, rad (40 degrees).
pub const MAX_OPEN_RAD: f64 = 0.7;
/// Largest protrusion of the jaw, mm; retraction goes to minus a third of it.
pub const MAX_PROTRUSION_MM: f64 = 10.0;
/// Largest sideways motion of the jaw, mm.
pub const MAX_LATERAL_MM: f64 = 12.0;
/// Largest turn of the eyes in either direction, rad (40 degrees).
pub const MAX_GAZE_RAD: f64 = 0.7;

/// A value for the left and one for the right side, the subject's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sides {
    /// The subject's left.
    pub left: f64,
    /// The subject's right.
    pub right: f64,
}

impl Sides {
    /// The value of a side.
    pub fn of(&self, side: Side) -> f64 {
        match side {
            Side::Left => self.left,
            Side::Right => self.right,
        }
    }
}

/// Position of the jaw; all zero is closed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JawPose {
    /// Rotation about the axis through the condyles, rad; positive opens. An opening jaw slides forwards and down along the
    /// articular eminences by itself.
    pub open_rad: f64,
    /// Forward motion of both condyles, mm; the eminences take them down.
    pub protrusion_mm: f64,
    /// Motion of the lower incisors towards the subject's left, mm: the jaw turns about the left condyle while the right
    /// one slides forwards and down.
    pub lateral_mm: f64,
}

/// Direction of both eyes; zero looks along `+z`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gaze {
    /// Turn towards the subject's left, rad.
    pub yaw_rad: f64,
    /// Turn upwards, rad.
    pub pitch_rad: f64,
}

/// Everything a face is asked to do.
///
/// ```
/// use facile_sim::{MuscleSet, Pose};
/// let mut pose = Pose::default();
/// pose.set(MuscleSet::embedded(), "zygomatic_major.left", 0.8)?;
/// pose.jaw.open_rad = 0.1;
/// assert_eq!(pose.scaled(0.5).contractions["zygomatic_major"].left, 0.4);
/// # Ok::<(), facile_sim::SimError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Contraction in `[0, 1]` of each muscle that is not at rest, by name.
    #[serde(default)]
    pub contractions: BTreeMap<String, Sides>,
    /// Position of the jaw.
    #[serde(default)]
    pub jaw: JawPose,
    /// Direction of the eyes.
    #[serde(default)]
    pub gaze: Gaze,
}

impl Pose {
    /// Contracts what `key` names: a muscle or a group, alone or with `.left` or `.right`.
    ///
    /// # Errors
    /// [`SimError::UnknownName`], [`SimError::NoSides`], or [`SimError::OutOfRange`] if `contraction` is not in `[0, 1]`.
    pub fn set(
        &mut self,
        muscles: &MuscleSet,
        key: &str,
        contraction: f64,
    ) -> Result<(), SimError> {
        let target = muscles.key(key)?;
        in_range(|| format!("contraction of `{key}`"), contraction, 0.0, 1.0)?;
        for m in target.muscles {
            let name = &muscles.muscles()[m].name;
            let sides = self.contractions.entry(name.clone()).or_default();
            for side in &target.sides {
                match side {
                    Side::Left => sides.left = contraction,
                    Side::Right => sides.right = contraction,
                }
            }
        }
        self.contractions
            .retain(|_, s| s.left != 0.0 || s.right != 0.0);
        Ok(())
    }

    /// The same motion at another intensity: contractions, jaw and gaze times `intensity`.
    pub fn scaled(&self, intensity: f64) -> Self {
        let mut out = self.clone();
        for sides in out.contractions.values_mut() {
            sides.left *= intensity;
            sides.right *= intensity;
        }
        if intensity == 0.0 {
            out.contractions.clear();
        }
        out.jaw.open_rad *= intensity;
        out.jaw.protrusion_mm *= intensity;
        out.jaw.lateral_mm *= intensity;
        out.gaze.yaw_rad *= intensity;
        out.gaze.pitch_rad *= intensity;
        out
    }

    /// Both motions at once: contractions add up to at most 1, jaw and gaze add up.
    pub fn combined(&self, other: &Self) -> Self {
        let mut out = self.clone();
        for (name, add) in &other.contractions {
            let sides = out.contractions.entry(name.clone()).or_default();
            sides.left = (sides.left + add.left).min(1.0);
            sides.right = (sides.right + add.right).min(1.0);
        }
        out.jaw.open_rad += other.jaw.open_rad;
        out.jaw.protrusion_mm += other.jaw.protrusion_mm;
        out.jaw.lateral_mm += other.jaw.lateral_mm;
        out.gaze.yaw_rad += other.gaze.yaw_rad;
        out.gaze.pitch_rad += other.gaze.pitch_rad;
        out
    }

    /// The same motion with every muscle named, those at rest with a contraction of 0: muscles that are not named are not
    /// gone through, and this shows what that saves.
    #[must_use]
    pub fn naming_all(&self, muscles: &MuscleSet) -> Self {
        let mut out = self.clone();
        for muscle in muscles.muscles() {
            out.contractions.entry(muscle.name.clone()).or_default();
        }
        out
    }

    /// The mirror image: left and right exchanged.
    pub fn mirrored(&self) -> Self {
        let mut out = self.clone();
        for sides in out.contractions.values_mut() {
            std::mem::swap(&mut sides.left, &mut sides.right);
        }
        out.jaw.lateral_mm = -out.jaw.lateral_mm;
        out.gaze.yaw_rad = -out.gaze.yaw_rad;
        out
    }

    /// Whether nothing at all is asked for.
    pub fn is_neutral(&self) -> bool {
        self.contractions
            .values()
            .all(|s| s.left == 0.0 && s.right == 0.0)
            && self.jaw == JawPose::default()
            && self.gaze == Gaze::default()
    }

    /// Strongest contraction of the muscles that drive a lid, in `[0, 1]`.
    pub(crate) fn lid_pull(&self, muscles: &MuscleSet, drive: LidDrive, side: Side) -> f64 {
        let drivers = muscles.muscles().iter().filter(|m| m.lid == Some(drive));
        let sides = drivers.filter_map(|m| self.contractions.get(&m.name));
        sides.map(|s| s.of(side)).fold(0.0, f64::max)
    }

    /// Whether the lids of an eye are shut: their margins pass each other all along, whatever else the face does.
    pub fn shuts_eye(&self, muscles: &MuscleSet, side: Side) -> bool {
        self.lid_pull(muscles, LidDrive::Close, side) >= 1.0
    }

    /// Checks every name and number against the muscles and the ranges of jaw and gaze.
    ///
    /// # Errors
    /// [`SimError::UnknownName`], [`SimError::OutOfRange`], or [`SimError::NoSides`] for unequal sides of a muscle that
    /// crosses the mid-plane.
    pub fn check(&self, muscles: &MuscleSet) -> Result<(), SimError> {
        for (name, sides) in &self.contractions {
            let key = muscles.key(name)?;
            for value in [sides.left, sides.right] {
                in_range(|| format!("contraction of `{name}`"), value, 0.0, 1.0)?;
            }
            if (sides.left - sides.right).abs() > 0.0 {
                muscles.key(&format!("{name}.left"))?;
            }
            if muscles.index(name).is_none() || key.muscles.len() != 1 {
                return Err(SimError::UnknownName {
                    kind: "muscle of a pose",
                    name: name.clone(),
                    known: "single muscles".to_owned(),
                });
            }
        }
        let jaw = &self.jaw;
        in_range(
            || "jaw.open_rad".to_owned(),
            jaw.open_rad,
            -0.05,
            MAX_OPEN_RAD,
        )?;
        let forward = MAX_PROTRUSION_MM;
        in_range(
            || "jaw.protrusion_mm".to_owned(),
            jaw.protrusion_mm,
            -forward / 3.0,
            forward,
        )?;
        let side = MAX_LATERAL_MM;
        in_range(|| "jaw.lateral_mm".to_owned(), jaw.lateral_mm, -side, side)?;
        for (what, value) in [
            ("gaze.yaw_rad", self.gaze.yaw_rad),
            ("gaze.pitch_rad", self.gaze.pitch_rad),
        ] {
            in_range(|| what.to_owned(), value, -MAX_GAZE_RAD, MAX_GAZE_RAD)?;
        }
        Ok(())
    }
}

pub(crate) fn in_range(
    what: impl Fn() -> String,
    value: f64,
    min: f64,
    max: f64,
) -> Result<(), SimError> {
    if value >= min && value <= max {
        return Ok(());
    }
    Err(SimError::OutOfRange {
        what: what(),
        value,
        min,
        max,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_apart_and_scale() {
        let muscles = MuscleSet::embedded();
        let mut pose = Pose::default();
        assert!(pose.is_neutral());
        pose.set(muscles, "zygomatic_major", 0.8).expect("known");
        pose.set(muscles, "zygomatic_major.right", 0.2)
            .expect("known");
        let half = pose.scaled(0.5).contractions["zygomatic_major"];
        assert_eq!((half.left, half.right), (0.4, 0.1));
        let mirrored = pose.mirrored().contractions["zygomatic_major"];
        assert_eq!((mirrored.left, mirrored.right), (0.2, 0.8));
        assert!(pose.scaled(0.0).is_neutral());
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let muscles = MuscleSet::embedded();
        let mut pose = Pose::default();
        assert!(pose.set(muscles, "zygomatic_major", 1.5).is_err());
        assert!(pose.set(muscles, "zygomatic_major", f64::NAN).is_err());
        pose.jaw.open_rad = 2.0;
        let error = pose.check(muscles).expect_err("too wide").to_string();
        assert_eq!(error, "jaw.open_rad = 2 must be in [-0.05, 0.7]");
    }
}
