//! Fit of pose, size and identity model together: which mixture of the modes, and where, comes nearest to the goals.
//!
//! One Gauss-Newton step minimises, over a rigid motion, the size `s` and the modes' coefficients `a`,
//! `sum_i (x_i - g_i)^T W_i (x_i - g_i) + |a|^2 + (ln s / sigma)^2`, where `W_i` weighs the distances
//! along the normal and along the surface by how far each is known. Together, because the modes hold shifts and growth
//! of the face themselves: fitted in turns, pose and modes drift against each other. What the population never shows
//! is left to the smooth deformation. Source: [BPV06]; Blanz and Vetter 1999.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use facile_core::simd::{Kernel, dispatch};
use facile_core::subdivision::Stencils;
use facile_core::{IdentityModel, Isometry3, Point3, UnitQuaternion, Vector3};
use nalgebra::{DMatrix, DVector, Translation3};

use crate::fit::{Goal, NEAREST_STRIDE};
use crate::template::Template;

/// Area of skin whose goals err together, mm^2: as many goals as fit in there count as one.
const INDEPENDENT_AREA: f64 = 500.0;
/// Largest coefficient, in standard deviations of the population.
const LARGEST: f64 = 3.0;
/// Standard deviation of the logarithm of a head's size that is not in the modes.
const SIZE_DEVIATION: f64 = 0.04;
/// About how many goals a fit uses: it has far more than it needs.
const USED_GOALS: usize = 900;
/// Side of the cubes over which distances to the scan are averaged before a person is called strange, mm.
const CUBE: f64 = 20.0;
/// Distance, mm, that people of the model's own population leave at most after the nearest points, with noise or without.
const FAMILIAR: f64 = 0.9;
/// The power with which strangeness grows beyond that, and the most that it grows to.
const STRANGENESS_POWER: f64 = 16.0;
const STRANGEST: f64 = 6.0;
/// Modes that are opposite left and right: of the model's population they hold nine tenths of what is.
const ODD_MODES: usize = 8;
/// Unknowns before the coefficients: rotation, translation, logarithm of the size.
const POSE: usize = 7;

/// Displacements of cage and fine vertices per standard deviation of each mode.
///
/// The modes are those of the model's population together with its mirror images: what is the same left and right, and
/// apart from it what is opposite. The population's own modes hold a little of both, and so bend to the one side more
/// easily than to the other.
pub(crate) struct FineModes {
    /// By mode, mm; none without a model: then every fit gives the mean.
    cage: Vec<Vec<Vector3>>,
    /// By fine vertex, by mode, mm.
    modes: Vec<Vector3>,
    count: usize,
}

/// A mixture of the modes and its size.
#[derive(Clone, Debug)]
pub(crate) struct Identity {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) size: f64,
    /// How little the modes know of this person, from 1 for one of the model's population to [`STRANGEST`]: the factor
    /// by which their fit to the flow believes the goals less. Bent to a stranger, the modes pull places that have no
    /// features of their own along the surface.
    pub(crate) strangeness: f64,
}

/// The fine vertices of an identity, mm, and the unit normals of the face as it is now.
#[derive(Clone, Copy)]
pub(crate) struct Iterate<'a> {
    pub(crate) positions: &'a [Point3],
    pub(crate) normals: &'a [Vector3],
}

impl FineModes {
    /// Subdivides the modes of the cage, whose vertices have these `mirror` images.
    pub(crate) fn new(model: Option<&IdentityModel>, mirror: &[u32], stencils: &Stencils) -> Self {
        let cage = model.map_or_else(Vec::new, |m| symmetric_modes(m, mirror));
        let count = cage.len();
        let mut modes = vec![Vector3::zeros(); count * stencils.len()];
        for (k, mode) in cage.iter().enumerate() {
            let fine = stencils.apply(mode, Vector3::zeros());
            for (v, d) in fine.into_iter().enumerate() {
                modes[v * count + k] = d;
            }
        }
        Self { cage, modes, count }
    }

