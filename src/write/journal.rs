//! The journal of a finished unit: its files with their hashes, its records, and what failed in it.
//!
//! One JSON object for files and failures, then one line for each record, the very line that goes into
//! `annotations.jsonl`, then one for each sample's COCO entries. A journal appears only after all its files are in place.

use serde::{Deserialize, Serialize};

use super::manifest::Failure;

/// A file of a dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Path within the dataset, with forward slashes.
    pub name: String,
    /// Size.
    pub bytes: u64,
    /// BLAKE3 hash, hexadecimal.
    pub blake3: String,
}

/// What a finished unit left behind.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Journal {
    /// Its files.
    pub files: Vec<FileEntry>,
    /// Its records, one line of JSON each, without the line's end.
    pub records: Vec<String>,
    /// The entries of its samples in a COCO file, likewise.
    pub coco: Vec<String>,
    /// What could not be made.
    pub failures: Vec<Failure>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    records: usize,
    coco: usize,
    files: Vec<FileEntry>,
    failures: Vec<Failure>,
}

impl Journal {
    /// Number of samples that were made or that failed.
    pub fn samples(&self) -> u64 {
        let failed: u64 = self.failures.iter().map(|f| f.samples).sum();
        self.records.len() as u64 + failed
    }

    /// The journal as text.
    pub(super) fn to_text(&self) -> String {
        let header = Header {
            records: self.records.len(),
            coco: self.coco.len(),
            files: self.files.clone(),
            failures: self.failures.clone(),
        };
        let header =
            serde_json::to_string(&header).expect("names, sizes and hashes are plain JSON");
        let mut text = header + "\n";
        for line in self.records.iter().chain(&self.coco) {
            text.push_str(line);
            text.push('\n');
        }
        text
    }

    /// Reads a journal; `None` if it is damaged.
    pub(super) fn from_text(text: &str) -> Option<Self> {
        let mut lines = text.lines();
        let header: Header = serde_json::from_str(lines.next()?).ok()?;
        let mut records: Vec<String> = lines.map(str::to_owned).collect();
        if records.len() != header.records + header.coco || !text.ends_with('\n') {
            return None;
        }
        let coco = records.split_off(header.records);
        Some(Self {
            files: header.files,
            records,
            coco,
            failures: header.failures,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_journal_reads_back_and_a_cut_one_does_not() {
        let journal = Journal {
            files: vec![FileEntry {
                name: "images/000000.png".to_owned(),
                bytes: 12,
                blake3: "ab".to_owned(),
            }],
            records: vec!["{\"index\":0}".to_owned(), "{\"index\":1}".to_owned()],
            coco: vec!["{\"image\":{}}".to_owned()],
            failures: Vec::new(),
        };
        let text = journal.to_text();
        assert_eq!(Journal::from_text(&text), Some(journal));
        let cut = &text[..text.len() - 14];
        assert_eq!(Journal::from_text(cut), None);
        assert_eq!(Journal::from_text(""), None);
    }
}
