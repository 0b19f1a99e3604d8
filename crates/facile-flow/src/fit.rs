//! Rounds of flow and fit: the reference is drawn towards the scan, and the flow explains what is left.
//!
//! Each round shows reference and scan on the cylinder, computes the flow both ways, and fits a smooth deformation of
//! the cage to where the flow leads the visible vertices, the smoothing length shrinking from round to round. As the
//! shapes come closer the flow has less to explain and the channels mean the same on both sides: plain flow between
//! two different heads does not have that. Source: [BPV06], bootstrapping.

use std::ops::RangeInclusive;

use facile_core::math::fit_similarity;
use facile_core::mesh::vertex_normals;
use facile_core::{Isometry3, Plane, Point3, Vector3};
use rayon::prelude::*;

use crate::cage::Target;
use crate::cage_on_surface::{SurfaceTarget, solve_on_surface};
use crate::channels::{CylinderImage, MEAN, comparable};
use crate::flow::{DisplacementField, field_down_to, forward_backward};
use crate::identity_fit::{FineModes, Identity, Iterate, strangeness};
use crate::landmarks::Anchor;
use crate::neighbors::NONE;
use crate::onto_surface::{REACH, contacts};
use crate::pyramid::Pyramid;
use crate::radial_map::CylinderGrid;
use crate::scan::{ScanView, WorkingScan};
use crate::template::{Template, TemplateView};
use crate::{FlowError, RegistrationParams, ears};

/// Widest angle of the radial maps, rad: up to behind the ears.
const PHI_MAX: f64 = 2.0;
/// Height range of the radial maps, mm: collar to forehead.
const HEIGHTS: (f64, f64) = (-130.0, 100.0);
/// Radius at which cells are squares, mm.
const NOMINAL_RADIUS: f64 = 80.0;

/// The reference's shape on a scan.
pub(crate) struct Shape {
    /// Cage positions, mm, head frame of the scan.
    pub(crate) cage: Vec<Vector3>,
    /// The mixture of the identity model's modes below the smooth deformation.
    pub(crate) identity: Identity,
    /// Size of the face against the reference's.
    pub(crate) size: f64,
    /// What the last flow said of each fine vertex.
    pub(crate) evidence: Vec<Evidence>,
    /// A triangle of the scan near each fine vertex, or [`NONE`]: where searches for the nearest point start.
    pub(crate) starts: Vec<u32>,
    /// Correlation of mean curvature between the reference's face and the scan before the flow, `[-1, 1]`.
    pub(crate) curvature_correlation: f64,
    /// The cage before the last smooth deformation: what the identity model says alone, mm.
    pub(crate) base: Vec<Vector3>,
}

/// Weight of a place that the flow did not decide but only carried over from its neighbours. The thin plate between
/// decided places is a better guess: 0.3 makes the transfer error 0.1 mm larger.
/// For strangers to the identity model less, see [`Identity::strangeness`]: what it carries over is the model's guess.
const UNDECIDED: f64 = 0.08;
/// Weight of an ear's place against the face's: ears differ from person to person in shape, and tell all the same where
/// cheek and jaw end.
const EAR: f64 = 0.5;
/// Shifts of an ear from which it is believed against the flow, mm: below, the flow finds it, and better.
const EAR_SHIFT: f64 = 3.1;
/// Weight of the distance to the scan's surface against a goal that the flow decided. With 1 the known people's error is
/// 5 % larger.
const ON_SURFACE: f64 = 4.0;
/// Half the weight is left to goals this far away, mm.
const FAR: f64 = 20.0;

/// Gauss-Newton steps for each round of nearest points, and the errors that their fit may find, mm: far from the scan
/// the distances say nothing about how well the modes could explain it.
const NEAREST_STEPS: usize = 2;
const NEAREST_ERROR: RangeInclusive<f64> = 1.5..=1.5;
/// Errors that the fit to a flow's goals may find, mm. People of the model's own kind show about 0.6 mm in the last
/// round, others 1.3 mm and more; for them the modes must not bend to every goal.
const FLOW_ERROR: RangeInclusive<f64> = 0.5..=3.0;

/// What the flow knows about one fine vertex.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Evidence {
    /// Distance between forward and backward flow, mm; infinite where the flow says nothing.
    pub(crate) forward_backward: f64,
    /// Share of its displacement that the flow determined, `[0, 1]`.
    pub(crate) confidence: f64,
    /// Distance between where the flow led it and where the smooth deformation put it, mm; 0 where nothing led it.
    pub(crate) missed: f64,
}

