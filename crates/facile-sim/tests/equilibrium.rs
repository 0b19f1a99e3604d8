//! What an equilibrium must be, on the mean head.

use std::sync::OnceLock;

use facile_core::{
    Attributes, Isometry3, Point3, ReferenceHead, Similarity3, Subject, UnitQuaternion, Vector3,
};
use facile_sim::{
    Equilibrium, ExpressionSet, FaceModel, FaceRig, MuscleSet, Pose, Solver, SolverParams,
};

fn mean_subject() -> Subject {
    let reference = ReferenceHead::embedded();
    Subject {
        id: "mean".to_owned(),
        attributes: Attributes::default(),
        positions: reference.mesh.positions.clone(),
        expected_error: vec![0.0; reference.mesh.positions.len()],
        texture: reference.texture.clone(),
        eyes: reference.eyes,
        eye_color: "brown".to_owned(),
        skull_from_reference: Similarity3::identity(),
    }
}

fn rig() -> &'static FaceRig {
    static RIG: OnceLock<FaceRig> = OnceLock::new();
    RIG.get_or_init(|| {
        FaceRig::new(ReferenceHead::embedded(), MuscleSet::embedded()).expect("built in")
    })
}

fn model() -> &'static FaceModel {
    static MODEL: OnceLock<FaceModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        rig()
            .model(ReferenceHead::embedded(), &mean_subject())
            .expect("the mean head")
    })
}

fn pose(pairs: &[(&str, f64)]) -> Pose {
    let mut pose = Pose::default();
    for (key, c) in pairs {
        pose.set(MuscleSet::embedded(), key, *c).expect("known");
    }
    pose
}

fn solve(model: &FaceModel, pose: &Pose) -> Equilibrium {
    Solver::new()
        .solve(model, pose, &SolverParams::default())
        .expect("converges")
}

fn farthest(a: &[Point3], b: &[Point3]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(p, q)| (p - q).norm())
        .fold(0.0, f64::max)
}

#[test]
fn no_contraction_is_the_neutral_face() {
    let face = solve(model(), &Pose::default());
    assert!(farthest(&face.positions, &mean_subject().positions) < 1e-9);
    assert!(face.certificate.residual < 1e-9);
    let almost = pose(&[("zygomatic_major", 1e-9)]);
    let face = solve(model(), &almost);
    assert!(farthest(&face.positions, &mean_subject().positions) < 1e-6);
}

#[test]
fn mirrored_contractions_give_the_mirrored_face() {
    let one = pose(&[("zygomatic_major.left", 0.6), ("corrugator.right", 0.5)]);
    let left = solve(model(), &one);
    let right = solve(model(), &one.mirrored());
    let mirror = &ReferenceHead::embedded().cage.mirror;
    for (v, &m) in mirror.iter().enumerate() {
        let (p, q) = (left.positions[v], right.positions[m as usize]);
        let away = Vector3::new(p.x + q.x, p.y - q.y, p.z - q.z).norm();
        assert!(away < 0.05, "vertex {v}: {away} mm");
    }
    let moved = farthest(&left.positions, &mean_subject().positions);
    assert!(moved > 2.0);
}

#[test]
fn a_turned_subject_gives_the_turned_face() {
    let reference = ReferenceHead::embedded();
    let turn = Isometry3::from_parts(
        Vector3::new(12.0, -5.0, 30.0).into(),
        UnitQuaternion::from_euler_angles(0.2, -0.4, 0.1),
    );
    let mut subject = mean_subject();
    for p in &mut subject.positions {
        *p = turn * *p;
    }
    for eye in &mut subject.eyes {
        eye.center = turn * eye.center;
    }
    subject.skull_from_reference = Similarity3::from_isometry(turn, 1.0);
    let turned = rig().model(reference, &subject).expect("valid");
    let mut smirk = pose(&[("zygomatic_major.left", 0.4)]);
    smirk.jaw.open_rad = 0.05;
    let (a, b) = (solve(model(), &smirk), solve(&turned, &smirk));
    let back: Vec<Point3> = b
        .positions
        .iter()
        .map(|p| turn.inverse_transform_point(p))
        .collect();
    assert!(farthest(&a.positions, &back) < 0.05);
}

#[test]
fn verlet_finds_the_same_equilibrium() {
    let pose = pose(&[("corrugator", 0.3)]);
    let fast = solve(model(), &pose);
    let slow = Solver::new()
        .solve(model(), &pose, &SolverParams::verlet())
        .expect("rests");
    let away = farthest(&fast.nodes, &slow.nodes);
    assert!(away < 0.05, "{away} mm apart");
}

#[test]
fn a_smile_lifts_and_widens_the_mouth_and_a_blink_closes_the_eyes() {
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    let mark = |positions: &[Point3], k: usize| {
        scheme.points[k].position(positions, &reference.mesh.triangles)
    };
    let rest = mean_subject().positions;
    let named = |name: &str| {
        let expression = ExpressionSet::embedded().get(name).expect("built in");
        solve(
            model(),
            &expression.pose(MuscleSet::embedded()).expect("valid"),
        )
    };
    let smile = named("smile");
    let corner = mark(&smile.positions, 54) - mark(&rest, 54);
    assert!(corner.x > 2.0 && corner.y > 3.0, "{corner}");
    let open = named("mouth_open");
    let gap = mark(&open.positions, 62).y - mark(&open.positions, 66).y;
    assert!(gap > 8.0, "{gap}");
    let blink = named("blink");
    for (upper, lower) in [(43, 47), (44, 46), (37, 41), (38, 40)] {
        let slit = |p: &[Point3]| (mark(p, upper) - mark(p, lower)).norm();
        assert!(slit(&blink.positions) < 0.45 * slit(&rest));
    }
}

#[test]
fn the_same_solve_twice_gives_the_same_bits() {
    let pose = pose(&[("mentalis", 0.4)]);
    let mut solver = Solver::new();
    let params = SolverParams::default();
    let a = solver.solve(model(), &pose, &params).expect("converges");
    let b = solver.solve(model(), &pose, &params).expect("converges");
    assert_eq!(a.positions, b.positions);
    assert_eq!(a.certificate, b.certificate);
}
