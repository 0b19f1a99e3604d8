//! The scalar Projective-Dynamics matrix: one factor for all three coordinates.
//!
//! Springs count with their stiffness in every direction, prisms with the exact shape term and a scalar share of the
//! volume term, contacts that carry with their share. Leaving contact out costs 2 to 8 times more iterations.
//! Source: Bouaziz et al., Projective Dynamics, 2014; as a preconditioner of L-BFGS: Liu et al., Quasi-Newton methods
//! for real-time simulation of hyperelastic materials, 2017.

use crate::SimError;
use crate::elements::Volume;
use crate::load::Load;
use crate::simd::{LANES, Lanes};
use crate::sparse::{Factor, Pattern};
use crate::springs::ends;
use crate::vector::{V3, ZERO, dot};

/// Share of a volume gradient's square that acts along each coordinate.
const VOLUME_SHARE: f64 = 0.5;
/// Share of a contact's stiffness that acts along each coordinate.
const CONTACT_SHARE: f64 = 0.5;

/// Rows of the nodes that the solver moves, and where prisms add to the matrix.
#[derive(Debug)]
pub(crate) struct SystemPattern {
    /// Nodes by row.
    nodes: Vec<u32>,
    pattern: Pattern,
    /// Slot of each node's diagonal entry.
    diagonal: Vec<u32>,
    /// For each edge and lane, the slot of the pair of its ends.
    edges: Vec<[u32; LANES]>,
    /// Slot of the pair of skin and fascia of each node.
    columns: Vec<u32>,
    /// For each prism, the slots of its 15 pairs of different nodes.
    elements: Vec<[u32; 15]>,
    /// Number of entries. The slot after the last one takes what belongs to nodes that do not move.
    entries: usize,
}

impl SystemPattern {
    /// The pattern over the prisms of `triangles`, whose sides are `edges`; `moving`: for the skin's nodes, then the
    /// fascia's.
    pub(crate) fn new(
        triangles: &[[u32; 3]],
        edges: &[[u32; 2]],
        moving: &[bool],
    ) -> Result<Self, SimError> {
        let n = (moving.len() / 2) as u32;
        let mut rows = vec![None; moving.len()];
        let mut nodes = Vec::new();
        for (i, _) in moving.iter().enumerate().filter(|(_, m)| **m) {
            rows[i] = Some(nodes.len() as u32);
            nodes.push(i as u32);
        }
        let pairs = |t: &[u32; 3]| -> Vec<(u32, u32)> {
            pairs_of(&prism(t, n))
                .into_iter()
                .filter_map(|[a, b]| Some((rows[a as usize]?, rows[b as usize]?)))
                .collect()
        };
        let pattern = Pattern::new(nodes.len(), "equilibrium", triangles.iter().flat_map(pairs))?;
        let entries = pattern.entries();
        let slot = |[a, b]: [u32; 2]| match (rows[a as usize], rows[b as usize]) {
            (Some(p), Some(q)) => pattern.slot(p, q),
            _ => entries as u32,
        };
        Ok(Self {
            diagonal: (0..2 * n).map(|i| slot([i, i])).collect(),
            edges: edges.iter().map(|e| ends(*e, n).map(slot)).collect(),
            columns: (0..n).map(|i| slot([i, n + i])).collect(),
            elements: triangles
                .iter()
                .map(|t| pairs_of(&prism(t, n)).map(slot))
                .collect(),
            entries,
            nodes,
            pattern,
        })
    }
}

fn prism(t: &[u32; 3], n: u32) -> [u32; 6] {
    [t[0], t[1], t[2], n + t[0], n + t[1], n + t[2]]
}

/// The pairs of different nodes of a prism.
fn pairs_of<T: Copy>(p: &[T; 6]) -> [[T; 2]; 15] {
    let mut k = 0;
    let mut out = [[p[0]; 2]; 15];
    for a in 1..6 {
        for b in 0..a {
            out[k] = [p[a], p[b]];
            k += 1;
        }
    }
    out
}

