//! The journal of a finished group: its files with their hashes, and its records.
//!
//! One JSON object for the files, then one line for each record, the very line that goes into `annotations.jsonl`. A
//! journal appears only after all its files are in place.

use serde::{Deserialize, Serialize};

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

/// What a finished group left behind.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Journal {
    /// Its files.
    pub files: Vec<FileEntry>,
    /// Its records, one line of JSON each, without the line's end.
    pub records: Vec<String>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    records: usize,
    files: Vec<FileEntry>,
}

impl Journal {
    /// The journal as text.
    pub(super) fn to_text(&self) -> String {
        let header = Header {
            records: self.records.len(),
            files: self.files.clone(),
        };
        let header =
            serde_json::to_string(&header).expect("names, sizes and hashes are plain JSON");
        let mut text = header + "\n";
        for record in &self.records {
            text.push_str(record);
            text.push('\n');
        }
        text
    }

    /// Reads a journal; `None` if it is damaged.
    pub(super) fn from_text(text: &str) -> Option<Self> {
        let mut lines = text.lines();
        let header: Header = serde_json::from_str(lines.next()?).ok()?;
        let records: Vec<String> = lines.map(str::to_owned).collect();
        (records.len() == header.records).then_some(Self {
            files: header.files,
            records,
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
        };
        let text = journal.to_text();
        assert_eq!(Journal::from_text(&text), Some(journal));
        let cut = &text[..text.len() - 14];
        assert_eq!(Journal::from_text(cut), None);
        assert_eq!(Journal::from_text(""), None);
    }
}
