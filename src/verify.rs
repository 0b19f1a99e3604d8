//! Checks a dataset: every file against its hash, and single samples against the recipe.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::pipeline::{Pipeline, Worker};
use crate::recipe::Recipe;
use crate::recipe::file::Format;
use crate::threads;
use crate::write::{self, ANNOTATIONS, CHECKSUMS, EncodedSample, Encoder, Manifest};

/// Bytes read at once.
const BLOCK: usize = 1 << 16;

/// What a check found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// Number of files that were checked.
    pub files: u64,
    /// Files that are not what they should be, in the order of the list of hashes.
    pub bad: Vec<BadFile>,
    /// What the dataset says of itself.
    pub manifest: Manifest,
}

/// A file that is not what it should be.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BadFile {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// Hashes every file of a dataset and compares with its list, on all processors.
///
/// # Errors
/// [`Error::Dataset`] for a folder that holds no dataset, or one that is not finished; [`Error::Io`] if the list cannot
/// be read. Files that are wrong are no error: they are in [`Verdict::bad`].
pub fn verify(root: &Path) -> Result<Verdict, Error> {
    let manifest = manifest(root)?;
    let path = root.join(CHECKSUMS);
    let text = fs::read_to_string(&path).map_err(|e| Error::io(&path, e))?;
    let mut entries = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let entry = line.split_once("  ").ok_or_else(|| Error::Dataset {
            path: path.clone(),
            reason: format!("line {}: expected a hash and a name", number + 1),
        })?;
        entries.push(entry);
    }
    let check = |(hash, name): &(&str, &str)| {
        let path = root.join(name);
        let reason = match hash_of(&path) {
            Ok(found) if found.to_hex().as_str() == *hash => return None,
            Ok(found) => format!("its hash is {found}, expected {hash}"),
            Err(e) => e.to_string(),
        };
        Some(BadFile { path, reason })
    };
    Ok(Verdict {
        files: entries.len() as u64,
        bad: threads::with(|| entries.par_iter().filter_map(check).collect()),
        manifest,
    })
}

/// Makes sample `index` again from the recipe and compares it with the bytes of the dataset.
///
/// # Errors
/// [`Error::Dataset`] if the folder holds no dataset or that of another recipe; whatever making the sample reports.
pub fn verify_sample(root: &Path, recipe: Recipe, index: u64) -> Result<Verdict, Error> {
    let manifest = manifest(root)?;
    let pipeline = Arc::new(Pipeline::new(recipe)?);
    if manifest.recipe_hash != pipeline.recipe_hash() {
        return Err(Error::Dataset {
            path: root.to_owned(),
            reason: format!(
                "was made from another recipe, other scans or another version: its hash is {}, this recipe's {}",
                manifest.recipe_hash,
                pipeline.recipe_hash()
            ),
        });
    }
    let recipe = pipeline.recipe();
    let sample = Worker::new(pipeline.clone()).sample(index)?;
    let sample = Encoder::new(recipe).encode(&sample)?;
    let mut found = Comparison {
        root,
        files: 0,
        bad: Vec::new(),
    };
    found.record(&sample);
    if recipe.formats.contains(&Format::Folder) {
        for (name, bytes) in sample.files() {
            let path = root.join(name);
            let stored = fs::read(&path);
            found.compare(path, stored, bytes);
        }
    }
    if recipe.formats.contains(&Format::Webdataset) {
        found.tar(&sample, index / manifest.samples_per_unit)?;
    }
    if recipe.formats.contains(&Format::Parquet) {
        found.parquet(&sample, index / manifest.samples_per_unit);
    }
    Ok(Verdict {
        files: found.files,
        bad: found.bad,
        manifest,
    })
}

/// The sample in line `row` of a dataset's annotations, counted from 0.
///
/// # Errors
/// [`Error::Io`] if they cannot be read, [`Error::Dataset`] if there is no such line.
pub fn sample_of_row(root: &Path, row: u64) -> Result<u64, Error> {
    let path = root.join(ANNOTATIONS);
    let manifest = manifest(root)?;
    let index = if manifest.complete {
        // Lines are in the order of samples, without those that failed
        (row < manifest.written).then(|| {
            let failures = manifest.failures.iter();
            failures.fold(row, |index, failure| {
                if failure.first <= index {
                    index + failure.samples
                } else {
                    index
                }
            })
        })
    } else {
        let file = File::open(&path).map_err(|e| Error::io(&path, e))?;
        let line = BufReader::new(file).lines().nth(row as usize).transpose();
        let line = line.map_err(|e| Error::io(&path, e))?;
        line.and_then(|line| index_of(line.as_bytes()))
    };
    index.ok_or_else(|| Error::Dataset {
        path,
        reason: format!("has no record in row {row}, counted from 0"),
    })
}

/// The number at the start of a record, `{"index":7,...`.
fn index_of(line: &[u8]) -> Option<u64> {
    let rest = line.strip_prefix(b"{\"index\":")?;
    let end = rest.iter().position(|b| *b == b',')?;
    std::str::from_utf8(&rest[..end]).ok()?.parse().ok()
}