/// The factored matrix with its work space.
#[derive(Debug)]
pub(crate) struct Preconditioner {
    factor: Factor<f32>,
    matrix: Vec<f64>,
    sides: Vec<Lanes>,
    /// How many times the matrix was factored.
    pub(crate) factors: usize,
}

impl Preconditioner {
    pub(crate) fn new(system: &SystemPattern) -> Self {
        Self {
            factor: Factor::new(&system.pattern),
            matrix: vec![0.0; system.entries + 1],
            sides: vec![[0.0; LANES]; system.nodes.len()],
            factors: 0,
        }
    }

    /// Assembles and factors the matrix at `x`. `carries`: whether each contact presses.
    pub(crate) fn factor(
        &mut self,
        load: &Load<'_>,
        x: &[V3],
        carries: &[bool],
        contact_stiffness: f64,
    ) -> Result<(), SimError> {
        let model = load.model;
        let system = &model.template.pattern;
        let matrix = &mut self.matrix;
        matrix.fill(0.0);
        let mut diagonal = vec![0.0; system.diagonal.len()];
        let n = load.attachment.len();
        // Springs.
        let edges = model.template.edges.iter().zip(&system.edges);
        for ((edge, slots), stiffness) in edges.zip(&load.stiffness) {
            for ((&[a, b], &slot), &k) in ends(*edge, n as u32).iter().zip(slots).zip(stiffness) {
                diagonal[a as usize] += k;
                diagonal[b as usize] += k;
                matrix[slot as usize] -= k;
            }
        }
        let vertical = model.springs.vertical_stiffness;
        for (i, (&slot, &hold)) in system.columns.iter().zip(&load.attachment).enumerate() {
            diagonal[i] += vertical;
            diagonal[n + i] += vertical + hold;
            matrix[slot as usize] -= vertical;
        }
        // Contacts.
        for (c, _) in carries.iter().enumerate().filter(|(_, on)| **on) {
            let gradient = load.contacts.gap(c, x).gradient;
            let k = CONTACT_SHARE * contact_stiffness * dot(gradient, gradient);
            load.contacts.nodes(c, |node, share| {
                diagonal[node as usize] += k * share * share;
            });
        }
        // Prisms.
        let elements = &model.elements;
        let ks = elements.shape_stiffness;
        for (e, slots) in system.elements.iter().enumerate() {
            let nodes = &elements.nodes[e];
            let volume = Volume::of(&nodes.map(|i| x[i as usize]));
            let group = &elements.groups[e / LANES];
            let kappa = VOLUME_SHARE * group.stiffening(e % LANES, volume.value);
            let slopes = volume.gradient();
            for (&node, s) in nodes.iter().zip(&slopes) {
                diagonal[node as usize] += ks * (5.0 / 6.0) + kappa * dot(*s, *s);
            }
            for (&slot, [a, b]) in slots.iter().zip(&pairs_of(&slopes)) {
                matrix[slot as usize] += kappa * dot(*a, *b) - ks / 6.0;
            }
        }
        for (&slot, value) in system.diagonal.iter().zip(diagonal) {
            matrix[slot as usize] += value;
        }
        self.factors += 1;
        self.factor.refactor(
            &system.pattern,
            "equilibrium",
            &self.matrix[..system.entries],
        )
    }

    /// `out = -P^-1 gradient` on moving nodes, zero elsewhere.
    pub(crate) fn descend(&mut self, system: &SystemPattern, gradient: &[V3], out: &mut [V3]) {
        let order = system.pattern.order();
        for (&row, &node) in order.iter().zip(&system.nodes) {
            let [x, y, z] = gradient[node as usize];
            self.sides[row as usize] = [-x, -y, -z, 0.0];
        }
        self.factor.solve_ordered(&system.pattern, &mut self.sides);
        out.fill(ZERO);
        for (&row, &node) in order.iter().zip(&system.nodes) {
            let [x, y, z, _] = self.sides[row as usize];
            out[node as usize] = [x, y, z];
        }
    }
}