    /// The mean face at a size.
    pub(crate) fn mean(&self, size: f64) -> Identity {
        Identity {
            coefficients: vec![0.0; self.count],
            size,
            strangeness: 1.0,
        }
    }

    /// The cage with modes added: `(rest + sum of modes) * size`.
    pub(crate) fn cage(&self, rest: &[Point3], identity: &Identity) -> Vec<Vector3> {
        let mut cage: Vec<Vector3> = rest.iter().map(|p| p.coords).collect();
        for (mode, a) in self.cage.iter().zip(&identity.coefficients) {
            for (p, d) in cage.iter_mut().zip(mode) {
                *p += d * *a;
            }
        }
        for p in &mut cage {
            *p *= identity.size;
        }
        cage
    }

    /// Where an identity puts one fine vertex, mm.
    fn place(&self, template: &Template<'_>, v: usize, identity: &Identity) -> Point3 {
        let modes = &self.modes[v * self.count..(v + 1) * self.count];
        let rest = template.reference.mesh.positions[v].coords;
        let moved = (modes.iter().zip(&identity.coefficients)).fold(rest, |p, (m, a)| p + m * *a);
        Point3::from(moved * identity.size)
    }

    /// One step: improves `identity` and returns the rigid motion of the face that brings it nearest to the goals.
    /// `normals`: those of the face as it is now. How far the goals can be believed is found from their distances, within
    /// `error` mm, times the strangeness.
    pub(crate) fn step(
        &self,
        template: &Template<'_>,
        normals: &[Vector3],
        goals: &[Goal],
        error: &RangeInclusive<f64>,
        identity: &mut Identity,
    ) -> Isometry3 {
        let n = POSE + self.count;
        let used: Vec<Used<'_>> = (used_goals(template, goals).into_iter())
            .map(|(goal, count)| Used {
                goal,
                count,
                at: self.place(template, goal.vertex as usize, identity),
            })
            .collect();
        let error = goal_error(template, normals, &used).clamp(*error.start(), *error.end())
            * identity.strangeness;
        let unit = 1.0 / (INDEPENDENT_AREA * error * error);
        let mut system = NormalEquations::new(n);
        for Used { goal, count, at } in used {
            let v = goal.vertex as usize;
            let (x, normal) = (at.coords, normals[v]);
            let weight = template.areas[v] * unit * count;
            let across = (goal.weight * weight).sqrt();
            let along = across * goal.slide.sqrt();
            // The square root of W.
            let weigh = |d: Vector3| d * along + normal * (normal.dot(&d) * (across - along));
            let residual = weigh(goal.at - at);
            let rows = system.rows(&residual);
            let mut put = |i: usize, d: Vector3| {
                for axis in 0..3 {
                    rows[axis][i] = d[axis];
                }
            };
            for axis in 0..3 {
                let e = Vector3::ith(axis, 1.0);
                put(axis, weigh(e.cross(&x)));
                put(3 + axis, weigh(e));
            }
            put(6, weigh(x));
            let modes = &self.modes[v * self.count..(v + 1) * self.count];
            for (k, mode) in modes.iter().enumerate() {
                put(POSE + k, weigh(mode * identity.size));
            }
        }
        let (mut matrix, mut right) = system.finish();
        let prior = 1.0 / (SIZE_DEVIATION * SIZE_DEVIATION);
        matrix[6 * n + 6] += prior;
        right[6] -= prior * libm::log(identity.size);
        for (k, a) in identity.coefficients.iter().enumerate() {
            let i = POSE + k;
            matrix[i * n + i] += 1.0;
            right[i] -= a;
        }
        let full = DMatrix::from_fn(n, n, |i, j| matrix[i.max(j) * n + i.min(j)]);
        let Some(factor) = full.cholesky() else {
            return Isometry3::identity();
        };
        let step = factor.solve(&DVector::from_vec(right));
        for (k, a) in identity.coefficients.iter_mut().enumerate() {
            *a = (*a + step[POSE + k]).clamp(-LARGEST, LARGEST);
        }
        identity.size *= libm::exp(step[6].clamp(-0.1, 0.1));
        Isometry3::from_parts(
            Translation3::new(step[3], step[4], step[5]),
            UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2])),
        )
    }
}

