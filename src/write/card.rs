//! `dataset_card.md` and `croissant.json`: what is in a dataset, for people and for tools.
//!
//! Both are made from the records alone, so they say what is there and not what was asked for. `croissant.json` follows
//! Croissant 1.0 (JSON-LD on schema.org).

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Deserialize;
use serde_json::{Value, json};

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
#[derive(Debug, Default)]
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

#[derive(Deserialize)]
struct Entry {
    size: [u32; 2],
    subject: Subject,
    expression: Expression,
    light: Named,
    occluder: Kind,
    head_pose: HeadPose,
    #[serde(default)]
    landmarks: BTreeMap<String, Landmarks>,
}

#[derive(Deserialize)]
struct Subject {
    id: String,
    kind: String,
    #[serde(default)]
    attributes: BTreeMap<String, Value>,
}

#[derive(Deserialize)]
struct Expression {
    name: String,
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
struct Named {
    name: String,
}

#[derive(Deserialize)]
struct Kind {
    kind: String,
}

#[derive(Deserialize)]
struct HeadPose {
    yaw_deg: f64,
    pitch_deg: f64,
}

#[derive(Deserialize)]
struct Landmarks {
    visibility: Vec<String>,
}

impl Tally {
    /// Counts a record. Lines that are no records are left out; the writer makes none.
    pub(crate) fn add(&mut self, record: &str) {
        let Ok(entry) = serde_json::from_str::<Entry>(record) else {
            return;
        };
        self.images += 1;
        self.size = entry.size;
        let mut count = |factor, value: String| {
            *self
                .counts
                .entry(factor)
                .or_default()
                .entry(value)
                .or_default() += 1;
        };
        let attribute = |name: &str| match entry.subject.attributes.get(name) {
            Some(Value::String(text)) => text.clone(),
            _ => "not known".to_owned(),
        };
        count("source of subjects", entry.subject.kind.clone());
        for name in ["sex", "ancestry", "license", "source"] {
            count(name, attribute(name));
        }
        let Expression {
            name,
            intensity,
            equilibrium,
        } = entry.expression;
        count("expression", name);
        // Drawn intensities are all different.
        count("intensity, to 0.1", format!("{intensity:.1}"));
        count("lighting", entry.light.name);
        count("occluder", entry.occluder.kind);
        if let Some(landmarks) = entry.landmarks.into_values().next() {
            for visibility in landmarks.visibility {
                count("visibility of landmarks", visibility);
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
        *self.subjects.entry(entry.subject.id).or_default() += 1;
        if let Some(found) = equilibrium {
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

    /// The description, as JSON-LD.
    pub(super) fn croissant(&self, manifest: &Manifest, annotations: &FileEntry) -> Value {
        let mut files = vec![json!({
            "@type": "cr:FileObject",
            "@id": ANNOTATIONS,
            "name": ANNOTATIONS,
            "contentUrl": ANNOTATIONS,
            "contentSize": format!("{} B", annotations.bytes),
            "encodingFormat": "application/jsonlines",
            // The hash is BLAKE3; the format knows no property for it.
            "description": format!("BLAKE3 {}", annotations.blake3),
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
                Format::Parquet => set(
                    PARQUET,
                    "parquet/*.parquet",
                    "application/vnd.apache.parquet",
                ),
                Format::Webdataset => set(WEBDATASET, "webdataset/*.tar", "application/x-tar"),
            });
        }
        if manifest.coco {
            files.push(set(COCO, COCO, "application/json"));
        }
        let field = |name: &str, path: &str, kind: &str| {
            json!({
                "@type": "cr:Field",
                "@id": format!("records/{name}"),
                "name": name,
                "dataType": kind,
                "source": {
                    "fileObject": { "@id": ANNOTATIONS },
                    "extract": { "jsonPath": path },
                },
            })
        };
        let licenses: Vec<&String> = self
            .counts
            .get("license")
            .into_iter()
            .flat_map(|l| l.keys())
            .collect();
        json!({
            "@context": {
                "@vocab": "https://schema.org/",
                "cr": "http://mlcommons.org/croissant/",
                "sc": "https://schema.org/",
                "dct": "http://purl.org/dc/terms/",
                "conformsTo": "dct:conformsTo",
            },
            "@type": "sc:Dataset",
            "conformsTo": "http://mlcommons.org/croissant/1.0",
            "name": manifest.recipe,
            "description": format!(
                "{} images of {} artificial faces with exact labels",
                self.images,
                self.subjects.len()
            ),
            "license": licenses,
            "version": manifest.recipe_hash,
            "creator": { "@type": "sc:SoftwareApplication", "name": manifest.program },
            "distribution": files,
            "recordSet": [{
                "@type": "cr:RecordSet",
                "@id": "records",
                "name": "records",
                "field": [
                    field("index", "$.index", "sc:Integer"),
                    field("image", "$.image", "sc:Text"),
                    field("subject", "$.subject.id", "sc:Text"),
                    field("expression", "$.expression.name", "sc:Text"),
                    field("intensity", "$.expression.intensity", "sc:Float"),
                    field("light", "$.light.name", "sc:Text"),
                    field("occluder", "$.occluder.kind", "sc:Text"),
                    field("yaw_deg", "$.head_pose.yaw_deg", "sc:Float"),
                    field("face_box_px", "$.face_box_px", "sc:Float"),
                ],
            }],
        })
    }
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
        let mut tally = Tally::default();
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
        }
        tally.add("not a record");
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
        let croissant = tally.croissant(&manifest, &entry);
        assert_eq!(croissant["distribution"].as_array().map(Vec::len), Some(2));
    }
}