const NO_EVIDENCE: Evidence = Evidence {
    forward_backward: f64::INFINITY,
    confidence: 0.0,
    missed: 0.0,
};

/// A grid that covers the face.
pub(crate) fn face_grid(cell_mm: f64) -> CylinderGrid {
    CylinderGrid::new(PHI_MAX, HEIGHTS.0, HEIGHTS.1, cell_mm, NOMINAL_RADIUS)
}

/// Fits the template to `scan`, which is moved so that the head frame fits the deformed template.
///
/// # Errors
/// [`FlowError::NoFace`] if the curvature of the two does not agree.
pub(crate) fn fit_shape(
    template: &Template<'_>,
    modes: &FineModes,
    scan: &mut WorkingScan<'_>,
    size: f64,
    anchors: &[Anchor],
    params: &RegistrationParams,
) -> Result<Shape, FlowError> {
    let grid = face_grid(params.cell_mm);
    let rest = &template.reference.cage.positions;
    let identity = modes.mean(size);
    let mut shape = Shape {
        cage: modes.cage(rest, &identity),
        identity,
        size,
        evidence: vec![NO_EVIDENCE; template.reference.mesh.positions.len()],
        starts: vec![NONE; template.reference.mesh.positions.len()],
        curvature_correlation: 0.0,
        base: Vec::new(),
    };
    follow_nearest(template, modes, scan, &mut shape, anchors, params);
    shape.base.clone_from(&shape.cage);
    let with_color = scan.has_color();
    // From here on the scan stays, so that it is drawn on the cylinder once, and the head moves.
    let seen = scan.view(grid, &params.weights, params.curvature_sigma_mm);
    let mut pose = Isometry3::identity();
    for (round, &length) in params.smoothing_mm.iter().enumerate() {
        let mut posed = template.fine(&shape.cage);
        for p in &mut posed {
            *p = pose * *p;
        }
        let view = template.view(
            posed,
            grid,
            &params.weights,
            params.curvature_sigma_mm,
            with_color,
        );
        let images = Images::new(&view, &seen, params);
        if round == 0 {
            shape.curvature_correlation = check_face(&images, &grid, params)?;
        }
        let last = round + 1 == params.smoothing_mm.len();
        let mut goals = follow_flow(template, &view, &images, &seen, scan, &mut shape, last);
        anchor_goals(template, scan, anchors, &view.mesh.positions, &mut goals);
        for goal in &mut goals {
            goal.at = pose.inverse() * goal.at;
        }
        // The head was turned as a whole since its normals were found.
        let back = pose.rotation.inverse();
        let normals: Vec<Vector3> = view.normals.iter().map(|n| back * n).collect();
        let identity = (&normals[..], &mut shape.identity);
        pose *= fit_identity(template, modes, identity, &mut goals, 1, FLOW_ERROR);
        let base = modes.cage(rest, &shape.identity);
        let fine = template.fine(&base);
        let targets = targets(template, &fine, &goals);
        let cage_fit = &template.cage_fit;
        let mut displacement = cage_fit.solve(template.reference, &targets, length)?;
        if last && params.slides_on_surface {
            let cage: Vec<Vector3> = (base.iter().zip(&displacement))
                .map(|(b, d)| b + d)
                .collect();
            let surface = surface_targets(template, scan, &pose, &cage, &fine, &mut shape.starts);
            let both = (&targets[..], &surface[..]);
            displacement =
                solve_on_surface(template.reference, cage_fit, both, length, &displacement)?;
        }
        shape.cage = base.iter().zip(&displacement).map(|(b, d)| b + d).collect();
        shape.base = base;
        if last {
            let now = template.fine(&shape.cage);
            for goal in goals.iter().filter(|g| !g.is_landmark) {
                let v = goal.vertex as usize;
                shape.evidence[v].missed = (goal.at - now[v]).norm();
            }
        }
    }
    scan.transform(&pose.inverse());
    face_forwards(template, scan, &mut shape);
    Ok(shape)
}

