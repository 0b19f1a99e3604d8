//! The springs of the three layers at rest (section 4.1).

use crate::params::PaperParams;
use crate::simd::{LANES, Lanes};
use crate::template::Template;
use crate::vector::{V3, cross, dot, norm, sub};

/// Squared lengths are floored at this share of their mean, where Van Gelder's formula would divide by zero.
const MIN_LENGTH_SHARE: f64 = 1e-3;
/// Range of Van Gelder's factor; on the reference head it is 0.25 to 2.4 away from slivers.
const FACTOR_RANGE: (f64, f64) = (0.05, 5.0);

/// The springs along each edge of the mesh, by lane: in the skin, in the fascia, from the skin's first end to the fascia's
/// second, from the skin's second end to the fascia's first; and those between skin and fascia of each node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Springs {
    pub(crate) stiffness: Vec<Lanes>,
    pub(crate) rest_length: Vec<Lanes>,
    pub(crate) vertical_stiffness: f64,
    pub(crate) vertical_length: Vec<f64>,
}

/// Lane of an edge's spring in the fascia.
pub(crate) const FASCIA: usize = 1;

/// Ends of the springs of an edge, by lane.
pub(crate) fn ends([a, b]: [u32; 2], n: u32) -> [[u32; 2]; LANES] {
    [[a, b], [n + a, n + b], [a, n + b], [b, n + a]]
}

impl Springs {
    /// All springs between skin and fascia and within both. `rest`: the skin's nodes, then the fascia's.
    pub(crate) fn new(template: &Template, params: &PaperParams, rest: &[V3]) -> Self {
        let n = template.node_count();
        let factors = van_gelder(&template.triangles, &template.edges, &rest[..n]);
        let length = |[a, b]: [u32; 2]| norm(sub(rest[a as usize], rest[b as usize]));
        let crossed = params.skin_fascia_stiffness;
        Self {
            stiffness: factors
                .iter()
                .map(|f| {
                    let (skin, fascia) = (params.skin_stiffness * f, params.fascia_stiffness * f);
                    [skin, fascia, crossed, crossed]
                })
                .collect(),
            rest_length: template
                .edges
                .iter()
                .map(|e| ends(*e, n as u32).map(length))
                .collect(),
            vertical_stiffness: crossed,
            vertical_length: (0..n as u32).map(|i| length([i, n as u32 + i])).collect(),
        }
    }
}

/// Van Gelder's factor of each edge: the area of its triangles over its squared length. Multiplied by a membrane's
/// modulus times thickness it gives the stiffness with which a triangle mesh behaves like that membrane.
///
/// Source: Van Gelder, Approximate simulation of elastic membranes by triangulated spring meshes, 1998, eq. 5.
fn van_gelder(triangles: &[[u32; 3]], edges: &[[u32; 2]], x: &[V3]) -> Vec<f64> {
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
