//! The preconditioner: the Hessian in blocks of three coordinates, and its factor.
//!
//! Far from rest, what could make the matrix indefinite is left out: the sideways push of compressed springs and the
//! bending of prisms under pressure. Nodes that rest on a surface move along it alone: their normals are taken out of the system. Factors
//! of the three coordinates one by one cost a fifth, but need five times the iterations: at the nose and below the
//! chin the skin is not across the radius, and one stiffness couples all three.
//! Source of the method: Liu et al., Quasi-Newton methods for real-time simulation of hyperelastic materials, 2017.

use super::assembly::{Assembly, Hessian, SystemPattern, add_outer};
use crate::SimError;
use crate::load::Load;
use crate::simd::dispatch;
use crate::sparse::{Block, BlockFactor, NO_BLOCK};
use crate::vector::{V3, ZERO, dot};

/// The factored matrix with its work space.
#[derive(Debug)]
pub(crate) struct Preconditioner {
    factor: BlockFactor,
    /// Blocks by slot: rows of the larger node, columns of the smaller. One more takes what belongs to nodes that do not move.
    matrix: Vec<Block>,
    sides: Vec<f32>,
    /// Mean stiffness of each moving node against motion on its own, 0 for the others.
    pub(crate) own: Vec<f64>,
}

impl Preconditioner {
    pub(crate) fn new(system: &SystemPattern) -> Self {
        Self {
            factor: BlockFactor::new(&system.pattern),
            matrix: vec![NO_BLOCK; system.entries + 1],
            sides: vec![0.0; 3 * system.nodes.len()],
            own: vec![0.0; system.diagonal.len()],
        }
    }

    /// Smallest pivot of the last factor.
    pub(crate) fn smallest_pivot(&self) -> f64 {
        f64::from(self.factor.smallest)
    }