/// Rounds of nearest points that fit pose, size and modes before the flow begins, and tell how strange the person is.
fn follow_nearest(
    template: &Template<'_>,
    modes: &FineModes,
    scan: &mut WorkingScan<'_>,
    shape: &mut Shape,
    anchors: &[Anchor],
    params: &RegistrationParams,
) {
    let rest = &template.reference.cage.positions;
    let mut beyond = vec![false; template.reference.mesh.positions.len()];
    for k in 0..params.nearest_rounds {
        let share = k as f64 / params.nearest_rounds as f64;
        let fine = template.fine(&shape.cage);
        let normals = vertex_normals(&fine, &template.reference.mesh.triangles);
        let mut goals = nearest_goals(
            template,
            scan,
            (&fine, &normals),
            &mut shape.starts,
            &mut beyond,
            18.0 - 10.0 * share,
        );
        anchor_goals(template, scan, anchors, &fine, &mut goals);
        let motion = fit_identity(
            template,
            modes,
            (&normals, &mut shape.identity),
            &mut goals,
            NEAREST_STEPS,
            NEAREST_ERROR,
        );
        scan.transform(&motion.inverse());
        shape.cage = modes.cage(rest, &shape.identity);
        if k + 1 == params.nearest_rounds {
            let positions = template.fine(&shape.cage);
            let normals = vertex_normals(&positions, &template.reference.mesh.triangles);
            let now = Iterate {
                positions: &positions,
                normals: &normals,
            };
            shape.identity.strangeness = strangeness(template, &now, &goals);
        }
    }
}

/// Moves head and scan so that the face lies nearest to the reference's, up to its size: the modes shift the face in
/// the head, so the fit alone leaves the frame to chance.
fn face_forwards(template: &Template<'_>, scan: &mut WorkingScan<'_>, shape: &mut Shape) {
    let fine = template.fine(&shape.cage);
    let weights: Vec<f64> = (template.face.iter().zip(&template.areas))
        .map(|(face, area)| if *face { *area } else { 0.0 })
        .collect();
    let Some(fit) = fit_similarity(&template.reference.mesh.positions, &fine, &weights) else {
        return;
    };
    let motion = fit.isometry.inverse();
    for p in &mut shape.cage {
        *p = (motion * Point3::from(*p)).coords;
    }
    for p in &mut shape.base {
        *p = (motion * Point3::from(*p)).coords;
    }
    shape.size = fit.scaling();
    scan.transform(&motion);
}

/// The two images of one round.
struct Images<'a> {
    head: CylinderImage,
    scan: CylinderImage,
    params: &'a RegistrationParams,
}

impl<'a> Images<'a> {
    fn new(view: &TemplateView, seen: &ScanView, params: &'a RegistrationParams) -> Self {
        let both = Plane::from_fn(
            view.raw.covered.width(),
            view.raw.covered.height(),
            |x, y| view.raw.covered[(x, y)] * seen.raw.covered[(x, y)],
        );
        Self {
            head: comparable(&view.raw, &both, &params.weights),
            scan: comparable(&seen.raw, &both, &params.weights),
            params,
        }
    }
}

/// Correlates mean curvature between the reference's face, posed on the scan, and the scan.
fn check_face(
    images: &Images<'_>,
    grid: &CylinderGrid,
    params: &RegistrationParams,
) -> Result<f64, FlowError> {
    let mut pairs = Vec::new();
    for y in 0..grid.height {
        for x in 0..grid.width {
            let (h, phi) = grid.cylinder_from_cell([x as f64, y as f64]);
            if phi.abs() < 1.0 && (-100.0..40.0).contains(&h) {
                let weight = images.head.mask[(x, y)] * images.scan.mask[(x, y)];
                let mean = |image: &CylinderImage| f64::from(image.values[(x, y)][MEAN]);
                pairs.push((mean(&images.head), mean(&images.scan), f64::from(weight)));
            }
        }
    }
    let found = correlation(&pairs);
    let limit = params.min_curvature_correlation;
    if found < limit {
        return Err(FlowError::NoFace {
            measure: "the correlation of its curvature with a face's",
            found,
            relation: "at least",
            limit,
        });
    }
    Ok(found)
}

/// Weighted correlation of pairs `(a, b, weight)`; 0 for fewer than ten.
fn correlation(pairs: &[(f64, f64, f64)]) -> f64 {
    let total: f64 = pairs.iter().map(|p| p.2).sum();
    if pairs.len() < 10 || total <= 0.0 {
        return 0.0;
    }
    let mean =
        |f: &dyn Fn(&(f64, f64, f64)) -> f64| pairs.iter().map(|p| f(p) * p.2).sum::<f64>() / total;
    let (a, b) = (mean(&|p| p.0), mean(&|p| p.1));
    let covariance = mean(&|p| (p.0 - a) * (p.1 - b));
    let spread = (mean(&|p| (p.0 - a).powi(2)) * mean(&|p| (p.1 - b).powi(2))).sqrt();
    covariance / spread.max(1e-12)
}

/// Where a fine vertex should be.
pub(crate) struct Goal {
    pub(crate) vertex: u32,
    /// Head frame, mm.
    pub(crate) at: Point3,
    /// `[0, 1]`, without the vertex's area.
    pub(crate) weight: f64,
    /// `[0, 1]`: how far the place along the surface is known, against the distance to it.
    pub(crate) slide: f64,
    /// Whether it was given from outside.
    pub(crate) is_landmark: bool,
}

