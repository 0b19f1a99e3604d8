use std::collections::{BTreeMap, BTreeSet};

use facile_core::identity::IdentityModel;

use super::*;
use crate::elements::{SLIVER_SHARE, Volume};
use crate::template::Rims;
use crate::vector::{V3, dot, from_point, sub};
use crate::{FaceRig, MuscleSet, Pose, Solver, SolverParams, mean_subject};

/// Nodes of the coarse meshes of `facile bench sim`.
const COARSE: [usize; 2] = [500, 1000];

fn coarse() -> Vec<Resolution> {
    let head = ReferenceHead::embedded();
    COARSE
        .map(|nodes| Resolution::coarser(head, nodes).expect("possible"))
        .into()
}

/// Number of faces at each edge.
fn sides(cage: &Cage) -> BTreeMap<(u32, u32), usize> {
    let mut sides = BTreeMap::new();
    for face in &cage.faces {
        for (k, &a) in face.iter().enumerate() {
            let b = face[(k + 1) % face.len()];
            *sides.entry((a.min(b), a.max(b))).or_insert(0) += 1;
        }
    }
    sides
}

/// Number of loops that some edges form; nothing if they form anything else.
fn loops(edges: impl Iterator<Item = (u32, u32)>) -> Option<usize> {
    let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (a, b) in edges {
        around.entry(a).or_default().push(b);
        around.entry(b).or_default().push(a);
    }
    if around.values().any(|ends| ends.len() != 2) {
        return None;
    }
    let mut count = 0;
    while let Some((&start, _)) = around.first_key_value() {
        let mut at = Some(start);
        while let Some(v) = at {
            let ends = around.remove(&v)?;
            at = ends.into_iter().find(|w| around.contains_key(w));
        }
        count += 1;
    }
    Some(count)
}

fn skin(head: &ReferenceHead) -> Vec<V3> {
    let n = head.cage.positions.len();
    head.mesh.positions[..n].iter().map(from_point).collect()
}

fn rims(head: &ReferenceHead) -> Rims {
    let eyes = head.eyes.map(|e| from_point(&e.center));
    Rims::new(&head.cage, &skin(head), eyes)
}

/// How the cage vertices of `head` move in a half smile, on it or on another mesh of it.
fn smile(head: &ReferenceHead, other: Option<&Resolution>) -> Vec<Vector3> {
    let muscles = MuscleSet::embedded();
    let mut pose = Pose::default();
    pose.set(muscles, "zygomatic_major", 0.6).expect("known");
    pose.jaw.open_rad = 0.1;
    let own = mean_subject(head);
    let (mesh, subject) = other.map_or((head, own.clone()), |r| (&r.head, r.subject(&own)));
    let rig = FaceRig::new(mesh, muscles).expect("muscles reach");
    let free = |head: &ReferenceHead| {
        let roles = head.cage.roles.iter();
        roles.filter(|r| **r == Role::Free).count()
    };
    assert_eq!(rig.template().free_count(), free(mesh));
    let params = Resolution::params(free(head), free(mesh));
    let model = rig.model_with(mesh, &subject, params).expect("built");
    let face = Solver::new()
        .solve(&model, &pose, &SolverParams::default())
        .expect("certifies");
    assert_eq!(face.certificate.inverted_elements, 0);
    let pairs = face.positions.iter().zip(&subject.positions);
    let moved: Vec<Vector3> = pairs.map(|(p, q)| p - q).collect();
    other.map_or(moved.clone(), |r| r.carry(&moved))
}

/// Mean distance of two motions at the free vertices of `head`, in the mean motion.
fn apart(head: &ReferenceHead, a: &[Vector3], b: &[Vector3]) -> f64 {
    let free: Vec<usize> = (0..head.cage.roles.len())
        .filter(|&v| head.cage.roles[v] == Role::Free)
        .collect();
    let distance: f64 = free.iter().map(|&v| (a[v] - b[v]).norm()).sum();
    distance / free.iter().map(|&v| a[v].norm()).sum::<f64>()
}

