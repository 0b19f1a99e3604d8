//! Finds the face in a scan: unit, pose and size, without marks.
//!
//! Every plausible unit gives candidates of the nose (places that stick out); each is tried with a coarse grid of
//! rotations, and the reference's face is fitted to the scan by trimmed iterative closest point, in stages that keep
//! only the best. The scan must be roughly upright and face `+z` within 45 degrees.

mod cubes;
mod icp;
mod nose;

use facile_core::math::fit_similarity;
use facile_core::{Mesh, Point3, ReferenceHead, Segment, Similarity3, UnitQuaternion, Vector3};
use nalgebra::Translation3;
use serde::{Deserialize, Serialize};

use crate::FlowError;
use crate::radial_map::{CylinderGrid, RadialMap, visible_vertices};
use cubes::Cubes;
use icp::{FacePoints, PoseScore};

/// Limits of the search for the face.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormaliseParams {
    /// Millimetres in one unit of the scan; found from its size when absent.
    pub unit_mm: Option<f64>,
    /// Largest yaw, pitch and roll that are searched, rad.
    pub max_angle: f64,
    /// Least share of the reference's face that must have scan surface, `[0, 1]`.
    pub min_coverage: f64,
    /// Largest root mean square distance of the aligned reference face to the scan, mm.
    pub max_distance: f64,
}

impl Default for NormaliseParams {
    fn default() -> Self {
        Self {
            unit_mm: None,
            max_angle: 0.8,
            min_coverage: 0.6,
            max_distance: 7.0,
        }
    }
}

/// Where the face is in a scan.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Head frame (mm) from the scan's coordinates. Keeps the true size where the unit was recognised.
    pub head_from_scan: Similarity3,
    /// Size of the face against the reference's.
    pub size: f64,
    /// Millimetres in one unit of the scan.
    pub unit_mm: f64,
    /// Whether the unit is one of mm, cm, inch, m; else the size was set to the reference's.
    pub unit_is_known: bool,
    /// Share of the reference's face with scan surface nearby.
    pub coverage: f64,
    /// Root mean square distance of the aligned reference face to the scan, mm.
    pub distance: f64,
}

/// Units that scans come in, mm.
const UNITS: [f64; 4] = [1.0, 10.0, 1000.0, 25.4];
/// Diagonal of a scan that can hold a face: a face mask up to a bust, mm.
const DIAGONAL: std::ops::Range<f64> = 120.0..1300.0;
/// Diagonal given to scans of unknown unit before their size is found, mm.
const USUAL_DIAGONAL: f64 = 330.0;

/// One start of the search: scan (mm) from reference.
#[derive(Clone, Copy)]
struct Start {
    pose: Similarity3,
    unit_mm: f64,
    score: PoseScore,
}

/// The reference's face as the search knows it; made once for many scans.
pub(crate) struct FaceModel {
    points: FacePoints,
    nose: Point3,
    nose_normal: Vector3,
}

impl FaceModel {
    /// Even points of the reference's face and its nose.
    pub(crate) fn new(reference: &ReferenceHead) -> Self {
        let (nose, nose_normal) = reference_nose(reference);
        Self {
            points: face_points(reference),
            nose,
            nose_normal,
        }
    }
}

/// The pose that landmarks on the reference (mm) and on the scan give. The unit is the listed one nearest to the size
/// they show, if that is within a quarter; else it is unknown.
///
/// # Errors
/// [`FlowError::Landmarks`] if they lie on one line.
pub(crate) fn pose_from_landmarks(
    on_reference: &[Point3],
    on_scan: &[Point3],
    params: &NormaliseParams,
) -> Result<Pose, FlowError> {
    let weights = vec![1.0; on_scan.len()];
    let fit = fit_similarity(on_reference, on_scan, &weights)
        .filter(|fit| fit.scaling() > 1e-9)
        .ok_or_else(|| FlowError::Landmarks {
            reason: "they do not determine a pose".to_owned(),
        })?;
    let unit = 1.0 / fit.scaling();
    let nearest = UNITS
        .into_iter()
        .find(|u| (0.75..1.33).contains(&(unit / u)));
    let unit_mm = params.unit_mm.or(nearest).unwrap_or(unit);
    // Scan (in that unit, mm) from reference.
    let pose = Similarity3::from_parts(
        Translation3::from(fit.isometry.translation.vector * unit_mm),
        fit.isometry.rotation,
        fit.scaling() * unit_mm,
    );
    let score = PoseScore {
        coverage: 1.0,
        rms: 0.0,
        cost: 0.0,
    };
    Ok(pose_from_start(
        &Start {
            pose,
            unit_mm,
            score,
        },
        params,
    ))
}

