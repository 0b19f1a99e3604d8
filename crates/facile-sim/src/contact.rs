//! One-sided contact with the skull and the eyeballs, and of the lips with each other.
//!
//! Section 4.3.2 puts nodes back that fall below the skull and drops the inward part of forces near it. That never
//! settles; its equilibrium is the one of frictionless constraints `gap >= 0`, which is what both solvers here look for:
//! the quasi-static one slides resting nodes along the surface, Verlet and FIRE put nodes back. Gaps are measured in mm from each node's own
//! place at rest, so that a face at rest is free of contact force. Lips are flesh on flesh: they press on each other with
//! an energy of their overlap.

use crate::depth;
use crate::kinematics::Rigid;
use crate::skull::HeightField;
use crate::vector::{
    M3, V3, ZERO, add_scaled, dot, norm, rotate, rotate_back, scale, sub, transpose, unit,
};

/// Nodes nearer than this to skull or eyeball touch it, mm.
const TOUCH_MM: f64 = 1e-6;
/// Nodes are put back onto a surface to this accuracy, mm.
const EXACT_MM: f64 = 1e-10;

/// A node against the skull field.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SkullContact {
    pub(crate) node: u32,
    /// Cage vertex whose motion the piece of skull below follows.
    pub(crate) cage: u32,
    /// Distance from the field at rest, along the radius, mm.
    pub(crate) offset: f64,
    /// One over the gradient's length at rest: turns radial distance into distance from the surface.
    pub(crate) cosine: f64,
}

/// A node against an eyeball.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EyeContact {
    pub(crate) node: u32,
    pub(crate) eye: u32,
    /// Distance from the eyeball's centre that the node keeps, mm.
    pub(crate) distance: f64,
}

/// A node of the upper lip's rim against a point between two nodes of the lower one's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LipContact {
    pub(crate) node: u32,
    pub(crate) below: [u32; 2],
    pub(crate) weights: [f64; 2],
    /// Gap at rest where the lips are closed further than they touch, mm, at most 0.
    pub(crate) offset: f64,
    /// Cage vertices of the three nodes, whose mean rotation turns the direction of contact, which is up at rest.
    pub(crate) cage: [u32; 3],
    /// Slots in the solver's matrix of the pairs of the node with both below, and of these two.
    pub(crate) slots: [u32; 3],
}

/// Stiffness of flesh on flesh, for a pair of lip nodes, in that of relaxed fascia.
const LIP_STIFFNESS: f64 = 7.0;

/// All contacts of a model.
#[derive(Clone, Debug, Default)]
pub(crate) struct Contacts {
    pub(crate) skull: Vec<SkullContact>,
    pub(crate) eyes: Vec<EyeContact>,
    pub(crate) lips: Vec<LipContact>,
}

/// Where each contact's gap was measured last, and what it was there.
#[derive(Debug, Default)]
pub(crate) struct Measured(Vec<(V3, Gap)>);

/// A gap changes by at most this much per mm of motion.
const STEEPEST: f64 = 4.0;

impl Measured {
    /// Whether the node of contact `c`, at `x`, has not come near enough since to touch.
    #[inline]
    fn clears(&self, c: usize, x: V3) -> bool {
        self.least(c, x) > TOUCH_MM
    }

    /// The least that the gap of contact `c` is at `x`, mm.
    #[inline]
    fn least(&self, c: usize, x: V3) -> f64 {
        let (at, gap) = &self.0[c];
        gap.value - STEEPEST * norm(sub(x, *at))
    }
}

/// The larger of two depths; one that is not a number wins.
fn worse(a: f64, b: f64) -> f64 {
    if b.is_nan() { b } else { a.max(b) }
}

/// Contacts in a pose.
#[derive(Debug)]
pub(crate) struct PosedContacts<'a> {
    /// Stiffness of a relaxed spring of the fascia.
    pub(crate) unit_stiffness: f64,
    pub(crate) contacts: &'a Contacts,
    pub(crate) field: &'a HeightField,
    /// Motion of the piece of skull below each skull contact.
    pub(crate) frames: Vec<Rigid>,
    pub(crate) eyes: [V3; 2],
    /// Turned direction of each lip contact.
    pub(crate) directions: Vec<V3>,
}

/// A gap and its gradient by the nodes it depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gap {
    /// Distance, mm; negative is penetration.
    pub(crate) value: f64,
    /// Gradient by the contact's node.
    pub(crate) gradient: V3,
}

/// Before a gap was measured: nothing is clear of it, and no node is there.
const UNKNOWN: (V3, Gap) = (
    [f64::INFINITY; 3],
    Gap {
        value: 0.0,
        gradient: ZERO,
    },
);

