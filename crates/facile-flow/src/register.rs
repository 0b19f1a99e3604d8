//! The whole way of one scan: normalise, flow and fit, settle, eyes, texture, report.

use std::time::Instant;

use facile_core::io::Scan;
use facile_core::{Attributes, IdentityModel, Point3, ReferenceHead, Similarity3, Subject};

use crate::expected_error::expected_error;
use crate::fit::{Shape, fit_shape};
use crate::identity_fit::FineModes;
use crate::landmarks::ScanLandmarks;
use crate::normalise::{FaceModel, Pose, find_face, pose_from_landmarks};
use crate::onto_surface::{Settled, settle};
use crate::report::{RegistrationReport, quantile, rows_of};
use crate::scan::{WorkingScan, clean};
use crate::template::Template;
use crate::texel_map::TexelMaps;
use crate::{FlowError, RegistrationParams, eyes, folds, iris, texture};

/// A registered scan.
#[derive(Clone, Debug)]
pub struct Registration {
    /// The person on the reference topology.
    pub subject: Subject,
    /// Brings the scan's coordinates into the subject's head frame, mm.
    pub head_from_scan: Similarity3,
    /// How good it is.
    pub report: RegistrationReport,
    /// Wall time of each stage.
    pub times: Vec<StageTime>,
}

impl Registration {
    /// The subject's fine vertices in the scan's coordinates.
    pub fn positions_on_scan(&self) -> Vec<Point3> {
        let scan_from_head = self.head_from_scan.inverse();
        let positions = self.subject.positions.iter();
        positions.map(|p| scan_from_head * p).collect()
    }
}

/// How long one stage of a registration took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageTime {
    /// The stage.
    pub stage: &'static str,
    /// Wall time, s.
    pub seconds: f64,
}

/// Measures stage after stage.
struct Clock {
    last: Instant,
    times: Vec<StageTime>,
}

impl Clock {
    fn start() -> Self {
        Self {
            last: Instant::now(),
            times: Vec::new(),
        }
    }

    fn stop(&mut self, stage: &'static str) {
        let now = Instant::now();
        let seconds = (now - self.last).as_secs_f64();
        self.times.push(StageTime { stage, seconds });
        self.last = now;
    }
}

/// Registers scans to one reference head. Holds what every scan needs, so make it once for many.
pub struct Registrar<'a> {
    template: Template<'a>,
    face: FaceModel,
    modes: FineModes,
    params: RegistrationParams,
    texels: TexelMaps,
}

impl std::fmt::Debug for Registrar<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Registrar")
            .field("params", &self.params)
            .finish_non_exhaustive()
    }
}

impl<'a> Registrar<'a> {
    /// Prepares the operators on `reference`.
    ///
    /// # Errors
    /// [`FlowError::Parameter`] for values out of range, [`FlowError::Singular`] for a reference without surface.
    pub fn new(
        reference: &'a ReferenceHead,
        params: RegistrationParams,
    ) -> Result<Self, FlowError> {
        params.validate()?;
        // The embedded model belongs to the embedded head's cage; another reference is fitted without.
        let same_cage =
            reference.cage.positions.len() == ReferenceHead::embedded().cage.positions.len();
        let model = (params.use_identity && same_cage).then(IdentityModel::embedded);
        Ok(Self {
            template: Template::new(reference)?,
            face: FaceModel::new(reference),
            modes: FineModes::new(
                model,
                &reference.cage.mirror,
                &reference.subdivision.stencils,
            ),
            texels: TexelMaps::new(params.texture_size),
            params,
        })
    }

