//! The springs of the three layers at rest (section 4.1), and how they buckle.
//!
//! A compressed spring pushes its ends aside, the more the shorter it is, without bound: `k (1 - l / L)` for a rest length
//! `l` and a length `L`. Between nodes a few tenths of a millimetre apart, at the rims of lips and lids, that push is
//! stronger than all that holds them, and they have two places, to either side. So a spring pushes with `brace L` at most,
//! as a strut does that buckles, and the brace of all springs together is what the shape term holds:
//! `k_s sum |x_i - c|^2 / 2` of a prism is `k_s / 6` for each of its 15 pairs of nodes, and springs join those very pairs.
//! Its slope falls evenly from `k` at rest to `-brace`, where the push has come down to `brace L`, and stays there: never
//! below `-brace`, so that shape makes up for the concave part of every spring, and the energy of springs, attachments,
//! shape and lips is convex. It has one minimum, wherever a solver comes from. Its second derivative has no jump, which a
//! solver would go back and forth across.

use crate::params::PaperParams;
use crate::simd::{LANES, Lanes, lanes};
use crate::template::Template;
use crate::vector::{V3, cross, dot, norm, sub};

/// Squared lengths are floored at this share of their mean, where Van Gelder's formula would divide by zero.
const MIN_LENGTH_SHARE: f64 = 1e-3;
/// Range of Van Gelder's factor; on the reference head it is 0.25 to 2.4 away from slivers.
const FACTOR_RANGE: (f64, f64) = (0.05, 5.0);

/// A prism's shape resists the motion of each pair of its nodes against each other by this part of `k_s`.
const NODES_OF_A_PRISM: f64 = 6.0;

/// The springs along each edge of the mesh, by lane: in the skin, in the fascia, from the skin's first end to the fascia's
/// second, from the skin's second end to the fascia's first; and those between skin and fascia of each node.
#[derive(Clone, Debug, Default)]
pub(crate) struct Springs {
    pub(crate) stiffness: Vec<Lanes>,
    pub(crate) rest_length: Vec<Lanes>,
    pub(crate) vertical_stiffness: f64,
    pub(crate) vertical_length: Vec<f64>,
    /// The most that each of an edge's four springs pushes, over its length.
    pub(crate) brace: Vec<f64>,
    /// Likewise for the springs between skin and fascia.
    pub(crate) vertical_brace: Vec<f64>,
}

/// Springs shorter than this have no direction, mm.
pub(crate) const MIN_LENGTH_MM: f64 = 1e-9;

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
        let (brace, vertical_brace) = braces(template, params);
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
            brace,
            vertical_brace,
            vertical_stiffness: crossed,
            vertical_length: (0..n as u32).map(|i| length([i, n as u32 + i])).collect(),
        }
    }
}

/// Four springs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Four {
    pub(crate) stiffness: Lanes,
    pub(crate) rest: Lanes,
    /// The most that each pushes, over its length.
    pub(crate) brace: Lanes,
}

impl Four {
    /// Compression at which the slope has fallen to minus the brace, compression up to there, and beyond.
    #[inline(always)]
    fn pressed(&self, length: &Lanes) -> [Lanes; 3] {
        let (k, rest, brace) = (&self.stiffness, &self.rest, &self.brace);
        let width = lanes(|l| 2.0 * brace[l] * rest[l] / (k[l] + brace[l]));
        let pressed = lanes(|l| (rest[l] - length[l]).max(0.0));
        let yielding = lanes(|l| pressed[l].min(width[l]));
        [width, yielding, lanes(|l| pressed[l] - yielding[l])]
    }

    /// Twice the energy, and the pull.
    #[inline(always)]
    pub(crate) fn energy(&self, length: &Lanes) -> (Lanes, Lanes) {
        let (k, rest, brace) = (&self.stiffness, &self.rest, &self.brace);
        let [width, yielding, beyond] = self.pressed(length);
        let stretch = lanes(|l| length[l] - rest[l] + beyond[l]);
        // What the fall of the slope takes away; springs without a length at rest are never pressed.
        let lost = lanes(|l| {
            let fall = (k[l] + brace[l]) * (k[l] + brace[l]) / (4.0 * brace[l] * rest[l] + 1e-12);
            fall * yielding[l] * yielding[l]
        });
        let energy = lanes(|l| {
            let buckled = brace[l] * beyond[l] * (2.0 * (rest[l] - width[l]) - beyond[l]);
            k[l] * stretch[l] * stretch[l] - lost[l] * yielding[l] * (2.0 / 3.0) + buckled
        });
        let pull = lanes(|l| k[l] * stretch[l] + lost[l] + brace[l] * beyond[l]);
        (energy, pull)
    }

