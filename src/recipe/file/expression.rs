//! `[[expression]]` and `[simulation]`: what faces do, and how that is solved.

use std::collections::BTreeMap;

use facile_sim::SolverKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[expression]]`: muscles, action units, jaw and gaze add up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExpressionTable {
    /// Name in records. Alone it selects a built-in expression.
    pub name: String,
    /// Each intensity, over 0 and up to 1, makes an expression of its own: contractions, action units, jaw and gaze times
    /// the intensity.
    #[serde(default = "default_intensities")]
    pub intensities: Vec<f64>,
    /// Contraction from 0 to 1 of each muscle or group of muscles, of one side with `.left` or `.right` after the name.
    #[serde(default)]
    pub muscles: BTreeMap<String, f64>,
    /// Intensity from 0 to 1 of each FACS action unit, such as `AU12`, of one side with `.left` or `.right`.
    #[serde(default)]
    pub action_units: BTreeMap<String, f64>,
    /// Opening of the jaw, from 0 to 40 degrees.
    #[serde(default)]
    pub jaw_deg: f64,
    /// Motion of the jaw forwards, mm.
    #[serde(default)]
    pub jaw_protrusion_mm: f64,
    /// Motion of the jaw to the subject's left, mm.
    #[serde(default)]
    pub jaw_lateral_mm: f64,
    /// Turn of the eyes to the subject's left, from -40 to 40 degrees.
    #[serde(default)]
    pub gaze_yaw_deg: f64,
    /// Turn of the eyes upwards, from -40 to 40 degrees.
    #[serde(default)]
    pub gaze_pitch_deg: f64,
}

/// `[simulation]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationTable {
    /// The solver. All reach the same equilibrium; `quasi_static` is by far the fastest.
    pub solver: SolverWord,
}

/// Name of a solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SolverWord {
    /// Minimises the energy, contact as a bound.
    #[default]
    QuasiStatic,
    /// The paper's damped motion, followed until it rests.
    Verlet,
    /// Motion that is stopped whenever it goes uphill.
    Fire,
}

impl From<SolverWord> for SolverKind {
    fn from(word: SolverWord) -> Self {
        match word {
            SolverWord::QuasiStatic => Self::QuasiStatic,
            SolverWord::Verlet => Self::Verlet,
            SolverWord::Fire => Self::Fire,
        }
    }
}

fn default_intensities() -> Vec<f64> {
    vec![1.0]
}
