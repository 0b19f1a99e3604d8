//! Shape and volume preservation of the skin's prisms, eq. 12 and 13.
//!
//! A prism has six nodes: a triangle of the skin and the one of the fascia below it. Both terms are gradients of
//! energies. Shape, eq. 12: `(k_s / 2) sum |(x_i - c) - R o_i|^2` with the centre `c` of the six nodes and rest offsets
//! `o_i` that turn with jaw and lids. Volume: `(kappa / 2)(V - V_0)^2` with `V = N . h`, `N` the area vector of the
//! triangle half-way between the layers and `h` the mean offset of skin from fascia; `kappa = 3 k_v / A_0`. At rest it
//! equals eq. 13, but it has no net force or torque, and pushes the fascia down where eq. 13 as printed pushes it up.
//! Below a share of the volume at rest it stiffens with the cube of what is missing, so that flesh is not turned inside
//! out where muscles squeeze it to nothing. The sums over all prisms are in `kernels`.

use crate::params::PaperParams;
use crate::simd::{LANES, Lanes, lanes};
use crate::vector::{M3, V3, ZERO, add, cross, dot, norm, rotate, scale, sub};

/// Areas below this share of the mean count as that share in `kappa`.
const MIN_AREA_SHARE: f64 = 0.05;
/// Prisms below this share of the mean volume are slivers.
pub(crate) const SLIVER_SHARE: f64 = 0.01;
/// Share of the volume at rest below which a prism stiffens.
const SQUEEZED_SHARE: f64 = 0.2;
/// How much: the energy `kappa / 2 (V - V_0)^2` grows by `SQUEEZE kappa / (3 V_0) (share V_0 - V)^3`. A prism that is
/// squeezed to nothing is 2,000 times as stiff as at rest. With 60 below a share of 0.4, up to 14 prisms of a built-in
/// expression turned inside out, and solutions split there. The volume counts as that of a sliver at least.
const SQUEEZE: f64 = 5_000.0;

/// Prisms at rest.
#[derive(Clone, Debug, Default)]
pub(crate) struct Elements {
    /// Nodes: three of the skin, then the three of the fascia below.
    pub(crate) nodes: Vec<[u32; 6]>,
    /// Offsets from the prism's centre at rest, mm.
    pub(crate) offsets: Vec<[V3; 6]>,
    /// `kappa` of the volume energy.
    pub(crate) kappa: Vec<f64>,
    /// Volume at rest, mm^3.
    pub(crate) volume: Vec<f64>,
    /// `k_s`.
    pub(crate) shape_stiffness: f64,
    /// The same prisms by fours, for the kernel.
    pub(crate) groups: Vec<PrismGroup>,
}

/// Four prisms, one per lane. The last group is filled up with prisms that weigh nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct PrismGroup {
    pub(crate) nodes: [[u32; LANES]; 6],
    /// `k_s`.
    pub(crate) shape: Lanes,
    kappa: Lanes,
    volume: Lanes,
    /// Sign of the volume at rest.
    sign: Lanes,
    /// Volume below which the prism stiffens, and how much.
    squeezed: Lanes,
    squeeze: Lanes,
}

impl PrismGroup {
    /// Energy of these volumes, and its derivative.
    #[inline(always)]
    pub(crate) fn pressure(&self, volume: &Lanes) -> (Lanes, Lanes) {
        let stretch = lanes(|l| volume[l] - self.volume[l]);
        let missing = lanes(|l| {
            let m = self.squeezed[l] - self.sign[l] * volume[l];
            if m > 0.0 { m } else { 0.0 }
        });
        let push = lanes(|l| self.squeeze[l] * missing[l] * missing[l]);
        let elastic = lanes(|l| self.kappa[l] * stretch[l]);
        let energy = lanes(|l| 0.5 * elastic[l] * stretch[l] + push[l] * missing[l] * (1.0 / 3.0));
        (energy, lanes(|l| elastic[l] - self.sign[l] * push[l]))
    }

    /// Second derivative of the energy by the volume.
    pub(crate) fn stiffening(&self, lane: usize, volume: f64) -> f64 {
        let missing = (self.squeezed[lane] - self.sign[lane] * volume).max(0.0);
        self.kappa[lane] + 2.0 * self.squeeze[lane] * missing
    }

    fn put(
        &mut self,
        lane: usize,
        nodes: &[u32; 6],
        shape: f64,
        kappa: f64,
        volume: f64,
        floor: f64,
    ) {
        for (k, &node) in nodes.iter().enumerate() {
            self.nodes[k][lane] = node;
        }
        self.shape[lane] = shape;
        self.kappa[lane] = kappa;
        self.volume[lane] = volume;
        self.sign[lane] = 1f64.copysign(volume);
        self.squeezed[lane] = SQUEEZED_SHARE * volume.abs();
        self.squeeze[lane] = SQUEEZE * kappa / volume.abs().max(floor);
    }
}

