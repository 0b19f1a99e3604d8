//! Random faces in random poses: does every solve certify, or say why it does not?

use facile_core::identity::IdentityModel;
use facile_core::rng::RandomStream;
use facile_core::{CoreError, ReferenceHead, Subject};

use crate::SimError;
use crate::model::{FaceModel, FaceRig};
use crate::muscle::{MuscleSet, Symmetry};
use crate::pose::{Pose, Sides};
use crate::solver::{Solver, SolverParams};

/// Largest opening of the jaw in a random pose, rad (30 degrees).
const MAX_JAW_RAD: f64 = std::f64::consts::PI / 6.0;
/// Contractions up to this should turn no prism inside out.
const MODERATE: f64 = 0.85;

/// What a number of random solves came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StressReport {
    /// Solves that were tried.
    pub solves: usize,
    /// Those with a certificate.
    pub certified: usize,
    /// Those that were refused: number of the solve and the reason.
    pub refused: Vec<(usize, String)>,
    /// Certified faces with a coordinate that is not finite. Must be 0.
    pub not_finite: usize,
    /// Largest penetration of skull and eyeballs, mm.
    pub worst_penetration_mm: f64,
    /// Largest overlap of the lips, mm.
    pub worst_lip_overlap_mm: f64,
    /// Certified faces with prisms that are turned inside out: number of the solve, and how many.
    pub inverted: Vec<(usize, usize)>,
    /// Most iterations of a solve.
    pub most_iterations: usize,
}

/// A random pose: every muscle of each side uniform in `[0, strongest]`, the jaw in 0 to 30 degrees.
pub fn random_pose(muscles: &MuscleSet, strongest: f64, random: &mut RandomStream) -> Pose {
    let mut pose = Pose::default();
    for muscle in muscles.muscles() {
        let left = random.uniform(0.0, strongest);
        let right = match muscle.side {
            Symmetry::Both => random.uniform(0.0, strongest),
            Symmetry::Midline => left,
        };
        pose.contractions
            .insert(muscle.name.clone(), Sides { left, right });
    }
    pose.jaw.open_rad = random.uniform(0.0, MAX_JAW_RAD);
    pose
}

/// Solves `count` random poses, `per_subject` on each of as many identities of family `seed` as that takes; `moderate`
/// keeps contractions up to 0.85.
///
/// # Errors
/// [`CoreError`] if the identity model is damaged. A face that cannot carry muscles counts as refused.
pub fn stress(
    rig: &FaceRig,
    reference: &ReferenceHead,
    seed: u64,
    count: usize,
    per_subject: usize,
    moderate: bool,
) -> Result<StressReport, CoreError> {
    let muscles = rig.template().muscles().clone();
    let strongest = if moderate { MODERATE } else { 1.0 };
    let mut solver = Solver::new();
    let mut report = StressReport::default();
    let mut person: Option<Result<FaceModel, SimError>> = None;
    for number in 0..count {
        if number.is_multiple_of(per_subject.max(1)) {
            let index = (number / per_subject.max(1)) as u64;
            let subject: Subject = IdentityModel::embedded().sample(reference, seed, index)?;
            person = Some(rig.model(reference, &subject));
        }
        let mut random = RandomStream::new(seed, number as u64);
        let pose = random_pose(&muscles, strongest, &mut random);
        report.solves += 1;
        let result = match &person {
            Some(Ok(model)) => solver.solve(model, &pose, &SolverParams::default()),
            Some(Err(e)) => Err(e.clone()),
            None => continue,
        };
        match result {
            Err(e) => report.refused.push((number, e.to_string())),
            Ok(face) => {
                let c = &face.certificate;
                let finite = face.positions.iter().all(|p| p.coords.norm().is_finite());
                report.certified += 1;
                report.not_finite += usize::from(!finite);
                report.worst_penetration_mm = report.worst_penetration_mm.max(c.max_penetration_mm);
                report.worst_lip_overlap_mm = report.worst_lip_overlap_mm.max(c.lip_overlap_mm);
                if c.inverted_elements > 0 {
                    report.inverted.push((number, c.inverted_elements));
                }
                report.most_iterations = report.most_iterations.max(c.iterations);
            }
        }
    }
    Ok(report)
}