#[test]
fn other_meshes_move_as_the_face_does() {
    let head = ReferenceHead::embedded();
    let usual = smile(head, None);
    let finer = Resolution::finer(head, Cut::Centres);
    let coarse = coarse();
    // The paper's constants of shape are those of single prisms: other sizes are another material.
    for (mesh, limit) in [(&finer, 0.35), (&coarse[1], 0.35), (&coarse[0], 0.55)] {
        let distance = apart(head, &usual, &smile(head, Some(mesh)));
        assert!(distance < limit, "{distance} of the motion");
    }
    // What coarse faces cannot follow, if their nodes move just as they should, is a small part of that.
    for (mesh, limit) in coarse.iter().zip([0.1, 0.05]) {
        let source = mesh.origin.source.iter();
        let nodes: Vec<Vector3> = source.map(|&v| usual[v as usize]).collect();
        let distance = apart(head, &usual, &mesh.carry(&nodes));
        assert!(distance < limit, "{distance} of the motion");
        assert!(distance > 0.1 * limit, "{distance} of the motion");
    }
}

#[test]
fn coarser_meshes_have_the_nodes_that_were_asked_for_and_the_same_topology() {
    let head = ReferenceHead::embedded();
    let shape = |cage: &Cage| {
        let sides = sides(cage);
        assert!(sides.values().all(|n| *n <= 2));
        let border = sides.iter().filter(|(_, n)| **n == 1).map(|(e, _)| *e);
        let euler = cage.positions.len() + cage.faces.len() - sides.len();
        (euler, loops(border).expect("borders are loops"))
    };
    for (mesh, asked) in coarse().iter().zip(COARSE) {
        let cage = &mesh.head.cage;
        let roles = cage.roles.iter();
        let free = roles.filter(|r| **r == Role::Free).count();
        assert!(free == asked || free + 1 == asked, "{free} of {asked}");
        assert_eq!(shape(cage), shape(&head.cage));
        assert!(cage.faces.iter().all(|f| f.len() == 3));
    }
}

#[test]
fn a_finer_mesh_has_twice_or_four_times_the_nodes() {
    let head = ReferenceHead::embedded();
    let count = |head: &ReferenceHead| {
        let roles = head.cage.roles.iter();
        roles.filter(|r| **r == Role::Free).count() as f64
    };
    for (cut, times) in [(Cut::Centres, 2.0), (Cut::Quarters, 4.0)] {
        let ratio = count(&Resolution::finer(head, cut).head) / count(head);
        assert!((ratio / times - 1.0).abs() < 0.05, "{ratio}");
    }
}

#[test]
fn coarser_meshes_are_symmetric() {
    for mesh in coarse() {
        let cage = &mesh.head.cage;
        let skin = skin(&mesh.head);
        for (v, &m) in cage.mirror.iter().enumerate() {
            assert_eq!(cage.mirror[m as usize], v as u32);
            assert_eq!(cage.roles[m as usize], cage.roles[v]);
            let [x, y, z] = skin[m as usize];
            let away = sub(skin[v], [-x, y, z]);
            assert!(dot(away, away) < 1e-12, "{v}: {away:?}");
        }
        let corners = |face: &Vec<u32>, image: &dyn Fn(u32) -> u32| -> BTreeSet<u32> {
            face.iter().map(|&v| image(v)).collect()
        };
        let faces: BTreeSet<_> = cage.faces.iter().map(|f| corners(f, &|v| v)).collect();
        let mirrored = |f| corners(f, &|v| cage.mirror[v as usize]);
        assert!(cage.faces.iter().all(|f| faces.contains(&mirrored(f))));
    }
}

