//! Expressions by name: muscle contractions, jaw and gaze, from TOML.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use serde::{Deserialize, Serialize};

use crate::SimError;
use crate::action_units::action_units;
use crate::muscle::MuscleSet;
use crate::pose::Pose;

/// An expression as a file says it. Muscles, action units, jaw and gaze add up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expression {
    /// Its name.
    pub name: String,
    /// Contractions in `[0, 1]` by muscle or group, alone or with `.left` or `.right`.
    #[serde(default)]
    pub muscles: BTreeMap<String, f64>,
    /// Intensities in `[0, 1]` by action unit, such as `AU12`, alone or with `.left` or `.right`.
    #[serde(default)]
    pub action_units: BTreeMap<String, f64>,
    /// Opening of the jaw, degrees.
    #[serde(default)]
    pub jaw_deg: f64,
    /// Protrusion of the jaw, mm.
    #[serde(default)]
    pub jaw_protrusion_mm: f64,
    /// Motion of the jaw to the subject's left, mm.
    #[serde(default)]
    pub jaw_lateral_mm: f64,
    /// Turn of the eyes to the subject's left, degrees.
    #[serde(default)]
    pub gaze_yaw_deg: f64,
    /// Turn of the eyes upwards, degrees.
    #[serde(default)]
    pub gaze_pitch_deg: f64,
}

impl Expression {
    /// The pose at full intensity.
    ///
    /// # Errors
    /// [`SimError::UnknownName`], [`SimError::NoSides`] and [`SimError::OutOfRange`] for what the muscles do not know.
    pub fn pose(&self, muscles: &MuscleSet) -> Result<Pose, SimError> {
        let mut pose = Pose::default();
        // A side's own value wins over the one for both, whatever the order of the keys.
        let one_side = |key: &str| key.ends_with(".left") || key.ends_with(".right");
        for sided in [false, true] {
            for (key, &c) in self.muscles.iter().filter(|(k, _)| one_side(k) == sided) {
                pose.set(muscles, key, c)?;
            }
        }
        pose.jaw.open_rad = self.jaw_deg.to_radians();
        pose.jaw.protrusion_mm = self.jaw_protrusion_mm;
        pose.jaw.lateral_mm = self.jaw_lateral_mm;
        pose.gaze.yaw_rad = self.gaze_yaw_deg.to_radians();
        pose.gaze.pitch_rad = self.gaze_pitch_deg.to_radians();
        let pose = pose.combined(&action_units(muscles, &self.action_units)?);
        pose.check(muscles)?;
        Ok(pose)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    expression: Vec<Expression>,
}

/// Named expressions, in the order of their file.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpressionSet {
    expressions: Vec<Expression>,
}

impl ExpressionSet {
    /// The expressions that ship with the program.
    ///
    /// # Panics
    /// If the embedded file is wrong, which a test rules out.
    pub fn embedded() -> &'static Self {
        static SET: OnceLock<ExpressionSet> = OnceLock::new();
        SET.get_or_init(|| {
            let text = include_str!(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/../../assets/expressions.toml"
            ));
            Self::parse(text, "expressions.toml").expect("the embedded expressions are tested")
        })
    }

    /// Reads a TOML text; `file` names it in errors.
    ///
    /// # Errors
    /// [`SimError::Format`] for text that does not parse or a name that is given twice.
    pub fn parse(text: &str, file: &str) -> Result<Self, SimError> {
        let bad = |reason: String| SimError::Format {
            file: file.to_owned(),
            reason,
        };
        let parsed: File = toml::from_str(text).map_err(|e| bad(e.to_string()))?;
        for (k, e) in parsed.expression.iter().enumerate() {
            if parsed.expression[..k].iter().any(|f| f.name == e.name) {
                return Err(bad(format!("expression `{}` is defined twice", e.name)));
            }
        }
        Ok(Self {
            expressions: parsed.expression,
        })
    }

    /// The expressions, in the order of the file.
    pub fn expressions(&self) -> &[Expression] {
        &self.expressions
    }

    /// The expression of a name.
    ///
    /// # Errors
    /// [`SimError::UnknownName`] with the known names.
    pub fn get(&self, name: &str) -> Result<&Expression, SimError> {
        self.expressions
            .iter()
            .find(|e| e.name == name)
            .ok_or_else(|| SimError::UnknownName {
                kind: "expression",
                name: name.to_owned(),
                known: self
                    .expressions
                    .iter()
                    .map(|e| e.name.as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_embedded_expression_is_a_pose() {
        let (set, muscles) = (ExpressionSet::embedded(), MuscleSet::embedded());
        for name in [
            "neutral",
            "smile",
            "anger",
            "disgust",
            "fear",
            "sadness",
            "surprise",
            "kiss",
            "mouth_open",
            "blink",
            "wink",
        ] {
            let pose = set
                .get(name)
                .expect("built in")
                .pose(muscles)
                .expect("valid");
            assert_eq!(pose.is_neutral(), name == "neutral");
        }
    }

    #[test]
    fn one_side_wins_and_errors_name_the_culprit() {
        let text = "[[expression]]\nname = \"smirk\"\nmuscles = { zygomatic_major = 0.2, \
                    \"zygomatic_major.left\" = 0.9 }\njaw_deg = 4.0\n";
        let set = ExpressionSet::parse(text, "e.toml").expect("valid");
        let muscles = MuscleSet::embedded();
        let pose = set
            .get("smirk")
            .expect("defined")
            .pose(muscles)
            .expect("valid");
        let sides = pose.contractions["zygomatic_major"];
        assert_eq!((sides.left, sides.right), (0.9, 0.2));
        assert!((pose.jaw.open_rad - 4f64.to_radians()).abs() < 1e-15);
        assert!(
            set.get("grin")
                .expect_err("unknown")
                .to_string()
                .contains("smirk")
        );
        let unknown = text.replace("zygomatic_major = ", "zygomatic = 0.1, cheek = ");
        let set = ExpressionSet::parse(&unknown, "e.toml").expect("parses");
        assert!(set.expressions()[0].pose(muscles).is_err());
    }
}
