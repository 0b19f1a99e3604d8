//! The springs of the three layers at rest (section 4.1).

use crate::params::PaperParams;
use crate::template::Template;
use crate::vector::{V3, cross, dot, norm, sub};

/// Squared lengths are floored at this share of their mean, where Van Gelder's formula would divide by zero.
const MIN_LENGTH_SHARE: f64 = 1e-3;
/// Range of Van Gelder's factor; on the reference head it is 0.25 to 2.4 away from slivers.
const FACTOR_RANGE: (f64, f64) = (0.05, 5.0);

/// Springs as separate lists of the same length. Those of the fascia come first, in the order of the template's edges.
#[derive(Clone, Debug, Default)]
pub(crate) struct Springs {
    pub(crate) ends: Vec<[u32; 2]>,
    pub(crate) stiffness: Vec<f64>,
    pub(crate) rest_length: Vec<f64>,
}

impl Springs {
    /// All springs between skin and fascia and within both. `rest`: the skin's nodes, then the fascia's.
    pub(crate) fn new(template: &Template, params: &PaperParams, rest: &[V3]) -> Self {
        let n = template.node_count() as u32;
        let factors = van_gelder(&template.triangles, &template.edges, &rest[..n as usize]);
        let mut springs = Self::default();
        let mut add = |a: u32, b: u32, stiffness: f64| {
            springs.ends.push([a, b]);
            springs.stiffness.push(stiffness);
            let length = norm(sub(rest[a as usize], rest[b as usize]));
            springs.rest_length.push(length);
        };
        for (&[a, b], factor) in template.edges.iter().zip(&factors) {
            add(n + a, n + b, params.fascia_stiffness * factor);
        }
        for (&[a, b], factor) in template.edges.iter().zip(&factors) {
            add(a, b, params.skin_stiffness * factor);
        }
        for i in 0..n {
            add(i, n + i, params.skin_fascia_stiffness);
        }
        for &[a, b] in &template.edges {
            add(a, n + b, params.skin_fascia_stiffness);
            add(b, n + a, params.skin_fascia_stiffness);
        }
        springs
    }
}

/// Van Gelder's factor of each edge: the area of its triangles over its squared length. Multiplied by a membrane's
/// modulus times thickness it gives the stiffness with which a triangle mesh behaves like that membrane.
///
/// Source: Van Gelder, Approximate simulation of elastic membranes by triangulated spring meshes, 1998, eq. 5.
pub(crate) fn van_gelder(triangles: &[[u32; 3]], edges: &[[u32; 2]], x: &[V3]) -> Vec<f64> {
    let mut area = vec![0.0; edges.len()];
    for &[a, b, c] in triangles {
        let p = [a, b, c].map(|i| x[i as usize]);
        let size = 0.5 * norm(cross(sub(p[1], p[0]), sub(p[2], p[0])));
        for [u, v] in [[a, b], [b, c], [c, a]] {
            if let Ok(e) = edges.binary_search(&[u.min(v), u.max(v)]) {
                area[e] += size;
            }
        }
    }
    let squared: Vec<f64> = edges
        .iter()
        .map(|e| {
            let d = sub(x[e[0] as usize], x[e[1] as usize]);
            dot(d, d)
        })
        .collect();
    let floor = MIN_LENGTH_SHARE * squared.iter().sum::<f64>() / edges.len().max(1) as f64;
    area.iter()
        .zip(&squared)
        .map(|(a, l)| (a / l.max(floor).max(1e-12)).clamp(FACTOR_RANGE.0, FACTOR_RANGE.1))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_equilateral_triangles_give_the_known_factor() {
        let h = 0.5 * 3f64.sqrt();
        let x = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.5, h, 0.0],
            [0.5, -h, 0.0],
        ];
        let edges = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3]];
        let factors = van_gelder(&[[0, 1, 2], [0, 3, 1]], &edges, &x);
        assert!((factors[0] - h).abs() < 1e-12);
        assert!((factors[1] - 0.5 * h).abs() < 1e-12);
    }

    #[test]
    fn a_zero_length_edge_has_a_finite_factor() {
        let x = [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]];
        let factors = van_gelder(&[[0, 1, 2]], &[[0, 1], [0, 2], [1, 2]], &x);
        assert!(factors.iter().all(|f| f.is_finite()));
    }
}
