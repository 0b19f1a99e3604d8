//! The face of one subject: layers, springs, prisms, muscles, skull, jaw, lids, ready to be posed.
//!
//! The model lives in the subject's own skull frame (the rotation and translation of
//! [`Subject::skull_from_reference`]), so that a turned subject gives the turned solution. Read next `load`, which
//! applies a pose to a model, and [`crate::solver`].

use std::sync::Arc;

use facile_core::reference::Role;
use facile_core::{Isometry3, Point3, ReferenceHead, Subject};

use crate::SimError;
use crate::contact::{Contacts, EyeContact, LipContact, SkullContact};
use crate::elements::Elements;
use crate::follow::Follow;
use crate::kinematics::Hinges;
use crate::layers::{Layers, area_vector};
use crate::lids::lid_vertices;
use crate::mandible::Mandible;
use crate::muscle::{Bound, MuscleSet};
use crate::params::PaperParams;
use crate::skull::HeightField;
use crate::springs::Springs;
use crate::template::Template;
use crate::vector::{V3, from_point, norm, sub, unit};

/// Where the fascia's normal or the field's is closer than this (cosine) to perpendicular to the radius, nothing touches
/// the field.
const MIN_FACING: f64 = 0.25;
/// Skin per node of the paper's mesh, mm^2: under 4,000 nodes on a face of about 480 cm^2.
const PAPER_NODE_AREA_MM2: f64 = 12.0;
/// Skin nearer to an eyeball than this is kept outside of it, mm.
const EYE_REACH_MM: f64 = 6.0;
/// Skin stays this far off the sclera's sphere where the rest shape allows it, mm: the cornea bulges by about as much.
const EYE_CLEARANCE_MM: f64 = 0.5;

/// The face of a subject.
#[derive(Debug)]
pub struct FaceModel {
    pub(crate) template: Arc<Template>,
    pub(crate) follow: Arc<Follow>,
    pub(crate) params: PaperParams,
    /// Nodes at rest: the skin's, then the fascia's, mm, in the skull's frame.
    pub(crate) rest: Vec<V3>,
    pub(crate) springs: Springs,
    pub(crate) elements: Elements,
    /// Stiffness of the spring between each node's fascia and the skull, 0 where there is none.
    pub(crate) attachment: Vec<f64>,
    pub(crate) field: HeightField,
    pub(crate) contacts: Contacts,
    pub(crate) bound: Vec<Bound>,
    pub(crate) hinges: Hinges,
    /// Fine vertices at rest, mm, head frame.
    pub(crate) fine: Vec<Point3>,
    /// Cage vertices at rest, mm, in the skull's frame.
    pub(crate) cage: Vec<V3>,
    /// Head frame from the skull's frame.
    pub(crate) head_from_skull: Isometry3,
}

/// What subjects of one reference head share: the simulation mesh with its muscles, and the smooth followers.
#[derive(Clone, Debug)]
pub struct FaceRig {
    template: Arc<Template>,
    follow: Arc<Follow>,
}

impl FaceRig {
    /// Prepares `reference` with these muscles.
    ///
    /// # Errors
    /// [`SimError::Muscle`] for a muscle that misses the simulated skin.
    pub fn new(reference: &ReferenceHead, muscles: &MuscleSet) -> Result<Self, SimError> {
        Ok(Self {
            template: Arc::new(Template::new(reference, muscles)?),
            follow: Arc::new(Follow::new(reference)?),
        })
    }

    /// The simulation mesh.
    pub fn template(&self) -> &Template {
        &self.template
    }

    /// The face of a subject.
    ///
    /// # Errors
    /// [`SimError::SizeMismatch`] for a subject of another topology, [`SimError::Subject`] for coordinates that are not
    /// finite, [`SimError::Muscle`] where a muscle has no length on this subject.
    pub fn model(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
    ) -> Result<FaceModel, SimError> {
        self.model_with(reference, subject, PaperParams::default())
    }