    pub(crate) fn template(&self) -> &Template<'a> {
        &self.template
    }

    /// Registers one scan: a neutral face, roughly upright, facing `+z` within 45 degrees, in any unit.
    ///
    /// The subject's `id` is the scan's name and its attributes are unknown. Deterministic: equal input
    /// gives equal bytes for any number of threads. Cost about a second for 100,000 triangles.
    ///
    /// # Errors
    /// [`FlowError::TooFewTriangles`] and [`FlowError::NoFace`] with the measure that failed.
    pub fn register(&self, input: &Scan) -> Result<Registration, FlowError> {
        self.register_with(input, None)
    }

    /// As [`Self::register`], with landmarks where they are known: they give the pose, from any direction, and hold
    /// their places.
    ///
    /// # Errors
    /// As [`Self::register`], and [`FlowError::Landmarks`] for landmarks that do not determine a pose.
    pub fn register_with(
        &self,
        input: &Scan,
        landmarks: Option<&ScanLandmarks>,
    ) -> Result<Registration, FlowError> {
        let (template, params) = (&self.template, &self.params);
        let mut clock = Clock::start();
        let cleaned = clean(&input.mesh)?;
        clock.stop("clean");
        let anchors = match landmarks {
            Some(landmarks) => landmarks.anchors(template.reference)?,
            None => Vec::new(),
        };
        let pose = if anchors.is_empty() {
            find_face(
                &self.face,
                &cleaned.mesh,
                &cleaned.normals,
                &params.normalise,
            )?
        } else {
            let on_scan: Vec<Point3> = anchors.iter().map(|a| a.at).collect();
            let on_reference: Vec<Point3> = (anchors.iter())
                .map(|a| a.on(&template.reference.mesh.positions))
                .collect();
            pose_from_landmarks(&on_reference, &on_scan, &params.normalise)?
        };
        clock.stop("normalise");
        let mut scan = WorkingScan::new(cleaned, input.texture.as_ref(), &pose.head_from_scan);
        clock.stop("prepare");
        let mut shape = fit_shape(
            template,
            &self.modes,
            &mut scan,
            pose.size,
            &anchors,
            params,
        )?;
        clock.stop("fit");
        let mut settled = settle(template, &scan, &mut shape, params)?;
        for _ in 0..3 {
            template.slit.close(
                template.reference,
                &template.adjacency,
                &mut settled.positions,
                shape.size,
            );
        }
        let folded = folds::unfold(template, &mut settled.positions, shape.size, 80);
        clock.stop("settle");
        let expected_error = expected_error(template, &shape, &settled);
        let head_from_scan = scan.head_from_scan();
        let report = self.report(
            &pose,
            &shape,
            &settled,
            &expected_error,
            &Facts {
                head_from_scan,
                folded,
            },
        );
        let eyes = eyes::place_eyes(template.reference, &settled.positions);
        let subject = Subject {
            id: input.name.clone(),
            attributes: Attributes::default(),
            texture: texture::bake(
                template,
                &self.texels,
                &scan,
                &settled.positions,
                params.delight,
            ),
            eye_color: iris::eye_color(template.reference, &scan, &eyes),
            eyes,
            skull_from_reference: eyes::place_skull(template.reference, &settled.positions),
            positions: settled.positions,
            expected_error,
        };
        clock.stop("texture");
        Ok(Registration {
            subject,
            head_from_scan,
            report,
            times: clock.times,
        })
    }

    fn report(
        &self,
        pose: &Pose,
        shape: &Shape,
        settled: &Settled,
        expected_error: &[f32],
        facts: &Facts,
    ) -> RegistrationReport {
        let template = &self.template;
        let n = settled.positions.len();
        let is_face = |v: usize| template.face[v];
        let share = |of: &dyn Fn(usize) -> bool, among: &dyn Fn(usize) -> bool| {
            let area = |keep: &dyn Fn(usize) -> bool| -> f64 {
                (0..n).filter(|&v| keep(v)).map(|v| template.areas[v]).sum()
            };
            area(&|v| among(v) && of(v)) / area(among).max(1e-9)
        };
        let covered = |v: usize| settled.residual[v].is_some();
        let distances: Vec<f64> = settled.residual.iter().flatten().copied().collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let round_trips: Vec<f64> = (0..n)
            .filter(|&v| is_face(v) && shape.evidence[v].forward_backward.is_finite())
            .map(|v| shape.evidence[v].forward_backward)
            .collect();
        let errors: Vec<f64> = (0..n)
            .filter(|&v| is_face(v))
            .map(|v| f64::from(expected_error[v]))
            .collect();
        RegistrationReport {
            unit_mm: pose.unit_mm,
            unit_is_known: pose.unit_is_known,
            head_from_scan: rows_of(&facts.head_from_scan),
            size: shape.size,
            rigid_coverage: pose.coverage,
            rigid_distance_mm: pose.distance,
            curvature_correlation: shape.curvature_correlation,
            coverage: share(&covered, &|v| template.skin[v] > 0.0),
            face_coverage: share(&covered, &is_face),
            forward_backward_mm: mean(&round_trips),
            surface_distance_mean_mm: mean(&distances),
            surface_distance_p95_mm: quantile(distances, 0.95),
            folded_triangles: facts.folded,
            expected_error_mm: mean(&errors),
        }
    }
}

/// What the stages found besides the shape.
struct Facts {
    head_from_scan: Similarity3,
    folded: usize,
}

/// Registers one scan; see [`Registrar`] for many.
///
/// # Errors
/// As [`Registrar::new`] and [`Registrar::register`].
pub fn register(
    reference: &ReferenceHead,
    scan: &Scan,
    params: &RegistrationParams,
) -> Result<Registration, FlowError> {
    Registrar::new(reference, params.clone())?.register(scan)
}
