//! `dataset_card.md` and `croissant.json`: what is in a dataset, for people and for tools.
//!
//! Both are made from the records alone, so they say what is there and not what was asked for. `croissant.json` follows
//! Croissant 1.0 (JSON-LD on schema.org).

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Deserialize;
use serde_json::{Value, json};

use super::contact::CONTACT_SHEET;
use super::folder::ANNOTATIONS;
use super::journal::FileEntry;
use super::manifest::Manifest;
use super::parquet::PARQUET;
use super::webdataset::WEBDATASET;
use super::{COCO, IMAGES};
use crate::recipe::file::Format;

/// Name of the card in a dataset.
pub const CARD: &str = "dataset_card.md";
/// Name of the Croissant description in a dataset.
pub const CROISSANT: &str = "croissant.json";
/// Width of the classes of yaw and pitch, degrees.
const ANGLE_STEP: f64 = 15.0;

/// Numbers of certificates, and the widths of their classes.
const RESIDUAL: &str = "relative residual";
const PENETRATION: &str = "penetration of the skull";
const LIP_OVERLAP: &str = "overlap of the lips";
const INVERTED: &str = "inverted elements";
const ITERATIONS: &str = "iterations";
const LENGTH_STEP: f64 = 0.05;
const ITERATION_STEP: f64 = 50.0;

/// Counts what records say.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Tally {
    images: u64,
    size: [u32; 2],
    counts: BTreeMap<&'static str, BTreeMap<String, u64>>,
    angles: BTreeMap<&'static str, BTreeMap<i64, u64>>,
    subjects: BTreeMap<String, u64>,
    equilibria: u64,
    largest_residual: f64,
    largest_penetration_mm: f64,
    /// Classes of the certificates' numbers: lower ends, in units of the class.
    certificates: BTreeMap<&'static str, BTreeMap<i64, u64>>,
}

/// What is read of a record. Text is borrowed from its line.
#[derive(Deserialize)]
struct Entry<'a> {
    size: [u32; 2],
    #[serde(borrow)]
    subject: Subject<'a>,
    #[serde(borrow)]
    expression: Expression<'a>,
    #[serde(borrow)]
    light: Named<'a>,
    #[serde(borrow)]
    occluder: Kind<'a>,
    head_pose: HeadPose,
    #[serde(borrow, default)]
    landmarks: BTreeMap<&'a str, Landmarks<'a>>,
}

#[derive(Deserialize)]
struct Subject<'a> {
    #[serde(borrow)]
    id: Cow<'a, str>,
    #[serde(borrow)]
    kind: Cow<'a, str>,
    #[serde(borrow, default)]
    attributes: Attributes<'a>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Attributes<'a> {
    #[serde(borrow)]
    sex: Option<Cow<'a, str>>,
    #[serde(borrow)]
    ancestry: Option<Cow<'a, str>>,
    #[serde(borrow)]
    license: Option<Cow<'a, str>>,
    #[serde(borrow)]
    source: Option<Cow<'a, str>>,
}

#[derive(Deserialize)]
struct Expression<'a> {
    #[serde(borrow)]
    name: Cow<'a, str>,
    intensity: f64,
    equilibrium: Option<Equilibrium>,
}

#[derive(Deserialize)]
struct Equilibrium {
    residual: f64,
    max_penetration_mm: f64,
    lip_overlap_mm: f64,
    inverted_elements: u64,
    iterations: u64,
}

#[derive(Deserialize)]
struct Named<'a> {
    #[serde(borrow)]
    name: Cow<'a, str>,
}

#[derive(Deserialize)]
struct Kind<'a> {
    #[serde(borrow)]
    kind: Cow<'a, str>,
}

#[derive(Deserialize)]
struct HeadPose {
    yaw_deg: f64,
    pitch_deg: f64,
}

#[derive(Deserialize)]
struct Landmarks<'a> {
    #[serde(borrow)]
    visibility: Vec<&'a str>,
}

/// What is known, or that it is not.
fn known<'a>(value: Option<&'a Cow<'_, str>>) -> &'a str {
    value.map_or("not known", |v| v)
}

/// Counts one more of a value.
fn count(counts: &mut BTreeMap<String, u64>, value: &str) {
    match counts.get_mut(value) {
        Some(n) => *n += 1,
        None => drop(counts.insert(value.to_owned(), 1)),
    }
}

