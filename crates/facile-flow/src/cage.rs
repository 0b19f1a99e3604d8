//! Smooth deformation of the reference's cage towards target positions of fine vertices.
//!
//! Minimises, over displacements `d` of the cage vertices with the subdivision stencils `S`,
//! `sum_i w_i |S_i d - t_i|^2 + l^4 ∫|Δd|^2 + l^2 m ∫|∇d|^2`, where `w_i` includes the vertex's area. A wave of length
//! `2 pi l` mm is halved; what has no target follows smoothly. Source: Botsch and Sorkine, On linear variational
//! surface deformation methods, 2008 (discrete operators). Sparse Cholesky on one thread, so that bits repeat.

use facile_core::subdivision::Stencils;
use facile_core::{Point3, ReferenceHead, Segment, Vector3};
use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat, SymbolicSparseColMatRef};
use faer::{Mat, Side};

use crate::FlowError;

/// Share of first-order smoothness: keeps parts without targets from swinging out.
const MEMBRANE: f64 = 0.7;
/// Opposite rims of the mouth slit closer than this move together, mm.
const SLIT: f64 = 3.0;
/// Weight of that bond against one square millimetre of targets.
const SLIT_WEIGHT: f64 = 8.0;
/// Pull towards no displacement, per square millimetre.
const REST: f64 = 1e-5;

/// A symmetric sparse matrix, lower half by columns, over the pattern that all its terms share.
struct Pattern {
    starts: Vec<usize>,
    rows: Vec<usize>,
}

impl Pattern {
    fn from_pairs(n: usize, pairs: impl Iterator<Item = (usize, usize)>) -> Self {
        let mut columns: Vec<Vec<usize>> = vec![Vec::new(); n];
        for (column, row) in pairs {
            // The same pairs come again and again, often in a row.
            if columns[column].last() != Some(&row) {
                columns[column].push(row);
            }
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for mut column in columns {
            column.sort_unstable();
            column.dedup();
            rows.extend(column);
            starts.push(rows.len());
        }
        Self { starts, rows }
    }

    /// Place of entry `(a, b)`, in either order.
    fn index(&self, a: usize, b: usize) -> usize {
        let (column, row) = (a.min(b), a.max(b));
        let range = self.starts[column]..self.starts[column + 1];
        let found = self.rows[range.clone()].binary_search(&row);
        range.start + found.expect("the pattern holds every pair of its terms")
    }
}

/// The smooth deformation of one reference head; everything that does not depend on the scan is prepared.
pub(crate) struct CageFit {
    pattern: Pattern,
    symbolic: SymbolicLlt<usize>,
    /// Values of `∫|Δd|^2`, `∫|∇d|^2` and of the fixed small terms, over the pattern.
    bending: Vec<f64>,
    stretching: Vec<f64>,
    fixed: Vec<f64>,
    /// Places in the pattern of every pair of every fine vertex's stencil, and where each vertex's begin.
    slots: Vec<u32>,
    slot_starts: Vec<u32>,
}

/// Where one fine vertex should go.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    /// The fine vertex.
    pub(crate) vertex: u32,
    /// Its displacement, mm.
    pub(crate) displacement: Vector3,
    /// Weight times the vertex's area, mm^2.
    pub(crate) weight: f64,
}

