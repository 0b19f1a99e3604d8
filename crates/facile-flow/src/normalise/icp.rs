//! Trimmed iterative closest point: places the reference's face on a scan.

use facile_core::{Matrix3, Point3, Similarity3, UnitQuaternion, Vector3};
use nalgebra::{SMatrix, SVector, Translation3};

use super::cubes::Cubes;

/// A point of the surface near `p`, and the unit normal there; `None` if it is further than `reach` mm.
fn nearest(scan: &Cubes, p: &Point3, reach: f64) -> Option<(Point3, Vector3)> {
    let (point, normal) = scan.nearest(p)?;
    // The foot on the point's plane: the points are too sparse to be distances.
    let foot = p - normal * normal.dot(&(p - point));
    let near = (foot - point).norm() < 2.0 * super::cubes::SIDE;
    let point = if near { foot } else { point };
    ((point - p).norm() <= reach).then_some((point, normal))
}

/// Points of the reference's face with normals, reference frame: those of one side, then their mirror images.
pub(crate) struct FacePoints {
    /// Positions, mm.
    pub(crate) points: Vec<Point3>,
    /// Unit normals.
    pub(crate) normals: Vec<Vector3>,
}

impl FacePoints {
    /// Points of one side with their normals, and their mirror images: so that a mirrored scan gives the mirrored pose.
    pub(crate) fn mirrored(side: &[(Point3, Vector3)]) -> Self {
        let turn = |v: &Vector3| Vector3::new(-v.x, v.y, v.z);
        let both = |side: &mut dyn Iterator<Item = Vector3>| -> Vec<Vector3> {
            let mut all: Vec<Vector3> = side.collect();
            all.extend(all.clone().iter().map(turn));
            all
        };
        Self {
            points: both(&mut side.iter().map(|s| s.0.coords))
                .into_iter()
                .map(Point3::from)
                .collect(),
            normals: both(&mut side.iter().map(|s| s.1)),
        }
    }

    /// Every `step`-th point and its mirror image.
    pub(crate) fn thinned(&self, count: usize) -> Self {
        let half = self.points.len() / 2;
        let step = self.points.len().div_ceil(count.max(1)).max(1);
        let chosen: Vec<usize> = (0..half).step_by(step).collect();
        let side: Vec<(Point3, Vector3)> = (chosen.iter())
            .map(|&i| (self.points[i], self.normals[i]))
            .collect();
        Self::mirrored(&side)
    }
}

/// How well a pose fits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseScore {
    /// Share of the face's points with scan surface that looks the same way within [`REACH`].
    pub(crate) coverage: f64,
    /// Root of the mean squared distance, missing points counting [`REACH`], mm.
    pub(crate) rms: f64,
    /// What poses are compared by: the squared distance plus what the normals say, mm^2. Distances alone let a face
    /// slide along itself.
    pub(crate) cost: f64,
}

/// Squared distance that normals at right angles weigh as much as, mm^2.
const NORMAL_COST: f64 = 150.0;

/// Surface further away than this does not count as the same place, mm.
pub(crate) const REACH: f64 = 12.0;
/// Share of the nearest pairs that move the pose; hair, collar and holes take the rest.
const KEPT: f64 = 0.8;
/// Standard deviation of the logarithm of head size around the reference's.
const SIZE_DEVIATION: f64 = 0.06;

/// One pair of the fit: a point of the face, its nearest point on the scan, the scan's normal; scan frame, mm.
struct Pair {
    from: Point3,
    to: Point3,
    normal: Vector3,
    distance: f64,
    /// Of the angle between the two normals.
    cosine: f64,
}

fn pairs(
    face: &FacePoints,
    scan: &Cubes,
    pose: &Similarity3,
    reach: f64,
) -> impl Iterator<Item = Option<Pair>> {
    (face.points.iter()).zip(&face.normals).map(move |(p, n)| {
        let from = pose * p;
        let (to, normal) = nearest(scan, &from, reach)?;
        let cosine = normal.dot(&(pose.isometry.rotation * n));
        if cosine < 0.5 {
            return None;
        }
        let distance = (to - from).norm();
        Some(Pair {
            from,
            to,
            normal,
            distance,
            cosine,
        })
    })
}