/// Every how many pairs of fine vertices take part while the pose and a few dozen modes are found from nearest points.
pub(crate) const NEAREST_STRIDE: u32 = 6;

/// Nearest points of the scan: they tell how far the surface is, and little about where on it. Vertices that find none
/// are marked as `beyond` it and asked no more, since the reach only shrinks.
fn nearest_goals(
    template: &Template<'_>,
    scan: &WorkingScan<'_>,
    (fine, normals): (&[Point3], &[Vector3]),
    starts: &mut [u32],
    beyond: &mut [bool],
    reach: f64,
) -> Vec<Goal> {
    let goal = |(v, (start, beyond)): (usize, (&mut u32, &mut bool))| {
        if template.skin[v] <= 0.0 || *beyond || !template.pair[v].is_multiple_of(NEAREST_STRIDE) {
            return None;
        }
        let hit = scan.nearest_from(*start, &fine[v], &normals[v], reach);
        *beyond = hit.is_none();
        let hit = hit?;
        if hit.normal.dot(&normals[v]) < 0.6 || scan.is_on_border(&hit) {
            return None;
        }
        *start = hit.triangle;
        let far = (hit.point - fine[v]).norm() / reach;
        Some(Goal {
            vertex: v as u32,
            at: hit.point,
            weight: template.skin[v] * (1.0 - far * far).powi(2),
            slide: 0.05,
            is_landmark: false,
        })
    };
    starts
        .par_iter_mut()
        .zip(beyond)
        .enumerate()
        .filter_map(goal)
        .collect()
}

/// Adds the landmarks that were given as goals of the vertices around them.
fn anchor_goals(
    template: &Template<'_>,
    scan: &WorkingScan<'_>,
    anchors: &[Anchor],
    positions: &[Point3],
    goals: &mut Vec<Goal>,
) {
    /// Area of skin that one landmark speaks for, mm^2.
    const AREA: f64 = 300.0;
    let head_from_scan = scan.head_from_scan();
    for anchor in anchors {
        let wrong = head_from_scan * anchor.at - anchor.on(positions);
        for (&vertex, share) in anchor.corners.iter().zip(anchor.barycentric) {
            if share > 0.0 {
                let weight = share * AREA / template.areas[vertex as usize].max(1e-3);
                goals.push(Goal {
                    vertex,
                    at: positions[vertex as usize] + wrong,
                    weight,
                    slide: 1.0,
                    is_landmark: true,
                });
            }
        }
    }
}

/// Fits pose, size and modes; returns the motion of the head towards the goals, and moves these back by it, into the
/// head's frame. `normals`: those of the head as it is now.
fn fit_identity(
    template: &Template<'_>,
    modes: &FineModes,
    (normals, identity): (&[Vector3], &mut Identity),
    goals: &mut [Goal],
    steps: usize,
    error: RangeInclusive<f64>,
) -> Isometry3 {
    let mut whole = Isometry3::identity();
    for _ in 0..steps {
        let motion = modes.step(template, normals, goals, &error, identity);
        for goal in goals.iter_mut() {
            goal.at = motion.inverse() * goal.at;
        }
        whole *= motion;
    }
    whole
}