/// The record of sample `index` in annotations, whose lines are in the order of samples: by bisection, since there may be
/// millions.
fn record_line(path: &Path, index: u64) -> std::io::Result<Option<Vec<u8>>> {
    let file = File::open(path)?;
    // The line is one of those that begin from `low` on and before `high`.
    let (mut low, mut high) = (0, file.metadata()?.len());
    let mut file = BufReader::new(file);
    let mut line = Vec::new();
    while low < high {
        let middle = low + (high - low) / 2;
        // The first line that begins at `middle` or behind it
        let start = if middle == 0 {
            file.seek(SeekFrom::Start(0))?;
            0
        } else {
            file.seek(SeekFrom::Start(middle - 1))?;
            line.clear();
            middle - 1 + file.read_until(b'\n', &mut line)? as u64
        };
        line.clear();
        let length = file.read_until(b'\n', &mut line)? as u64;
        if length == 0 || start >= high {
            high = middle;
            continue;
        }
        match index_of(&line) {
            Some(found) if found == index => {
                line.pop_if(|b| *b == b'\n');
                return Ok(Some(line));
            }
            Some(found) if found < index => low = start + length,
            Some(_) => high = middle,
            None => {
                let reason = format!("byte {start}: expected a record");
                return Err(std::io::Error::other(reason));
            }
        }
    }
    Ok(None)
}

fn manifest(root: &Path) -> Result<Manifest, Error> {
    Manifest::read(root)?.ok_or_else(|| Error::Dataset {
        path: root.to_owned(),
        reason: "holds no dataset (no manifest.json)".to_owned(),
    })
}

fn hash_of(path: &Path) -> std::io::Result<blake3::Hash> {
    let mut file = File::open(path)?;
    let mut hasher = blake3::Hasher::new();
    let mut block = vec![0; BLOCK];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hasher.finalize()),
            n => hasher.update(&block[..n]),
        };
    }
}

/// Compares stored bytes with those of a sample that was made again.
struct Comparison<'a> {
    root: &'a Path,
    files: u64,
    bad: Vec<BadFile>,
}

impl Comparison<'_> {
    fn compare(&mut self, path: PathBuf, stored: std::io::Result<Vec<u8>>, made: &[u8]) {
        self.files += 1;
        let reason = match stored {
            Ok(stored) if stored == made => return,
            Ok(stored) => match stored.iter().zip(made).position(|(a, b)| a != b) {
                Some(at) => format!("differs from byte {at} on"),
                None => format!("has {} bytes, expected {}", stored.len(), made.len()),
            },
            Err(e) => e.to_string(),
        };
        self.bad.push(BadFile { path, reason });
    }

    fn record(&mut self, sample: &EncodedSample) {
        let path = self.root.join(ANNOTATIONS);
        let stored = record_line(&path, sample.index).and_then(|line| {
            let reason = format!("has no record of sample {}", sample.index);
            line.ok_or_else(|| std::io::Error::other(reason))
        });
        self.compare(path, stored, sample.record.as_bytes());
    }

    fn parquet(&mut self, sample: &EncodedSample, unit: u64) {
        let path = self.root.join(write::parquet_name(unit));
        let file = |kind: &str| format!("{kind}.bytes");
        let maps = sample.all_maps().map(|(kind, bytes)| (file(kind), bytes));
        let values = [
            (file("image"), &sample.image[..]),
            ("record".to_owned(), sample.record.as_bytes()),
        ];
        for (column, made) in values.into_iter().chain(maps) {
            let stored = write::table_cell(&path, sample.index, &column)
                .and_then(|cell| cell.ok_or_else(|| std::io::Error::other("is not in the table")));
            self.compare(path.join(column), stored, made);
        }
    }

    fn tar(&mut self, sample: &EncodedSample, unit: u64) -> Result<(), Error> {
        let path = self.root.join(write::tar_name(unit));
        let mut archive = tar::Archive::new(File::open(&path).map_err(|e| Error::io(&path, e))?);
        let mut made: BTreeMap<String, &[u8]> = sample
            .members()
            .map(|(ending, bytes)| (format!("{:06}.{ending}", sample.index), bytes))
            .collect();
        for entry in archive
            .entries_with_seek()
            .map_err(|e| Error::io(&path, e))?
        {
            let mut entry = entry.map_err(|e| Error::io(&path, e))?;
            let name = String::from_utf8_lossy(&entry.path_bytes()).into_owned();
            if let Some(made) = made.remove(&name) {
                let mut stored = Vec::new();
                let read = entry.read_to_end(&mut stored).map(|_| stored);
                self.compare(path.join(&name), read, made);
            }
        }
        for (name, bytes) in made {
            let missing = std::io::Error::other("is not in the file");
            self.compare(path.join(name), Err(missing), bytes);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_record_is_found_by_bisection_and_no_other() {
        let dir = tempfile::tempdir().expect("makes");
        let path = dir.path().join(ANNOTATIONS);
        // Lines of very different lengths, numbers with gaps
        let numbers: Vec<u64> = (0..60).map(|i| i * 3 + i / 7).collect();
        let line = |n: u64| {
            format!(
                "{{\"index\":{n},\"more\":\"{}\"}}",
                "x".repeat((n * n % 311) as usize)
            )
        };
        let text: String = numbers.iter().map(|n| line(*n) + "\n").collect();
        fs::write(&path, text).expect("writes");
        for n in 0..200 {
            let found = record_line(&path, n).expect("reads");
            let expected = numbers.contains(&n).then(|| line(n).into_bytes());
            assert_eq!(found, expected, "{n}");
        }
        fs::write(&path, "").expect("writes");
        assert_eq!(record_line(&path, 0).expect("reads"), None);
        fs::write(&path, "no record\n").expect("writes");
        assert!(record_line(&path, 0).is_err());
    }
}
