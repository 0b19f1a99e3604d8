//! The built-in subjects: scans that ship with the program and go through registration like a user's own.

use std::path::Path;
use std::sync::OnceLock;

use serde::Deserialize;

use crate::assets::{self, SUBJECT_FILES, SUBJECTS_TOML};
use crate::io::{Scan, ScanOptions, parse_scan};
use crate::{Attributes, CoreError};

#[derive(Deserialize)]
struct SubjectsToml {
    subject: Vec<Entry>,
}

#[derive(Deserialize)]
struct Entry {
    name: String,
    file: String,
    sex: Option<String>,
    ancestry: Option<String>,
    age: Option<String>,
    eyes: Option<String>,
    hair: Option<String>,
    source: Option<String>,
    license: Option<String>,
}

/// The list of subjects, parsed once.
fn entries() -> &'static [Entry] {
    static ENTRIES: OnceLock<Vec<Entry>> = OnceLock::new();
    ENTRIES.get_or_init(|| {
        assets::parse_toml::<SubjectsToml>(SUBJECTS_TOML, "subjects.toml")
            .expect("the embedded list of subjects is tested")
            .subject
    })
}

/// Names of the built-in subjects, in order.
pub fn names() -> Vec<&'static str> {
    entries().iter().map(|e| e.name.as_str()).collect()
}

/// The scan of a built-in subject and what is known of the person.
///
/// # Errors
/// [`CoreError::UnknownName`] with the known names.
pub fn load(name: &str) -> Result<(Scan, Attributes), CoreError> {
    let entry = entries().iter().find(|e| e.name == name);
    let file = entry.and_then(|e| SUBJECT_FILES.iter().find(|(file, _)| *file == e.file));
    let (Some(entry), Some((file, bytes))) = (entry, file) else {
        return Err(CoreError::UnknownName {
            kind: "built-in subject",
            name: name.to_owned(),
            known: names().join(", "),
        });
    };
    let mut scan = parse_scan(bytes, Path::new(file), &ScanOptions::default())?;
    scan.name.clone_from(&entry.name);
    let attributes = Attributes {
        sex: entry.sex.clone(),
        ancestry: entry.ancestry.clone(),
        age: entry.age.clone(),
        eye_color: entry.eyes.clone(),
        hair: entry.hair.clone(),
        source: entry.source.clone(),
        license: entry.license.clone(),
    };
    Ok((scan, attributes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_subject_loads_with_texture_and_attributes() {
        assert_eq!(names().len(), 12);
        for name in names() {
            let (scan, attributes) = load(name).expect("ships");
            assert_eq!(scan.name, name);
            assert!(scan.mesh.triangles.len() > 10_000, "{name}");
            assert!(scan.texture.is_some(), "{name}");
            assert!(scan.notices.is_empty(), "{name}: {:?}", scan.notices);
            assert!(attributes.sex.is_some() && attributes.license.is_some());
            let (low, high) = scan.mesh.bounds().expect("not empty");
            assert!((150.0..400.0).contains(&(high.y - low.y)), "{name}, mm");
        }
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let message = load("nobody").expect_err("unknown").to_string();
        assert!(message.starts_with("unknown built-in subject `nobody`; known: "));
        assert!(message.contains(names()[0]));
    }
}