impl PosedContacts<'_> {
    /// Number of contacts with skull and eyeballs.
    pub(crate) fn len(&self) -> usize {
        self.contacts.skull.len() + self.contacts.eyes.len()
    }

    /// The gap of contact `c`.
    #[inline]
    pub(crate) fn gap(&self, c: usize, x: &[V3]) -> Gap {
        let skull = self.contacts.skull.len();
        if c < skull {
            let s = &self.contacts.skull[c];
            let frame = &self.frames[c];
            let local = rotate_back(&frame.rotation, sub(x[s.node as usize], frame.translation));
            let (gap, gradient) = self.field.gap(local);
            Gap {
                value: (gap - s.offset) * s.cosine,
                gradient: scale(rotate(&frame.rotation, gradient), s.cosine),
            }
        } else {
            let s = &self.contacts.eyes[c - skull];
            let away = sub(x[s.node as usize], self.eyes[s.eye as usize]);
            let distance = norm(away).max(1e-9);
            Gap {
                value: distance - s.distance,
                gradient: scale(away, 1.0 / distance),
            }
        }
    }

    /// Overlap of a lip contact, mm, negative where the lips are apart.
    fn overlap(&self, c: usize, x: &[V3]) -> f64 {
        let s = &self.contacts.lips[c];
        let [a, b] = s.below.map(|i| x[i as usize]);
        let below = add_scaled(scale(a, s.weights[0]), b, s.weights[1]);
        s.offset - dot(sub(x[s.node as usize], below), self.directions[c])
    }

    /// Energy of the lips' overlap; adds its gradient.
    pub(crate) fn lip_energy(&self, x: &[V3], gradient: &mut [V3]) -> f64 {
        let stiffness = LIP_STIFFNESS * self.unit_stiffness;
        let mut energy = 0.0;
        for (c, s) in self.contacts.lips.iter().enumerate() {
            let overlap = self.overlap(c, x);
            if overlap > 0.0 {
                energy += stiffness * overlap * overlap;
                let push = scale(self.directions[c], stiffness * overlap);
                let i = s.node as usize;
                gradient[i] = sub(gradient[i], push);
                for (&i, w) in s.below.iter().zip(s.weights) {
                    gradient[i as usize] = add_scaled(gradient[i as usize], push, w);
                }
            }
        }
        0.5 * energy
    }

    /// Calls `f(contact, normal, stiffness)` for lips that press.
    pub(crate) fn lip_stiffness(&self, x: &[V3], mut f: impl FnMut(&LipContact, V3, f64)) {
        let stiffness = LIP_STIFFNESS * self.unit_stiffness;
        for (c, s) in self.contacts.lips.iter().enumerate() {
            if self.overlap(c, x) > 0.0 {
                f(s, self.directions[c], stiffness);
            }
        }
    }

    /// Largest overlap of the lips, mm.
    pub(crate) fn lip_overlap(&self, x: &[V3]) -> f64 {
        (0..self.contacts.lips.len())
            .map(|c| self.overlap(c, x))
            .fold(0.0, f64::max)
    }

    /// Largest penetration, mm: exact distances from the surfaces.
    pub(crate) fn penetration(&self, x: &[V3]) -> f64 {
        let skull = self.contacts.skull.iter().zip(&self.frames);
        let skull = skull.map(|(s, frame)| {
            let local = rotate_back(&frame.rotation, sub(x[s.node as usize], frame.translation));
            depth::below_field(self.field, s.offset, local)
        });
        let eyes = self.contacts.eyes.iter().map(|s| {
            let away = sub(x[s.node as usize], self.eyes[s.eye as usize]);
            depth::inside_ball(s.distance, away)
        });
        skull.chain(eyes).fold(0.0, worse)
    }

    /// The node of a contact with skull or eyeball.
    #[inline]
    pub(crate) fn node(&self, c: usize) -> usize {
        let skull = self.contacts.skull.len();
        if c < skull {
            self.contacts.skull[c].node as usize
        } else {
            self.contacts.eyes[c - skull].node as usize
        }
    }

    /// The gap of contact `c`, which was measured at `x` or is now.
    #[inline]
    fn gap_from(&self, c: usize, x: &[V3], measured: &Measured) -> Gap {
        let (at, gap) = &measured.0[c];
        if *at == x[self.node(c)] {
            *gap
        } else {
            self.gap(c, x)
        }
    }

    /// Finds the nodes that rest on skull or eyeball: those that touch and that the `gradient` pushes in. Writes their
    /// normals, zero for the others.
    pub(crate) fn resting(
        &self,
        x: &[V3],
        gradient: &[V3],
        measured: &Measured,
        normals: &mut [V3],
    ) {
        normals.fill(ZERO);
        for c in 0..self.len() {
            let node = self.node(c);
            if measured.clears(c, x[node]) {
                continue;
            }
            let gap = self.gap_from(c, x, measured);
            if gap.value <= TOUCH_MM && dot(gradient[node], gap.gradient) > 0.0 {
                normals[node] = unit(gap.gradient);
            }
        }
    }

    /// Takes the part along the normals at `x` out of `gradient`, for nodes that rest by `normals`.
    pub(crate) fn reduce(
        &self,
        x: &[V3],
        normals: &[V3],
        measured: &Measured,
        gradient: &mut [V3],
    ) {
        for c in 0..self.len() {
            let node = self.node(c);
            if normals[node] != ZERO {
                let n = unit(self.gap_from(c, x, measured).gradient);
                gradient[node] = add_scaled(gradient[node], n, -dot(gradient[node], n));
            }
        }
    }

    /// Calls `f(node, second derivatives)` for nodes that rest by `normals`. A node that keeps to a curved surface feels
    /// its curvature times the force on it; only the part along the surface.
    pub(crate) fn curvature(
        &self,
        x: &[V3],
        gradient: &[V3],
        normals: &[V3],
        mut f: impl FnMut(usize, M3),
    ) {
        for c in 0..self.len() {
            let node = self.node(c);
            let n = normals[node];
            if n == ZERO {
                continue;
            }
            let gap = self.gap(c, x).gradient;
            let push = dot(gradient[node], gap) / dot(gap, gap);
            let bend = self.bend(c, x).map(|row| scale(row, -push));
            let cut = |m: M3| m.map(|row| add_scaled(row, n, -dot(row, n)));
            f(node, transpose(&cut(transpose(&cut(bend)))));
        }
    }

    /// Second derivatives of the gap of contact `c`, 1/mm.
    fn bend(&self, c: usize, x: &[V3]) -> M3 {
        if let Some(s) = self.contacts.skull.get(c) {
            let frame = &self.frames[c];
            let local = rotate_back(&frame.rotation, sub(x[s.node as usize], frame.translation));
            let turn = |m: M3| m.map(|row| rotate(&frame.rotation, row));
            let bend = turn(transpose(&turn(self.field.curvature(local))));
            bend.map(|row| scale(row, s.cosine))
        } else {
            let s = &self.contacts.eyes[c - self.contacts.skull.len()];
            let away = sub(x[s.node as usize], self.eyes[s.eye as usize]);
            let distance = norm(away).max(1e-9);
            let n = scale(away, 1.0 / distance);
            [0, 1, 2].map(|k| {
                let mut row = scale(n, -n[k] / distance);
                row[k] += 1.0 / distance;
                row
            })
        }
    }

    /// Adds the nodes that would come to rest if each moved alone: those that are pushed in by more than their own
    /// `stiffness` takes up over the gap. Writes their normals.
    pub(crate) fn landing(
        &self,
        x: &[V3],
        gradient: &[V3],
        stiffness: &[f64],
        measured: &Measured,
        normals: &mut [V3],
    ) {
        for c in 0..self.len() {
            let node = self.node(c);
            if normals[node] != ZERO || stiffness[node] <= 0.0 {
                continue;
            }
            let most = STEEPEST * norm(gradient[node]);
            if measured.least(c, x[node]) * stiffness[node] > most {
                continue;
            }
            let gap = self.gap_from(c, x, measured);
            let push = dot(gradient[node], gap.gradient);
            if push > 0.0 && gap.value * stiffness[node] < push {
                normals[node] = unit(gap.gradient);
            }
        }
    }

    /// Puts nodes onto skull and eyeballs: those that rest there already, and those that are below. Measures the gaps
    /// of all that may touch.
    pub(crate) fn settle(&self, x: &mut [V3], normals: &[V3], measured: &mut Measured) {
        measured.0.resize(self.len(), UNKNOWN);
        for c in 0..self.len() {
            let node = self.node(c);
            let rests = normals[node] != ZERO;
            if !rests && measured.clears(c, x[node]) {
                continue;
            }
            for _ in 0..5 {
                let gap = self.gap(c, x);
                measured.0[c] = (x[node], gap);
                if gap.value > 0.0 && !rests || gap.value.abs() < EXACT_MM {
                    break;
                }
                let back = -gap.value / dot(gap.gradient, gap.gradient);
                x[node] = add_scaled(x[node], gap.gradient, back);
            }
        }
    }

    /// Puts nodes back onto the surfaces they fell through and takes away their inward velocity.
    pub(crate) fn project(&self, x: &mut [V3], velocity: &mut [V3]) {
        for c in 0..self.len() {
            let gap = self.gap(c, x);
            if gap.value > 0.0 {
                continue;
            }
            let node = self.node(c);
            let square = dot(gap.gradient, gap.gradient);
            let inward = dot(velocity[node], gap.gradient).min(0.0);
            x[node] = add_scaled(x[node], gap.gradient, -gap.value / square);
            velocity[node] = add_scaled(velocity[node], gap.gradient, -inward / square);
        }
    }

    /// Takes the part of `gradient` that contact forces balance out of it, in place: for nodes within `touch` mm of a
    /// surface, the part that pushes them inward.
    pub(crate) fn balance(&self, x: &[V3], touch: f64, gradient: &mut [V3]) {
        for c in 0..self.len() {
            let gap = self.gap(c, x);
            if gap.value > touch {
                continue;
            }
            let node = self.node(c);
            let push = dot(gradient[node], gap.gradient);
            if push > 0.0 {
                let square = dot(gap.gradient, gap.gradient);
                gradient[node] = add_scaled(gradient[node], gap.gradient, -push / square);
            }
        }
    }
}