impl Elements {
    /// Prisms over `triangles` of the skin. `rest`: the skin's nodes, then the fascia's.
    pub(crate) fn new(triangles: &[[u32; 3]], params: &PaperParams, rest: &[V3]) -> Self {
        let n = (rest.len() / 2) as u32;
        let mut out = Self {
            shape_stiffness: params.shape_stiffness,
            ..Self::default()
        };
        let mut areas = Vec::with_capacity(triangles.len());
        for &[a, b, c] in triangles {
            let nodes = [a, b, c, n + a, n + b, n + c];
            let x = nodes.map(|i| rest[i as usize]);
            let center = center(&x);
            out.nodes.push(nodes);
            out.offsets.push(x.map(|p| sub(p, center)));
            let v = Volume::of(&x);
            out.volume.push(v.value);
            areas.push(norm(v.area));
        }
        let mean = areas.iter().sum::<f64>() / areas.len().max(1) as f64;
        let floor = (MIN_AREA_SHARE * mean).max(1e-9);
        out.kappa = areas
            .iter()
            .map(|a| 3.0 * params.volume_stiffness / a.max(floor))
            .collect();
        let size = out.volume.iter().map(|v| v.abs()).sum::<f64>() / areas.len().max(1) as f64;
        let floor = (SLIVER_SHARE * size).max(1e-9);
        out.groups = vec![PrismGroup::default(); out.nodes.len().div_ceil(LANES)];
        for (e, nodes) in out.nodes.iter().enumerate() {
            let (kappa, volume) = (out.kappa[e], out.volume[e]);
            let group = &mut out.groups[e / LANES];
            group.put(
                e % LANES,
                nodes,
                params.shape_stiffness,
                kappa,
                volume,
                floor,
            );
        }
        out
    }

    /// Offsets turned with what lies under each prism, by groups of four.
    pub(crate) fn turned(&self, rotation: impl Fn(usize) -> M3) -> Vec<[[Lanes; 3]; 6]> {
        let mut out = vec![[[[0.0; LANES]; 3]; 6]; self.groups.len()];
        for (e, offsets) in self.offsets.iter().enumerate() {
            let r = rotation(e);
            let group = &mut out[e / LANES];
            for (k, o) in offsets.iter().enumerate() {
                let turned = rotate(&r, *o);
                for c in 0..3 {
                    group[k][c][e % LANES] = turned[c];
                }
            }
        }
        out
    }

    /// Number of prisms that are turned inside out, of those that hold flesh: slivers at rest have no inside.
    pub(crate) fn inverted(&self, x: &[V3]) -> usize {
        let size = self.volume.iter().map(|v| v.abs()).sum::<f64>();
        let sliver = SLIVER_SHARE * size / self.volume.len().max(1) as f64;
        self.nodes
            .iter()
            .zip(&self.volume)
            .filter(|(_, rest)| rest.abs() > sliver)
            .filter(|(nodes, rest)| Volume::of(&nodes.map(|i| x[i as usize])).value * **rest < 0.0)
            .count()
    }
}

fn center(x: &[V3; 6]) -> V3 {
    scale(x.iter().fold(ZERO, |s, p| add(s, *p)), 1.0 / 6.0)
}

/// The approximate volume of a prism, `N . h`.
pub(crate) struct Volume {
    pub(crate) value: f64,
    /// Area vector `N` of the middle triangle, mm^2.
    pub(crate) area: V3,
    height: V3,
    middle: [V3; 3],
}

impl Volume {
    #[inline]
    pub(crate) fn of(x: &[V3; 6]) -> Self {
        let middle = [0, 1, 2].map(|k| scale(add(x[k], x[k + 3]), 0.5));
        let area = scale(
            cross(sub(middle[1], middle[0]), sub(middle[2], middle[0])),
            0.5,
        );
        let up = [0, 1, 2].map(|k| sub(x[k], x[k + 3]));
        let height = scale(add(add(up[0], up[1]), up[2]), 1.0 / 3.0);
        Self {
            value: dot(area, height),
            area,
            height,
            middle,
        }
    }

    /// Second derivative by the 15 pairs of different nodes `(a, b)`, `b < a`: cross product matrices `[w]_x`, rows a.
    #[inline]
    pub(crate) fn bending(&self) -> [V3; 15] {
        let side = |k: usize| sub(self.middle[(k + 1) % 3], self.middle[(k + 2) % 3]);
        let e = [side(0), side(1), side(2)];
        let mut out = [ZERO; 15];
        let mut q = 0;
        for a in 1..6usize {
            for b in 0..a {
                let (ka, kb) = (a % 3, b % 3);
                let (sa, sb) = (
                    if a < 3 { 1.0 } else { -1.0 },
                    if b < 3 { 1.0 } else { -1.0 },
                );
                let c = if kb == (ka + 1) % 3 {
                    -0.125
                } else if ka == (kb + 1) % 3 {
                    0.125
                } else {
                    0.0
                };
                out[q] = add(
                    scale(self.height, c),
                    scale(sub(scale(e[ka], sb), scale(e[kb], sa)), 1.0 / 12.0),
                );
                q += 1;
            }
        }
        out
    }

