//! A model in a pose: springs changed by muscles, skull and jaw in place, everything the solvers' energy needs.
//!
//! The total energy is that of springs, zero-length attachments, shape, volume and the lips' overlap; skull and eyeballs
//! bound it, see `contact`.
//! Its gradient is the left side of eq. 11 at rest: the residual of the equilibrium.

use crate::SimError;
use crate::contact::PosedContacts;
use crate::kernels::{EdgeSprings, Prisms};
use crate::kinematics::Rigid;
use crate::lids::LidPose;
use crate::model::FaceModel;
use crate::muscle::{LidDrive, Side};
use crate::pose::Pose;
use crate::simd::{LANES, Lanes, dispatch};
use crate::springs::{FASCIA, MIN_LENGTH_MM};
use crate::vector::{V3, add_scaled, dot, norm, rotate, sub};

/// A posed model.
#[derive(Debug)]
pub(crate) struct Load<'a> {
    pub(crate) model: &'a FaceModel,
    /// Springs along edges, see [`crate::springs::Springs`].
    pub(crate) stiffness: Vec<Lanes>,
    pub(crate) rest_length: Vec<Lanes>,
    /// Rest offsets of the prisms, turned.
    pub(crate) offsets: Vec<[[Lanes; 3]; 6]>,
    /// Attachment springs of each node's fascia: stiffness and place on the skull.
    pub(crate) attachment: Vec<f64>,
    pub(crate) anchors: Vec<V3>,
    /// All nodes moved along with skull, jaw and lids; where nodes that the solver does not move stay.
    pub(crate) carried: Vec<V3>,
    /// Rigid motion of every cage vertex.
    pub(crate) motion: Vec<Rigid>,
    pub(crate) contacts: PosedContacts<'a>,
}

impl<'a> Load<'a> {
    /// Applies a pose that has been checked.
    pub(crate) fn new(model: &'a FaceModel, pose: &Pose) -> Result<Self, SimError> {
        pose.check(&model.template.muscles)?;
        let template = &model.template;
        let n = template.node_count();
        let motion_of = model.hinges.motion(pose.jaw, lid_poses(model, pose));
        let motion: Vec<Rigid> = (0..model.cage.len() as u32)
            .map(|v| motion_of.of(v))
            .collect();
        let of_node = |i: usize| &motion[template.cage_of_node[i % n] as usize];
        let carried: Vec<V3> = (0..2 * n)
            .map(|i| of_node(i).apply(model.rest[i]))
            .collect();
        let contacts = PosedContacts {
            unit_stiffness: model.params.fascia_stiffness,
            contacts: &model.contacts,
            field: &model.field,
            frames: model
                .contacts
                .skull
                .iter()
                .map(|s| motion[s.cage as usize])
                .collect(),
            eyes: model.hinges.eyes,
            directions: model
                .contacts
                .lips
                .iter()
                .map(|l| rotate(&motion_of.element_rotation(l.cage), [0.0, 1.0, 0.0]))
                .collect(),
        };
        let offsets = model.elements.turned(|e| {
            let corners = template.triangles[e].map(|i| template.cage_of_node[i as usize]);
            motion_of.element_rotation(corners)
        });
        let mut load = Self {
            stiffness: model.springs.stiffness.clone(),
            rest_length: model.springs.rest_length.clone(),
            attachment: model.attachment.clone(),
            anchors: carried[n..].to_vec(),
            model,
            offsets,
            carried,
            motion,
            contacts,
        };
        load.contract(pose);
        Ok(load)
    }

    /// Changes the springs of contracted muscles: rest length `sum(c l) / sum(c)`, stiffness times `S(c)` once, with the
    /// strongest contraction; attachments on the first segment of linear muscles likewise.
    fn contract(&mut self, pose: &Pose) {
        let model = self.model;
        let template = &model.template;
        let params = &model.params;
        let edges = template.edges.len();
        let n = template.node_count();
        let mut lengths = vec![[0.0f64; 3]; edges];
        let mut hold = vec![[0.0f64; 2]; n];
        for (actuator, bound) in template.actuators.iter().zip(&model.bound) {
            let muscle = &template.muscles.muscles()[actuator.muscle];
            // A muscle that does not pull leaves no trace.
            let Some(sides) = pose.contractions.get(&muscle.name) else {
                continue;
            };
            let c = sides.of(actuator.side.unwrap_or(Side::Left));
            let places = bound.contracted(c);
            for &[edge, a, b] in &bound.edges {
                let length = norm(sub(places[a as usize], places[b as usize]));
                let sums = &mut lengths[edge as usize];
                *sums = [sums[0] + c * length, sums[1] + c, sums[2].max(c)];
            }
            for &node in &bound.anchors {
                let [firmest, share] = &mut hold[node as usize];
                (*firmest, *share) = (firmest.max(c * muscle.origin_hold), share.max(c));
            }
        }
        for (edge, [weighted, total, strongest]) in lengths.into_iter().enumerate() {
            if total > 0.0 {
                self.rest_length[edge][FASCIA] = weighted / total;
                self.stiffness[edge][FASCIA] *= params.gain(strongest);
            }
        }
        for (node, [firmest, c]) in hold.into_iter().enumerate() {
            if c > 0.0 {
                // Fascia that is not attached at rest is attached here, the more the stronger the muscle pulls.
                let at_rest = self.attachment[node];
                let full = params.fascia_skull_stiffness * params.muscle_gain * (firmest / c);
                self.attachment[node] = at_rest + c * (full - at_rest).max(0.0);
            }
        }
    }

