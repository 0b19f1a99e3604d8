//! Places what the skull carries: eyeballs behind the lids, teeth and tongue behind the lips.

use facile_core::math::fit_similarity;
use facile_core::{Eye, Point3, ReferenceHead, Segment, Similarity3, Subject};

/// Lid vertices of the ring that defines an orbit lie within this distance of the eye's surface, mm.
const ORBIT: f64 = 12.0;
/// Share of lid vertices that may come closer to the eyeball than the reference's closest do.
const OUTLIERS: f64 = 0.05;

/// Left and right eye of a head with these fine positions.
///
/// The lids of reference and subject give a similarity for each orbit, which carries the eyeball; then it moves along
/// its own axis until the lids keep the clearance they have on the reference, touching and not poked through.
pub(crate) fn place_eyes(reference: &ReferenceHead, positions: &[Point3]) -> [Eye; 2] {
    [
        (Segment::LeftEyelid, reference.eyes[0]),
        (Segment::RightEyelid, reference.eyes[1]),
    ]
    .map(|(segment, eye)| place_eye(reference, positions, segment, eye))
}

fn place_eye(reference: &ReferenceHead, positions: &[Point3], segment: Segment, eye: Eye) -> Eye {
    let mesh = &reference.mesh;
    let mut on_lid = vec![false; mesh.positions.len()];
    for (t, s) in mesh.triangles.iter().zip(&mesh.segments) {
        if *s == segment {
            for &v in t {
                on_lid[v as usize] = true;
            }
        }
    }
    let height = |p: &Point3| (p - eye.center).norm() - eye.radius;
    let lids: Vec<usize> = (0..on_lid.len())
        .filter(|&v| on_lid[v] && height(&mesh.positions[v]) < ORBIT)
        .collect();
    let from: Vec<Point3> = lids.iter().map(|&v| mesh.positions[v]).collect();
    let to: Vec<Point3> = lids.iter().map(|&v| positions[v]).collect();
    // The rim next to the eyeball counts most.
    let weights: Vec<f64> = from
        .iter()
        .map(|p| 1.0 / (1.0 + height(p).max(0.0)))
        .collect();
    let Some(fit) = fit_similarity(&from, &to, &weights) else {
        return eye;
    };
    // Eyeballs vary little in size: let the lids scale them by at most 8 %.
    let radius = eye.radius * fit.scaling().clamp(0.92, 1.08);
    let center = fit * eye.center;
    let outwards = fit.isometry.rotation * facile_core::Vector3::z();
    let clearance = |center: Point3, points: &[Point3], radius: f64| {
        let mut all: Vec<f64> = points
            .iter()
            .map(|p| (p - center).norm() - radius)
            .collect();
        all.sort_unstable_by(f64::total_cmp);
        all.get((all.len() as f64 * OUTLIERS) as usize)
            .copied()
            .unwrap_or(0.0)
    };
    let wanted = clearance(eye.center, &from, eye.radius);
    // Moving back always opens the gap: bisect.
    let (mut back, mut front) = (-5.0, 5.0);
    for _ in 0..40 {
        let middle = 0.5 * (back + front);
        if clearance(center + outwards * middle, &to, radius) > wanted {
            back = middle;
        } else {
            front = middle;
        }
    }
    let mut placed = eye;
    placed.center = center + outwards * back;
    placed.radius = radius;
    placed
}

/// Places teeth and tongue of `reference` in a subject on its topology that was registered to another head.
///
/// Nothing happens if the topologies differ.
pub fn seat_skull(subject: &mut Subject, reference: &ReferenceHead) {
    if subject.positions.len() == reference.mesh.positions.len() {
        subject.skull_from_reference = place_skull(reference, &subject.positions);
    }
}

/// Places teeth and tongue: skull of the subject from the reference's.
///
/// The similarity of the surroundings of the mouth; moved back if the lips have become thinner than on the reference.
pub(crate) fn place_skull(reference: &ReferenceHead, positions: &[Point3]) -> Similarity3 {
    let mesh = &reference.mesh;
    let lips = |s: &Segment| matches!(s, Segment::UpperLip | Segment::LowerLip);
    let mut lip = vec![false; mesh.positions.len()];
    let mut inner = vec![false; mesh.positions.len()];
    for (t, s) in mesh.triangles.iter().zip(&mesh.segments) {
        for &v in t {
            lip[v as usize] |= lips(s);
            inner[v as usize] |= matches!(s, Segment::InnerMouth | Segment::EyeSocket);
        }
    }
    let count = lip.iter().filter(|l| **l).count().max(1) as f64;
    let mouth = (mesh.positions.iter())
        .zip(&lip)
        .filter(|(_, l)| **l)
        .fold(facile_core::Vector3::zeros(), |s, (p, _)| s + p.coords)
        / count;
    let mut weights = vec![0.0; mesh.positions.len()];
    for (v, w) in weights.iter_mut().enumerate() {
        if !inner[v] {
            let distance = (mesh.positions[v].coords - mouth).norm();
            *w = libm::exp(-(distance / 35.0).powi(2));
        }
    }
    let whole =
        fit_similarity(&mesh.positions, positions, &weights).unwrap_or_else(Similarity3::identity);
    // How deep the front teeth lie behind the lips along z, in the frame of the teeth.
    let depth = |points: &[Point3]| {
        let mut all: Vec<f64> = (mesh.positions.iter())
            .zip(points)
            .zip(&lip)
            .filter(|((r, _), l)| **l && r.x.abs() < 12.0)
            .map(|((r, p), _)| (whole.inverse() * p - r).z)
            .collect();
        all.sort_unstable_by(f64::total_cmp);
        all.get(all.len() / 20).copied().unwrap_or(0.0)
    };
    let thinner = (-depth(positions)).clamp(0.0, 6.0);
    whole * nalgebra::Translation3::new(0.0, 0.0, -thinner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_keeps_its_own_eyes_and_skull() {
        let reference = ReferenceHead::embedded();
        let eyes = place_eyes(reference, &reference.mesh.positions);
        for (found, expected) in eyes.iter().zip(&reference.eyes) {
            assert!((found.center - expected.center).norm() < 1e-6);
            assert!((found.radius - expected.radius).abs() < 1e-9);
        }
        let skull = place_skull(reference, &reference.mesh.positions);
        assert!((skull.scaling() - 1.0).abs() < 1e-9);
        assert!(skull.isometry.translation.vector.norm() < 1e-6);
    }

    #[test]
    fn a_moved_and_grown_head_takes_its_eyes_along() {
        let reference = ReferenceHead::embedded();
        let motion = Similarity3::new(
            facile_core::Vector3::new(3.0, -8.0, 2.0),
            facile_core::Vector3::new(0.0, 0.1, 0.0),
            1.05,
        );
        let positions: Vec<Point3> = reference
            .mesh
            .positions
            .iter()
            .map(|p| motion * p)
            .collect();
        let eyes = place_eyes(reference, &positions);
        for (found, expected) in eyes.iter().zip(&reference.eyes) {
            let distance = (found.center - motion * expected.center).norm();
            assert!(distance < 1.0, "{distance} mm");
            assert!((found.radius - 1.05 * expected.radius).abs() < 1e-9);
        }
    }
}
