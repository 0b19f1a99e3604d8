//! What muscles, jaw and gaze do to the mean head.

use std::sync::OnceLock;

use facile_core::reference::Role;
use facile_core::{Mesh, Point3, ReferenceHead, Segment};
use facile_sim::work_precision::largest_distance;
use facile_sim::{
    Equilibrium, ExpressionSet, FaceModel, MuscleSet, Pose, Solver, SolverParams, mean_subject,
};

fn model() -> &'static FaceModel {
    static MODEL: OnceLock<FaceModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        let reference = ReferenceHead::embedded();
        FaceModel::new(reference, MuscleSet::embedded(), &mean_subject(reference))
            .expect("the mean head")
    })
}

fn pose(key: &str, contraction: f64) -> Pose {
    let mut pose = Pose::default();
    pose.set(MuscleSet::embedded(), key, contraction)
        .expect("known");
    pose
}

fn solve(pose: &Pose) -> Equilibrium {
    Solver::new()
        .solve(model(), pose, &SolverParams::default())
        .expect("converges")
}

/// An ibug-68 landmark.
fn mark(positions: &[Point3], k: usize) -> Point3 {
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    scheme.points[k].position(positions, &reference.mesh.triangles)
}

fn rest(k: usize) -> Point3 {
    mark(&ReferenceHead::embedded().mesh.positions, k)
}

#[test]
fn no_muscle_makes_the_face_jump() {
    for muscle in MuscleSet::embedded().muscles() {
        for c in [0.1, 0.7] {
            let at = |more: f64| solve(&pose(&muscle.name, c + more));
            let start = at(0.0);
            let [half, whole] = [0.0005, 0.001].map(|more| largest_distance(&start, &at(more)));
            // What is left of a step half as long besides half the way is a jump.
            let jump = (whole - 2.0 * half).abs();
            assert!(jump < 0.002, "{} at {c}: {jump} mm", muscle.name);
            assert!(whole < 0.03, "{} at {c}: {whole} mm for 0.001", muscle.name);
        }
    }
}

#[test]
fn a_contracted_orbicularis_oris_is_dragged_along_by_the_jaw() {
    let pursed = pose("orbicularis_oris", 0.5);
    let mut dropped = pursed.clone();
    dropped.jaw.open_rad = 0.25;
    let (a, b) = (solve(&pursed), solve(&dropped));
    let drop = |k: usize| mark(&a.positions, k).y - mark(&b.positions, k).y;
    // Middle of the lower lip's rim, of the upper one's, both corners.
    let (lower, upper, left, right) = (drop(57), drop(51), drop(54), drop(48));
    assert!(lower > 4.0, "{lower}");
    assert!(upper < 0.5 * lower, "{upper} {lower}");
    assert!(
        left > 1.0 && right > 1.0 && left.max(right) < lower,
        "{left} {right}"
    );
    // The muscle still narrows the mouth that the jaw opens.
    let width = |p: &[Point3]| (mark(p, 54) - mark(p, 48)).norm();
    let mut open = Pose::default();
    open.jaw.open_rad = 0.25;
    assert!(width(&b.positions) < width(&solve(&open).positions) - 1.0);
}

#[test]
fn the_mentalis_lifts_the_chin_and_does_not_draw_the_lip_down() {
    for c in [0.5, 1.0] {
        let face = solve(&pose("mentalis", c));
        let rise = |k: usize| mark(&face.positions, k).y - rest(k).y;
        // Both rims of the lower lip in the middle stay where they are or rise, then the chin.
        assert!(
            rise(57) > -0.15 && rise(66) > -0.15,
            "{} {}",
            rise(57),
            rise(66)
        );
        let chin = face
            .positions
            .iter()
            .zip(&ReferenceHead::embedded().mesh.positions);
        let boss =
            chin.filter(|(_, p)| p.x.abs() < 8.0 && (-108.0..-100.0).contains(&p.y) && p.z > 60.0);
        let highest = boss.map(|(q, p)| q.y - p.y).fold(0.0, f64::max);
        assert!(highest > 3.0 * c, "{highest}");
    }
}

