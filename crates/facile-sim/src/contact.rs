//! One-sided contact with the skull, the eyeballs, and of the lips with each other.
//!
//! Section 4.3.2 puts nodes back that fall below the skull and drops the inward part of forces near it. That never
//! settles; its equilibrium is the one of frictionless constraints `gap >= 0`, which is what both solvers here look for:
//! the quasi-static one slides resting nodes along the surface, Verlet and FIRE put nodes back. Gaps are measured in mm from each node's own
//! place at rest, so that a face at rest is free of contact force.

use crate::kinematics::Rigid;
use crate::skull::HeightField;
use crate::vector::{V3, add_scaled, dot, norm, rotate, rotate_back, scale, sub, unit};

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

/// A node of the upper lip against a triangle of the lower one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LipContact {
    pub(crate) node: u32,
    pub(crate) corners: [u32; 3],
    pub(crate) weights: V3,
    /// Direction of contact at rest, from the lower to the upper lip.
    pub(crate) direction: V3,
    /// Gap at rest, mm, at most 0: lips may touch a little at rest.
    pub(crate) offset: f64,
    /// Cage vertices of both sides, whose mean rotation turns the direction.
    pub(crate) cage: [u32; 3],
}

/// All contacts of a model.
#[derive(Clone, Debug, Default)]
pub(crate) struct Contacts {
    pub(crate) skull: Vec<SkullContact>,
    pub(crate) eyes: Vec<EyeContact>,
    pub(crate) lips: Vec<LipContact>,
}

/// Contacts in a pose.
#[derive(Debug)]
pub(crate) struct PosedContacts<'a> {
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
    /// Gradient by the contact's node; the corners of a lip contact have minus their weight times it.
    pub(crate) gradient: V3,
}