    /// The energy without contact with skull and eyeballs; `gradient` (one entry per node) receives its gradient.
    pub(crate) fn energy(&self, x: &[V3], gradient: &mut [V3]) -> f64 {
        gradient.fill([0.0; 3]);
        let edges = dispatch(EdgeSprings {
            edges: &self.model.template.edges,
            stiffness: &self.stiffness,
            rest_length: &self.rest_length,
            brace: &self.model.springs.brace,
            x,
            gradient,
        });
        let prisms = dispatch(Prisms {
            groups: &self.model.elements.groups,
            offsets: &self.offsets,
            x,
            gradient,
        });
        let lips = self.contacts.lip_energy(x, gradient);
        edges + prisms + self.column_energy(x, gradient) + lips
    }

    /// Springs between the skin and the fascia below it, and between fascia and skull.
    fn column_energy(&self, x: &[V3], gradient: &mut [V3]) -> f64 {
        let n = self.attachment.len();
        let springs = &self.model.springs;
        let mut energy = 0.0;
        for i in 0..n {
            let d = sub(x[i], x[n + i]);
            let length = norm(d);
            let ([spring, ..], [pull, ..]) = springs.vertical(i).energy(&[length; LANES]);
            let pull = pull / length.max(MIN_LENGTH_MM);
            let hold = sub(x[n + i], self.anchors[i]);
            let k = self.attachment[i];
            energy += spring + k * dot(hold, hold);
            gradient[i] = add_scaled(gradient[i], d, pull);
            let below = add_scaled(gradient[n + i], d, -pull);
            gradient[n + i] = add_scaled(below, hold, k);
        }
        0.5 * energy
    }
}

