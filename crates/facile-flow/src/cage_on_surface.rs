//! Smooth deformation of the cage whose vertices lie on the scan but are free to slide along it.
//!
//! Adds `sum_j u_j (n_j . (S_j d) - o_j)^2` to the energy of [`crate::cage`]: how far the surface is, is known nearly
//! everywhere, and where on it only at features. Told both at once, the smooth deformation carries what features
//! know around the bends of cheek and jaw; told the distance afterwards, it runs straight on into the air and is
//! pushed back along the normals. The three axes are coupled, so the system is solved by conjugate gradients with
//! the factor of one axis as the preconditioner. Source: Chen and Medioni 1992 (point to plane); Saad 2003, ch. 9.

use facile_core::subdivision::Stencils;
use facile_core::{ReferenceHead, Vector3};

use crate::FlowError;
use crate::cage::{CageFit, Target};

/// Share of the surface's weight that the preconditioner sees along every axis: 0.03 to 0.3 take as many iterations.
const ISOTROPIC: f64 = 0.1;
/// Iterations end when the squared residual has fallen to this share, in the preconditioner's norm.
const TOLERANCE: f64 = 1e-6;
/// Some twenty iterations are enough; the limit is for scans of a few triangles.
const MOST_ITERATIONS: usize = 60;

/// A plane that one fine vertex should lie on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfaceTarget {
    /// The fine vertex.
    pub(crate) vertex: u32,
    /// Unit normal of the plane.
    pub(crate) normal: Vector3,
    /// Displacement of the vertex along it, mm.
    pub(crate) offset: f64,
    /// Weight times the vertex's area, mm^2.
    pub(crate) weight: f64,
}

/// The displacements of the cage vertices that follow `targets`, on the `surface`, with smoothing length `length` mm;
/// `start` is a guess.
///
/// # Errors
/// [`FlowError::Singular`] if the preconditioner cannot be factored.
pub(crate) fn solve_on_surface(
    reference: &ReferenceHead,
    fit: &CageFit,
    (targets, surface): (&[Target], &[SurfaceTarget]),
    length: f64,
    start: &[Vector3],
) -> Result<Vec<Vector3>, FlowError> {
    let stencils = &reference.subdivision.stencils;
    // Everything but the surface is the same along each axis.
    let mut values = fit.smoothness(length);
    let mut right = vec![Vector3::zeros(); start.len()];
    for target in targets {
        fit.add_weight(stencils, target.vertex, target.weight, &mut values);
        spread(
            stencils,
            target.vertex,
            target.displacement * target.weight,
            &mut right,
        );
    }
    let mut preconditioner = values.clone();
    for target in surface {
        let weight = ISOTROPIC * target.weight;
        fit.add_weight(stencils, target.vertex, weight, &mut preconditioner);
        let pull = target.normal * (target.offset * target.weight);
        spread(stencils, target.vertex, pull, &mut right);
    }
    let preconditioner = fit.factor(&preconditioner)?;
    let apply = |x: &[Vector3]| {
        let mut product = vec![Vector3::zeros(); x.len()];
        fit.multiply(&values, x, &mut product);
        for target in surface {
            let row = stencils.row(target.vertex as usize);
            let at: Vector3 = row.iter().map(|&(a, w)| x[a as usize] * w).sum();
            let pull = target.normal * (target.normal.dot(&at) * target.weight);
            spread(stencils, target.vertex, pull, &mut product);
        }
        product
    };
    Ok(conjugate_gradients(
        apply,
        |r| preconditioner.solve(r),
        &right,
        start.to_vec(),
    ))
}

/// Adds what pulls at a fine vertex to the cage vertices that it hangs on.
fn spread(stencils: &Stencils, vertex: u32, pull: Vector3, out: &mut [Vector3]) {
    for &(a, w) in stencils.row(vertex as usize) {
        out[a as usize] += pull * w;
    }
}

/// Preconditioned conjugate gradients from `x`, sums in the order of the vertices.
fn conjugate_gradients(
    apply: impl Fn(&[Vector3]) -> Vec<Vector3>,
    precondition: impl Fn(&[Vector3]) -> Vec<Vector3>,
    right: &[Vector3],
    mut x: Vec<Vector3>,
) -> Vec<Vector3> {
    let dot = |a: &[Vector3], b: &[Vector3]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
    let mut residual: Vec<Vector3> = right.iter().zip(apply(&x)).map(|(b, a)| b - a).collect();
    let mut step = precondition(&residual);
    let mut square = dot(&residual, &step);
    let enough = TOLERANCE * square;
    for _ in 0..MOST_ITERATIONS {
        if square <= enough {
            break;
        }
        let product = apply(&step);
        let along = square / dot(&step, &product);
        for i in 0..x.len() {
            x[i] += step[i] * along;
            residual[i] -= product[i] * along;
        }
        let z = precondition(&residual);
        let next = dot(&residual, &z);
        for (s, z) in step.iter_mut().zip(z) {
            *s = z + *s * (next / square);
        }
        square = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The head moved as a whole, known by its surface alone except at two places: the rest slides after them.
    #[test]
    fn features_carry_along_what_is_only_known_to_lie_on_the_surface() {
        let reference = ReferenceHead::embedded();
        let fit = CageFit::new(reference).expect("a surface");
        let normals = reference.mesh.vertex_normals();
        let moved = Vector3::new(1.0, -2.0, 0.5);
        let vertices = 0..normals.len() as u32;
        let surface: Vec<SurfaceTarget> = (vertices.clone())
            .map(|vertex| {
                let normal = normals[vertex as usize];
                SurfaceTarget {
                    vertex,
                    normal,
                    offset: normal.dot(&moved),
                    weight: 4.0,
                }
            })
            .collect();
        let targets: Vec<Target> = (vertices.step_by(997))
            .map(|vertex| Target {
                vertex,
                displacement: moved,
                weight: 10.0,
            })
            .collect();
        let start = vec![Vector3::zeros(); reference.cage.positions.len()];
        let found = solve_on_surface(reference, &fit, (&targets, &surface), 14.0, &start)
            .expect("definite");
        let fine = reference
            .subdivision
            .stencils
            .apply(&found, Vector3::zeros());
        let worst = (fine.iter().zip(&reference.mesh.positions))
            .filter(|(_, p)| crate::template::in_front(p))
            .map(|(d, _)| (d - moved).norm())
            .fold(0.0, f64::max);
        assert!(worst < 0.1, "{worst} mm");
    }
}
