//! Journals made again from a finished dataset, so that only what was lost is remade.
//!
//! Annotations, checksums and COCO entries of a finished dataset are in the order of their units, and a number in each
//! says to which one they belong.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader};
use std::iter::Peekable;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::coco::COCO;
use super::folder::{ANNOTATIONS, CHECKSUMS, Folder};
use super::journal::{FileEntry, Journal};
use super::manifest::{Failure, Manifest};
use super::parquet::PARQUET;
use super::webdataset::WEBDATASET;
use crate::Error;

/// Writes the journals of all units of a finished dataset. Units of which a part of the lists is lost get none, and are
/// made again.
pub(super) fn journals(folder: &Folder, manifest: &Manifest) -> Result<(), Error> {
    let root = folder.root();
    let per_unit = manifest.samples_per_unit.max(1);
    let mut records = lines(root, ANNOTATIONS)
        .filter_map(|line| Some((index_of(&line)? / per_unit, line)))
        .peekable();
    let mut files = lines(root, CHECKSUMS)
        .filter_map(|line| file_of(root, &line, per_unit))
        .peekable();
    let mut coco = if manifest.coco {
        coco_lines(root)
    } else {
        BTreeMap::new()
    };
    for unit in 0..manifest.units() {
        let samples = unit * per_unit..(unit + 1) * per_unit;
        let journal = Journal {
            files: taken(&mut files, unit),
            records: taken(&mut records, unit),
            coco: samples.clone().filter_map(|i| coco.remove(&i)).collect(),
            failures: failures_within(&manifest.failures, &samples),
        };
        let is_whole = journal.samples() == samples.end.min(manifest.samples) - samples.start
            && (!manifest.coco || journal.coco.len() == journal.records.len());
        if is_whole {
            folder.finish_unit(unit, &journal)?;
        }
    }
    Ok(())
}

fn lines(root: &Path, name: &str) -> impl Iterator<Item = String> {
    let file = File::open(root.join(name)).ok().map(BufReader::new);
    file.into_iter()
        .flat_map(|file| file.lines().map_while(Result::ok))
}

/// The items of one unit from a sequence in the order of units.
fn taken<T>(items: &mut Peekable<impl Iterator<Item = (u64, T)>>, unit: u64) -> Vec<T> {
    let mut taken = Vec::new();
    while let Some((_, item)) = items.next_if(|(u, _)| *u <= unit) {
        taken.push(item);
    }
    taken
}

fn index_of(record: &str) -> Option<u64> {
    #[derive(Deserialize)]
    struct Index {
        index: u64,
    }
    serde_json::from_str::<Index>(record).ok().map(|r| r.index)
}

/// A line of the checksums as a file of its unit. A file that is gone gets a size that none has.
fn file_of(root: &Path, line: &str, per_unit: u64) -> Option<(u64, FileEntry)> {
    let (blake3, name) = line.split_once("  ")?;
    let (folder, file) = name.split_once('/')?;
    let number: u64 = file.split_once('.')?.0.parse().ok()?;
    let unit = if folder == WEBDATASET || folder == PARQUET {
        number
    } else {
        number / per_unit
    };
    let bytes = fs::metadata(root.join(name)).map_or(u64::MAX, |m| m.len());
    let entry = FileEntry {
        name: name.to_owned(),
        bytes,
        blake3: blake3.to_owned(),
    };
    Some((unit, entry))
}

/// The lines of the journals that a COCO file was made of, by sample.
fn coco_lines(root: &Path) -> BTreeMap<u64, String> {
    let text = fs::read_to_string(root.join(COCO)).unwrap_or_default();
    let mut file: Value = serde_json::from_str(&text).unwrap_or_default();
    let list = |v: Value| match v {
        Value::Array(items) => items,
        _ => Vec::new(),
    };
    let (images, annotations) = (
        list(file["images"].take()),
        list(file["annotations"].take()),
    );
    let pairs = images.into_iter().zip(annotations);
    pairs
        .filter_map(|(image, annotation)| {
            let id = image["id"].as_u64()?;
            let line = serde_json::json!({ "image": image, "annotation": annotation });
            Some((id, line.to_string()))
        })
        .collect()
}

/// The parts of failures that lie within some samples.
fn failures_within(failures: &[Failure], samples: &std::ops::Range<u64>) -> Vec<Failure> {
    let within = failures.iter().filter_map(|f| {
        let first = f.first.max(samples.start);
        let end = (f.first + f.samples).min(samples.end);
        (first < end).then(|| Failure {
            first,
            samples: end - first,
            ..f.clone()
        })
    });
    within.collect()
}
