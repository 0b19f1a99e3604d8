//! The preconditioner: the Hessian's diagonal blocks in cylindrical coordinates, three sparse factors at once.
//!
//! A layer of springs is stiff along itself and soft across, and contact is stiff across alone. A scalar matrix, one for
//! all coordinates as in Projective Dynamics, knows only one stiffness and needs three times the iterations. Here each
//! node has a frame (around, up, outwards; outwards along the normal of the skull where it has contact), that turns so
//! little from node to node that translations stay free; in it the blocks between different coordinates are left out. The transverse stiffness of
//! compressed springs is clamped to zero, so that the matrices are positive definite.
//! Source of the method: Liu et al., Quasi-Newton methods for real-time simulation of hyperelastic materials, 2017.

use crate::SimError;
use crate::elements::Volume;
use crate::load::Load;
use crate::simd::{LANES, Lanes, lanes};
use crate::sparse::{Factor, Pattern};
use crate::springs::ends;
use crate::vector::{M3, V3, ZERO, cross, dot, norm, rotate, rotate_back, sub, unit};

/// Stiffness that keeps a node on the surface it rests on.
const HELD: f64 = 1e6;

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
    factor: Factor<[f32; LANES]>,
    matrix: Vec<Lanes>,
    diagonal: Vec<Lanes>,
    sides: Vec<Lanes>,
    frames: Vec<M3>,
    /// For nodes that rested when the matrix was factored, one over the stiffness they would have had, else 0.
    held: Vec<f64>,
}

impl Preconditioner {
    pub(crate) fn new(system: &SystemPattern) -> Self {
        Self {
            factor: Factor::new(&system.pattern),
            matrix: vec![[0.0; LANES]; system.entries + 1],
            diagonal: vec![[0.0; LANES]; system.diagonal.len()],
            sides: vec![[0.0; LANES]; system.nodes.len()],
            frames: Vec::new(),
            held: vec![0.0; system.diagonal.len()],
        }
    }

    /// Assembles and factors the matrix at `x`. `normals`: of nodes that rest on a surface and stay on it, else zero.
    pub(crate) fn factor(
        &mut self,
        load: &Load<'_>,
        x: &[V3],
        normals: &[V3],
    ) -> Result<(), SimError> {
        let model = load.model;
        let system = &model.template.pattern;
        self.frames.clear();
        self.frames.extend(model.rest.iter().map(frame));
        let n = load.attachment.len();
        for c in 0..load.contacts.len() {
            let node = load.contacts.node(c);
            let normal = load.contacts.gap(c, x).gradient;
            self.frames[node] = around(unit(normal));
            // The skin above turns along: the layers hang together.
            if node >= n {
                self.frames[node - n] = self.frames[node];
            }
        }
        self.matrix.fill([0.0; LANES]);
        self.diagonal.fill([0.0; LANES]);
        self.add_springs(load, x);
        self.add_prisms(load, x);
        load.contacts.lip_stiffness(x, |node, k| {
            add_to(&mut self.diagonal[node as usize], [k; 3]);
        });
        for (i, normal) in normals.iter().enumerate() {
            let diagonal = &mut self.diagonal[i];
            self.held[i] = 0.0;
            if *normal != ZERO {
                self.held[i] = 1.0 / diagonal[2];
                diagonal[2] += HELD;
            }
        }
        for (&slot, value) in system.diagonal.iter().zip(&self.diagonal) {
            let entry = &mut self.matrix[slot as usize];
            *entry = lanes(|l| entry[l] + value[l]);
            entry[3] = 1.0;
        }
        self.factor.refactor(
            &system.pattern,
            "equilibrium",
            &self.matrix[..system.entries],
        )
    }

