//! Faces that are no good: built and solved all the same, or refused with a reason; never a NaN, never a panic.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use facile_core::reference::Role;
use facile_core::{Point3, ReferenceHead, Subject};
use facile_sim::{
    Equilibrium, ExpressionSet, FaceModel, FaceRig, MuscleSet, Pose, SimError, Solver,
    SolverParams, mean_subject,
};

fn reference() -> &'static ReferenceHead {
    ReferenceHead::embedded()
}

fn rig() -> &'static FaceRig {
    static RIG: OnceLock<FaceRig> = OnceLock::new();
    RIG.get_or_init(|| FaceRig::new(reference(), MuscleSet::embedded()).expect("built in"))
}

fn pose(name: &str) -> Pose {
    let expression = ExpressionSet::embedded().get(name).expect("built in");
    expression.pose(MuscleSet::embedded()).expect("valid")
}

fn solve(model: &FaceModel, name: &str) -> Equilibrium {
    Solver::new()
        .solve(model, &pose(name), &SolverParams::default())
        .unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Builds a subject and solves some expressions, which have to certify with finite faces.
fn poses_well(head: &ReferenceHead, rig: &FaceRig, subject: &Subject, names: &[&str]) {
    let model = rig.model(head, subject).expect("built");
    let neutral = solve(&model, "neutral");
    assert_eq!(neutral.positions, subject.positions);
    for name in names {
        let face = solve(&model, name);
        assert!(
            face.positions
                .iter()
                .all(|p| p.iter().all(|c| c.is_finite())),
            "{name}"
        );
        assert!(face.certificate.max_penetration_mm <= 0.02, "{name}");
        let moved = face.positions.iter().zip(&subject.positions);
        let farthest = moved.map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
        assert!(farthest > 0.5 && farthest < 80.0, "{name}: {farthest} mm");
    }
}

/// Cage vertices on the skin around a place, nearest first.
fn around(place: Point3) -> Vec<usize> {
    let head = reference();
    let mut found: Vec<usize> = (0..head.cage.positions.len())
        .filter(|&v| head.cage.roles[v] == Role::Free)
        .collect();
    let away = |v: usize| (head.mesh.positions[v] - place).norm();
    found.sort_by(|a, b| away(*a).total_cmp(&away(*b)));
    found
}

/// Places on a cheek, at a corner of the mouth, and on an upper lid.
fn places() -> [Point3; 3] {
    let scheme = reference().scheme("ibug68").expect("built in");
    let mark = |k: usize| {
        scheme.points[k].position(&reference().mesh.positions, &reference().mesh.triangles)
    };
    let cheek = mark(31) + (mark(3) - mark(31)) * 0.5;
    [cheek, mark(54), mark(43)]
}

#[test]
fn edges_of_no_length_and_triangles_of_no_area() {
    for (k, place) in places().into_iter().enumerate() {
        let near = around(place);
        // Two vertices at one place, then a whole patch of them; both layers' triangles there have no area.
        for count in [2, 9] {
            let mut subject = mean_subject(reference());
            let target = subject.positions[near[0]];
            for &v in &near[..count] {
                subject.positions[v] = target;
            }
            let names = if k == 0 {
                &["smile", "surprise"][..]
            } else {
                &["smile"][..]
            };
            poses_well(reference(), rig(), &subject, names);
        }
    }
}

#[test]
fn a_face_that_is_one_point_is_refused() {
    let mut subject = mean_subject(reference());
    subject.positions.fill(Point3::new(0.0, 0.0, 80.0));
    let error = rig().model(reference(), &subject).expect_err("no face");
    assert!(
        error.to_string().contains("no skin faces outwards"),
        "{error}"
    );
}

#[test]
fn tissue_without_thickness_and_tissue_that_jumps() {
    let n = reference().cage.thickness.len();
    let kinds: [&dyn Fn(usize) -> f64; 4] = [
        &|_| 0.0,
        &|v| if v % 2 == 0 { 0.0 } else { 12.0 },
        &|v| if v % 3 == 0 { -4.0 } else { 5.0 },
        &|v| if v % 5 == 0 { f64::NAN } else { 5.0 },
    ];
    for thickness in kinds {
        let mut head = reference().clone();
        head.cage.thickness = (0..n).map(thickness).collect();
        let rig = FaceRig::new(&head, MuscleSet::embedded()).expect("muscles reach");
        poses_well(&head, &rig, &mean_subject(&head), &["smile", "surprise"]);
    }
}

/// The reference head with a face of the cage, and its mirror image, cut out of the skin: what is around it follows
/// passively, its corners are bound to nothing.
fn with_island(face: &[u32]) -> ReferenceHead {
    let mut head = reference().clone();
    let cage = &mut head.cage;
    let inside: BTreeSet<u32> = face
        .iter()
        .flat_map(|&v| [v, cage.mirror[v as usize]])
        .collect();
    for f in &cage.faces {
        if f.iter().any(|v| inside.contains(v)) {
            for v in f.iter().filter(|v| !inside.contains(v)) {
                cage.roles[*v as usize] = Role::Passive;
            }
        }
    }
    for &v in &inside {
        cage.attached[v as usize] = false;
    }
    head
}

#[test]
fn an_island_that_nothing_holds_goes_with_the_skull() {
    // Somewhere at the side of the forehead where no muscle's line runs.
    let is_free = |f: &[u32]| {
        f.iter()
            .all(|&v| reference().cage.roles[v as usize] == Role::Free)
    };
    let corners = around(Point3::new(45.0, 55.0, 70.0));
    let found = corners.iter().take(60).find_map(|&corner| {
        let faces = reference().cage.faces.iter();
        let face = faces
            .filter(|f| f.contains(&(corner as u32)))
            .find(|f| is_free(f))?;
        let head = with_island(face);
        let rig = FaceRig::new(&head, MuscleSet::embedded()).ok()?;
        Some((head, rig, face.clone()))
    });
    let (head, rig, island) = found.expect("a place without muscles");
    let subject = mean_subject(&head);
    poses_well(&head, &rig, &subject, &["smile", "mouth_open"]);
    // Nothing pulls on it and it stays.
    let model = rig.model(&head, &subject).expect("built");
    let (rest, face) = (solve(&model, "neutral"), solve(&model, "mouth_open"));
    for &v in &island {
        let away = |i: &usize| (rest.nodes[*i] - subject.positions[v as usize]).norm();
        let node = (0..rest.nodes.len()).min_by(|i, j| away(i).total_cmp(&away(j)));
        let node = node.expect("nodes");
        assert!(away(&node) < 1e-9);
        let moved = (face.nodes[node] - rest.nodes[node]).norm();
        assert!(moved < 0.01, "{moved}");
    }
}

#[test]
fn people_who_open_their_mouths_or_close_their_eyes_at_rest() {
    let model = rig()
        .model(reference(), &mean_subject(reference()))
        .expect("built");
    for name in ["mouth_open", "blink", "kiss"] {
        let mut subject = mean_subject(reference());
        subject.positions = solve(&model, name).positions;
        poses_well(
            reference(),
            rig(),
            &subject,
            &["smile", "blink", "mouth_open"],
        );
    }
}

#[test]
fn numbers_that_are_none_are_refused_with_their_place() {
    let refused = |change: &dyn Fn(&mut Subject), says: &str| {
        let mut subject = mean_subject(reference());
        change(&mut subject);
        let error = rig().model(reference(), &subject).expect_err("refused");
        assert!(matches!(error, SimError::Subject { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains("`mean`") && text.contains(says), "{text}");
    };
    // A cage vertex, and one of the fine mesh alone.
    refused(&|s| s.positions[7].x = f64::NAN, "vertex 7 is not finite");
    let last = reference().mesh.positions.len() - 1;
    refused(
        &|s| s.positions[last].y = f64::INFINITY,
        &format!("vertex {last} is not finite"),
    );
    refused(&|s| s.eyes[1].radius = 0.0, "right eye");
    refused(&|s| s.eyes[0].center.z = f64::NAN, "left eye");
    refused(
        &|s| s.skull_from_reference.isometry.translation.vector.x = f64::NAN,
        "skull",
    );
    let mut short = mean_subject(reference());
    short.positions.pop();
    assert!(matches!(
        rig().model(reference(), &short),
        Err(SimError::SizeMismatch { .. })
    ));
}