    /// The face of a subject with other constants than those of Table 1: for maps of stability.
    ///
    /// # Errors
    /// Those of [`Self::model`].
    pub fn model_with(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
        params: PaperParams,
    ) -> Result<FaceModel, SimError> {
        let fine = &subject.positions;
        if fine.len() != reference.mesh.positions.len() {
            return Err(SimError::SizeMismatch {
                what: "fine vertices of a subject",
                expected: reference.mesh.positions.len(),
                got: fine.len(),
            });
        }
        let named = |e: SimError| match e {
            SimError::Subject { reason, .. } => SimError::Subject {
                subject: subject.id.clone(),
                reason,
            },
            other => other,
        };
        check_finite(subject)?;
        let template = &self.template;
        let head_from_skull = subject.skull_from_reference.isometry;
        let local: Vec<Point3> = fine
            .iter()
            .map(|p| head_from_skull.inverse_transform_point(p))
            .collect();
        let layers = template.layers(reference, &local).map_err(named)?;
        let cage: Vec<V3> = local[..reference.cage.positions.len()]
            .iter()
            .map(from_point)
            .collect();
        let mut rest = layers.skin.clone();
        rest.extend(&layers.fascia);
        let hinges = hinges(reference, subject, template, &cage)?;
        let field = template.skull.fit(&template.triangles, &layers);
        let field = field.map_err(|_| SimError::Subject {
            subject: subject.id.clone(),
            reason: "no skin faces outwards, so that there is no skull below".to_owned(),
        })?;
        let contacts = contacts(reference, template, &layers, &field, &hinges, subject);
        let bound = template
            .actuators
            .iter()
            .map(|a| a.on(&template.muscles.muscles()[a.muscle], &layers.fascia))
            .collect::<Result<_, _>>()?;
        Ok(FaceModel {
            springs: Springs::new(template, &params, &rest),
            elements: Elements::new(&template.triangles, &params, &rest),
            attachment: attachments(template, &params, &rest),
            template: Arc::clone(template),
            follow: Arc::clone(&self.follow),
            params,
            rest,
            field,
            contacts,
            bound,
            hinges,
            fine: fine.clone(),
            cage,
            head_from_skull,
        })
    }
}

impl FaceModel {
    /// The face of a subject. For many subjects of one reference head make one [`FaceRig`] and call
    /// [`FaceRig::model`].
    ///
    /// # Errors
    /// Those of [`FaceRig::new`] and [`FaceRig::model`].
    pub fn new(
        reference: &ReferenceHead,
        muscles: &MuscleSet,
        subject: &Subject,
    ) -> Result<Self, SimError> {
        FaceRig::new(reference, muscles)?.model(reference, subject)
    }

    /// The muscles of the model.
    pub fn muscles(&self) -> &MuscleSet {
        &self.template.muscles
    }

    /// Length at rest of each muscle's centre line on this subject, mm: name, left or the only one, right.
    pub fn muscle_lengths(&self) -> Vec<(&str, f64)> {
        let names = self.template.muscles.muscles();
        self.template
            .actuators
            .iter()
            .zip(&self.bound)
            .map(|(a, b)| (names[a.muscle].name.as_str(), b.length()))
            .collect()
    }
}

/// Refuses coordinates that are not numbers, and skulls and eyes without a size.
fn check_finite(subject: &Subject) -> Result<(), SimError> {
    let refuse = |reason: String| SimError::Subject {
        subject: subject.id.clone(),
        reason,
    };
    let finite = |p: &Point3| p.iter().all(|c| c.is_finite());
    if let Some(v) = subject.positions.iter().position(|p| !finite(p)) {
        return Err(refuse(format!(
            "the position of vertex {v} is not finite: {}",
            subject.positions[v]
        )));
    }
    for (eye, name) in subject.eyes.iter().zip(["left", "right"]) {
        if !(finite(&eye.center) && eye.radius > 0.0 && eye.radius.is_finite()) {
            return Err(refuse(format!(
                "the {name} eye has no place or size: centre {}, radius {} mm",
                eye.center, eye.radius
            )));
        }
    }
    let skull = &subject.skull_from_reference;
    let placed = skull.to_homogeneous().iter().all(|c| c.is_finite());
    if !placed || skull.scaling() <= 0.0 {
        return Err(refuse("the skull has no place or size".to_owned()));
    }
    Ok(())
}

fn hinges(
    reference: &ReferenceHead,
    subject: &Subject,
    template: &Template,
    cage: &[V3],
) -> Result<Hinges, SimError> {
    // In the skull's frame the subject's skull differs from the reference by its size alone.
    let size = subject.skull_from_reference.scaling();
    let scaled = |p: &Point3| Point3::from(p.coords * size);
    let mandible = Mandible::new(
        &scaled(&reference.jaw.hinge_left),
        &scaled(&reference.jaw.hinge_right),
        size,
    );
    let mandible = mandible.ok_or_else(|| SimError::Subject {
        subject: subject.id.clone(),
        reason: "both condyles of the jaw are at the same place".to_owned(),
    })?;
    let eyes = subject.eyes.map(|e| {
        let center = subject
            .skull_from_reference
            .isometry
            .inverse_transform_point(&e.center);
        from_point(&center)
    });
    let weights: Vec<f64> = reference
        .cage
        .lid
        .iter()
        .zip(&reference.cage.roles)
        .map(|(w, role)| if *role == Role::Fixed { 0.0 } else { *w })
        .collect();
    Ok(Hinges {
        mandible,
        eyes,
        jaw: reference.cage.jaw.clone(),
        lids: lid_vertices(cage, &weights, &template.margins.lids, &eyes),
    })
}