/// The modes of a model's population and its mirror images: the even part of each mode, and the [`ODD_MODES`] strongest
/// principal components of the odd parts.
fn symmetric_modes(model: &IdentityModel, mirror: &[u32]) -> Vec<Vec<Vector3>> {
    let turned = |d: &Vector3| Vector3::new(-d.x, d.y, d.z);
    let part = |k: usize, sign: f64| -> Vec<Vector3> {
        let mode = model.cage_mode(k);
        (mode.iter().zip(mirror))
            .map(|(d, m)| (d + turned(&mode[*m as usize]) * sign) * 0.5)
            .collect()
    };
    let odd: Vec<Vec<Vector3>> = (0..model.len()).map(|k| part(k, -1.0)).collect();
    let inner = |i: usize, j: usize| -> f64 {
        let (i, j) = (i.min(j), i.max(j));
        odd[i].iter().zip(&odd[j]).map(|(a, b)| a.dot(b)).sum()
    };
    let axes = DMatrix::from_fn(odd.len(), odd.len(), inner).symmetric_eigen();
    let mut order: Vec<usize> = (0..odd.len()).collect();
    order.sort_by(|a, b| axes.eigenvalues[*b].total_cmp(&axes.eigenvalues[*a]));
    let component = |axis: usize| -> Vec<Vector3> {
        let mut sum = vec![Vector3::zeros(); mirror.len()];
        for (mode, share) in odd.iter().zip(axes.eigenvectors.column(axis).iter()) {
            for (s, d) in sum.iter_mut().zip(mode) {
                *s += d * *share;
            }
        }
        sum
    };
    let odd = order.into_iter().take(ODD_MODES).map(component);
    (0..model.len()).map(|k| part(k, 1.0)).chain(odd).collect()
}

/// The goals that a fit uses, and how many each stands for. Landmarks come one by one and count each; of the rest
/// one pair of mirror images stands for others, so that a mirrored scan gives the mirrored fit.
fn used_goals<'g>(template: &Template<'_>, goals: &'g [Goal]) -> Vec<(&'g Goal, f64)> {
    let count = |of: &dyn Fn(&&Goal) -> bool| goals.iter().filter(of).count();
    let stride = (count(&|g| !g.is_landmark) / USED_GOALS).max(1) as u32;
    let is_used = |g: &&Goal| {
        !g.is_landmark && (template.pair[g.vertex as usize] / NEAREST_STRIDE).is_multiple_of(stride)
    };
    let share = count(&|g| !g.is_landmark) as f64 / count(&is_used).max(1) as f64;
    (goals.iter())
        .filter(|g| g.is_landmark || is_used(g))
        .map(|g| (g, if g.is_landmark { 1.0 } else { share }))
        .collect()
}

/// How little the modes know of the person that `now` was fitted to: from the distances along the normals that remain.
/// They are averaged over cubes first: noise averages out, and what remains is shape that the modes do not hold.
pub(crate) fn strangeness(template: &Template<'_>, now: &Iterate<'_>, goals: &[Goal]) -> f64 {
    let mut cubes: BTreeMap<[i32; 3], (f64, f64)> = BTreeMap::new();
    for goal in goals {
        let v = goal.vertex as usize;
        if template.face[v] {
            let at = template.reference.mesh.positions[v];
            let weight = template.areas[v] * goal.weight;
            let distance = now.normals[v].dot(&(goal.at - now.positions[v]));
            // Cubes about the origin: the middle plane divides none.
            let cube = [at.x, at.y, at.z].map(|c| (c / CUBE).round() as i32);
            let (sum, total) = cubes.entry(cube).or_default();
            *sum += weight * distance;
            *total += weight;
        }
    }
    let (square, total) = (cubes.values())
        .filter(|(_, weight)| *weight > 0.0)
        .fold((0.0, 1e-9), |(square, total), (sum, weight)| {
            (square + sum * sum / weight, total + weight)
        });
    let misfit = f64::sqrt(square / total);
    libm::pow(misfit / FAMILIAR, STRANGENESS_POWER).clamp(1.0, STRANGEST)
}

