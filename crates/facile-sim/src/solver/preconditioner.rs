//! The preconditioner: the Hessian in blocks of three coordinates, made positive, and its factor.
//!
//! What could make the matrix indefinite is left out: the sideways push of compressed springs and the bending of prisms
//! under pressure. Nodes that rest on a surface move along it alone: their normals are taken out of the system. Factors
//! of the three coordinates one by one cost a fifth, but need five times the iterations: at the nose and below the
//! chin the skin is not across the radius, and one stiffness couples all three.
//! Source of the method: Liu et al., Quasi-Newton methods for real-time simulation of hyperelastic materials, 2017.

use crate::SimError;
use crate::elements::Volume;
use crate::load::Load;
use crate::simd::LANES;
use crate::sparse::{BlockFactor, Pattern};
use crate::springs::ends;
use crate::vector::{M3, V3, ZERO, add_scaled, dot, norm, rotate, rotate_back, sub};

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
    factor: BlockFactor,
    /// Blocks by slot: rows of the larger node, columns of the smaller. One more takes what belongs to nodes that do not move.
    matrix: Vec<M3>,
    sides: Vec<f32>,
    /// Mean stiffness of each moving node against motion on its own, 0 for the others.
    pub(crate) own: Vec<f64>,
}

impl Preconditioner {
    pub(crate) fn new(system: &SystemPattern) -> Self {
        Self {
            factor: BlockFactor::new(&system.pattern),
            matrix: vec![[ZERO; 3]; system.entries + 1],
            sides: vec![0.0; 3 * system.nodes.len()],
            own: vec![0.0; system.diagonal.len()],
        }
    }

    /// Smallest pivot of the last factor.
    pub(crate) fn smallest_pivot(&self) -> f64 {
        f64::from(self.factor.smallest)
    }

    /// Assembles the matrix at `x`.
    pub(crate) fn assemble(&mut self, load: &Load<'_>, x: &[V3]) {
        let system = &load.model.template.pattern;
        self.matrix.fill([ZERO; 3]);
        self.add_springs(load, x);
        self.add_prisms(load, x);
        load.contacts.lip_stiffness(x, |node, k| {
            let block = &mut self.matrix[system.diagonal[node as usize] as usize];
            add_diagonal(block, k);
        });
        for (i, &slot) in system.diagonal.iter().enumerate() {
            let block = &self.matrix[slot as usize];
            self.own[i] = if (slot as usize) < system.entries {
                (block[0][0] + block[1][1] + block[2][2]) / 3.0
            } else {
                0.0
            };
        }
    }

    /// Factors the matrix, once after it was assembled. `normals`: of nodes that rest on a surface and stay on it, else
    /// zero.
    pub(crate) fn factor(
        &mut self,
        system: &SystemPattern,
        normals: &[V3],
    ) -> Result<(), SimError> {
        self.hold(system, normals);
        self.factor.refactor(
            &system.pattern,
            "equilibrium",
            &self.matrix[..system.entries],
        )
    }

    /// Takes the motion of resting nodes along their normals out of the system: each is left with its own stiffness.
    fn hold(&mut self, system: &SystemPattern, normals: &[V3]) {
        for ([a, b], block) in system.pattern.pairs().zip(&mut self.matrix) {
            let m = normals[system.nodes[a as usize] as usize];
            let n = normals[system.nodes[b as usize] as usize];
            if a == b {
                if n != ZERO {
                    let own = dot(n, rotate(block, n));
                    cut_rows(block, n);
                    cut_columns(block, n);
                    add_outer(block, n, n, own);
                }
                continue;
            }
            if n != ZERO {
                cut_rows(block, n);
            }
            if m != ZERO {
                cut_columns(block, m);
            }
        }
    }

    /// Springs along edges, of columns, and to the skull.
    fn add_springs(&mut self, load: &Load<'_>, x: &[V3]) {
        let model = load.model;
        let system = &model.template.pattern;
        let n = load.attachment.len();
        let mut add = |[a, b]: [u32; 2], slot: u32, k: f64, rest: f64| {
            let d = sub(x[a as usize], x[b as usize]);
            let length = norm(d).max(1e-9);
            let across = k * (1.0 - rest / length).max(0.0);
            let along = (k - across) / (length * length);
            for (slot, sign) in [
                (system.diagonal[a as usize], 1.0),
                (system.diagonal[b as usize], 1.0),
                (slot, -1.0),
            ] {
                let block = &mut self.matrix[slot as usize];
                add_outer(block, d, d, sign * along);
                add_diagonal(block, sign * across);
            }
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
            let slot = system.diagonal[n + i];
            add_diagonal(&mut self.matrix[slot as usize], hold);
        }
    }