impl Tally {
    /// Counts a record. Lines that are no records are left out; the writer makes none.
    pub(crate) fn add(&mut self, record: &str) {
        let Ok(entry) = serde_json::from_str::<Entry<'_>>(record) else {
            return;
        };
        self.images += 1;
        self.size = entry.size;
        let Subject {
            id,
            kind,
            attributes,
        } = &entry.subject;
        // Drawn intensities are all different.
        let intensity = format!("{:.1}", entry.expression.intensity);
        for (factor, value) in [
            ("source of subjects", &**kind),
            ("sex", known(attributes.sex.as_ref())),
            ("ancestry", known(attributes.ancestry.as_ref())),
            ("license", known(attributes.license.as_ref())),
            ("source", known(attributes.source.as_ref())),
            ("expression", &entry.expression.name),
            ("intensity, to 0.1", &intensity),
            ("lighting", &entry.light.name),
            ("occluder", &entry.occluder.kind),
        ] {
            count(self.counts.entry(factor).or_default(), value);
        }
        if let Some(landmarks) = entry.landmarks.values().next() {
            let counts = self.counts.entry("visibility of landmarks").or_default();
            for visibility in &landmarks.visibility {
                count(counts, visibility);
            }
        }
        for (name, angle) in [
            ("yaw of the head", entry.head_pose.yaw_deg),
            ("pitch of the head", entry.head_pose.pitch_deg),
        ] {
            let class = (angle / ANGLE_STEP).round() as i64;
            *self
                .angles
                .entry(name)
                .or_default()
                .entry(class)
                .or_default() += 1;
        }
        count(&mut self.subjects, id);
        if let Some(found) = &entry.expression.equilibrium {
            self.add_certificate(found);
        }
    }

    fn add_certificate(&mut self, found: &Equilibrium) {
        self.equilibria += 1;
        self.largest_residual = self.largest_residual.max(found.residual);
        self.largest_penetration_mm = self.largest_penetration_mm.max(found.max_penetration_mm);
        let numbers = [
            (RESIDUAL, (2.0 * found.residual.max(1e-12).log10()).floor()),
            (
                PENETRATION,
                (found.max_penetration_mm / LENGTH_STEP).floor(),
            ),
            (LIP_OVERLAP, (found.lip_overlap_mm / LENGTH_STEP).floor()),
            (INVERTED, found.inverted_elements as f64),
            (
                ITERATIONS,
                (found.iterations as f64 / ITERATION_STEP).floor(),
            ),
        ];
        for (name, class) in numbers {
            let classes = self.certificates.entry(name).or_default();
            *classes.entry(class as i64).or_default() += 1;
        }
    }

    /// Adds what another tally counted.
    pub(crate) fn merge(&mut self, other: Self) {
        fn add<K: Ord>(to: &mut BTreeMap<K, u64>, from: BTreeMap<K, u64>) {
            for (key, n) in from {
                *to.entry(key).or_default() += n;
            }
        }
        if other.images > 0 {
            self.size = other.size;
        }
        self.images += other.images;
        self.equilibria += other.equilibria;
        self.largest_residual = self.largest_residual.max(other.largest_residual);
        self.largest_penetration_mm = self
            .largest_penetration_mm
            .max(other.largest_penetration_mm);
        add(&mut self.subjects, other.subjects);
        for (factor, counts) in other.counts {
            add(self.counts.entry(factor).or_default(), counts);
        }
        for (factor, counts) in other.angles {
            add(self.angles.entry(factor).or_default(), counts);
        }
        for (name, counts) in other.certificates {
            add(self.certificates.entry(name).or_default(), counts);
        }
    }

    /// Number of images by the values of each factor.
    pub(crate) fn factors(&self) -> Vec<(String, Vec<(String, u64)>)> {
        let counts = self.counts.iter().map(|(factor, counts)| {
            let rows = counts.iter().map(|(value, n)| (value.clone(), *n));
            ((*factor).to_owned(), rows.collect())
        });
        let angles = self.angles.iter().map(|(factor, counts)| {
            let rows = counts.iter().map(|(class, n)| {
                let middle = *class as f64 * ANGLE_STEP;
                (format!("{middle:+} degrees"), *n)
            });
            ((*factor).to_owned(), rows.collect())
        });
        counts.chain(angles).collect()
    }

    /// Number of images by the numbers of their equilibria's certificates, each class by its lower end.
    pub(crate) fn certificates(&self) -> Vec<(String, Vec<(String, u64)>)> {
        let name = |certificate: &str, class: i64| match certificate {
            RESIDUAL => format!("from {:.1e}", 10_f64.powf(class as f64 / 2.0)),
            PENETRATION | LIP_OVERLAP => format!("from {:.2} mm", class as f64 * LENGTH_STEP),
            ITERATIONS => format!("from {}", class as f64 * ITERATION_STEP),
            _ => class.to_string(),
        };
        let each = self.certificates.iter().map(|(certificate, counts)| {
            let rows = counts
                .iter()
                .map(|(class, n)| (name(certificate, *class), *n));
            ((*certificate).to_owned(), rows.collect())
        });
        each.collect()
    }

    /// The card, as Markdown.
    pub(super) fn card(&self, manifest: &Manifest, failed: u64) -> String {
        let mut text = format!("# {}\n\n", manifest.recipe);
        let [width, height] = self.size;
        let _ = writeln!(
            text,
            "{} images of {} artificial faces, {width} x {height} px, with exact labels. Made by {} from recipe `{}`; \
             `facile verify` checks the files, and the same recipe makes the same bytes again.\n",
            self.images,
            self.subjects.len(),
            manifest.program,
            manifest.recipe_hash,
        );
        if failed > 0 {
            let _ = writeln!(
                text,
                "{failed} samples could not be made; `manifest.json` says which and why.\n"
            );
        }
        if self.equilibria > 0 {
            let _ = writeln!(
                text,
                "{} images show a face in a simulated equilibrium. The largest relative residual is {:.1e}, the deepest \
                 penetration of the skull {:.3} mm.\n",
                self.equilibria, self.largest_residual, self.largest_penetration_mm,
            );
        }
        let _ = writeln!(text, "![Some of the images]({CONTACT_SHEET})\n");
        text += "## What is in it\n";
        for (factor, rows) in self.factors() {
            histogram(&mut text, &factor, &rows);
        }
        text += "\n## Files\n\n";
        let _ = writeln!(
            text,
            "`{ANNOTATIONS}` has one record for each image; lengths are in millimetres, image positions in pixels from the \
             upper left corner, angles in degrees. `labels.schema.json` describes every field and map. `checksums.b3` lists the BLAKE3 hash of every file."
        );
        text
    }

    /// The description, as JSON-LD. `sha256` is the hash of the annotations, the one that the format knows.
    pub(super) fn croissant(
        &self,
        manifest: &Manifest,
        annotations: &FileEntry,
        sha256: &str,
    ) -> Value {
        let licenses: Vec<&String> = self
            .counts
            .get("license")
            .into_iter()
            .flat_map(|l| l.keys())
            .collect();
        json!({
            "@context": croissant_context(),
            "@type": "sc:Dataset",
            "conformsTo": "http://mlcommons.org/croissant/1.0",
            "name": manifest.recipe,
            "description": format!(
                "{} images of {} artificial faces with exact labels, made by {}",
                self.images,
                self.subjects.len(),
                manifest.program
            ),
            "license": licenses,
            "version": "1.0.0",
            "identifier": manifest.recipe_hash,
            "creator": { "@type": "sc:Organization", "name": "facile" },
            "citeAs": "A. Brambilla, A. Colombo: Facile: a System for Artificial Face Dataset Generation",
            "distribution": distribution(manifest, annotations, sha256),
            "recordSet": [{
                "@type": "cr:RecordSet",
                "@id": "records",
                "name": "records",
                "description": "one record for each image",
                "field": fields(),
            }],
        })
    }
}

