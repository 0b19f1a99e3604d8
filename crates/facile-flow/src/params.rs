//! Settings of a registration.

use serde::{Deserialize, Serialize};

use crate::FlowError;
use crate::channels::ChannelWeights;
use crate::flow::FlowParams;
use crate::normalise::NormaliseParams;

/// Settings of a registration. The defaults are tuned on ICT identities and raw scans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationParams {
    /// Search for the face.
    pub normalise: NormaliseParams,
    /// Weights of the channels of eq. 4.
    pub weights: ChannelWeights,
    /// Optical flow.
    pub flow: FlowParams,
    /// Side of a cell of the radial maps at a radius of 80 mm, mm; smaller is slower.
    pub cell_mm: f64,
    /// Standard deviation of the neighbourhood of the curvature estimate, mm.
    pub curvature_sigma_mm: f64,
    /// Whether the identity model is fitted before the smooth deformation.
    pub use_identity: bool,
    /// Rounds of nearest points that fit the identity model before the flow begins.
    pub nearest_rounds: usize,
    /// Smoothing length of the deformation in each round of flow and fit, mm; the number of rounds is its length.
    pub smoothing_mm: Vec<f64>,
    /// Whether the last round's deformation slides along the scan's surface, told the distance to it together with the
    /// places of features. A sixth of the time of `coarse`.
    pub slides_on_surface: bool,
    /// Smoothing length of each step onto the surface after the last round, mm.
    pub surface_smoothing_mm: Vec<f64>,
    /// Least correlation of mean curvature between the aligned reference face and the scan: below, it is no face.
    pub min_curvature_correlation: f64,
    /// Largest side of the subject's texture, texels; smaller, down to a quarter or 512, if the scan's own colours
    /// are coarser.
    pub texture_size: usize,
    /// Whether the light baked into the scan's colours is evened out.
    pub delight: bool,
}

impl Default for RegistrationParams {
    fn default() -> Self {
        Self {
            normalise: NormaliseParams::default(),
            weights: ChannelWeights::default(),
            flow: FlowParams::default(),
            cell_mm: 1.5,
            curvature_sigma_mm: 3.0,
            use_identity: true,
            nearest_rounds: 6,
            smoothing_mm: vec![30.0, 20.0, 9.0],
            slides_on_surface: true,
            surface_smoothing_mm: vec![12.0, 6.0],
            min_curvature_correlation: 0.25,
            texture_size: 2048,
            delight: false,
        }
    }
}

impl RegistrationParams {
    /// Settings for a quick look: half of the time of the defaults, at most twice their error.
    ///
    /// Cells of 3.3 mm, two rounds of flow of one warp a level, no slide along the surface and no step onto it, and a texture
    /// of 192 texels a side.
    pub fn coarse() -> Self {
        Self {
            cell_mm: 3.3,
            flow: FlowParams {
                warps: 1,
                sweeps: 4,
                ..FlowParams::default()
            },
            nearest_rounds: 4,
            smoothing_mm: vec![30.0, 12.0],
            slides_on_surface: false,
            surface_smoothing_mm: Vec::new(),
            texture_size: 192,
            ..Self::default()
        }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`FlowError::Parameter`] with the first value outside its range.
    pub fn validate(&self) -> Result<(), FlowError> {
        let checks = [
            ("cell_mm", self.cell_mm, 0.3, 6.0, "0.3 to 6 mm"),
            (
                "curvature_sigma_mm",
                self.curvature_sigma_mm,
                0.5,
                20.0,
                "0.5 to 20 mm",
            ),
            (
                "texture_size",
                self.texture_size as f64,
                16.0,
                8192.0,
                "16 to 8192 texels",
            ),
            ("flow.levels", self.flow.levels as f64, 1.0, 12.0, "1 to 12"),
            (
                "normalise.max_angle",
                self.normalise.max_angle,
                0.0,
                1.2,
                "0 to 1.2 rad",
            ),
            (
                "normalise.unit_mm",
                self.normalise.unit_mm.unwrap_or(1.0),
                1e-6,
                1e6,
                "above 0",
            ),
        ];
        let lengths = self.smoothing_mm.iter().chain(&self.surface_smoothing_mm);
        let all = checks
            .into_iter()
            .chain(lengths.map(|l| ("smoothing_mm", *l, 0.1, 500.0, "0.1 to 500 mm")));
        for (name, found, low, high, allowed) in all {
            if !(low..=high).contains(&found) {
                return Err(FlowError::Parameter {
                    name,
                    found,
                    allowed,
                });
            }
        }
        Ok(())
    }
}
