//! The energy's second derivatives, in blocks of three coordinates.

use crate::SimError;
use crate::elements::Volume;
use crate::load::Load;
use crate::simd::{Kernel, LANES, Lanes, lanes};
use crate::sparse::{Block, NO_BLOCK, Pattern};
use crate::springs::{Four, MIN_LENGTH_MM, ends};
use crate::vector::{V3, ZERO, norm, scale, sub};

/// Rows of the nodes that the solver moves, and where prisms add to the matrix.
#[derive(Debug)]
pub(crate) struct SystemPattern {
    /// Nodes by row.
    pub(super) nodes: Vec<u32>,
    pub(super) pattern: Pattern,
    /// Slot of each node's diagonal entry.
    pub(super) diagonal: Vec<u32>,
    /// For each edge and lane, the slot of the pair of its ends.
    edges: Vec<[u32; LANES]>,
    /// Slot of the pair of skin and fascia of each node.
    columns: Vec<u32>,
    /// For each prism, the slots of its 15 pairs of different nodes.
    elements: Vec<[u32; 15]>,
    /// For each pair of lips, the slots of the upper node with both lower ones, and of these two.
    pub(crate) lips: Vec<[u32; 3]>,
    /// Number of entries. The slot after the last one takes what belongs to nodes that do not move.
    pub(super) entries: usize,
}

impl SystemPattern {
    /// The pattern over the prisms of `triangles`, whose sides are `edges`; `moving`: for the skin's nodes, then the
    /// fascia's.
    pub(crate) fn new(
        triangles: &[[u32; 3]],
        edges: &[[u32; 2]],
        lips: &[(u32, [u32; 2])],
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
        let touching = lips
            .iter()
            .flat_map(|&(i, [a, b])| [[i, a], [i, b], [a, b]])
            .filter_map(|[a, b]| Some((rows[a as usize]?, rows[b as usize]?)));
        let pairs = triangles.iter().flat_map(pairs).chain(touching);
        let pattern = Pattern::new(nodes.len(), "equilibrium", pairs)?;
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
            lips: lips
                .iter()
                .map(|&(i, [a, b])| [[i, a], [i, b], [a, b]].map(slot))
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

/// Which second derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hessian {
    /// All of them: indefinite far from rest.
    Exact,
    /// Without the sideways push of compressed springs, those that yield as stiff along as at rest, and
    /// without the bending of prisms under pressure: never indefinite.
    Positive,
}

/// Adds the energy's second derivatives at `x` to a matrix.
pub(super) struct Assembly<'a> {
    pub(super) load: &'a Load<'a>,
    pub(super) x: &'a [V3],
    pub(super) hessian: Hessian,
    /// By slot of [`SystemPattern`], zero before.
    pub(super) matrix: &'a mut [Block],
}

impl Kernel for Assembly<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        self.add_springs();
        self.add_prisms();
        self.add_lips();
    }
}

