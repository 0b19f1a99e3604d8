//! The energy's two large sums and their gradients: springs edge by edge, prisms four at a time.
//!
//! An edge of the mesh has four springs between its four nodes: in the skin, in the fascia, and two crossed ones. They
//! fill the four lanes, and each node is read and written once for both of its springs.

use crate::elements::PrismGroup;
use crate::simd::{Kernel, LANES, Lanes, lanes, total};
use crate::springs::{Four, MIN_LENGTH_MM};
use crate::vector::V3;

/// Energy of the springs along edges.
pub(crate) struct EdgeSprings<'a> {
    /// Nodes of the skin at the ends of each edge.
    pub(crate) edges: &'a [[u32; 2]],
    /// By lane: skin, fascia, skin `a` to fascia `b`, skin `b` to fascia `a`.
    pub(crate) stiffness: &'a [Lanes],
    pub(crate) rest_length: &'a [Lanes],
    /// Most that each of an edge's springs pushes, over its length.
    pub(crate) brace: &'a [f64],
    /// The skin's nodes, then the fascia's.
    pub(crate) x: &'a [V3],
    /// Receives the gradient on top of what is there.
    pub(crate) gradient: &'a mut [V3],
}

impl Kernel for EdgeSprings<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let n = self.x.len() / 2;
        let (skin, fascia) = self.x.split_at(n);
        let (on_skin, on_fascia) = self.gradient.split_at_mut(n);
        let mut energy = [0.0; LANES];
        let springs = self.stiffness.iter().zip(self.rest_length).zip(self.brace);
        for (&[a, b], ((k, rest), &brace)) in self.edges.iter().zip(springs) {
            let (a, b) = (a as usize, b as usize);
            let (p, q, u, v) = (skin[a], skin[b], fascia[a], fascia[b]);
            let mut d = [[0.0; LANES]; 3];
            for c in 0..3 {
                d[c] = [p[c] - q[c], u[c] - v[c], p[c] - v[c], q[c] - u[c]];
            }
            let length =
                lanes(|l| (d[0][l] * d[0][l] + d[1][l] * d[1][l] + d[2][l] * d[2][l]).sqrt());
            let springs = Four {
                stiffness: *k,
                rest: *rest,
                brace: [brace; LANES],
            };
            let (twice, pull) = springs.energy(&length);
            energy = lanes(|l| energy[l] + twice[l]);
            let pull = lanes(|l| pull[l] / length[l].max(MIN_LENGTH_MM));
            for c in 0..3 {
                let f = lanes(|l| d[c][l] * pull[l]);
                on_skin[a][c] += f[0] + f[2];
                on_skin[b][c] += f[3] - f[0];
                on_fascia[a][c] += f[1] - f[3];
                on_fascia[b][c] -= f[1] + f[2];
            }
        }
        0.5 * total(energy)
    }
}

/// Energy of shape and volume.
pub(crate) struct Prisms<'a> {
    pub(crate) groups: &'a [PrismGroup],
    /// Offsets from the centre at rest, turned.
    pub(crate) offsets: &'a [[[Lanes; 3]; 6]],
    pub(crate) x: &'a [V3],
    pub(crate) gradient: &'a mut [V3],
}

type Vector = [Lanes; 3];

#[inline(always)]
fn vector(f: impl Fn(usize, usize) -> f64) -> Vector {
    let mut out = [[0.0; LANES]; 3];
    for (c, lane) in out.iter_mut().enumerate() {
        for (l, value) in lane.iter_mut().enumerate() {
            *value = f(c, l);
        }
    }
    out
}

#[inline(always)]
fn cross(a: &Vector, b: &Vector) -> Vector {
    vector(|c, l| {
        let (d, e) = ((c + 1) % 3, (c + 2) % 3);
        a[d][l] * b[e][l] - a[e][l] * b[d][l]
    })
}