/// Scores a pose; points without surface within `reach` mm count as that far. Cost O(n log m).
pub(crate) fn score(face: &FacePoints, scan: &Cubes, pose: &Similarity3, reach: f64) -> PoseScore {
    let (mut found, mut square, mut total, mut turned) = (0.0, 0.0, 0.0, 0.0);
    for pair in pairs(face, scan, pose, reach) {
        total += 1.0;
        let (distance, cosine) = pair.map_or((reach, 0.5), |p| {
            found += 1.0;
            (p.distance, p.cosine)
        });
        square += distance * distance;
        turned += 1.0 - cosine;
    }
    let total = f64::max(total, 1.0);
    PoseScore {
        coverage: found / total,
        rms: (square / total).sqrt(),
        cost: (square + NORMAL_COST * turned) / total,
    }
}

/// Improves a pose (scan from reference, mm) by `iterations` steps of point-to-plane distances, each with the nearest
/// 80 % of the pairs. The size is held near 1 by what is known of heads. Cost O(iterations n log m).
///
/// Source: Chen and Medioni 1992 (planes); Chetverikov et al. 2002 (trimming).
pub(crate) fn refine(
    face: &FacePoints,
    scan: &Cubes,
    mut pose: Similarity3,
    iterations: usize,
    reach: f64,
) -> Similarity3 {
    for k in 0..iterations {
        // Look far at first, nearer once the pose is good.
        let reach = reach * (1.0 - 0.6 * k as f64 / iterations as f64);
        let mut matched: Vec<Pair> = pairs(face, scan, &pose, reach).flatten().collect();
        if matched.len() < 12 {
            return pose;
        }
        // The nearest, in the order of the face's points.
        let kept = (matched.len() as f64 * KEPT).ceil() as usize;
        let mut distances: Vec<f64> = matched.iter().map(|p| p.distance).collect();
        let limit = *distances.select_nth_unstable_by(kept - 1, f64::total_cmp).1;
        matched.retain(|p| p.distance <= limit);
        let Some(step) = gauss_newton_step(&matched, &pose) else {
            return pose;
        };
        pose = step;
    }
    pose
}

/// Weight of the plain distance of a pair against that along the normal.
const PLAIN: f64 = 0.05;

/// Least-squares step of rotation, translation and size about the pairs' centre.
fn gauss_newton_step(pairs: &[Pair], pose: &Similarity3) -> Option<Similarity3> {
    let n = pairs.len() as f64;
    let center = pairs
        .iter()
        .fold(Vector3::zeros(), |s, p| s + p.from.coords)
        / n;
    let mut matrix = SMatrix::<f64, 7, 7>::zeros();
    let mut right = SVector::<f64, 7>::zeros();
    let (mut spread, mut plain) = (Matrix3::zeros(), SVector::<f64, 7>::zeros());
    for pair in pairs {
        let (arm, axis, wrong) = (pair.from.coords - center, pair.normal, pair.to - pair.from);
        let turn = arm.cross(&axis);
        let row = SVector::<f64, 7>::from([
            turn.x,
            turn.y,
            turn.z,
            axis.x,
            axis.y,
            axis.z,
            arm.dot(&axis),
        ]);
        matrix += row * row.transpose();
        right += row * axis.dot(&wrong);
        spread += arm * arm.transpose();
        let twist = arm.cross(&wrong);
        plain += SVector::<f64, 7>::from([
            twist.x,
            twist.y,
            twist.z,
            wrong.x,
            wrong.y,
            wrong.z,
            arm.dot(&wrong),
        ]);
    }
    // Planes slide freely: a little of the plain distance keeps the pose from drifting along flat cheeks. About the
    // centre its rotation, translation and size do not mix.
    let inertia = Matrix3::identity() * spread.trace() - spread;
    for i in 0..3 {
        for j in 0..3 {
            matrix[(i, j)] += PLAIN * inertia[(i, j)];
        }
        matrix[(3 + i, 3 + i)] += PLAIN * n;
    }
    matrix[(6, 6)] += PLAIN * spread.trace();
    right += plain * PLAIN;
    // Prior of size, with the weight that 2 mm of noise per pair gives it.
    let prior = n * 4.0 / (SIZE_DEVIATION * SIZE_DEVIATION) / 100.0;
    matrix[(6, 6)] += prior;
    right[6] -= prior * libm::log(pose.scaling());
    let step = matrix.cholesky()?.solve(&right);
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    let size = step[6].clamp(-0.1, 0.1);
    let shift = Vector3::new(step[3], step[4], step[5]);
    let about_center = Similarity3::from_parts(
        Translation3::from(center + shift),
        rotation,
        libm::exp(size),
    ) * Translation3::from(-center);
    Some(about_center * pose)
}
