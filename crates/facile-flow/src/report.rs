//! What a registration says about itself. Holds no times, so that equal input gives equal bytes.

use facile_core::Similarity3;
use serde::{Deserialize, Serialize};

/// The quality of one registration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegistrationReport {
    /// Millimetres in one unit of the scan.
    pub unit_mm: f64,
    /// Whether the unit was recognised; else the head's size was set to the reference's.
    pub unit_is_known: bool,
    /// Head frame (mm) from the scan's coordinates, row by row, `[rotation * scale | translation]`.
    pub head_from_scan: [[f64; 4]; 3],
    /// Size of the head against the reference's.
    pub size: f64,
    /// Share of the reference's face with scan surface nearby, before the fit.
    pub rigid_coverage: f64,
    /// Root mean square distance of the rigidly aligned reference face to the scan, mm.
    pub rigid_distance_mm: f64,
    /// Correlation of mean curvature between the aligned reference face and the scan, `[-1, 1]`.
    pub curvature_correlation: f64,
    /// Share of the outer skin's area that ended on the scan's surface.
    pub coverage: f64,
    /// The same for the face: forehead to chin, between the ears.
    pub face_coverage: f64,
    /// Mean distance between forward and backward flow over the face, mm.
    pub forward_backward_mm: f64,
    /// Mean distance of the covered skin to the scan, mm.
    pub surface_distance_mean_mm: f64,
    /// 95th percentile of that distance, mm.
    pub surface_distance_p95_mm: f64,
    /// Triangles of the whole head that are folded over.
    pub folded_triangles: usize,
    /// Mean expected error over the face, mm.
    pub expected_error_mm: f64,
}

/// A similarity as the rows of its 3x4 matrix.
pub(crate) fn rows_of(similarity: &Similarity3) -> [[f64; 4]; 3] {
    let m = similarity.to_homogeneous();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// Value below which a share `q` of the values lies; 0 for none.
pub(crate) fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values
        .get(((last as f64) * q).round() as usize)
        .copied()
        .unwrap_or(0.0)
}