/// Finds the face of `mesh` (any unit, with unit vertex `normals`).
///
/// # Errors
/// [`FlowError::NoFace`] with the measure that failed.
pub(crate) fn find_face(
    face: &FaceModel,
    mesh: &Mesh,
    normals: &[Vector3],
    params: &NormaliseParams,
) -> Result<Pose, FlowError> {
    let diagonal = robust_diagonal(mesh);
    let mut units: Vec<f64> = match params.unit_mm {
        Some(unit) => vec![unit],
        None => UNITS
            .into_iter()
            .filter(|u| DIAGONAL.contains(&(diagonal * u)))
            .collect(),
    };
    if units.is_empty() {
        units.push(USUAL_DIAGONAL / diagonal.max(1e-12));
    }
    let mut best: Option<Start> = None;
    for unit_mm in units {
        let surface = Cubes::new(mesh, normals, unit_mm).spread();
        for (pose, score) in search(face, &surface, params) {
            if best.is_none_or(|b| score.cost < b.score.cost) {
                best = Some(Start {
                    pose,
                    unit_mm,
                    score,
                });
            }
        }
    }
    let no_face = |measure, found, relation, limit| FlowError::NoFace {
        measure,
        found,
        relation,
        limit,
    };
    let Some(best) = best else {
        return Err(no_face(
            "the number of places that stick out like a nose",
            0.0,
            "at least",
            1.0,
        ));
    };
    if best.score.coverage < params.min_coverage {
        return Err(no_face(
            "the share of a face's surface found",
            best.score.coverage,
            "at least",
            params.min_coverage,
        ));
    }
    if best.score.rms > params.max_distance {
        return Err(no_face(
            "the distance between scan and mean face in mm",
            best.score.rms,
            "at most",
            params.max_distance,
        ));
    }
    Ok(pose_from_start(&best, params))
}

fn pose_from_start(best: &Start, params: &NormaliseParams) -> Pose {
    let size = best.pose.scaling();
    let is_listed = |unit: f64| UNITS.iter().any(|u| (u - unit).abs() < 1e-9 * u);
    let unit_is_known = params.unit_mm.is_some() || is_listed(best.unit_mm);
    // A known unit keeps the head's true size; else the head gets the reference's.
    let (unit_mm, size) = if unit_is_known {
        (best.unit_mm, size)
    } else {
        (best.unit_mm / size, 1.0)
    };
    let rigid = best.pose.isometry.inverse();
    let shrink = unit_mm / best.unit_mm;
    let head_from_scan = Similarity3::from_parts(
        Translation3::from(rigid.translation.vector * shrink),
        rigid.rotation,
        unit_mm,
    );
    Pose {
        head_from_scan,
        size,
        unit_mm,
        unit_is_known,
        coverage: best.score.coverage,
        distance: best.score.rms,
    }
}

/// Tries nose candidates and rotations in stages; returns the last stage's poses with their scores.
fn search(
    face: &FaceModel,
    surface: &Cubes,
    params: &NormaliseParams,
) -> Vec<(Similarity3, PoseScore)> {
    let mut starts: Vec<Similarity3> = Vec::new();
    for tip in nose::tips(surface, 8) {
        for rotation in rotation_grid(params.max_angle) {
            if (rotation * face.nose_normal).dot(&tip.normal) < 0.8 {
                continue;
            }
            let shift = tip.point.coords - rotation * face.nose.coords;
            starts.push(Similarity3::from_parts(
                Translation3::from(shift),
                rotation,
                1.0,
            ));
        }
    }
    // Stages: points of the face, iterations, reach (mm), poses kept.
    let stages = [
        (60, 0, 40.0, 60),
        (120, 6, 40.0, 10),
        (300, 12, 25.0, 4),
        (1000, 15, 15.0, 2),
    ];
    let mut scored: Vec<(Similarity3, PoseScore)> = Vec::new();
    for (count, iterations, reach, kept) in stages {
        let points = face.points.thinned(count);
        let poses: Vec<Similarity3> = if scored.is_empty() {
            std::mem::take(&mut starts)
        } else {
            scored.iter().map(|s| s.0).collect()
        };
        let far = if iterations == 0 { reach } else { icp::REACH };
        scored = poses
            .into_iter()
            .map(|pose| {
                let refined = icp::refine(&points, surface, pose, iterations, reach);
                (refined, icp::score(&points, surface, &refined, far))
            })
            .collect();
        scored.sort_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
        scored = distinct(&scored, face.nose, kept);
    }
    scored
}