/// The terms of Croissant 1.0, as its readers expect them.
fn croissant_context() -> Value {
    let mut context = json!({
        "@language": "en",
        "@vocab": "https://schema.org/",
        "cr": "http://mlcommons.org/croissant/",
        "data": { "@id": "cr:data", "@type": "@json" },
        "dataType": { "@id": "cr:dataType", "@type": "@vocab" },
        "dct": "http://purl.org/dc/terms/",
        "examples": { "@id": "cr:examples", "@type": "@json" },
        "rai": "http://mlcommons.org/croissant/RAI/",
        "sc": "https://schema.org/",
        "conformsTo": "dct:conformsTo",
    });
    for term in [
        "citeAs",
        "column",
        "equivalentProperty",
        "extract",
        "field",
        "fileObject",
        "fileProperty",
        "fileSet",
        "format",
        "includes",
        "isLiveDataset",
        "jsonPath",
        "key",
        "md5",
        "parentField",
        "path",
        "recordSet",
        "references",
        "regex",
        "repeated",
        "replace",
        "samplingRate",
        "separator",
        "source",
        "subField",
        "transform",
    ] {
        context[term] = Value::from(format!("cr:{term}"));
    }
    context
}

/// The files of a dataset.
fn distribution(manifest: &Manifest, annotations: &FileEntry, sha256: &str) -> Vec<Value> {
    let mut files = vec![json!({
        "@type": "cr:FileObject",
        "@id": ANNOTATIONS,
        "name": ANNOTATIONS,
        "contentUrl": ANNOTATIONS,
        "contentSize": format!("{} B", annotations.bytes),
        "encodingFormat": "application/jsonlines",
        "sha256": sha256,
    })];
    let set = |id: &str, glob: &str, format: &str| {
        json!({
            "@type": "cr:FileSet",
            "@id": id,
            "name": id,
            "includes": glob,
            "encodingFormat": format,
        })
    };
    for format in &manifest.formats {
        files.push(match format {
            Format::Folder => set(IMAGES, "images/*", "image/*"),
            Format::Parquet => set(PARQUET, "parquet/*.parquet", "application/x-parquet"),
            Format::Webdataset => set(WEBDATASET, "webdataset/*.tar", "application/x-tar"),
        });
    }
    if manifest.coco {
        files.push(set(COCO, COCO, "application/json"));
    }
    files
}