    /// Derivative of the pull by the length.
    #[inline(always)]
    pub(crate) fn slope(&self, length: &Lanes) -> Lanes {
        let (k, brace) = (&self.stiffness, &self.brace);
        let [width, yielding, _] = self.pressed(length);
        lanes(|l| k[l] - (k[l] + brace[l]) * (yielding[l] / (width[l] + 1e-300)))
    }
}

impl Springs {
    /// The spring between skin and fascia of node `i`, four times.
    pub(crate) fn vertical(&self, i: usize) -> Four {
        Four {
            stiffness: [self.vertical_stiffness; LANES],
            rest: [self.vertical_length[i]; LANES],
            brace: [self.vertical_brace[i]; LANES],
        }
    }
}

/// What the shape of the prisms around an edge, and around a node, has to brace a spring with: `k_s / 6` for each prism.
fn braces(template: &Template, params: &PaperParams) -> (Vec<f64>, Vec<f64>) {
    let share = params.shape_stiffness / NODES_OF_A_PRISM;
    let mut edges = vec![0.0; template.edges.len()];
    let mut columns = vec![0.0; template.node_count()];
    for &[a, b, c] in &template.triangles {
        for [u, v] in [[a, b], [b, c], [c, a]] {
            if let Ok(e) = template.edges.binary_search(&[u.min(v), u.max(v)]) {
                edges[e] += share;
            }
            columns[u as usize] += share;
        }
    }
    (edges, columns)
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
    fn springs_yield_smoothly_and_push_no_more_than_their_brace() {
        let springs = Four {
            stiffness: [2400.0, 40.0, 0.05, 7.0],
            rest: [1.1, 3.0, 2.0, 0.0],
            brace: [10.0, 10.0, 10.0, 1.0],
        };
        for k in 1..400 {
            let lengths = springs.rest.map(|rest| 0.005 * f64::from(k) * rest);
            let step = 1e-6;
            let at = |away: f64| springs.energy(&lengths.map(|l| l + away));
            let ((_, pull), above, below) = (at(0.0), at(step), at(-step));
            let slope = springs.slope(&lengths);
            for l in 0..3 {
                let (stiffness, brace) = (springs.stiffness[l], springs.brace[l]);
                let (length, rest) = (lengths[l], springs.rest[l]);
                let near = |a: f64, b: f64| (a - b).abs() < 5e-4 * stiffness * rest;
                assert!(
                    near(0.25 * (above.0[l] - below.0[l]) / step, pull[l]),
                    "{length}"
                );
                assert!(
                    near(0.5 * (above.1[l] - below.1[l]) / step, slope[l]),
                    "{length}"
                );
                let rounding = 1e-12 * (stiffness + brace) * rest;
                assert!(
                    pull[l] >= -brace * length - rounding,
                    "{length}: {}",
                    pull[l]
                );
                assert!(slope[l] >= -brace - rounding, "{length}: {}", slope[l]);
                assert!(length < rest || near(pull[l], stiffness * (length - rest)));
            }
        }
        // Without a length at rest.
        let (energy, pull) = springs.energy(&[2.0; LANES]);
        assert_eq!((energy[3], pull[3]), (28.0, 14.0));
        let (energy, pull) = springs.energy(&[0.0; LANES]);
        assert_eq!((energy[3], pull[3]), (0.0, 0.0));
        assert_eq!(springs.slope(&[0.0; LANES])[3], 7.0);
    }

    #[test]
    fn a_zero_length_edge_has_a_finite_factor() {
        let x = [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]];
        let factors = van_gelder(&[[0, 1, 2]], &[[0, 1], [0, 2], [1, 2]], &x);
        assert!(factors.iter().all(|f| f.is_finite()));
    }
}