    /// Assembles the matrix at `x`.
    pub(crate) fn assemble(&mut self, load: &Load<'_>, x: &[V3], hessian: Hessian) {
        let system = &load.model.template.pattern;
        self.matrix.fill(NO_BLOCK);
        dispatch(Assembly {
            load,
            x,
            hessian,
            matrix: &mut self.matrix,
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

    /// Adds the curvature of the surfaces below resting nodes to an assembled matrix.
    pub(crate) fn bend(&mut self, load: &Load<'_>, x: &[V3], gradient: &[V3], normals: &[V3]) {
        let diagonal = &load.model.template.pattern.diagonal;
        let matrix = &mut self.matrix;
        load.contacts.curvature(x, gradient, normals, |node, bend| {
            let block = &mut matrix[diagonal[node] as usize];
            for (row, b) in block.iter_mut().zip(bend) {
                for (m, b) in row.iter_mut().zip(b) {
                    *m += b;
                }
            }
        });
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
                    let own = dot(n, times(block, n));
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

/// `m a`.
fn times(m: &Block, a: V3) -> V3 {
    m.map(|row| row[0] * a[0] + row[1] * a[1] + row[2] * a[2])
}

/// `m^T a`.
fn times_back(m: &Block, a: V3) -> V3 {
    [0, 1, 2].map(|c| m[0][c] * a[0] + m[1][c] * a[1] + m[2][c] * a[2])
}

/// `m = (I - n n^T) m`.
fn cut_rows(m: &mut Block, n: V3) {
    let along = times_back(m, n);
    add_outer(m, n, along, -1.0);
}

/// `m = m (I - n n^T)`.
fn cut_columns(m: &mut Block, n: V3) {
    let along = times(m, n);
    add_outer(m, along, n, -1.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::Measured;
    use crate::model::FaceModel;
    use crate::vector::{add_scaled, norm, unit};
    use crate::{FaceRig, MuscleSet, Pose};
    use facile_core::ReferenceHead;

    fn posed(pose: &Pose, check: impl FnOnce(&Load<'_>)) {
        let reference = ReferenceHead::embedded();
        let rig = FaceRig::new(reference, MuscleSet::embedded()).expect("built in");
        let model = rig
            .model(reference, &crate::mean_subject(reference))
            .expect("the mean head");
        check(&Load::new(&model, pose).expect("valid"));
    }

    /// Motion of the nodes that move, without a pattern.
    fn motion(model: &FaceModel) -> Vec<V3> {
        let moving = model.template.moving.iter().enumerate();
        let any = |i: usize| [0.3, 1.7, 2.9].map(|f| libm::sin(f * i as f64 + f));
        moving
            .map(|(i, m)| if *m { any(i) } else { ZERO })
            .collect()
    }

    /// Moves nodes by up to 0.7 mm: no spring is left where its law has a corner in its second derivative.
    fn crumple(x: &mut [V3]) {
        for (i, p) in x.iter_mut().enumerate() {
            let away = [1.3, 2.1, 0.7].map(|f| libm::sin(f * i as f64));
            *p = add_scaled(*p, away, 0.4);
        }
    }

    /// What the matrix makes of a motion.
    fn product(load: &Load<'_>, matrix: &Preconditioner, v: &[V3]) -> Vec<V3> {
        let system = &load.model.template.pattern;
        let mut product = vec![ZERO; v.len()];
        for ([a, b], block) in system.pattern.pairs().zip(&matrix.matrix) {
            let [a, b] = [a, b].map(|row| system.nodes[row as usize] as usize);
            product[b] = add_scaled(product[b], times(block, v[a]), 1.0);
            if a != b {
                product[a] = add_scaled(product[a], times_back(block, v[b]), 1.0);
            }
        }
        product
    }

    /// Largest difference of a product from the slope of a gradient, to fourth order in a step, over the largest part.
    fn difference(
        model: &FaceModel,
        product: &[V3],
        step: f64,
        gradient: impl FnMut(f64) -> Vec<V3>,
    ) -> f64 {
        let [a, b, c, d] = [step, -step, 2.0 * step, -2.0 * step].map(gradient);
        let size = product.iter().map(|p| norm(*p)).fold(0.0, f64::max);
        let mut worst = 0.0f64;
        for i in (0..product.len()).filter(|i| model.template.moving[*i]) {
            for k in 0..3 {
                let slope = 8.0 * (a[i][k] - b[i][k]) - (c[i][k] - d[i][k]);
                worst = worst.max((slope / (12.0 * step) - product[i][k]).abs() / size);
            }
        }
        worst
    }

    /// The same for a motion from `x` that nothing bounds.
    fn free_difference(load: &Load<'_>, matrix: &Preconditioner, x: &[V3]) -> f64 {
        let v = motion(load.model);
        let product = product(load, matrix, &v);
        difference(load.model, &product, 5e-5, |t| {
            let moved = x.iter().zip(&v);
            let y: Vec<V3> = moved.map(|(p, v)| add_scaled(*p, *v, t)).collect();
            let mut gradient = vec![ZERO; y.len()];
            load.energy(&y, &mut gradient);
            gradient
        })
    }

    #[test]
    fn at_rest_nothing_is_left_out_and_the_factor_inverts_the_matrix() {
        posed(&Pose::default(), |load| {
            let system = &load.model.template.pattern;
            let mut matrix = Preconditioner::new(system);
            matrix.assemble(load, &load.model.rest, Hessian::Exact);
            let exact = matrix.matrix.clone();
            matrix.assemble(load, &load.model.rest, Hessian::Positive);
            for (p, e) in matrix.matrix.iter().flatten().zip(exact.iter().flatten()) {
                for (p, e) in p.iter().zip(e) {
                    assert!((p - e).abs() <= 1e-6, "{p} {e}");
                }
            }
            let v = motion(load.model);
            let product = product(load, &matrix, &v);
            matrix
                .factor(system, &vec![ZERO; v.len()])
                .expect("positive");
            let mut back = vec![ZERO; v.len()];
            matrix.descend(system, &product, &mut back);
            for (p, v) in back.iter().zip(&v) {
                assert!(norm(add_scaled(*p, *v, 1.0)) < 0.02);
            }
        });
    }

    #[test]
    fn the_exact_matrix_is_the_hessian_of_a_crumpled_face_whose_lips_press() {
        let mut pose = Pose::default();
        for (key, c) in [("zygomatic_major", 0.8), ("orbicularis_oris", 0.7)] {
            pose.set(MuscleSet::embedded(), key, c).expect("known");
        }
        posed(&pose, |load| {
            let mut x = load.carried.clone();
            crumple(&mut x);
            for lip in &load.model.contacts.lips {
                x[lip.node as usize][1] -= 3.0;
            }
            assert!(load.contacts.lip_overlap(&x) > 1.0);
            let mut matrix = Preconditioner::new(&load.model.template.pattern);
            matrix.assemble(load, &x, Hessian::Exact);
            let worst = free_difference(load, &matrix, &x);
            assert!(worst < 1e-8, "{worst}");
            matrix.assemble(load, &x, Hessian::Positive);
            let worst = free_difference(load, &matrix, &x);
            assert!(worst > 1e-3, "nothing was left out: {worst}");
        });
    }

    /// Nodes that slide on skull, jaw and eyeballs: what is left of their forces along the surface changes as the matrix
    /// says, if the surface's curvature is in it.
    #[test]
    fn where_nodes_slide_the_matrix_knows_how_surfaces_bend() {
        let mut pose = Pose::default();
        for (key, c) in [("orbicularis_oculi", 0.8), ("orbicularis_oris", 0.9)] {
            pose.set(MuscleSet::embedded(), key, c).expect("known");
        }
        pose.jaw.open_rad = 0.2;
        posed(&pose, |load| {
            let contacts = &load.contacts;
            let mut x = load.carried.clone();
            crumple(&mut x);
            // Half of the nodes end below a surface and are put onto it: they rest, whatever their force.
            let mut normals = vec![ZERO; x.len()];
            contacts.settle(&mut x, &normals, &mut Measured::default());
            let (mut on_skull, mut on_eyes) = (0, 0);
            for c in 0..contacts.len() {
                let gap = contacts.gap(c, &x);
                if gap.value < 1e-3 {
                    normals[contacts.node(c)] = unit(gap.gradient);
                    let is_skull = c < contacts.contacts.skull.len();
                    *(if is_skull {
                        &mut on_skull
                    } else {
                        &mut on_eyes
                    }) += 1;
                }
            }
            assert!(on_skull > 300 && on_eyes > 20, "{on_skull} {on_eyes}");
            contacts.settle(&mut x, &normals, &mut Measured::default());
            for c in 0..contacts.len() {
                let n = &mut normals[contacts.node(c)];
                if *n != ZERO {
                    *n = unit(contacts.gap(c, &x).gradient);
                }
            }
            let mut gradient = vec![ZERO; x.len()];
            load.energy(&x, &mut gradient);
            let along = |a: &mut [V3]| {
                for (a, n) in a.iter_mut().zip(&normals) {
                    *a = add_scaled(*a, *n, -dot(*a, *n));
                }
            };
            let mut v = motion(load.model);
            along(&mut v);
            let slides = |t: f64| {
                let moved = x.iter().zip(&v);
                let mut y: Vec<V3> = moved.map(|(p, v)| add_scaled(*p, *v, t)).collect();
                let mut measured = Measured::default();
                contacts.settle(&mut y, &normals, &mut measured);
                let mut gradient = vec![ZERO; y.len()];
                load.energy(&y, &mut gradient);
                contacts.reduce(&y, &normals, &measured, &mut gradient);
                along(&mut gradient);
                gradient
            };
            let mut matrix = Preconditioner::new(&load.model.template.pattern);
            let differs = |matrix: &Preconditioner| {
                let mut product = product(load, matrix, &v);
                along(&mut product);
                difference(load.model, &product, 5e-5, slides)
            };
            matrix.assemble(load, &x, Hessian::Exact);
            let flat = differs(&matrix);
            matrix.bend(load, &x, &gradient, &normals);
            let bent = differs(&matrix);
            assert!(bent < 1e-7 && flat > 100.0 * bent, "{flat} {bent}");
        });
    }
}
