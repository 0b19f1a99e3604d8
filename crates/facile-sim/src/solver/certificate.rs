//! How true an equilibrium is.

use serde::{Deserialize, Serialize};

use super::{Outcome, SolverKind};
use crate::layers::area_vector;
use crate::load::Load;
use crate::vector::{V3, dot, norm};

/// Nodes nearer than this to a surface may lean on it, mm.
const TOUCH_MM: f64 = 1e-3;

/// Evidence that a face is at rest. It holds no wall time: the same input gives the same bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Which solver.
    pub solver: SolverKind,
    /// Largest unbalanced force on a node, over the force of a relaxed fascia spring that is stretched by 1 mm. Forces
    /// that press a node onto a surface it touches are balanced by that surface.
    pub residual: f64,
    /// Largest depth of a node below skull, jaw or eyeball, mm, beyond its place at rest: the exact distance from that
    /// surface, in the frame of the piece below the node.
    pub max_penetration_mm: f64,
    /// Largest overlap of the lips, mm, beyond that at rest: they press on each other like soft flesh.
    pub lip_overlap_mm: f64,
    /// Prisms of the skin that are turned inside out, apart from slivers: those below a hundredth of the mean volume.
    pub inverted_elements: usize,
    /// Triangles of the skin that face the other way than at rest.
    pub flipped_triangles: usize,
    /// Smallest pivot of the solver's last factor, over the stiffness of a relaxed fascia spring: how far the matrix is
    /// from singular. 0 for solvers without a factor and for the face at rest.
    pub smallest_pivot: f64,
    /// Iterations of the solver, all steps of the path together.
    pub iterations: usize,
    /// Elastic energy (springs, attachments, shape, volume), in the units of Table 1 and mm.
    pub energy: f64,
}

impl Certificate {
    pub(crate) fn new(load: &Load<'_>, x: &[V3], solver: SolverKind, outcome: &Outcome) -> Self {
        let assessed = assess(load, x);
        Self {
            solver,
            residual: assessed.residual,
            max_penetration_mm: load.contacts.penetration(x),
            lip_overlap_mm: load.contacts.lip_overlap(x),
            inverted_elements: load.model.elements.inverted(x),
            flipped_triangles: flipped(load, x),
            smallest_pivot: outcome.smallest_pivot / load.model.params.fascia_stiffness,
            iterations: outcome.iterations,
            energy: assessed.energy,
        }
    }
}

/// Triangles of the skin whose normal has turned by more than a right angle from where skull, jaw and lids carry it.
fn flipped(load: &Load<'_>, x: &[V3]) -> usize {
    let normal = |t: &[u32; 3], x: &[V3]| area_vector(t.map(|i| x[i as usize]));
    let triangles = load.model.template.triangles.iter();
    triangles
        .filter(|t| dot(normal(t, x), normal(t, &load.carried)) < 0.0)
        .count()
}

/// Residual and energy at `x`, measured the same way for every solver.
pub(crate) fn assess(load: &Load<'_>, x: &[V3]) -> Outcome {
    let mut gradient = vec![[0.0; 3]; x.len()];
    let energy = load.energy(x, &mut gradient);
    let residual = residual(load, x, &mut gradient, TOUCH_MM);
    Outcome {
        residual,
        iterations: 0,
        converged: true,
        energy,
        smallest_pivot: 0.0,
    }
}

/// Largest unbalanced force over the reference force. Takes balanced contact forces out of `gradient`.
pub(crate) fn residual(load: &Load<'_>, x: &[V3], gradient: &mut [V3], touch: f64) -> f64 {
    let moving = &load.model.template.moving;
    load.contacts.balance(x, touch, gradient);
    let largest = gradient
        .iter()
        .zip(moving)
        .filter(|(_, m)| **m)
        .map(|(g, _)| norm(*g))
        .fold(
            0.0,
            |a: f64, b| if b.is_nan() { f64::NAN } else { a.max(b) },
        );
    largest / load.model.params.fascia_stiffness
}
