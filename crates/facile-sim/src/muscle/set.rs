//! The muscles' TOML file.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::OnceLock;

use serde::Deserialize;

use crate::SimError;

/// How a muscle contracts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MuscleKind {
    /// Towards its attachment, the first point.
    Linear,
    /// Towards its middle.
    Sphincter,
}

impl MuscleKind {
    /// The origin `o` of the contraction as a fraction of the muscle's length.
    pub fn origin(self) -> f64 {
        match self {
            Self::Linear => 0.0,
            Self::Sphincter => 0.5,
        }
    }
}

/// Whether a muscle comes in pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Symmetry {
    /// The left one is given, the right one is its mirror image: `phi` becomes `-phi`.
    Both,
    /// One muscle that crosses the mid-plane.
    Midline,
}

/// A side of the face, the subject's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// The subject's left, `x > 0`.
    Left,
    /// The subject's right, `x < 0`.
    Right,
}

impl Side {
    /// Both sides, left first.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];
}

/// What a muscle does to the tarsal plate of its eyelids, beside what it does to the fascia.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LidDrive {
    /// Closes both lids over the eyeball.
    Close,
    /// Lifts the upper lid and lowers the lower one.
    Open,
}

/// A muscle on the cylinder of the reference head.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Muscle {
    /// Name in recipes, `snake_case`.
    pub name: String,
    /// Linear or sphincter.
    pub kind: MuscleKind,
    /// Paired or not.
    pub side: Symmetry,
    /// Fascia nearer than this to the centre line belongs to the muscle, mm on the reference head.
    pub width_mm: f64,
    /// The share of its length a linear or sphincter muscle loses at full contraction, in `(0, 1]`.
    ///
    /// The paper's value is 1: the muscle shortens to a point. Muscles shorten by a third to a half.
    #[serde(default = "full")]
    pub shortening: f64,
    /// How many times firmer than fascia elsewhere the muscle's origin is bound to bone when it contracts, at least 1.
    ///
    /// The paper's value is 1: a short muscle then draws its origin as far as its insertion.
    #[serde(default = "full")]
    pub origin_hold: f64,
    /// The lids' plates that it moves.
    #[serde(default)]
    pub lid: Option<LidDrive>,
    /// Control points `[h (mm), phi (degrees)]`, attachment first, at least 2. A smooth line passes through them.
    pub points: Vec<[f64; 2]>,
    /// Origin, insertion and action, from anatomy.
    pub note: String,
}

fn full() -> f64 {
    1.0
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    group: BTreeMap<String, Vec<String>>,
    muscle: Vec<Muscle>,
}

/// What a key of a recipe means: muscles of one or both sides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Key {
    /// Indices of the muscles.
    pub muscles: Vec<usize>,
    /// The sides; both for a muscle without sides.
    pub sides: Vec<Side>,
}

/// All muscles of the reference head, in the order of their file, and named groups of them.
#[derive(Clone, Debug, PartialEq)]
pub struct MuscleSet {
    muscles: Vec<Muscle>,
    groups: BTreeMap<String, Vec<usize>>,
}

impl MuscleSet {
    /// The muscles that ship with the program.
    ///
    /// # Panics
    /// If the embedded file is wrong, which a test rules out.
    pub fn embedded() -> &'static Self {
        static SET: OnceLock<MuscleSet> = OnceLock::new();
        SET.get_or_init(|| {
            let text = include_str!(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/../../assets/muscles.toml"
            ));
            Self::parse(text, "muscles.toml").expect("the embedded muscles are tested")
        })
    }

    /// Reads a TOML text; `file` names it in errors.
    ///
    /// # Errors
    /// [`SimError::Format`] for text that does not parse, [`SimError::Muscle`] and [`SimError::OutOfRange`] for a muscle
    /// that breaks a rule, [`SimError::UnknownName`] for a group of unknown muscles.
    pub fn parse(text: &str, file: &str) -> Result<Self, SimError> {
        let parsed: File = toml::from_str(text).map_err(|e| SimError::Format {
            file: file.to_owned(),
            reason: e.to_string(),
        })?;
        let mut set = Self {
            muscles: Vec::new(),
            groups: BTreeMap::new(),
        };
        for muscle in parsed.muscle {
            check(&muscle, &set)?;
            set.muscles.push(muscle);
        }
        for (name, members) in parsed.group {
            if set.index(&name).is_some() {
                let reason = "a group has the same name".to_owned();
                return Err(SimError::Muscle { name, reason });
            }
            let members = members
                .iter()
                .map(|m| set.index(m).ok_or_else(|| set.unknown(m)))
                .collect::<Result<_, _>>()?;
            set.groups.insert(name, members);
        }
        Ok(set)
    }

    /// The muscles, in the order of the file.
    pub fn muscles(&self) -> &[Muscle] {
        &self.muscles
    }

    /// The place of a muscle in [`Self::muscles`].
    pub fn index(&self, name: &str) -> Option<usize> {
        self.muscles.iter().position(|m| m.name == name)
    }

    /// Names of groups and the places of their members.
    pub fn groups(&self) -> &BTreeMap<String, Vec<usize>> {
        &self.groups
    }

    /// Reads a key: the name of a muscle or of a group, alone or followed by `.left` or `.right`.
    ///
    /// # Errors
    /// [`SimError::UnknownName`], or [`SimError::NoSides`] for one side of a muscle that crosses the mid-plane.
    pub fn key(&self, key: &str) -> Result<Key, SimError> {
        let (name, sides) = match key.rsplit_once('.') {
            Some((name, "left")) => (name, vec![Side::Left]),
            Some((name, "right")) => (name, vec![Side::Right]),
            _ => (key, Side::BOTH.to_vec()),
        };
        let muscles = match (self.index(name), self.groups.get(name)) {
            (Some(index), _) => vec![index],
            (None, Some(members)) => members.clone(),
            (None, None) => return Err(self.unknown(key)),
        };
        if sides.len() == 1
            && let Some(&m) = muscles
                .iter()
                .find(|&&m| self.muscles[m].side == Symmetry::Midline)
        {
            return Err(SimError::NoSides {
                name: self.muscles[m].name.clone(),
            });
        }
        Ok(Key { muscles, sides })
    }

    fn unknown(&self, name: &str) -> SimError {
        let known: Vec<&str> = self
            .muscles
            .iter()
            .map(|m| m.name.as_str())
            .chain(self.groups.keys().map(String::as_str))
            .collect();
        SimError::UnknownName {
            kind: "muscle",
            name: name.to_owned(),
            known: known.join(", "),
        }
    }
}