    /// Springs along edges, of columns, and to the skull.
    fn add_springs(&mut self, load: &Load<'_>, x: &[V3]) {
        let model = load.model;
        let system = &model.template.pattern;
        let n = load.attachment.len();
        let mut add = |[a, b]: [u32; 2], slot: u32, k: f64, rest: f64| {
            let (a, b) = (a as usize, b as usize);
            let d = sub(x[a], x[b]);
            let length = norm(d).max(1e-9);
            let across = k * (1.0 - rest / length).max(0.0);
            // Both frames are upright and nearly the same: the first one serves.
            let u = rotate(&self.frames[a], d);
            let along = (k - across) / (length * length);
            let block = u.map(|v| along * v * v + across);
            add_to(&mut self.diagonal[a], block);
            add_to(&mut self.diagonal[b], block);
            add_to(&mut self.matrix[slot as usize], block.map(|v| -v));
        };
        let edges = model.template.edges.iter().zip(&system.edges);
        for (e, (edge, slots)) in edges.enumerate() {
            for (l, pair) in ends(*edge, n as u32).into_iter().enumerate() {
                add(pair, slots[l], load.stiffness[e][l], load.rest_length[e][l]);
            }
        }
        let springs = &model.springs;
        for (i, &slot) in system.columns.iter().enumerate() {
            let pair = [i as u32, (n + i) as u32];
            add(
                pair,
                slot,
                springs.vertical_stiffness,
                springs.vertical_length[i],
            );
        }
        for (i, &hold) in load.attachment.iter().enumerate() {
            add_to(&mut self.diagonal[n + i], [hold; 3]);
        }
    }

    fn add_prisms(&mut self, load: &Load<'_>, x: &[V3]) {
        let model = load.model;
        let elements = &model.elements;
        let ks = elements.shape_stiffness;
        for (e, slots) in model.template.pattern.elements.iter().enumerate() {
            let nodes = &elements.nodes[e];
            let volume = Volume::of(&nodes.map(|i| x[i as usize]));
            let kappa = elements.groups[e / LANES].stiffening(e % LANES, volume.value);
            let mut slopes = volume.gradient();
            for (&node, s) in nodes.iter().zip(&mut slopes) {
                *s = rotate(&self.frames[node as usize], *s);
                let own = s.map(|v| ks * (5.0 / 6.0) + kappa * v * v);
                add_to(&mut self.diagonal[node as usize], own);
            }
            for (&slot, [a, b]) in slots.iter().zip(&pairs_of(&slopes)) {
                let pair = [0, 1, 2].map(|c| kappa * a[c] * b[c] - ks / 6.0);
                add_to(&mut self.matrix[slot as usize], pair);
            }
        }
    }

    /// `out = -P^-1 gradient` on moving nodes, zero elsewhere.
    pub(crate) fn descend(&mut self, system: &SystemPattern, gradient: &[V3], out: &mut [V3]) {
        let order = system.pattern.order();
        for (&row, &node) in order.iter().zip(&system.nodes) {
            let [a, b, c] = rotate(&self.frames[node as usize], gradient[node as usize]);
            self.sides[row as usize] = [-a, -b, -c, 0.0];
        }
        self.factor.solve_ordered(&system.pattern, &mut self.sides);
        out.fill(ZERO);
        for (&row, &node) in order.iter().zip(&system.nodes) {
            let [a, b, c, _] = self.sides[row as usize];
            let (frame, node) = (&self.frames[node as usize], node as usize);
            // A node that was let go since is moved by its own stiffness alone.
            let free = c - self.held[node] * dot(frame[2], gradient[node]);
            out[node] = rotate_back(frame, [a, b, free]);
        }
    }
}

/// Rows: around the axis, up, outwards.
fn frame(p: &V3) -> M3 {
    around(unit([p[0], 0.0, p[2]]))
}

/// An upright frame whose last row is `out`.
fn around(out: V3) -> M3 {
    let side = unit([out[2], 0.0, -out[0]]);
    [side, cross(out, side), out]
}

#[inline(always)]
fn add_to(a: &mut Lanes, b: V3) {
    a[0] += b[0];
    a[1] += b[1];
    a[2] += b[2];
}