/// Stiffness of the zero-length springs between attached fascia and skull: Table 1's stiffness for each node of the
/// paper's mesh, times the share of such a node's area that a node here stands for. Without it a coarse chin hangs on too
/// few springs to follow the jaw. Smaller nodes count as one of the paper's, or as the mean on a mesh that is finer.
fn attachments(template: &Template, params: &PaperParams, rest: &[V3]) -> Vec<f64> {
    let mut area = vec![0.0; template.node_count()];
    for t in &template.triangles {
        let size = norm(area_vector(t.map(|i| rest[i as usize])));
        for &i in t {
            area[i as usize] += size / 3.0;
        }
    }
    let mean = area.iter().sum::<f64>() / area.len().max(1) as f64;
    let least = mean.min(PAPER_NODE_AREA_MM2);
    template
        .attached
        .iter()
        .zip(&template.ligament)
        .zip(&area)
        .map(|((&a, ligament), size)| {
            let nodes = size.max(least) / PAPER_NODE_AREA_MM2;
            let share = if a { nodes } else { 0.0 };
            params.fascia_skull_stiffness * (share + ligament)
        })
        .collect()
}

/// Nodes nearer to the cylinder's axis at rest touch no skull, mm: below the chin an open jaw carries them across the
/// axis, where the height field means nothing.
const MIN_RADIUS_MM: f64 = 25.0;

fn contacts(
    reference: &ReferenceHead,
    template: &Template,
    layers: &Layers,
    field: &HeightField,
    hinges: &Hinges,
    subject: &Subject,
) -> Contacts {
    let n = template.node_count();
    let mut out = Contacts::default();
    for node in 0..template.free {
        let cage = template.cage_of_node[node];
        let (skin, fascia) = (layers.skin[node], layers.fascia[node]);
        let lid = reference.cage.lid[cage as usize] != 0.0;
        let (gap, gradient) = field.gap(fascia);
        let radial = unit([fascia[0], 0.0, fascia[2]]);
        let facing = sub(skin, fascia);
        let faces_out = (facing[0] * radial[0] + facing[2] * radial[2]) > MIN_FACING * norm(facing);
        let is_off_axis = fascia[0].hypot(fascia[2]) > MIN_RADIUS_MM;
        // At the lower border of the jaw the field is a cliff: nodes would rest on either side of it.
        let is_no_cliff = 1.0 / norm(gradient) > MIN_FACING;
        if !lid && faces_out && is_no_cliff && is_off_axis && template.moving[n + node] {
            out.skull.push(SkullContact {
                node: (n + node) as u32,
                cage,
                offset: gap,
                cosine: 1.0 / norm(gradient),
            });
        }
        for (e, eye) in subject.eyes.iter().enumerate() {
            let distance = norm(sub(skin, hinges.eyes[e]));
            if distance < eye.radius + EYE_REACH_MM {
                out.eyes.push(EyeContact {
                    node: node as u32,
                    eye: e as u32,
                    distance: distance.min(eye.radius + EYE_CLEARANCE_MM),
                });
            }
        }
    }
    out.lips = lips(template, &layers.skin);
    out
}

/// The lips' contacts on a subject. Beyond the corners of the lower lip there is nothing to touch.
fn lips(template: &Template, skin: &[V3]) -> Vec<LipContact> {
    let at = |i: u32| skin[i as usize];
    let pairs = template
        .margins
        .lip_pairs
        .iter()
        .zip(&template.pattern.lips);
    pairs
        .map(|(&(node, below), &slots)| {
            let [a, b] = below.map(at);
            let t = ((at(node)[0] - a[0]) / (b[0] - a[0]).max(1e-9)).clamp(0.0, 1.0);
            let height = (1.0 - t) * a[1] + t * b[1];
            LipContact {
                node,
                below,
                weights: [1.0 - t, t],
                offset: (at(node)[1] - height).min(0.0),
                cage: [node, below[0], below[1]].map(|i| template.cage_of_node[i as usize]),
                slots,
            }
        })
        .collect()
}
