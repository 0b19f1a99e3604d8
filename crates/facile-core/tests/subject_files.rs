//! Subjects survive the way to a file and back, bit for bit.

use std::path::Path;

use facile_core::io::{is_subject, load_scan};
use facile_core::{
    Attributes, Eye, Point3, ReferenceHead, Similarity3, Subject, Texture, UnitQuaternion, Vector3,
};

fn subject() -> Subject {
    let reference = ReferenceHead::embedded();
    let bump =
        |(i, p): (usize, &Point3)| p + Vector3::new(1.0, -2.0, 3.0) * ((i % 17) as f64 / 7.0);
    let texel = |i: usize| [(i % 251) as u8, (i % 13) as u8, (i / 7 % 256) as u8];
    Subject {
        id: "a \"b\"".to_owned(),
        attributes: Attributes {
            sex: Some("female".to_owned()),
            age: Some("41".to_owned()),
            ..Attributes::default()
        },
        positions: reference
            .mesh
            .positions
            .iter()
            .enumerate()
            .map(bump)
            .collect(),
        expected_error: (0..reference.mesh.positions.len())
            .map(|i| i as f32 / 3e3)
            .collect(),
        texture: Texture::new(64, 32, (0..64 * 32).map(texel).collect()),
        eyes: reference.eyes.map(|e| Eye {
            center: e.center * 1.01,
            radius: e.radius / 1.07,
        }),
        eye_color: "green".to_owned(),
        skull_from_reference: Similarity3::from_parts(
            Vector3::new(0.1, 0.2, 1.0 / 3.0).into(),
            UnitQuaternion::from_euler_angles(0.01, 0.02, -0.3),
            1.03,
        ),
    }
}

#[test]
fn a_subject_comes_back_bit_for_bit() {
    let reference = ReferenceHead::embedded();
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("s.glb");
    let subject = subject();
    subject.save(&path, reference).expect("saved");
    let loaded = Subject::load(&path, reference).expect("loaded");
    assert!(loaded == subject, "the subject changed on its way");
    let bytes = std::fs::read(&path).expect("read");
    assert!(is_subject(&bytes));
    assert_eq!(subject.to_glb(&path, reference).expect("again"), bytes);
}

#[test]
fn a_subject_is_also_a_scan_in_mm() {
    let reference = ReferenceHead::embedded();
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("s.glb");
    let subject = subject();
    subject.save(&path, reference).expect("saved");
    let scan = load_scan(&path, None).expect("loaded");
    let (low, high) = scan.mesh.bounds().expect("not empty");
    let height = high.y - low.y;
    assert!((200.0..500.0).contains(&height), "{height} mm");
    assert_eq!(scan.groups[0], "head");
    assert!(scan.groups.iter().any(|g| g == "upper_teeth"));
}

#[test]
fn other_files_are_not_taken_for_subjects() {
    let reference = ReferenceHead::embedded();
    let path = Path::new("s.glb");
    let good = subject().to_glb(path, reference).expect("valid");
    let message = |bytes: &[u8]| {
        Subject::from_glb(bytes, path, reference)
            .expect_err("not a subject")
            .to_string()
    };
    assert!(message(&good[..good.len() / 2]).contains("the file ends early"));
    let other = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = good.windows(from.len()).position(|w| w == from.as_bytes());
        let at = at.expect("the text is there");
        let mut bytes = good.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        bytes
    };
    assert!(message(&other("\"subject\"", "\"unknown\"")).contains("is not a subject"));
    assert!(
        message(&other("\"version\":1", "\"version\":9")).contains("expected subject version 1")
    );
    let digest = reference.topology_digest();
    assert!(
        message(&other(&digest, &digest.chars().rev().collect::<String>()))
            .contains("another reference head")
    );
    assert!(message(&other("\"green\"", "\"pink!\"")).contains("unknown eye colour `pink!`"));
}
