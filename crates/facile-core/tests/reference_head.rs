//! The shipped reference head keeps the promises that physics and rendering build on.

use facile_core::{ReferenceHead, Role, Segment};

#[test]
fn the_cage_is_small_enough_and_symmetric() {
    let cage = &ReferenceHead::embedded().cage;
    let simulated = cage.roles.iter().filter(|r| **r == Role::Free).count();
    assert!(
        (1_000..4_000).contains(&simulated),
        "{simulated} free nodes"
    );
    for (i, &m) in cage.mirror.iter().enumerate() {
        assert_eq!(
            cage.mirror[m as usize] as usize, i,
            "mirror of the mirror of {i}"
        );
        let (p, q) = (cage.positions[i], cage.positions[m as usize]);
        let distance = ((p.x + q.x).powi(2) + (p.y - q.y).powi(2) + (p.z - q.z).powi(2)).sqrt();
        assert!(
            distance < 0.01,
            "vertex {i} is {distance} mm from its mirror image"
        );
        assert_eq!(cage.roles[i], cage.roles[m as usize]);
    }
}

#[test]
fn annotations_are_in_range() {
    let cage = &ReferenceHead::embedded().cage;
    assert!(cage.jaw.iter().all(|w| (0.0..=1.0).contains(w)));
    assert!(cage.lid.iter().all(|w| (-1.0..=1.0).contains(w)));
    assert!(cage.thickness.iter().all(|t| (0.5..=15.0).contains(t)));
}

#[test]
fn every_landmark_lies_on_its_feature() {
    let head = ReferenceHead::embedded();
    let scheme = head.scheme("ibug68").expect("ships");
    assert_eq!(scheme.points.len(), 68);
    let at = scheme.positions(&head.mesh.positions, &head.mesh.triangles);
    // The subject's right side comes first in the scheme, and its x is negative.
    assert!(at[0].x < -40.0 && at[16].x > 40.0);
    assert!(at[8].y < -90.0, "chin at {}", at[8]);
    assert!(
        at[30].z > at[27].z,
        "the nose's tip is in front of its bridge"
    );
    for (i, point) in at.iter().enumerate().take(42).skip(36) {
        assert!(
            (point - head.eyes[1].center).norm() < 1.6 * head.eyes[1].radius,
            "landmark {i}"
        );
    }
    let segment = |i: usize| head.mesh.segments[scheme.points[i].triangle as usize];
    for i in [50, 51, 52, 61, 62, 63] {
        assert!(
            matches!(segment(i), Segment::UpperLip | Segment::Skin),
            "{i}: {:?}",
            segment(i)
        );
    }
    assert!(matches!(segment(57), Segment::LowerLip | Segment::Skin));
    assert_eq!(head.scheme("five").expect("ships").points.len(), 5);
}

#[test]
fn parts_are_there_and_inside_the_head() {
    let head = ReferenceHead::embedded();
    let (low, high) = head.mesh.bounds().expect("not empty");
    for wanted in [
        Segment::LeftEye,
        Segment::RightEye,
        Segment::UpperTeeth,
        Segment::LowerTeeth,
        Segment::Tongue,
    ] {
        let part = head
            .parts
            .iter()
            .find(|p| p.segment == wanted)
            .unwrap_or_else(|| panic!("{wanted:?} is missing"));
        for p in &part.mesh.positions {
            assert!(
                (0..3).all(|k| p[k] > low[k] && p[k] < high[k]),
                "{wanted:?} at {p}"
            );
        }
    }
}

#[test]
fn a_saved_head_reads_back_as_it_was() {
    let head = ReferenceHead::embedded();
    let dir = tempfile::tempdir().expect("a folder");
    head.save(dir.path(), "a copy").expect("writes");
    let copy = ReferenceHead::load(dir.path()).expect("reads");
    assert_eq!(copy.topology_digest(), head.topology_digest());
    assert_eq!(copy.cage.roles, head.cage.roles);
    assert_eq!(copy.cage.mirror, head.cage.mirror);
    assert_eq!(copy.mesh.segments, head.mesh.segments);
    assert_eq!(copy.mesh.positions, head.mesh.positions);
    assert_eq!(copy.parts.len(), head.parts.len());
    for (a, b) in copy.parts.iter().zip(&head.parts) {
        assert_eq!(a.segment, b.segment);
        assert_eq!(a.mesh.positions, b.mesh.positions);
        assert_eq!(a.mesh.texcoord_triangles, b.mesh.texcoord_triangles);
    }
    assert_eq!(copy.eyes, head.eyes);
    assert_eq!(copy.jaw, head.jaw);
    for (a, b) in copy.landmarks.iter().zip(&head.landmarks) {
        assert_eq!(a.name, b.name);
        let places = |h: &ReferenceHead, s: &facile_core::LandmarkScheme| {
            s.positions(&h.mesh.positions, &h.mesh.triangles)
        };
        for (p, q) in places(&copy, a).iter().zip(places(head, b)) {
            assert!((p - q).norm() < 1e-3);
        }
    }
    assert_eq!(copy.mouth_texture, head.mouth_texture);
    let square = |(a, b): (&u8, &u8)| f64::from(a.abs_diff(*b)).powi(2);
    let texels = |h: &ReferenceHead| h.texture.texels().as_flattened().to_vec();
    let (a, b) = (texels(&copy), texels(head));
    let mean = a.iter().zip(&b).map(square).sum::<f64>() / a.len() as f64;
    assert!(mean.sqrt() < 3.0, "the skin differs by {} RMS", mean.sqrt());
}
