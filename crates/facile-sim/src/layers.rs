//! Skin and fascia of a subject at rest (section 4.1).
//!
//! The fascia is the skin moved inward by the tissue's thickness. Where the skin is curved more tightly than the tissue
//! is thick (rims of lips and lids, nostrils) the moved layer would fold through itself, so there the tissue is thinned
//! until every prism between a skin triangle and its fascia triangle keeps its orientation.

use crate::SimError;
use crate::vector::{V3, add, add_scaled, cross, dot, norm, scale, sub};

/// A fascia triangle must keep this share of its skin triangle's area, and a prism this share of area times thickness.
const MIN_SHARE: f64 = 0.25;
/// Thinning stops here; a prism that is still folded is left to the solver.
const MIN_FACTOR: f64 = 0.04;

/// Positions of both layers at rest, mm.
#[derive(Clone, Debug)]
pub(crate) struct Layers {
    pub(crate) skin: Vec<V3>,
    pub(crate) fascia: Vec<V3>,
}

impl Layers {
    /// Moves `skin` along the unit vectors `inward` by `thickness` (mm, per node), thinned where needed.
    pub(crate) fn new(
        triangles: &[[u32; 3]],
        skin: Vec<V3>,
        inward: &[V3],
        thickness: &[f64],
    ) -> Result<Self, SimError> {
        if let Some(node) = skin.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return Err(SimError::Subject {
                subject: String::new(),
                reason: format!("the position of node {node} is not finite"),
            });
        }
        let mut depth: Vec<f64> = thickness.iter().map(|t| t.max(0.05)).collect();
        let least: Vec<f64> = depth.iter().map(|t| t * MIN_FACTOR).collect();
        let offset = |depth: &[f64]| -> Vec<V3> {
            (0..skin.len())
                .map(|i| add_scaled(skin[i], inward[i], depth[i]))
                .collect()
        };
        for _ in 0..80 {
            let fascia = offset(&depth);
            let mut thin = vec![false; skin.len()];
            for t in triangles {
                if is_folded(t, &skin, &fascia) {
                    for &i in t {
                        thin[i as usize] = true;
                    }
                }
            }
            let mut changed = false;
            for i in 0..depth.len() {
                if thin[i] && depth[i] > least[i] {
                    depth[i] = (depth[i] * 0.88).max(least[i]);
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
        Ok(Self {
            fascia: offset(&depth),
            skin,
        })
    }
}

fn is_folded(triangle: &[u32; 3], skin: &[V3], fascia: &[V3]) -> bool {
    let s = triangle.map(|i| skin[i as usize]);
    let f = triangle.map(|i| fascia[i as usize]);
    let area = area_vector(s);
    let size = norm(area);
    if size < 1e-9 {
        return false;
    }
    let kept = dot(area_vector(f), area) / (size * size);
    let up = scale(
        add(add(sub(s[0], f[0]), sub(s[1], f[1])), sub(s[2], f[2])),
        1.0 / 3.0,
    );
    kept < MIN_SHARE || dot(up, area) < MIN_SHARE * norm(up) * size
}

/// Half the cross product of two edges: the triangle's area along its normal.
pub(crate) fn area_vector([a, b, c]: [V3; 3]) -> V3 {
    scale(cross(sub(b, a), sub(c, a)), 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_sheet_keeps_its_thickness_and_a_tight_fold_thins() {
        let triangles = [[0, 1, 2]];
        let skin = vec![[0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let flat = Layers::new(&triangles, skin.clone(), &[[0.0, 0.0, -1.0]; 3], &[5.0; 3]);
        let flat = flat.expect("finite");
        assert!((flat.fascia[1][2] + 5.0).abs() < 1e-12);
        // Directions that meet 1 mm below the skin.
        let inward: Vec<V3> = skin
            .iter()
            .map(|p| crate::vector::unit([0.66 - p[0], 0.66 - p[1], -1.0]))
            .collect();
        let tight = Layers::new(&triangles, skin, &inward, &[5.0; 3]).expect("finite");
        assert!(!is_folded(&triangles[0], &tight.skin, &tight.fascia));
    }

    #[test]
    fn positions_that_are_not_finite_are_refused() {
        let skin = vec![[f64::NAN, 0.0, 0.0]];
        assert!(Layers::new(&[], skin, &[[0.0, 0.0, -1.0]], &[5.0]).is_err());
    }
}