    /// Gradient by the six nodes.
    #[inline]
    pub(crate) fn gradient(&self) -> [V3; 6] {
        let third = scale(self.area, 1.0 / 3.0);
        let side = |k: usize| {
            let along = sub(self.middle[(k + 1) % 3], self.middle[(k + 2) % 3]);
            scale(cross(along, self.height), 0.25)
        };
        let s = [side(0), side(1), side(2)];
        [
            add(s[0], third),
            add(s[1], third),
            add(s[2], third),
            sub(s[0], third),
            sub(s[1], third),
            sub(s[2], third),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Prisms;
    use crate::simd::dispatch;
    use crate::vector::IDENTITY;

    fn energy(elements: &Elements, x: &[V3], r: M3, gradient: &mut [V3]) -> f64 {
        let offsets = elements.turned(|_| r);
        gradient.fill(ZERO);
        dispatch(Prisms {
            groups: &elements.groups,
            offsets: &offsets,
            x,
            gradient,
        })
    }

    fn prism() -> (Elements, Vec<V3>) {
        let rest = vec![
            [0.0, 0.0, 5.0],
            [4.0, 0.5, 5.2],
            [0.3, 3.0, 4.9],
            [0.0, 0.0, 0.0],
            [4.0, 0.4, 0.0],
            [0.2, 3.0, 0.1],
        ];
        (
            Elements::new(&[[0, 1, 2]], &PaperParams::default(), &rest),
            rest,
        )
    }

    #[test]
    fn a_straight_prism_has_area_times_height() {
        let x = [
            [0.0, 0.0, 5.0],
            [4.0, 0.0, 5.0],
            [0.0, 3.0, 5.0],
            [0.0; 3],
            [4.0, 0.0, 0.0],
            [0.0, 3.0, 0.0],
        ];
        assert!((Volume::of(&x).value - 30.0).abs() < 1e-12);
    }

    #[test]
    fn the_gradient_is_that_of_the_energy_and_has_no_net_force_or_torque() {
        let (elements, rest) = prism();
        let mut x = rest;
        for (k, p) in x.iter_mut().enumerate() {
            let t = k as f64;
            *p = add(*p, [0.3 * libm::sin(t), 0.2 * libm::cos(3.0 * t), 0.1 * t]);
        }
        let mut gradient = vec![ZERO; 6];
        energy(&elements, &x, IDENTITY, &mut gradient);
        for i in 0..6 {
            for k in 0..3 {
                let at = |d: f64| {
                    let mut y = x.clone();
                    y[i][k] += d;
                    energy(&elements, &y, IDENTITY, &mut [ZERO; 6])
                };
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((slope - gradient[i][k]).abs() < 1e-6 * (1.0 + slope.abs()));
            }
        }
        let v = Volume::of(&[x[0], x[1], x[2], x[3], x[4], x[5]]).gradient();
        let force = v.iter().fold(ZERO, |s, g| add(s, *g));
        let torque = (0..6).fold(ZERO, |s, i| add(s, cross(x[i], v[i])));
        assert!(norm(force) < 1e-12 && norm(torque) < 1e-11);
    }

    #[test]
    fn volume_at_rest_equals_eq_13() {
        // A small change of height: eq. 13 pushes each skin node by k_v dV along the normal.
        let x = [
            [0.0, 0.0, 5.0],
            [4.0, 0.0, 5.0],
            [0.0, 3.0, 5.0],
            [0.0; 3],
            [4.0, 0.0, 0.0],
            [0.0, 3.0, 0.0],
        ];
        let params = PaperParams::default();
        let elements = Elements::new(&[[0, 1, 2]], &params, &x);
        let mut y = x;
        for p in &mut y[..3] {
            p[2] += 1e-6;
        }
        let v = Volume::of(&y);
        let stretch = v.value - elements.volume[0];
        let force = scale(v.gradient()[0], elements.kappa[0] * stretch);
        assert!((force[2] - params.volume_stiffness * stretch).abs() < 1e-9);
    }

    #[test]
    fn a_turned_prism_is_at_rest_when_its_offsets_turn_too() {
        let (elements, rest) = prism();
        let r = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let x: Vec<V3> = rest.iter().map(|p| rotate(&r, *p)).collect();
        let mut gradient = vec![ZERO; 6];
        let energy = energy(&elements, &x, r, &mut gradient);
        assert!(energy < 1e-24);
        assert_eq!(elements.inverted(&x), 0);
        let flat: Vec<V3> = rest.iter().map(|p| [p[0], p[1], -p[2]]).collect();
        assert_eq!(elements.inverted(&flat), 1);
    }
}
