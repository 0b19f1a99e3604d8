//! What an equilibrium must be, on the mean head.

use std::sync::OnceLock;

use facile_core::identity::IdentityModel;
use facile_core::rng::RandomStream;
use facile_core::{
    Isometry3, Point3, ReferenceHead, Similarity3, Subject, UnitQuaternion, Vector3,
};
use facile_sim::stress::random_pose;
use facile_sim::work_precision::{largest_distance, work_precision};
use facile_sim::{
    Equilibrium, ExpressionSet, FaceModel, FaceRig, MuscleSet, PaperParams, Pose, Solver,
    SolverKind, SolverParams,
};

fn mean_subject() -> Subject {
    facile_sim::mean_subject(ReferenceHead::embedded())
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

fn named(name: &str) -> Pose {
    let expression = ExpressionSet::embedded().get(name).expect("built in");
    expression.pose(MuscleSet::embedded()).expect("valid")
}

/// Largest distance of a solver's nodes from those of the default, mm.
fn disagreement(model: &FaceModel, pose: &Pose, kind: SolverKind) -> f64 {
    let fast = solve(model, pose);
    let slow = Solver::new()
        .solve(model, pose, &SolverParams::of(kind))
        .expect("rests");
    largest_distance(&fast, &slow)
}

#[test]
fn verlet_finds_the_same_equilibrium() {
    let away = disagreement(model(), &named("anger"), SolverKind::Verlet);
    assert!(away < 0.01, "{away} mm apart");
}

#[test]
fn fire_finds_the_same_equilibrium() {
    for name in ["anger", "blink"] {
        let away = disagreement(model(), &named(name), SolverKind::Fire);
        assert!(away < 0.01, "{name}: {away} mm apart");
    }
}

#[test]
#[ignore = "minutes: every solver on every expression"]
fn all_solvers_agree_on_all_expressions() {
    for expression in ExpressionSet::embedded().expressions() {
        let pose = named(&expression.name);
        for kind in [SolverKind::Verlet, SolverKind::Fire] {
            let away = disagreement(model(), &pose, kind);
            assert!(
                away < 0.01,
                "{} by {}: {away} mm",
                expression.name,
                kind.name()
            );
        }
    }
}

#[test]
fn a_longer_path_ends_in_the_same_equilibrium() {
    for name in ["smile", "surprise"] {
        let pose = named(name);
        let direct = solve(model(), &pose);
        let params = SolverParams {
            continuation_step: 0.1,
            ..SolverParams::default()
        };
        let careful = Solver::new()
            .solve(model(), &pose, &params)
            .expect("converges");
        let away = largest_distance(&direct, &careful);
        assert!(away < 0.01, "{name}: {away} mm apart");
    }
}

#[test]
fn a_ladder_of_intensities_ends_in_the_same_equilibria() {
    let pose = named("disgust");
    let rungs = [0.25, 0.5, 0.75, 1.0];
    let mut solver = Solver::new();
    let ladder = solver.solve_ladder(model(), &pose, &rungs, &SolverParams::default());
    let mut warm = 0;
    let mut cold = 0;
    for (rung, found) in rungs.iter().zip(ladder) {
        let found = found.expect("converges");
        let alone = solve(model(), &pose.scaled(*rung));
        let away = largest_distance(&found, &alone);
        assert!(away < 0.01, "at {rung}: {away} mm apart");
        warm += found.certificate.iterations;
        cold += alone.certificate.iterations;
    }
    assert!(warm < cold, "{warm} iterations warm, {cold} cold");
}

#[test]
fn no_expression_turns_flesh_inside_out() {
    for name in ["smile", "anger", "surprise", "kiss", "wink"] {
        let face = solve(model(), &named(name)).certificate;
        assert_eq!(face.inverted_elements, 0, "{name}");
        assert!(face.smallest_pivot > 0.0, "{name}");
    }
}

/// A muscle that is not contracted goes along with the jaw, as section 4.2 says of the orbicularis oris: the lower lip's
/// part of it moves down with the chin, the upper lip's stays.
#[test]
fn an_opening_jaw_drags_the_orbicularis_oris_along() {
    let mut open = Pose::default();
    open.jaw.open_rad = 0.25;
    let face = solve(model(), &open);
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    let rest = mean_subject().positions;
    let drop = |k: usize| {
        let at = |p: &[Point3]| scheme.points[k].position(p, &reference.mesh.triangles);
        at(&rest).y - at(&face.positions).y
    };
    let (upper, lower, chin, corner) = (drop(51), drop(57), drop(8), drop(54));
    assert!(chin > 8.0 && lower > 0.6 * chin, "lip {lower}, chin {chin}");
    assert!(upper < 0.25 * lower, "upper {upper}, lower {lower}");
    assert!(corner > upper && corner < lower, "corner {corner}");
}

#[test]
fn teeth_and_chin_follow_the_condyles() {
    let condyles = [52.0, -52.0].map(|x| Point3::new(x, -22.0, 4.0));
    let jaw_of = |open: f64, forward: f64, aside: f64| {
        let mut pose = Pose::default();
        pose.jaw.open_rad = open;
        pose.jaw.protrusion_mm = forward;
        pose.jaw.lateral_mm = aside;
        solve(model(), &pose)
    };
    let way = |face: &Equilibrium, k: usize| face.jaw * condyles[k] - condyles[k];
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    let chin = |face: &Equilibrium| {
        let at = |p: &[Point3]| scheme.points[8].position(p, &reference.mesh.triangles);
        at(&face.positions) - at(&mean_subject().positions)
    };
    // Protruded: straight along the eminences.
    let ahead = jaw_of(0.0, 5.0, 0.0);
    assert!(ahead.jaw.rotation.angle() < 1e-9);
    assert!((way(&ahead, 0).z - 5.0).abs() < 1e-9 && way(&ahead, 0).y < -3.0);
    assert!(chin(&ahead).z > 3.5 && chin(&ahead).y < -2.0);
    // Sideways: about the condyle of that side.
    let aside = jaw_of(0.0, 0.0, 6.0);
    assert!(way(&aside, 0).norm() < 0.2 && way(&aside, 1).z > 3.0);
    assert!(chin(&aside).x > 4.0, "{}", chin(&aside));
    // Open: the condyles go along, both alike.
    let open = jaw_of(0.35, 0.0, 0.0);
    assert!((open.jaw.rotation.angle() - 0.35).abs() < 1e-9);
    assert!(way(&open, 0).z > 4.0 && way(&open, 0).y < -3.0);
    assert!((way(&open, 0) - way(&open, 1)).norm() < 1e-9);
}

#[test]
fn lids_slide_on_the_eyeball() {
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    let rest = mean_subject();
    for c in [0.3, 0.6, 1.0] {
        let face = solve(model(), &named("blink").scaled(c));
        for (k, eye) in [(43, 0), (44, 0), (46, 0), (47, 0), (37, 1), (38, 1)] {
            let away = |p: &[Point3]| {
                let at = scheme.points[k].position(p, &reference.mesh.triangles);
                (at - rest.eyes[eye].center).norm()
            };
            let (before, after) = (away(&rest.positions), away(&face.positions));
            assert!((after - before).abs() < 1.5, "{k} at {c}: {before} {after}");
        }
    }
}

#[test]
fn the_face_moves_continuously_with_the_contraction() {
    let at = |c: f64| solve(model(), &pose(&[("risorius", c)]));
    for c in [0.2, 0.7] {
        let away = largest_distance(&at(c), &at(c + 0.001));
        assert!(away < 0.02, "at {c}: {away} mm for 0.001");
    }
}

#[test]
fn a_thousand_times_the_stiffness_gives_the_same_shape() {
    let soft = PaperParams::default();
    let stiff = PaperParams {
        skin_stiffness: 1e3 * soft.skin_stiffness,
        skin_fascia_stiffness: 1e3 * soft.skin_fascia_stiffness,
        fascia_stiffness: 1e3 * soft.fascia_stiffness,
        fascia_skull_stiffness: 1e3 * soft.fascia_skull_stiffness,
        shape_stiffness: 1e3 * soft.shape_stiffness,
        volume_stiffness: 1e3 * soft.volume_stiffness,
        ..soft
    };
    let model_of_stone = rig()
        .model_with(ReferenceHead::embedded(), &mean_subject(), stiff)
        .expect("valid");
    let pose = pose(&[("zygomatic_major", 0.5), ("mentalis", 0.7)]);
    let away = largest_distance(&solve(model(), &pose), &solve(&model_of_stone, &pose));
    assert!(away < 0.01, "{away} mm");
}

#[test]
fn lips_that_are_pressed_together_do_not_pass_through_each_other() {
    let mut shut = pose(&[("mentalis", 0.8), ("orbicularis_oris_upper_marginal", 0.6)]);
    shut.jaw.open_rad = -0.03;
    let face = solve(model(), &shut);
    assert!(
        face.certificate.lip_overlap_mm < 0.4,
        "{:?}",
        face.certificate
    );
}

#[test]
fn random_poses_certify_without_penetration() {
    let reference = ReferenceHead::embedded();
    for number in 0..3 {
        let subject = IdentityModel::embedded()
            .sample(reference, 7, number)
            .expect("embedded");
        let model = rig().model(reference, &subject).expect("valid");
        let mut random = RandomStream::new(11, number);
        let pose = random_pose(MuscleSet::embedded(), 0.6, &mut random);
        let face = solve(&model, &pose);
        assert!(face.certificate.max_penetration_mm < 1e-6);
        assert!(face.certificate.residual <= SolverParams::default().tolerance);
    }
}

#[test]
fn a_smaller_tolerance_gives_a_smaller_error() {
    let pose = pose(&[("corrugator", 0.5)]);
    let rows = work_precision(model(), &pose, &[SolverKind::QuasiStatic], &[1e-2, 2e-4], 1)
        .expect("converges");
    let cold: Vec<f64> = rows
        .iter()
        .filter(|r| !r.warm)
        .map(|r| r.error_mm)
        .collect();
    assert!(
        rows.len() == 4 && cold[1] < cold[0] && cold[1] < 0.01,
        "{rows:?}"
    );
}

#[test]
fn a_smile_lifts_and_widens_the_mouth_and_a_blink_closes_the_eyes() {
    let reference = ReferenceHead::embedded();
    let scheme = reference.scheme("ibug68").expect("built in");
    let mark = |positions: &[Point3], k: usize| {
        scheme.points[k].position(positions, &reference.mesh.triangles)
    };
    let rest = mean_subject().positions;
    let posed = |name: &str| solve(model(), &named(name));
    let smile = posed("smile");
    let corner = mark(&smile.positions, 54) - mark(&rest, 54);
    assert!(corner.x > 2.0 && corner.y > 3.0, "{corner}");
    let open = posed("mouth_open");
    let gap = mark(&open.positions, 62).y - mark(&open.positions, 66).y;
    assert!(gap > 8.0, "{gap}");
    let blink = posed("blink");
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