fn check(muscle: &Muscle, before: &MuscleSet) -> Result<(), SimError> {
    let bad = |reason: &str| {
        Err(SimError::Muscle {
            name: muscle.name.clone(),
            reason: reason.to_owned(),
        })
    };
    let snake = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if muscle.name.is_empty() || !muscle.name.chars().all(snake) {
        return bad("a name has lower-case letters, digits and underscores only");
    }
    if before.index(&muscle.name).is_some() {
        return bad("defined twice");
    }
    if muscle.points.len() < 2 {
        return bad("needs at least 2 points");
    }
    if muscle
        .points
        .windows(2)
        .any(|w| w[0].iter().zip(&w[1]).all(|(a, b)| (a - b).abs() < 1e-9))
    {
        return bad("two points in a row coincide");
    }
    let range = |what: &str, value: f64, min: f64, max: f64| {
        if value >= min && value <= max {
            return Ok(());
        }
        let what = format!("muscle `{}`: {what}", muscle.name);
        Err(SimError::OutOfRange {
            what,
            value,
            min,
            max,
        })
    };
    range("width_mm", muscle.width_mm, 0.1, 100.0)?;
    range("shortening", muscle.shortening, 0.01, 1.0)?;
    range("origin_hold", muscle.origin_hold, 1.0, 100.0)?;
    for [h, phi] in &muscle.points {
        range("h", *h, -1000.0, 1000.0)?;
        range("phi", phi.to_radians(), -PI, PI)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
        [group]
        mouth = ["ring", "lift"]
        [[muscle]]
        name = "ring"
        kind = "sphincter"
        side = "midline"
        width_mm = 6.0
        points = [[-60.0, -20.0], [-58.0, 0.0], [-60.0, 20.0]]
        note = "around the mouth"
        [[muscle]]
        name = "lift"
        kind = "linear"
        side = "both"
        width_mm = 8.0
        shortening = 0.5
        points = [[-20.0, 50.0], [-65.0, 20.0]]
        note = "from the cheek bone to the corner of the mouth"
    "#;

    #[test]
    fn keys_name_muscles_groups_and_sides() {
        let set = MuscleSet::parse(TEXT, "t").expect("valid");
        assert_eq!(set.key("lift.left").expect("known").sides, [Side::Left]);
        assert_eq!(set.key("mouth").expect("known").muscles, [0, 1]);
        assert_eq!(set.key("lift").expect("known").sides, Side::BOTH);
        assert!(matches!(
            set.key("ring.left"),
            Err(SimError::NoSides { .. })
        ));
        let error = set.key("smirk").expect_err("unknown").to_string();
        assert_eq!(error, "unknown muscle `smirk`; known are ring, lift, mouth");
    }

    #[test]
    fn broken_files_are_refused_with_the_place() {
        let broken = TEXT.replace("width_mm = 8.0", "width_mm = -8.0");
        let error = MuscleSet::parse(&broken, "t").expect_err("negative");
        assert_eq!(
            error.to_string(),
            "muscle `lift`: width_mm = -8 must be in [0.1, 100]"
        );
        let error = MuscleSet::parse(&TEXT.replace("kind", "kin"), "m.toml").expect_err("key");
        assert!(error.to_string().contains("kin"), "{error}");
        let twice = TEXT.replace("[-65.0, 20.0]", "[-20.0, 50.0]");
        assert!(MuscleSet::parse(&twice, "t").is_err());
    }

    #[test]
    fn the_embedded_muscles_parse() {
        assert!(MuscleSet::embedded().muscles().len() >= 20);
    }
}
