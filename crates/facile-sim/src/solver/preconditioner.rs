//! The scalar Projective-Dynamics matrix: one factor for all three coordinates.
//!
//! Springs count with their stiffness in every direction, prisms with the exact shape term and a scalar share of the
//! volume term, contacts that carry with their share. Leaving contact out costs 2 to 8 times more iterations.
//! Source: Bouaziz et al., Projective Dynamics, 2014; as a preconditioner of L-BFGS: Liu et al., Quasi-Newton methods
//! for real-time simulation of hyperelastic materials, 2017.

use crate::SimError;
use crate::elements::Volume;
use crate::load::Load;
use crate::sparse::{Factor, Pattern};
use crate::vector::{V3, ZERO, dot};

/// Share of a volume gradient's square that acts along each coordinate.
const VOLUME_SHARE: f64 = 0.5;
/// Share of a contact's stiffness that acts along each coordinate.
const CONTACT_SHARE: f64 = 0.5;

/// Rows of the nodes that the solver moves, and where prisms add to the matrix.
#[derive(Debug)]
pub(crate) struct SystemPattern {
    /// Row of each node.
    rows: Vec<Option<u32>>,
    /// Nodes by row.
    nodes: Vec<u32>,
    pattern: Pattern,
    /// For each prism, the slots of its 21 pairs of nodes, `u32::MAX` where one does not move.
    elements: Vec<[u32; 21]>,
}

const NO_SLOT: u32 = u32::MAX;

impl SystemPattern {
    /// The pattern over the prisms of `triangles`; `moving`: for the skin's nodes, then the fascia's.
    pub(crate) fn new(triangles: &[[u32; 3]], moving: &[bool]) -> Result<Self, SimError> {
        let n = (moving.len() / 2) as u32;
        let mut rows = vec![None; moving.len()];
        let mut nodes = Vec::new();
        for (i, _) in moving.iter().enumerate().filter(|(_, m)| **m) {
            rows[i] = Some(nodes.len() as u32);
            nodes.push(i as u32);
        }
        let prism = |t: &[u32; 3]| [t[0], t[1], t[2], n + t[0], n + t[1], n + t[2]];
        let pairs = |t: &[u32; 3]| -> Vec<(u32, u32)> {
            let r = prism(t).map(|i| rows[i as usize]);
            (0..6)
                .flat_map(|a| (0..=a).map(move |b| (a, b)))
                .filter_map(|(a, b)| Some((r[a]?, r[b]?)))
                .collect()
        };
        let pattern = Pattern::new(nodes.len(), "equilibrium", triangles.iter().flat_map(pairs))?;
        let elements = triangles
            .iter()
            .map(|t| {
                let r = prism(t).map(|i| rows[i as usize]);
                let mut slots = [NO_SLOT; 21];
                let mut k = 0;
                for a in 0..6 {
                    for b in 0..=a {
                        if let (Some(p), Some(q)) = (r[a], r[b]) {
                            slots[k] = pattern.slot(p, q);
                        }
                        k += 1;
                    }
                }
                slots
            })
            .collect();
        Ok(Self {
            rows,
            nodes,
            pattern,
            elements,
        })
    }
}

/// The factored matrix with its work space.
#[derive(Debug)]
pub(crate) struct Preconditioner {
    factor: Factor,
    matrix: Vec<f64>,
    sides: Vec<f64>,
}

impl Preconditioner {
    pub(crate) fn new(system: &SystemPattern) -> Self {
        Self {
            factor: Factor::new(&system.pattern, 3),
            matrix: vec![0.0; system.pattern.entries()],
            sides: vec![0.0; 3 * system.nodes.len()],
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
        let system = &load.model.template.pattern;
        self.matrix.fill(0.0);
        let matrix = &mut self.matrix;
        let mut add = |a: usize, b: usize, value: f64| {
            if let (Some(p), Some(q)) = (system.rows[a], system.rows[b]) {
                matrix[system.pattern.slot(p, q) as usize] += value;
            }
        };
        for (&[a, b], &k) in load.model.springs.ends.iter().zip(&load.stiffness) {
            let (a, b) = (a as usize, b as usize);
            add(a, a, k);
            add(b, b, k);
            add(a, b, -k);
        }
        let n = load.attachment.len();
        for (i, &k) in load.attachment.iter().enumerate() {
            add(n + i, n + i, k);
        }
        for (c, _) in carries.iter().enumerate().filter(|(_, on)| **on) {
            let gradient = load.contacts.gap(c, x).gradient;
            let k = CONTACT_SHARE * contact_stiffness * dot(gradient, gradient);
            load.contacts.nodes(c, |node, share| {
                add(node as usize, node as usize, k * share * share);
            });
        }
        let elements = &load.model.elements;
        let ks = elements.shape_stiffness;
        for (e, slots) in system.elements.iter().enumerate() {
            let volume = Volume::of(&elements.nodes[e].map(|i| x[i as usize])).gradient();
            let kappa = VOLUME_SHARE * elements.kappa[e];
            let mut k = 0;
            for a in 0..6 {
                for b in 0..=a {
                    if slots[k] != NO_SLOT {
                        let shape = ks * (f64::from(u8::from(a == b)) - 1.0 / 6.0);
                        let value = shape + kappa * dot(volume[a], volume[b]);
                        matrix[slots[k] as usize] += value;
                    }
                    k += 1;
                }
            }
        }
        self.factor
            .refactor(&system.pattern, "equilibrium", &self.matrix)
    }

    /// `out = -P^-1 gradient` on moving nodes, zero elsewhere.
    pub(crate) fn descend(&mut self, system: &SystemPattern, gradient: &[V3], out: &mut [V3]) {
        let n = system.nodes.len();
        for (row, &node) in system.nodes.iter().enumerate() {
            for k in 0..3 {
                self.sides[k * n + row] = -gradient[node as usize][k];
            }
        }
        self.factor.solve(&system.pattern, &mut self.sides);
        out.fill(ZERO);
        for (row, &node) in system.nodes.iter().enumerate() {
            out[node as usize] = [0, 1, 2].map(|k| self.sides[k * n + row]);
        }
    }
}