    fn add_prisms(&mut self, load: &Load<'_>, x: &[V3]) {
        let model = load.model;
        let system = &model.template.pattern;
        let elements = &model.elements;
        let ks = elements.shape_stiffness;
        for (e, slots) in system.elements.iter().enumerate() {
            let nodes = &elements.nodes[e];
            let volume = Volume::of(&nodes.map(|i| x[i as usize]));
            let kappa = elements.groups[e / LANES].stiffening(e % LANES, volume.value);
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
        }
    }

    /// `out = -P^-1 gradient` on moving nodes, zero elsewhere.
    pub(crate) fn descend(&mut self, system: &SystemPattern, gradient: &[V3], out: &mut [V3]) {
        let largest = system
            .nodes
            .iter()
            .flat_map(|&i| gradient[i as usize])
            .fold(1e-300, |m: f64, g| m.max(g.abs()));
        let order = system.pattern.order();
        for (&row, &node) in order.iter().zip(&system.nodes) {
            let side = &mut self.sides[3 * row as usize..][..3];
            for (s, g) in side.iter_mut().zip(gradient[node as usize]) {
                *s = (-g / largest) as f32;
            }
        }
        self.factor.solve(&system.pattern, &mut self.sides);
        out.fill(ZERO);
        for (&row, &node) in order.iter().zip(&system.nodes) {
            let side = &self.sides[3 * row as usize..][..3];
            for (o, s) in out[node as usize].iter_mut().zip(side) {
                *o = f64::from(*s) * largest;
            }
        }
    }
}

/// `m += k a b^T`.
#[inline(always)]
fn add_outer(m: &mut M3, a: V3, b: V3, k: f64) {
    for (row, a) in m.iter_mut().zip(a) {
        *row = add_scaled(*row, b, k * a);
    }
}

#[inline(always)]
fn add_diagonal(m: &mut M3, k: f64) {
    m[0][0] += k;
    m[1][1] += k;
    m[2][2] += k;
}

/// `m = (I - n n^T) m`.
fn cut_rows(m: &mut M3, n: V3) {
    let along = rotate_back(m, n);
    add_outer(m, n, along, -1.0);
}

/// `m = m (I - n n^T)`.
fn cut_columns(m: &mut M3, n: V3) {
    let along = rotate(m, n);
    add_outer(m, along, n, -1.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FaceRig, MuscleSet, Pose};
    use facile_core::ReferenceHead;

    #[test]
    fn at_rest_the_matrix_is_the_hessian_and_its_factor_inverts_it() {
        let reference = ReferenceHead::embedded();
        let rig = FaceRig::new(reference, MuscleSet::embedded()).expect("built in");
        let model = rig
            .model(reference, &crate::mean_subject(reference))
            .expect("the mean head");
        let load = Load::new(&model, &Pose::default()).expect("neutral");
        let system = &model.template.pattern;
        let mut matrix = Preconditioner::new(system);
        matrix.assemble(&load, &model.rest);
        let v: Vec<V3> = (0..model.rest.len())
            .map(|i| {
                let moves = f64::from(u8::from(model.template.moving[i]));
                [0.3, 1.7, 2.9].map(|f| moves * libm::sin(f * i as f64 + f))
            })
            .collect();
        let mut product = vec![ZERO; v.len()];
        for ([a, b], block) in system.pattern.pairs().zip(&matrix.matrix) {
            let [a, b] = [a, b].map(|row| system.nodes[row as usize] as usize);
            product[b] = add_scaled(product[b], rotate(block, v[a]), 1.0);
            if a != b {
                product[a] = add_scaled(product[a], rotate_back(block, v[b]), 1.0);
            }
        }
        let slope = |t: f64| {
            let moved = model.rest.iter().zip(&v);
            let y: Vec<V3> = moved.map(|(p, v)| add_scaled(*p, *v, t)).collect();
            let mut gradient = vec![ZERO; y.len()];
            load.energy(&y, &mut gradient);
            gradient
        };
        // Fourth order in the step.
        let [a, b, c, d] = [1e-4, -1e-4, 2e-4, -2e-4].map(slope);
        let size = product.iter().map(|p| norm(*p)).fold(0.0, f64::max);
        for i in (0..v.len()).filter(|i| model.template.moving[*i]) {
            for k in 0..3 {
                let measured = (8.0 * (a[i][k] - b[i][k]) - (c[i][k] - d[i][k])) / 12e-4;
                let away = (measured - product[i][k]).abs();
                assert!(away < 1e-8 * size, "node {i}: {measured} {}", product[i][k]);
            }
        }
        let free = vec![ZERO; v.len()];
        matrix.factor(system, &free).expect("positive");
        let mut back = vec![ZERO; v.len()];
        matrix.descend(system, &product, &mut back);
        for (p, v) in back.iter().zip(&v) {
            assert!(norm(add_scaled(*p, *v, 1.0)) < 0.02);
        }
    }
}