impl CageFit {
    /// Prepares the operators on the reference's shape. Cost O(n^1.5).
    pub(crate) fn new(reference: &ReferenceHead) -> Result<Self, FlowError> {
        let cage = &reference.cage;
        let n = cage.positions.len();
        let (edges, areas) = stiffness(&cage.positions, &cage.faces);
        let slit = slit_pairs(reference);
        // Rows of the Laplacian, diagonal included.
        let mut laplacian: Vec<Vec<(usize, f64)>> = vec![Vec::new(); n];
        let mut diagonal = vec![0.0; n];
        for &(a, b, w) in &edges {
            laplacian[a].push((b, -w));
            laplacian[b].push((a, -w));
            diagonal[a] += w;
            diagonal[b] += w;
        }
        for (v, row) in laplacian.iter_mut().enumerate() {
            row.push((v, diagonal[v]));
        }
        let mut pairs = Vec::new();
        let mut all_pairs = |members: &mut dyn Iterator<Item = usize>| {
            let members: Vec<usize> = members.collect();
            for &a in &members {
                pairs.extend(members.iter().filter(|b| **b >= a).map(|b| (a, *b)));
            }
        };
        for row in &laplacian {
            all_pairs(&mut row.iter().map(|e| e.0));
        }
        let stencils = &reference.subdivision.stencils;
        for i in 0..stencils.len() {
            all_pairs(&mut stencils.row(i).iter().map(|e| e.0 as usize));
        }
        pairs.extend(slit.iter().map(|&(a, b)| (a.min(b), a.max(b))));
        let pattern = Pattern::from_pairs(n, pairs.into_iter());
        let symbolic = factor_pattern(n, &pattern)?;
        let count = pattern.rows.len();
        let (mut bending, mut stretching, mut fixed) =
            (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        for (v, row) in laplacian.iter().enumerate() {
            for (k, &(a, wa)) in row.iter().enumerate() {
                for &(b, wb) in &row[k..] {
                    bending[pattern.index(a, b)] += wa * wb / areas[v];
                }
            }
            fixed[pattern.index(v, v)] += REST * areas[v];
        }
        for &(a, b, w) in &edges {
            add_spring(&pattern, &mut stretching, a, b, w);
        }
        for &(a, b) in &slit {
            add_spring(&pattern, &mut fixed, a, b, SLIT_WEIGHT);
        }
        let (mut slots, mut slot_starts) = (Vec::new(), vec![0]);
        for i in 0..stencils.len() {
            let row = stencils.row(i);
            for (k, &(a, _)) in row.iter().enumerate() {
                let pairs = row[k..].iter();
                slots.extend(pairs.map(|&(b, _)| pattern.index(a as usize, b as usize) as u32));
            }
            slot_starts.push(slots.len() as u32);
        }
        Ok(Self {
            pattern,
            symbolic,
            bending,
            stretching,
            fixed,
            slots,
            slot_starts,
        })
    }

    /// The displacements of the cage vertices that follow `targets` with smoothing length `length` mm.
    pub(crate) fn solve(
        &self,
        reference: &ReferenceHead,
        targets: &[Target],
        length: f64,
    ) -> Result<Vec<Vector3>, FlowError> {
        let stencils = &reference.subdivision.stencils;
        let mut values = self.smoothness(length);
        let mut right = vec![Vector3::zeros(); reference.cage.positions.len()];
        for target in targets {
            self.add_weight(stencils, target.vertex, target.weight, &mut values);
            for &(a, w) in stencils.row(target.vertex as usize) {
                right[a as usize] += target.displacement * (w * target.weight);
            }
        }
        Ok(self.factor(&values)?.solve(&right))
    }

    /// The values of the smoothness terms over the pattern.
    pub(crate) fn smoothness(&self, length: f64) -> Vec<f64> {
        let (l2, l4) = (length * length, length.powi(4));
        (0..self.pattern.rows.len())
            .map(|k| l4 * self.bending[k] + MEMBRANE * l2 * self.stretching[k] + self.fixed[k])
            .collect()
    }

    /// Adds a weight on the position of one fine vertex to the values.
    pub(crate) fn add_weight(
        &self,
        stencils: &Stencils,
        vertex: u32,
        weight: f64,
        values: &mut [f64],
    ) {
        let row = stencils.row(vertex as usize);
        let mut slots = self.slots[self.slot_starts[vertex as usize] as usize..].iter();
        for (k, &(_, wa)) in row.iter().enumerate() {
            for (&(_, wb), &slot) in row[k..].iter().zip(&mut slots) {
                values[slot as usize] += weight * wa * wb;
            }
        }
    }

    /// The product of the matrix of these values with `x`, added to `out`.
    pub(crate) fn multiply(&self, values: &[f64], x: &[Vector3], out: &mut [Vector3]) {
        for column in 0..x.len() {
            let mut sum = Vector3::zeros();
            for k in self.pattern.starts[column]..self.pattern.starts[column + 1] {
                let row = self.pattern.rows[k];
                out[row] += x[column] * values[k];
                if row != column {
                    sum += x[row] * values[k];
                }
            }
            out[column] += sum;
        }
    }

    /// Factors the matrix of these values. Cost O(n^1.5).
    pub(crate) fn factor(&self, values: &[f64]) -> Result<CageFactor, FlowError> {
        let n = self.pattern.starts.len() - 1;
        let structure = SymbolicSparseColMatRef::new_checked(
            n,
            n,
            &self.pattern.starts,
            None,
            &self.pattern.rows,
        );
        let matrix = SparseColMatRef::new(structure, values);
        Llt::try_new_with_symbolic(self.symbolic.clone(), matrix, Side::Lower)
            .map(CageFactor)
            .map_err(|_| FlowError::Singular { unknowns: n })
    }
}

/// A factored matrix over the cage's vertices.
pub(crate) struct CageFactor(Llt<usize, f64>);

impl CageFactor {
    /// The solution for one right side a vertex.
    pub(crate) fn solve(&self, right: &[Vector3]) -> Vec<Vector3> {
        let mut columns = Mat::<f64>::from_fn(right.len(), 3, |v, axis| right[v][axis]);
        self.0.solve_in_place(columns.as_mut());
        (0..right.len())
            .map(|v| Vector3::new(columns[(v, 0)], columns[(v, 1)], columns[(v, 2)]))
            .collect()
    }
}

fn factor_pattern(n: usize, pattern: &Pattern) -> Result<SymbolicLlt<usize>, FlowError> {
    let structure =
        SymbolicSparseColMat::new_checked(n, n, pattern.starts.clone(), None, pattern.rows.clone());
    SymbolicLlt::try_new(structure.as_ref(), Side::Lower)
        .map_err(|_| FlowError::Singular { unknowns: n })
}

fn add_spring(pattern: &Pattern, values: &mut [f64], a: usize, b: usize, weight: f64) {
    values[pattern.index(a, a)] += weight;
    values[pattern.index(b, b)] += weight;
    values[pattern.index(a, b)] -= weight;
}

/// Edges `(a < b, weight)` with cotangent weights, quads split both ways, and the areas of the vertices.
fn stiffness(positions: &[Point3], faces: &[Vec<u32>]) -> (Vec<(usize, usize, f64)>, Vec<f64>) {
    let mut entries: Vec<(usize, usize, f64)> = Vec::new();
    let mut areas = vec![1e-6; positions.len()];
    let mut add_triangle = |corners: [u32; 3], share: f64| {
        let [a, b, c] = corners.map(|v| v as usize);
        let area = 0.5
            * (positions[b] - positions[a])
                .cross(&(positions[c] - positions[a]))
                .norm();
        for v in [a, b, c] {
            areas[v] += share * area / 3.0;
        }
        for (i, j, k) in [(a, b, c), (b, c, a), (c, a, b)] {
            let (u, v) = (positions[i] - positions[k], positions[j] - positions[k]);
            let cotangent = u.dot(&v) / u.cross(&v).norm().max(1e-9);
            entries.push((i.min(j), i.max(j), 0.5 * share * cotangent));
        }
    };
    for face in faces {
        match face[..] {
            [a, b, c, d] => {
                for t in [[a, b, c], [a, c, d], [b, c, d], [b, d, a]] {
                    add_triangle(t, 0.5);
                }
            }
            _ => {
                for k in 1..face.len().saturating_sub(1) {
                    add_triangle([face[0], face[k], face[k + 1]], 1.0);
                }
            }
        }
    }
    entries.sort_by_key(|e| (e.0, e.1));
    let edges = entries
        .chunk_by(|p, q| (p.0, p.1) == (q.0, q.1))
        .map(|run| {
            // Obtuse corners give negative weights; a small positive one keeps the operator definite.
            let sum: f64 = run.iter().map(|e| e.2).sum();
            (run[0].0, run[0].1, sum.max(0.05))
        })
        .collect();
    (edges, areas)
}

/// Cage vertices of the upper lip with their nearest neighbours on the lower, across the slit.
fn slit_pairs(reference: &ReferenceHead) -> Vec<(usize, usize)> {
    let cage = &reference.cage;
    let mut upper = vec![false; cage.positions.len()];
    let mut lower = vec![false; cage.positions.len()];
    // Two fine triangles for each fine quad, in order.
    for (quad, parent) in reference.subdivision.parents.iter().enumerate() {
        let set = match reference.mesh.segments.get(2 * quad) {
            Some(Segment::UpperLip) => &mut upper,
            Some(Segment::LowerLip) => &mut lower,
            _ => continue,
        };
        for &v in &cage.faces[*parent as usize] {
            set[v as usize] = true;
        }
    }
    let mut pairs = Vec::new();
    for a in (0..upper.len()).filter(|&v| upper[v] && !lower[v]) {
        let nearest = (0..lower.len())
            .filter(|&v| lower[v] && !upper[v])
            .map(|v| ((cage.positions[v] - cage.positions[a]).norm(), v))
            .min_by(|p, q| p.0.total_cmp(&q.0));
        if let Some((distance, b)) = nearest
            && distance < SLIT
        {
            pairs.push((a, b));
        }
    }
    pairs
}