impl PosedContacts<'_> {
    /// Number of contacts.
    pub(crate) fn len(&self) -> usize {
        self.contacts.skull.len() + self.contacts.eyes.len() + self.contacts.lips.len()
    }

    /// The gap of contact `c`.
    #[inline]
    pub(crate) fn gap(&self, c: usize, x: &[V3]) -> Gap {
        let (skull, eyes) = (self.contacts.skull.len(), self.contacts.eyes.len());
        if c < skull {
            let s = &self.contacts.skull[c];
            let frame = &self.frames[c];
            let local = rotate_back(&frame.rotation, sub(x[s.node as usize], frame.translation));
            let (gap, gradient) = self.field.gap(local);
            Gap {
                value: (gap - s.offset) * s.cosine,
                gradient: scale(rotate(&frame.rotation, gradient), s.cosine),
            }
        } else if c < skull + eyes {
            let s = &self.contacts.eyes[c - skull];
            let away = sub(x[s.node as usize], self.eyes[s.eye as usize]);
            let distance = norm(away).max(1e-9);
            Gap {
                value: distance - s.distance,
                gradient: scale(away, 1.0 / distance),
            }
        } else {
            let s = &self.contacts.lips[c - skull - eyes];
            let direction = self.directions[c - skull - eyes];
            let below = (0..3).fold([0.0; 3], |sum, k| {
                add_scaled(sum, x[s.corners[k] as usize], s.weights[k])
            });
            Gap {
                value: dot(sub(x[s.node as usize], below), direction) - s.offset,
                gradient: direction,
            }
        }
    }

    /// Calls `f(node, share)` for the nodes that move contact `c`: the node with share 1, corners with minus their weight.
    #[inline]
    pub(crate) fn nodes(&self, c: usize, mut f: impl FnMut(u32, f64)) {
        let (skull, eyes) = (self.contacts.skull.len(), self.contacts.eyes.len());
        if c < skull {
            f(self.contacts.skull[c].node, 1.0);
        } else if c < skull + eyes {
            f(self.contacts.eyes[c - skull].node, 1.0);
        } else {
            let s = &self.contacts.lips[c - skull - eyes];
            f(s.node, 1.0);
            for k in 0..3 {
                f(s.corners[k], -s.weights[k]);
            }
        }
    }

    /// Largest penetration, mm.
    pub(crate) fn penetration(&self, x: &[V3]) -> f64 {
        (0..self.len())
            .map(|c| -self.gap(c, x).value)
            .fold(0.0, f64::max)
    }

    /// Number of contacts of a single node with skull or eyeball: the first ones.
    pub(crate) fn single(&self) -> usize {
        self.contacts.skull.len() + self.contacts.eyes.len()
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

    /// Finds the nodes that rest on skull or eyeball: those that touch and that the `gradient` pushes in. Writes their
    /// normals, zero for the others, and returns how many there are.
    pub(crate) fn resting(&self, x: &[V3], gradient: &[V3], normals: &mut [V3]) -> usize {
        normals.fill([0.0; 3]);
        let mut count = 0;
        for c in 0..self.single() {
            let node = self.node(c);
            let gap = self.gap(c, x);
            if gap.value <= TOUCH_MM && dot(gradient[node], gap.gradient) > 0.0 {
                normals[node] = unit(gap.gradient);
                count += 1;
            }
        }
        count
    }

    /// Puts nodes onto skull and eyeballs: those that rest there already, and those that are below.
    pub(crate) fn settle(&self, x: &mut [V3], normals: &[V3]) {
        for c in 0..self.single() {
            let node = self.node(c);
            let rests = normals[node] != [0.0; 3];
            for _ in 0..4 {
                let gap = self.gap(c, x);
                if gap.value.abs() < EXACT_MM || (gap.value > 0.0 && !rests) {
                    break;
                }
                let back = -gap.value / dot(gap.gradient, gap.gradient);
                x[node] = add_scaled(x[node], gap.gradient, back);
            }
        }
    }

    /// Puts nodes back onto the surfaces they fell through and takes away their inward velocity. `free`: which nodes move.
    pub(crate) fn project(&self, x: &mut [V3], velocity: &mut [V3], free: &[bool]) {
        for c in 0..self.len() {
            let gap = self.gap(c, x);
            if gap.value > 0.0 {
                continue;
            }
            let (mut weight, mut speed) = (0.0, 0.0);
            let square = dot(gap.gradient, gap.gradient);
            self.nodes(c, |node, share| {
                if free[node as usize] {
                    weight += share * share * square;
                    speed += share * dot(velocity[node as usize], gap.gradient);
                }
            });
            if weight < 1e-12 {
                continue;
            }
            let (back, slow) = (-gap.value / weight, (-speed).max(0.0) / weight);
            self.nodes(c, |node, share| {
                let i = node as usize;
                if free[i] {
                    x[i] = add_scaled(x[i], gap.gradient, back * share);
                    velocity[i] = add_scaled(velocity[i], gap.gradient, slow * share);
                }
            });
        }
    }

    /// Takes the part of `gradient` that contact forces balance out of it, in place: for nodes within `touch` mm of a
    /// surface, the part that pushes them inward.
    pub(crate) fn balance(&self, x: &[V3], touch: f64, gradient: &mut [V3], free: &[bool]) {
        for c in 0..self.len() {
            let gap = self.gap(c, x);
            if gap.value > touch {
                continue;
            }
            let (mut weight, mut push) = (0.0, 0.0);
            let square = dot(gap.gradient, gap.gradient);
            self.nodes(c, |node, share| {
                if free[node as usize] {
                    weight += share * share * square;
                    push += share * dot(gradient[node as usize], gap.gradient);
                }
            });
            if push > 0.0 && weight > 1e-12 {
                self.nodes(c, |node, share| {
                    let i = node as usize;
                    if free[i] {
                        gradient[i] = add_scaled(gradient[i], gap.gradient, -push / weight * share);
                    }
                });
            }
        }
    }
}