fn lid_poses(model: &FaceModel, pose: &Pose) -> [LidPose; 2] {
    let muscles = &model.template.muscles;
    Side::BOTH.map(|side| LidPose {
        close: pose.lid_pull(muscles, LidDrive::Close, side),
        open: pose.lid_pull(muscles, LidDrive::Open, side),
        pitch: pose.gaze.pitch_rad,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::noise;
    use crate::{FaceRig, MuscleSet};
    use facile_core::ReferenceHead;

    #[test]
    fn the_gradient_of_the_whole_system_is_that_of_its_energy() {
        let reference = ReferenceHead::embedded();
        let muscles = MuscleSet::embedded();
        let rig = FaceRig::new(reference, muscles).expect("built in");
        let model = rig
            .model(reference, &crate::mean_subject(reference))
            .expect("the mean head");
        let mut pose = Pose::default();
        for (key, c) in [
            ("zygomatic_major", 0.8),
            ("orbicularis_oris", 0.7),
            ("frontalis", 0.4),
        ] {
            pose.set(muscles, key, c).expect("known");
        }
        pose.jaw.open_rad = 0.05;
        let load = Load::new(&model, &pose).expect("valid");
        // Noise of a millimetre and a half; the upper lip is pressed through the lower one and some prisms are turned inside out.
        let mut x = load.carried.clone();
        for (i, p) in x.iter_mut().enumerate() {
            *p = [0, 1, 2].map(|k| p[k] + 1.5 * noise(3 * i + k));
        }
        for lip in &model.contacts.lips {
            x[lip.node as usize][1] -= 9.0;
        }
        assert!(model.elements.inverted(&x) > 0 && load.contacts.lip_overlap(&x) > 1.0);
        let mut gradient = vec![[0.0; 3]; x.len()];
        load.energy(&x, &mut gradient);
        let mut scratch = gradient.clone();
        let step = 1e-5;
        for trial in 0..8 {
            // All nodes along a random direction, then fewer and fewer of them.
            let every = 1 << trial;
            let direction: Vec<V3> = (0..x.len())
                .map(|i| {
                    let on = f64::from(u8::from(i % every == 0));
                    [0, 1, 2].map(|k| on * noise(7 * i + 31 * k + trial + 5))
                })
                .collect();
            let slope: f64 = gradient
                .iter()
                .zip(&direction)
                .map(|(g, d)| dot(*g, *d))
                .sum();
            let mut at = |t: f64| {
                let y: Vec<V3> = x
                    .iter()
                    .zip(&direction)
                    .map(|(p, d)| add_scaled(*p, *d, t))
                    .collect();
                load.energy(&y, &mut scratch)
            };
            // Fourth order in the step.
            let measured =
                (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step))) / (12.0 * step);
            let size: f64 = gradient
                .iter()
                .zip(&direction)
                .map(|(g, d)| dot(*g, *d).abs())
                .sum();
            assert!(
                (slope - measured).abs() < 1e-8 * size,
                "every {every}: {slope} {measured}"
            );
        }
    }

    #[test]
    fn idle_muscles_leave_no_trace() {
        let reference = ReferenceHead::embedded();
        let muscles = MuscleSet::embedded();
        let rig = FaceRig::new(reference, muscles).expect("built in");
        let subject = crate::mean_subject(reference);
        let model = rig.model(reference, &subject).expect("the mean head");
        let mut pose = Pose::default();
        pose.set(muscles, "zygomatic_major.left", 0.8)
            .expect("known");
        let named = pose.naming_all(muscles);
        assert_eq!(named.contractions.len(), muscles.muscles().len());
        let [a, b] = [&pose, &named].map(|p| Load::new(&model, p).expect("valid"));
        assert_eq!(a.stiffness, b.stiffness);
        assert_eq!(a.rest_length, b.rest_length);
        assert_eq!(a.attachment, b.attachment);
        assert_ne!(a.stiffness, model.springs.stiffness, "one muscle pulls");
    }

    #[test]
    fn without_volume_the_energy_is_convex() {
        let reference = ReferenceHead::embedded();
        let muscles = MuscleSet::embedded();
        let rig = FaceRig::new(reference, muscles).expect("built in");
        let params = crate::PaperParams {
            volume_stiffness: 0.0,
            ..crate::PaperParams::default()
        };
        let model = rig
            .model_with(reference, &crate::mean_subject(reference), params)
            .expect("the mean head");
        let mut pose = Pose::default();
        for muscle in muscles.muscles() {
            pose.set(muscles, &muscle.name, 0.7).expect("known");
        }
        pose.jaw.open_rad = 0.2;
        let load = Load::new(&model, &pose).expect("valid");
        let mut scratch = vec![[0.0; 3]; load.carried.len()];
        // Crumpled more and more, from nearly at rest to nodes in any order: most springs are compressed somewhere.
        for trial in 0..24usize {
            let size = 0.02 * f64::powi(1.4, trial as i32);
            let crumpled = |seed: usize| -> Vec<V3> {
                let moved = load.carried.iter().enumerate();
                moved
                    .map(|(i, p)| [0, 1, 2].map(|k| p[k] + size * noise(3 * i + k + seed)))
                    .collect()
            };
            let (x, y) = (crumpled(17 * trial), crumpled(17 * trial + 101));
            let mut at = |t: f64| {
                let between = x.iter().zip(&y);
                let z: Vec<V3> = between
                    .map(|(p, q)| [0, 1, 2].map(|k| (1.0 - t) * p[k] + t * q[k]))
                    .collect();
                load.energy(&z, &mut scratch)
            };
            let along: Vec<f64> = (0..=16).map(|k| at(f64::from(k) / 16.0)).collect();
            for three in along.windows(3) {
                let bend = three[0] + three[2] - 2.0 * three[1];
                assert!(bend >= -1e-12 * three[1], "size {size}: {bend}");
            }
        }
        // Two neighbours alone, from either side of each other: where an unbraced spring stands in the way.
        let n = model.template.node_count();
        for (e, &[a, b]) in model.template.edges.iter().enumerate().take(400) {
            let (i, j) = (n + a as usize, n + b as usize);
            let mut x = load.carried.clone();
            let (p, q) = (x[i], x[j]);
            let mut at = |t: f64| {
                (x[i], x[j]) = (add_scaled(p, sub(q, p), t), add_scaled(q, sub(p, q), t));
                load.energy(&x, &mut scratch)
            };
            let [low, middle, high] = [0.45, 0.5, 0.55].map(&mut at);
            assert!(low + high - 2.0 * middle >= -1e-9 * middle, "edge {e}");
        }
    }
}