#[test]
fn lids_follow_the_gaze_down_and_up_but_not_to_the_side() {
    let look = |pitch: f64, yaw: f64| {
        let mut pose = Pose::default();
        pose.gaze.pitch_rad = pitch;
        pose.gaze.yaw_rad = yaw;
        solve(&pose)
    };
    let (down, up, aside) = (look(-0.3, 0.0), look(0.3, 0.0), look(0.0, 0.3));
    for (upper, lower) in [(43, 47), (38, 40)] {
        let rise = |face: &Equilibrium, k: usize| mark(&face.positions, k).y - rest(k).y;
        assert!(
            rise(&down, upper) < -1.0 && rise(&up, upper) > 0.5,
            "{upper}"
        );
        // The lower lid goes the same way, less far.
        assert!(rise(&down, lower) < 0.0 && rise(&down, lower) > rise(&down, upper));
        assert!(rise(&aside, upper).abs() < 1e-6);
    }
    let turned = aside.eyes[0] * facile_core::Vector3::z();
    assert!((turned.x - libm::sin(0.3)).abs() < 1e-9);
}

/// Front of a row of teeth over `x` and `y`: the largest `z` of its triangles there, from above.
fn front_of(teeth: &Mesh, place: impl Fn(Point3) -> Point3, x: f64, y: f64) -> Option<f64> {
    let at = |i: u32| place(teeth.positions[i as usize]);
    let over = teeth.triangles.iter().filter_map(|t| {
        let [a, b, c] = t.map(at);
        let area = |p: Point3, q: Point3, x: f64, y: f64| {
            (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)
        };
        let whole = area(a, b, c.x, c.y);
        if whole.abs() < 1e-9 {
            return None;
        }
        let w = [area(b, c, x, y), area(c, a, x, y), area(a, b, x, y)].map(|s| s / whole);
        let inside = w.iter().all(|w| *w >= 0.0);
        inside.then(|| w[0] * a.z + w[1] * b.z + w[2] * c.z)
    });
    over.reduce(f64::max)
}

#[test]
fn lips_and_cheeks_stay_in_front_of_the_teeth() {
    let reference = ReferenceHead::embedded();
    let subject = mean_subject(reference);
    let rows: Vec<_> = reference
        .parts
        .iter()
        .filter(|p| matches!(p.segment, Segment::UpperTeeth | Segment::LowerTeeth))
        .collect();
    // Skin over the jaws: all simulated cage vertices around the mouth, of lips and cheeks.
    let (low, high) = (rest(8).y, rest(33).y);
    let skin: Vec<usize> = (0..reference.cage.positions.len())
        .filter(|&v| reference.cage.roles[v] == Role::Free)
        .filter(|&v| (low..high).contains(&subject.positions[v].y))
        .filter(|&v| subject.positions[v].x.abs() < 40.0 && subject.positions[v].z > 40.0)
        .collect();
    assert!(skin.len() > 300);
    let deepest = |face: &Equilibrium| {
        let mut deepest = f64::INFINITY;
        for &v in &skin {
            let p = face.positions[v];
            for row in &rows {
                let is_lower = row.segment == Segment::LowerTeeth;
                let place = |q: Point3| if is_lower { face.jaw * q } else { q };
                if let Some(front) = front_of(&row.mesh, place, p.x, p.y) {
                    deepest = deepest.min(p.z - front);
                }
            }
        }
        deepest
    };
    let at_rest = deepest(&solve(&Pose::default()));
    for expression in ExpressionSet::embedded().expressions() {
        let pose = expression.pose(MuscleSet::embedded()).expect("valid");
        let now = deepest(&solve(&pose));
        // Flesh is thinned where it is drawn over the teeth, by less than half.
        assert!(now > 0.5 * at_rest, "{}: {now} mm", expression.name);
    }
}