/// A goal that a fit uses.
struct Used<'g> {
    goal: &'g Goal,
    /// How many it stands for.
    count: f64,
    /// Where its vertex is now, mm.
    at: Point3,
}

/// Root mean squared distance of the goals an axis, mm.
fn goal_error(template: &Template<'_>, normals: &[Vector3], used: &[Used<'_>]) -> f64 {
    let (mut square, mut total) = (0.0, 1e-9);
    for Used { goal, count, at } in used {
        let v = goal.vertex as usize;
        let weight = template.areas[v] * count;
        let wrong = goal.at - at;
        let across = normals[v].dot(&wrong);
        let along = wrong.norm_squared() - across * across;
        square += weight * goal.weight * (goal.slide * along + across * across);
        total += weight * goal.weight * (2.0 * goal.slide + 1.0);
    }
    (square / total).sqrt()
}

/// Normal equations gathered from rows, [`BLOCK`] at a time: the matrix is read and written that much less often.
struct NormalEquations {
    n: usize,
    /// Lower half by rows of length `n`.
    matrix: Vec<f64>,
    right: Vec<f64>,
    /// Rows that wait, and their right sides.
    waiting: [Vec<f64>; BLOCK],
    sides: [f64; BLOCK],
    filled: usize,
}

/// Rows that are gathered at a time: three for each of two goals.
const BLOCK: usize = 6;

impl NormalEquations {
    fn new(n: usize) -> Self {
        Self {
            n,
            matrix: vec![0.0; n * n],
            right: vec![0.0; n],
            waiting: std::array::from_fn(|_| vec![0.0; n]),
            sides: [0.0; BLOCK],
            filled: 0,
        }
    }

    /// Three rows to be filled, whose right sides are `residual`.
    fn rows(&mut self, residual: &Vector3) -> &mut [Vec<f64>] {
        if self.filled == BLOCK {
            self.gather();
        }
        let first = self.filled;
        self.filled += 3;
        for axis in 0..3 {
            self.sides[first + axis] = residual[axis];
        }
        &mut self.waiting[first..first + 3]
    }

    /// Adds the waiting rows' products.
    fn gather(&mut self) {
        for k in self.filled..BLOCK {
            self.waiting[k].fill(0.0);
        }
        dispatch(Gather(self));
        self.filled = 0;
    }

    /// The matrix (lower half, by rows) and the right side.
    fn finish(mut self) -> (Vec<f64>, Vec<f64>) {
        self.gather();
        (self.matrix, self.right)
    }
}

/// The products of a full block of rows.
struct Gather<'a>(&'a mut NormalEquations);

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let NormalEquations {
            n,
            matrix,
            right,
            waiting,
            sides,
            ..
        } = self.0;
        for i in 0..*n {
            let m = i + 1;
            // Lengths that the compiler sees to be equal: no check of bounds inside the loop.
            let [a, b, c, d, e, f] = &*waiting;
            let (a, b, c) = (&a[..m], &b[..m], &c[..m]);
            let (d, e, f) = (&d[..m], &e[..m], &f[..m]);
            let (p, q, r, s, t, u) = (a[i], b[i], c[i], d[i], e[i], f[i]);
            let out = &mut matrix[i * *n..][..m];
            for j in 0..m {
                out[j] += (a[j] * p + b[j] * q + c[j] * r) + (d[j] * s + e[j] * t + f[j] * u);
            }
            for (row, side) in waiting.iter().zip(&*sides) {
                right[i] += row[i] * side;
            }
        }
    }
}