/// What readers get of a record: a column of the annotations, or a value within one.
fn fields() -> Vec<Value> {
    let field = |name: &str, column: &str, path: Option<&str>, kind: &str, is_list: bool| {
        let mut field = json!({
            "@type": "cr:Field",
            "@id": format!("records/{name}"),
            "name": name,
            "dataType": kind,
            "source": { "fileObject": { "@id": ANNOTATIONS }, "extract": { "column": column } },
        });
        if let Some(path) = path {
            field["source"]["transform"] = json!({ "jsonPath": path });
        }
        if is_list {
            field["repeated"] = Value::Bool(true);
        }
        field
    };
    vec![
        field("index", "index", None, "sc:Integer", false),
        field("image", "image", None, "sc:Text", false),
        field("subject", "subject", Some("$.id"), "sc:Text", false),
        field("expression", "expression", Some("$.name"), "sc:Text", false),
        field(
            "intensity",
            "expression",
            Some("$.intensity"),
            "sc:Float",
            false,
        ),
        field("light", "light", Some("$.name"), "sc:Text", false),
        field("occluder", "occluder", Some("$.kind"), "sc:Text", false),
        field("yaw_deg", "head_pose", Some("$.yaw_deg"), "sc:Float", false),
        field(
            "pitch_deg",
            "head_pose",
            Some("$.pitch_deg"),
            "sc:Float",
            false,
        ),
        field("face_box_px", "face_box_px", None, "sc:Float", true),
    ]
}

/// A table of counts with bars.
fn histogram(text: &mut String, factor: &str, rows: &[(String, u64)]) {
    const LONGEST: f64 = 30.0;
    let most = rows.iter().map(|(_, n)| *n).max().unwrap_or(1).max(1);
    let _ = writeln!(text, "\n| {factor} | number | |\n|---|---:|---|");
    for (value, n) in rows {
        let bar = "#".repeat((LONGEST * *n as f64 / most as f64).ceil() as usize);
        let _ = writeln!(text, "| {} | {n} | {bar} |", value.replace('|', "/"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_counts_what_the_records_say() {
        let (mut tally, mut halves) = (Tally::default(), Tally::default());
        for (name, yaw) in [("smile", 31.0), ("smile", 29.0), ("anger", -2.0)] {
            let record = json!({
                "size": [64, 48],
                "subject": { "id": "a", "kind": "builtin", "attributes": { "sex": "female" } },
                "expression": {
                    "name": name, "intensity": 0.5,
                    "equilibrium": {
                        "residual": 2e-4, "max_penetration_mm": 0.01, "lip_overlap_mm": 0.0,
                        "inverted_elements": 2, "iterations": 120,
                    },
                },
                "light": { "name": "key" },
                "occluder": { "kind": "none" },
                "head_pose": { "yaw_deg": yaw, "pitch_deg": 0.0 },
            });
            tally.add(&record.to_string());
            let mut one = Tally::default();
            one.add(&record.to_string());
            halves.merge(one);
        }
        tally.add("not a record");
        assert_eq!(halves, tally);
        let manifest = serde_json::from_value::<Manifest>(json!({
            "program": "facile", "recipe": "r", "recipe_hash": "h", "formats": ["folder"], "coco": false,
            "samples": 3, "samples_per_unit": 3, "part": null, "written": 3, "complete": true, "failures": [],
        }))
        .expect("a manifest");
        let card = tally.card(&manifest, 0);
        for line in [
            "3 images of 1 artificial",
            "| smile | 2 |",
            "| anger | 1 |",
            "| +30 degrees | 2 |",
            "| female | 3 |",
        ] {
            assert!(card.contains(line), "{line}:\n{card}");
        }
        let certificates = tally.certificates();
        let iterations = certificates.iter().find(|(name, _)| name == ITERATIONS);
        let expected = vec![("from 100".to_owned(), 3)];
        assert_eq!(iterations.map(|(_, rows)| rows), Some(&expected));
        let entry = FileEntry {
            name: ANNOTATIONS.to_owned(),
            bytes: 10,
            blake3: "ab".to_owned(),
        };
        let croissant = tally.croissant(&manifest, &entry, "00");
        assert_eq!(croissant["distribution"].as_array().map(Vec::len), Some(2));
    }
}