/// The first `count` poses that put the nose 6 mm or 10 degrees apart from each other.
fn distinct(
    scored: &[(Similarity3, PoseScore)],
    nose: Point3,
    count: usize,
) -> Vec<(Similarity3, PoseScore)> {
    let mut kept: Vec<(Similarity3, PoseScore)> = Vec::new();
    for candidate in scored {
        let same = |k: &(Similarity3, PoseScore)| {
            let (a, b) = (k.0, candidate.0);
            (a * nose - b * nose).norm() < 6.0
                && a.isometry.rotation.angle_to(&b.isometry.rotation) < 0.17
        };
        if kept.len() < count && !kept.iter().any(same) {
            kept.push(*candidate);
        }
    }
    kept
}

/// Yaw, pitch and roll on a grid of about 15 degrees.
fn rotation_grid(max_angle: f64) -> Vec<UnitQuaternion> {
    let steps = (max_angle / 0.28).ceil().max(1.0) as i32;
    let angles: Vec<f64> = (-steps..=steps)
        .map(|k| f64::from(k) * max_angle / f64::from(steps))
        .collect();
    let mut rotations = Vec::new();
    for &yaw in &angles {
        for &pitch in &angles {
            for &roll in &angles {
                rotations.push(
                    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll)
                        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), pitch)
                        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw),
                );
            }
        }
    }
    rotations
}

/// Points of the reference that every face scan shows: forehead to chin, between the ears, outer skin only.
fn face_points(reference: &ReferenceHead) -> FacePoints {
    let mesh = &reference.mesh;
    let normals = mesh.vertex_normals();
    let grid = CylinderGrid::new(1.6, -130.0, 90.0, 2.0, 80.0);
    let map = RadialMap::cast(&mesh.positions, &mesh.triangles, grid);
    let visible = visible_vertices(&map, &mesh.positions, 1.5);
    let mut is_face = visible;
    for (triangle, segment) in mesh.triangles.iter().zip(&mesh.segments) {
        if matches!(
            segment,
            Segment::InnerMouth
                | Segment::EyeSocket
                | Segment::Neck
                | Segment::Scalp
                | Segment::LeftEar
                | Segment::RightEar
        ) {
            for &v in triangle {
                is_face[v as usize] = false;
            }
        }
    }
    // Even cover: one vertex for each 5 mm cube.
    let mut taken = std::collections::BTreeMap::new();
    for (v, p) in mesh.positions.iter().enumerate() {
        let frontal = libm::fabs(libm::atan2(p.x, p.z)) < 1.15 && p.y < 60.0;
        if is_face[v] && frontal && p.x >= 0.0 {
            let cube = [p.x, p.y, p.z].map(|c| (c / 5.0).floor() as i32);
            taken.entry(cube).or_insert(v);
        }
    }
    // An order without pattern, so that every thinned list covers the whole face.
    let mut chosen: Vec<usize> = taken.into_values().collect();
    chosen.sort_by_key(|v| (*v as u32).wrapping_mul(2_654_435_761));
    let side: Vec<(Point3, Vector3)> = (chosen.iter())
        .map(|&v| (mesh.positions[v], normals[v]))
        .collect();
    FacePoints::mirrored(&side)
}

/// The reference's nose tip, as the detector of [`nose`] sees it.
fn reference_nose(reference: &ReferenceHead) -> (Point3, Vector3) {
    let mesh = &reference.mesh;
    let front = mesh
        .positions
        .iter()
        .copied()
        .max_by(|a, b| a.z.total_cmp(&b.z))
        .unwrap_or_else(Point3::origin);
    let (tip, normal) = nose::tips(&Cubes::new(mesh, &mesh.vertex_normals(), 1.0), 8)
        .into_iter()
        .min_by(|a, b| {
            (a.point - front)
                .norm()
                .total_cmp(&(b.point - front).norm())
        })
        .map_or((front, Vector3::z()), |t| (t.point, t.normal));
    // On the middle plane of the head.
    let normal = Vector3::new(0.0, normal.y, normal.z).try_normalize(1e-9);
    (
        Point3::new(0.0, tip.y, tip.z),
        normal.unwrap_or_else(Vector3::z),
    )
}

/// Diagonal of the box that holds the middle 96 % of the vertices along each axis, in the scan's unit.
fn robust_diagonal(mesh: &Mesh) -> f64 {
    let mut used = vec![false; mesh.positions.len()];
    for v in mesh.triangles.iter().flatten() {
        used[*v as usize] = true;
    }
    let spread = |axis: usize| {
        let mut values: Vec<f64> = (mesh.positions.iter())
            .zip(&used)
            .filter(|(_, u)| **u)
            .map(|(p, _)| p[axis])
            .collect();
        let n = values.len();
        if n == 0 {
            return 0.0;
        }
        let mut ranked = |rank: usize| *values.select_nth_unstable_by(rank, f64::total_cmp).1;
        ranked(n - 1 - n / 50) - ranked(n / 50)
    };
    Vector3::new(spread(0), spread(1), spread(2)).norm()
}