#[test]
fn rims_of_lips_and_lids_stay_loops_with_their_corners() {
    let head = ReferenceHead::embedded();
    let full = rims(head);
    let own = skin(head);
    for mesh in coarse() {
        let coarse = rims(&mesh.head);
        let skin = skin(&mesh.head);
        let cage = &mesh.head.cage;
        let pairs = |r: &Rims| [&r.lids[0][0], &r.lids[1][0], &r.lips].map(Clone::clone);
        for (rim, before) in pairs(&coarse).iter().zip(&pairs(&full)) {
            // Edges of the rim: with the inside of eye or mouth on one of their sides.
            let mut edges = BTreeMap::new();
            for face in &cage.faces {
                let is_inside = face
                    .iter()
                    .any(|&v| cage.roles[v as usize] == Role::Passive);
                for (k, &a) in face.iter().enumerate() {
                    let b = face[(k + 1) % face.len()];
                    if rim.contains(&a) && rim.contains(&b) {
                        let sides = edges.entry((a.min(b), a.max(b))).or_insert([0, 0]);
                        sides[usize::from(is_inside)] += 1;
                    }
                }
            }
            let between = edges.iter().filter(|(_, s)| **s == [1, 1]).map(|(e, _)| *e);
            assert_eq!(loops(between), Some(1));
            assert!(
                3 * rim.len() > before.len(),
                "{} {}",
                rim.len(),
                before.len()
            );
            let width = |rim: &BTreeSet<u32>, skin: &[V3]| {
                let x = || rim.iter().map(|&v| skin[v as usize][0]);
                [
                    x().fold(f64::INFINITY, f64::min),
                    x().fold(f64::NEG_INFINITY, f64::max),
                ]
            };
            for (a, b) in width(rim, &skin).into_iter().zip(width(before, &own)) {
                assert!((a - b).abs() < 1e-6, "{a} {b}");
            }
        }
        let rig = FaceRig::new(&mesh.head, MuscleSet::embedded()).expect("muscles reach");
        let margins = &rig.template().margins;
        let lips = coarse.lips.len();
        assert!(
            4 * margins.lip_pairs.len() > lips,
            "{} {lips}",
            margins.lip_pairs.len()
        );
    }
}

#[test]
fn no_prism_of_a_coarser_mesh_is_inverted_at_rest() {
    let head = ReferenceHead::embedded();
    let people: Vec<Subject> = (0..3)
        .map(|k| IdentityModel::embedded().sample(head, 7, k))
        .collect::<Result<_, _>>()
        .expect("valid");
    for mesh in coarse() {
        let rig = FaceRig::new(&mesh.head, MuscleSet::embedded()).expect("muscles reach");
        let template = rig.template();
        for subject in people.iter().chain([&mean_subject(head)]) {
            let positions = mesh.subject(subject).positions;
            let layers = template.layers(&mesh.head, &positions).expect("finite");
            let volume = |t: &[u32; 3]| {
                let [s, f] = [&layers.skin, &layers.fascia].map(|l| t.map(|i| l[i as usize]));
                Volume::of(&[s[0], s[1], s[2], f[0], f[1], f[2]]).value
            };
            let volumes: Vec<f64> = template.triangles.iter().map(volume).collect();
            let mean = volumes.iter().sum::<f64>() / volumes.len() as f64;
            // Folds at the corners of the mouth, as on the usual mesh, are slivers, which the certificate does not count.
            let least = volumes.iter().copied().fold(f64::INFINITY, f64::min);
            assert!(least > -SLIVER_SHARE * mean, "{least} of {mean} mm^3");
        }
    }
}

#[test]
fn vertices_that_are_left_stay_in_place_and_others_move_with_their_faces() {
    let head = ReferenceHead::embedded();
    let subject = mean_subject(head);
    for mesh in coarse() {
        let coarse = mesh.subject(&subject);
        for (v, &s) in mesh.origin.source.iter().enumerate() {
            let away = coarse.positions[v] - subject.positions[s as usize];
            assert!(away.norm() < 1e-6, "{away}");
        }
        let places: Vec<Vector3> = coarse.positions.iter().map(|p| p.coords).collect();
        let carried = mesh.carry(&places);
        let n = head.cage.positions.len();
        assert_eq!(carried.len(), n);
        // The vertices that were taken away are near the faces that took their places.
        let off = |v: usize| (carried[v] - subject.positions[v].coords).norm();
        let mean = (0..n).map(off).sum::<f64>() / n as f64;
        assert!(mean < 0.8 && (0..n).map(off).all(|d| d < 6.0), "{mean} mm");
    }
}

#[test]
fn as_few_nodes_as_cannot_be_and_more_than_there_are_are_refused() {
    let head = ReferenceHead::embedded();
    let all = 2022.0;
    let refused = |nodes: usize| match Resolution::coarser(head, nodes) {
        Err(SimError::OutOfRange {
            value, min, max, ..
        }) => {
            assert!(value == nodes as f64 && max == all);
            min
        }
        other => panic!("{:?}", other.map(|r| r.head.cage.positions.len())),
    };
    let least = refused(10);
    assert!(least > 10.0 && least < 500.0, "{least}");
    assert_eq!(refused(3000), least);
    assert!(Resolution::coarser(head, least as usize).is_ok());
}