impl Assembly<'_> {
    /// Springs along edges, of columns, and to the skull.
    #[inline(always)]
    fn add_springs(&mut self) {
        let model = self.load.model;
        let system = &model.template.pattern;
        let n = self.load.attachment.len();
        let edges = model.template.edges.iter().zip(&system.edges);
        let springs = self.load.stiffness.iter().zip(&self.load.rest_length);
        let springs = springs.zip(&model.springs.brace);
        for ((edge, slots), ((k, rest), &brace)) in edges.zip(springs) {
            let springs = Four {
                stiffness: *k,
                rest: *rest,
                brace: [brace; LANES],
            };
            let pairs = ends(*edge, n as u32);
            let mut ways = [ZERO; LANES];
            let mut lengths = [0.0; LANES];
            for (l, [a, b]) in pairs.into_iter().enumerate() {
                ways[l] = sub(self.x[a as usize], self.x[b as usize]);
                lengths[l] = norm(ways[l]).max(MIN_LENGTH_MM);
            }
            let (along, across) = self.stiffnesses(&springs, &lengths);
            for l in 0..LANES {
                self.add_spring(pairs[l], slots[l], ways[l], [along[l], across[l]]);
            }
        }
        for (i, &slot) in system.columns.iter().enumerate() {
            let way = sub(self.x[i], self.x[n + i]);
            let length = norm(way).max(MIN_LENGTH_MM);
            let springs = model.springs.vertical(i);
            let (along, across) = self.stiffnesses(&springs, &[length; LANES]);
            let pair = [i as u32, (n + i) as u32];
            self.add_spring(pair, slot, way, [along[0], across[0]]);
        }
        for (i, &hold) in self.load.attachment.iter().enumerate() {
            let slot = system.diagonal[n + i];
            add_diagonal(&mut self.matrix[slot as usize], hold);
        }
    }

    /// What resists motion of the ends of four springs along them beyond what resists it in every direction, over the
    /// squared length; and that.
    #[inline(always)]
    fn stiffnesses(&self, springs: &Four, lengths: &Lanes) -> (Lanes, Lanes) {
        let pull = springs.energy(lengths).1;
        let mut across = lanes(|l| pull[l] / lengths[l]);
        let mut slope = springs.stiffness;
        match self.hessian {
            Hessian::Exact => slope = springs.slope(lengths),
            Hessian::Positive => across = lanes(|l| across[l].max(0.0)),
        }
        let along = lanes(|l| (slope[l] - across[l]) / (lengths[l] * lengths[l]));
        (along, across)
    }

    #[inline(always)]
    fn add_spring(&mut self, [a, b]: [u32; 2], slot: u32, d: V3, [along, across]: [f64; 2]) {
        let system = &self.load.model.template.pattern;
        let mut own = NO_BLOCK;
        add_outer(&mut own, d, d, along);
        add_diagonal(&mut own, across);
        for slot in [system.diagonal[a as usize], system.diagonal[b as usize]] {
            let block = &mut self.matrix[slot as usize];
            for (row, r) in block.iter_mut().zip(&own) {
                *row = lanes(|l| row[l] + r[l]);
            }
        }
        let block = &mut self.matrix[slot as usize];
        for (row, r) in block.iter_mut().zip(&own) {
            *row = lanes(|l| row[l] - r[l]);
        }
    }

    #[inline(always)]
    fn add_prisms(&mut self) {
        let model = self.load.model;
        let system = &model.template.pattern;
        let elements = &model.elements;
        let ks = elements.shape_stiffness;
        for (e, slots) in system.elements.iter().enumerate() {
            let nodes = &elements.nodes[e];
            let volume = Volume::of(&nodes.map(|i| self.x[i as usize]));
            let group = &elements.groups[e / LANES];
            let kappa = group.stiffening(e % LANES, volume.value);
            let slopes = volume.gradient();
            for (&node, s) in nodes.iter().zip(&slopes) {
                let block = &mut self.matrix[system.diagonal[node as usize] as usize];
                add_outer(block, *s, *s, kappa);
                add_diagonal(block, ks * (5.0 / 6.0));
            }
            let pairs = pairs_of(nodes).into_iter().zip(pairs_of(&slopes));
            for (&slot, ([i, j], [s, t])) in slots.iter().zip(pairs) {
                let block = &mut self.matrix[slot as usize];
                let (s, t) = if i > j { (s, t) } else { (t, s) };
                add_outer(block, s, t, kappa);
                add_diagonal(block, -ks / 6.0);
            }
            if self.hessian == Hessian::Exact {
                let pressure = group.pressure(&[volume.value; LANES]).1[e % LANES];
                let bending = pairs_of(nodes).into_iter().zip(volume.bending());
                for (&slot, ([i, j], w)) in slots.iter().zip(bending) {
                    let w = scale(w, if i > j { pressure } else { -pressure });
                    add_cross(&mut self.matrix[slot as usize], w);
                }
            }
        }
    }

    /// Lips that press on each other.
    #[inline(always)]
    fn add_lips(&mut self) {
        let system = &self.load.model.template.pattern;
        let matrix = &mut *self.matrix;
        self.load.contacts.lip_stiffness(self.x, |lip, n, k| {
            let [a, b] = lip.below;
            let [s, t] = lip.weights;
            for (node, w) in [(lip.node, 1.0), (a, s), (b, t)] {
                let slot = system.diagonal[node as usize] as usize;
                add_outer(&mut matrix[slot], n, n, k * w * w);
            }
            for (&slot, w) in lip.slots.iter().zip([-s, -t, s * t]) {
                add_outer(&mut matrix[slot as usize], n, n, k * w);
            }
        });
    }
}

/// `m += k a b^T`.
#[inline(always)]
pub(super) fn add_outer(m: &mut Block, a: V3, b: V3, k: f64) {
    let b = [b[0], b[1], b[2], 0.0];
    for (row, a) in m.iter_mut().zip(a) {
        let s = k * a;
        *row = lanes(|l| row[l] + s * b[l]);
    }
}

#[inline(always)]
fn add_diagonal(m: &mut Block, k: f64) {
    m[0][0] += k;
    m[1][1] += k;
    m[2][2] += k;
}

/// `m += [w]_x`, so that `[w]_x v = w x v`.
#[inline(always)]
fn add_cross(m: &mut Block, w: V3) {
    let rows = [
        [0.0, -w[2], w[1], 0.0],
        [w[2], 0.0, -w[0], 0.0],
        [-w[1], w[0], 0.0, 0.0],
    ];
    for (row, r) in m.iter_mut().zip(rows) {
        *row = lanes(|l| row[l] + r[l]);
    }
}