impl Kernel for Prisms<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let (mut shape, mut volume) = ([0.0; LANES], [0.0; LANES]);
        for (group, offsets) in self.groups.iter().zip(self.offsets) {
            // Gather six nodes of four prisms.
            let mut p = [[[0.0; LANES]; 3]; 6];
            for (p, nodes) in p.iter_mut().zip(&group.nodes) {
                for l in 0..LANES {
                    let [x, y, z] = self.x[nodes[l] as usize];
                    p[0][l] = x;
                    p[1][l] = y;
                    p[2][l] = z;
                }
            }
            // Shape: offsets from the centre against those at rest. They sum to zero, so the centre adds no force.
            let sum = |c: usize, l: usize| {
                (p[0][c][l] + p[1][c][l] + p[2][c][l]) + (p[3][c][l] + p[4][c][l] + p[5][c][l])
            };
            let center = vector(|c, l| sum(c, l) * (1.0 / 6.0));
            let mut residual = [[[0.0; LANES]; 3]; 6];
            let mut square = [0.0; LANES];
            for (k, r) in residual.iter_mut().enumerate() {
                *r = vector(|c, l| p[k][c][l] - center[c][l] - offsets[k][c][l]);
                square = lanes(|l| {
                    square[l] + (r[0][l] * r[0][l] + r[1][l] * r[1][l] + r[2][l] * r[2][l])
                });
            }
            shape = lanes(|l| shape[l] + group.shape[l] * square[l]);
            // Volume: area vector of the middle triangle times the mean offset of skin from fascia.
            let mut middle = [[[0.0; LANES]; 3]; 3];
            for (k, m) in middle.iter_mut().enumerate() {
                *m = vector(|c, l| 0.5 * (p[k][c][l] + p[k + 3][c][l]));
            }
            let side = |a: usize, b: usize| vector(|c, l| middle[a][c][l] - middle[b][c][l]);
            let area = cross(&side(1, 0), &side(2, 0));
            let height = vector(|c, l| {
                let up = |k: usize| p[k][c][l] - p[k + 3][c][l];
                (up(0) + up(1) + up(2)) * (1.0 / 3.0)
            });
            let now = lanes(|l| {
                0.5 * (area[0][l] * height[0][l]
                    + area[1][l] * height[1][l]
                    + area[2][l] * height[2][l])
            });
            let (energy, pressure) = group.pressure(&now);
            volume = lanes(|l| volume[l] + energy[l]);
            let third = vector(|c, l| area[c][l] * (1.0 / 6.0));
            // Scatter.
            for k in 0..3 {
                let along = side((k + 1) % 3, (k + 2) % 3);
                let turn = cross(&along, &height);
                for (node, sign) in [(k, 1.0), (k + 3, -1.0)] {
                    let force = vector(|c, l| {
                        group.shape[l] * residual[node][c][l]
                            + pressure[l] * (0.25 * turn[c][l] + sign * third[c][l])
                    });
                    for l in 0..LANES {
                        let g = &mut self.gradient[group.nodes[node][l] as usize];
                        g[0] += force[0][l];
                        g[1] += force[1][l];
                        g[2] += force[2][l];
                    }
                }
            }
        }
        0.5 * total(shape) + total(volume)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load::Load;
    use crate::simd::dispatch;
    use crate::{FaceModel, MuscleSet, Pose, mean_subject};
    use facile_core::ReferenceHead;

    #[test]
    fn wide_registers_give_the_bits_of_plain_code() {
        let reference = ReferenceHead::embedded();
        let muscles = MuscleSet::embedded();
        let model = FaceModel::new(reference, muscles, &mean_subject(reference)).expect("built");
        let mut pose = Pose::default();
        pose.set(muscles, "zygomatic_major", 0.8).expect("known");
        pose.jaw.open_rad = 0.2;
        let load = Load::new(&model, &pose).expect("valid");
        let x = &load.carried;
        let mut sums = [[0.0; 2]; 2];
        let mut gradients = [vec![[0.0; 3]; x.len()], vec![[0.0; 3]; x.len()]];
        for (is_wide, (sum, gradient)) in sums.iter_mut().zip(&mut gradients).enumerate() {
            let springs = EdgeSprings {
                edges: &model.template.edges,
                stiffness: &load.stiffness,
                rest_length: &load.rest_length,
                brace: &model.springs.brace,
                x,
                gradient,
            };
            sum[0] = if is_wide == 1 {
                dispatch(springs)
            } else {
                springs.run()
            };
            let prisms = Prisms {
                groups: &model.elements.groups,
                offsets: &load.offsets,
                x,
                gradient,
            };
            sum[1] = if is_wide == 1 {
                dispatch(prisms)
            } else {
                prisms.run()
            };
        }
        assert!(sums[0][0] > 0.0 && sums[0][1] > 0.0);
        assert_eq!(sums[0].map(f64::to_bits), sums[1].map(f64::to_bits));
        let bits =
            |g: &[V3]| -> Vec<u64> { g.as_flattened().iter().map(|v| v.to_bits()).collect() };
        assert_eq!(bits(&gradients[0]), bits(&gradients[1]));
    }
}
