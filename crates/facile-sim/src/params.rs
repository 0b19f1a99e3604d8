//! The constants of the model: Table 1 of the paper, and what the paper leaves open.

/// Table 1 of the paper and the muscle gain of its section 4.2.
///
/// The table is unit-less and read in mm. The paper calls it "Table 4" once in its text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperParams {
    /// Stiffness of springs in the skin, before Van Gelder's correction.
    pub skin_stiffness: f64,
    /// Stiffness of the vertical and crossed springs between skin and fascia.
    pub skin_fascia_stiffness: f64,
    /// Stiffness of springs in the fascia, before Van Gelder's correction.
    pub fascia_stiffness: f64,
    /// Stiffness of the springs of length 0 between attached fascia and skull.
    pub fascia_skull_stiffness: f64,
    /// Mass `m_i` of a node.
    pub mass: f64,
    /// Damping `gamma_i` of a node.
    pub damping: f64,
    /// `k_s` of eq. 12, shape preservation.
    pub shape_stiffness: f64,
    /// `k_v` of eq. 13, volume preservation.
    pub volume_stiffness: f64,
    /// `S`: how many times stiffer a fully contracted muscle is than relaxed fascia.
    pub muscle_gain: f64,
}

impl Default for PaperParams {
    fn default() -> Self {
        Self {
            skin_stiffness: 20.0,
            skin_fascia_stiffness: 40.0,
            fascia_stiffness: 60.0,
            fascia_skull_stiffness: 5.0,
            mass: 0.5,
            damping: 25.0,
            shape_stiffness: 30.0,
            volume_stiffness: 2.0,
            muscle_gain: 20.0,
        }
    }
}

impl PaperParams {
    /// `S(c) = 1 + (S - 1) c`: the gain of a muscle at contraction `c`. The paper multiplies by `S` at any `c > 0`,
    /// which makes the face jump when a muscle wakes up.
    pub fn gain(&self, contraction: f64) -> f64 {
        1.0 + (self.muscle_gain - 1.0) * contraction
    }
}