/// Computes the flow (and its way back, for the weights, if `both_ways`) and reads where it leads the visible vertices.
fn follow_flow(
    template: &Template<'_>,
    view: &TemplateView,
    images: &Images<'_>,
    seen: &ScanView,
    scan: &WorkingScan<'_>,
    shape: &mut Shape,
    both_ways: bool,
) -> Vec<Goal> {
    let flow = &images.params.flow;
    let source = Pyramid::new(images.head.clone(), flow.levels);
    let target = Pyramid::new(images.scan.clone(), flow.levels);
    let (forward, backward) = rayon::join(
        || field_down_to(&source, &target, flow, usize::from(!both_ways)),
        || both_ways.then(|| field_down_to(&target, &source, flow, 1)),
    );
    let distance = match &backward {
        Some(backward) => forward_backward(&forward, backward),
        None => forward.confidence.map(|_| 0.0),
    };
    let cell = seen.map.grid.h_step;
    // In the last round the ears are near, and the flow finds them better.
    let ears = view.ears.each_ref().map(|ear| {
        (!both_ways)
            .then(|| ears::find(&images.head, &images.scan, ear, cell))
            .flatten()
            .filter(|d| d[0].hypot(d[1]) * cell > EAR_SHIFT)
    });
    let undecided = UNDECIDED / shape.identity.strangeness.powi(2);
    let mut goals = Vec::new();
    for (v, p) in view.mesh.positions.iter().enumerate() {
        shape.evidence[v] = NO_EVIDENCE;
        if !view.visible[v] || template.skin[v] <= 0.0 {
            continue;
        }
        let at = seen.map.grid.cell_from_point(p);
        let ear = ears[usize::from(p.x < 0.0)].filter(|_| template.is_ear[v]);
        let known = match ear {
            Some([dx, dy]) => Some(([at[0] + dx, at[1] + dy], 1.0, 0.0)),
            None => read_field(&forward, &distance, at),
        };
        let Some((to, confidence, round_trip)) = known else {
            continue;
        };
        let Some(goal) = seen.point(to) else { continue };
        let round_trip = round_trip * cell;
        // The scan must look the same way, else it is another surface: hair, collar, the side of a hole.
        let agreement = scan_normal(seen, scan, to).map_or(0.0, |n| n.dot(&view.normals[v]));
        if agreement < 0.3 {
            continue;
        }
        let [cx, cy] = to.map(|c| c.round() as usize);
        shape.starts[v] = seen.map.triangle[(cx, cy)];
        let far = (goal - p).norm();
        let skin = if template.is_ear[v] {
            EAR
        } else {
            template.skin[v]
        };
        let weight = skin * (undecided + (1.0 - undecided) * confidence)
            / (1.0 + (round_trip / 2.0).powi(2))
            / (1.0 + (far / FAR).powi(4));
        shape.evidence[v] = Evidence {
            forward_backward: round_trip,
            confidence,
            missed: 0.0,
        };
        goals.push(Goal {
            vertex: v as u32,
            at: goal,
            weight,
            slide: confidence,
            is_landmark: false,
        });
    }
    goals
}

/// Field, confidence and round trip (cells) at a continuous cell position. `None` outside the grid.
fn read_field(
    field: &DisplacementField,
    distance: &facile_core::Plane<f32>,
    [x, y]: [f64; 2],
) -> Option<([f64; 2], f64, f64)> {
    let (nx, ny) = (field.cells.width(), field.cells.height());
    if !(x >= 0.0 && y >= 0.0 && x < (nx - 1) as f64 && y < (ny - 1) as f64) {
        return None;
    }
    let v = crate::channels::bilinear(&field.cells, x as f32, y as f32);
    let cell = (x.round() as usize, y.round() as usize);
    Some((
        [x + f64::from(v[0]), y + f64::from(v[1])],
        f64::from(field.confidence[cell]),
        f64::from(distance[cell]),
    ))
}

fn scan_normal(seen: &ScanView, scan: &WorkingScan<'_>, [x, y]: [f64; 2]) -> Option<Vector3> {
    let normal = seen.map.interpolate(
        &scan.mesh.triangles,
        &scan.normals,
        x.round() as usize,
        y.round() as usize,
    )?;
    normal.try_normalize(1e-12)
}

/// The displacements of the fine vertices, from where the identity puts them, that bring them to their goals.
fn targets(template: &Template<'_>, fine: &[Point3], goals: &[Goal]) -> Vec<Target> {
    goals
        .iter()
        .map(|g| {
            let v = g.vertex as usize;
            Target {
                vertex: g.vertex,
                displacement: g.at - fine[v],
                weight: g.weight * template.areas[v],
            }
        })
        .collect()
}

/// The planes of the scan nearest to the head in shape `cage`, for displacements from `fine`. `pose` brings the head to
/// the scan.
fn surface_targets(
    template: &Template<'_>,
    scan: &WorkingScan<'_>,
    pose: &Isometry3,
    cage: &[Vector3],
    fine: &[Point3],
    starts: &mut [u32],
) -> Vec<SurfaceTarget> {
    let now: Vec<Point3> = (template.fine(cage).iter()).map(|p| pose * p).collect();
    let normals = vertex_normals(&now, &template.reference.mesh.triangles);
    let mut beyond = vec![false; now.len()];
    let contacts = contacts(template, scan, (&now, &normals), starts, &mut beyond, REACH);
    (contacts.iter().enumerate())
        .filter_map(|(v, contact)| {
            let contact = contact.as_ref()?;
            let moved = now[v] - pose * fine[v];
            Some(SurfaceTarget {
                vertex: v as u32,
                normal: pose.rotation.inverse() * contact.normal,
                offset: contact.normal.dot(&(moved + contact.to)),
                weight: ON_SURFACE * contact.weight * template.areas[v],
            })
        })
        .collect()
}
