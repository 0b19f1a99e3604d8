//! The `folder` format: files in a folder, written so that no interruption leaves half a file or loses a finished group.
//!
//! While a run goes on the folder holds `.facile/`: a lock, a scratch folder from which finished files are moved into
//! place, and one journal for every finished group with its records and the hash of each of its files. When all groups
//! are done the journals become `annotations.jsonl` and `checksums.b3` (in the format of `b3sum`), and `.facile/` goes.
//! Read next [`super::journal`] and [`super::manifest`].

use std::fs::{self, File};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use crate::Error;

use super::journal::{FileEntry, Journal};
use super::manifest::{Failure, MANIFEST, Manifest};

/// Name of the records in a finished dataset.
pub const ANNOTATIONS: &str = "annotations.jsonl";
/// Name of the list of hashes in a finished dataset.
pub const CHECKSUMS: &str = "checksums.b3";
const WORK: &str = ".facile";

/// An output folder that this process writes to.
#[derive(Debug)]
pub struct Folder {
    root: PathBuf,
    manifest: Manifest,
    next_scratch: AtomicU64,
    // Held open: the lock ends with the process, however that ends.
    _lock: File,
}

impl Folder {
    /// Opens a folder for a dataset, new or to be continued. `overwrite` removes whatever another recipe left there.
    ///
    /// # Errors
    /// [`Error::Occupied`] if it holds another dataset or other files, [`Error::Locked`] if another process is at
    /// work, [`Error::Io`] if it cannot be written.
    pub fn open(root: &Path, manifest: Manifest, overwrite: bool) -> Result<Self, Error> {
        if let Some(reason) = occupied(root, &manifest)? {
            if !overwrite {
                let folder = root.to_owned();
                return Err(Error::Occupied { folder, reason });
            }
            remove_dataset(root)?;
        }
        let work = root.join(WORK);
        for dir in [work.join("groups"), work.join("scratch")] {
            fs::create_dir_all(&dir).map_err(|e| Error::io(&dir, e))?;
        }
        let lock = lock(root, &work)?;
        let folder = Self {
            root: root.to_owned(),
            manifest,
            next_scratch: AtomicU64::new(0),
            _lock: lock,
        };
        folder.clear_scratch()?;
        folder.write_manifest(&folder.manifest)?;
        Ok(folder)
    }

    /// The folder's path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Writes one file at once: whoever looks sees all of it or nothing. Returns its size and hash.
    ///
    /// # Errors
    /// [`Error::Io`] with the file.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<FileEntry, Error> {
        self.place(name, |file| file.write_all(bytes))?;
        Ok(FileEntry {
            name: name.to_owned(),
            bytes: bytes.len() as u64,
            blake3: blake3::hash(bytes).to_hex().to_string(),
        })
    }

    /// Marks a group as finished.
    ///
    /// # Errors
    /// [`Error::Io`] with the journal.
    pub fn finish_group(&self, group: u64, journal: &Journal) -> Result<(), Error> {
        self.write(&journal_name(group), journal.to_text().as_bytes())
            .map(|_| ())
    }

    /// The journal of a group if it is finished and all its files are still there.
    pub fn finished_group(&self, group: u64) -> Option<Journal> {
        let text = fs::read_to_string(self.root.join(journal_name(group))).ok()?;
        let journal = Journal::from_text(&text)?;
        let present = |f: &FileEntry| {
            fs::metadata(self.root.join(&f.name)).is_ok_and(|m| m.is_file() && m.len() == f.bytes)
        };
        journal.files.iter().all(present).then_some(journal)
    }

    /// Writes annotations, checksums and manifest from the journals of the groups `0..groups`; groups without one are
    /// left out. Removes the journals if the dataset is complete. Returns the number of records.
    ///
    /// # Errors
    /// [`Error::Io`] with the file that could not be written.
    pub fn finish(&self, groups: u64, failures: Vec<Failure>) -> Result<u64, Error> {
        let mut records = 0;
        let mut hasher = blake3::Hasher::new();
        self.place(ANNOTATIONS, |file| {
            for journal in (0..groups).filter_map(|g| self.finished_group(g)) {
                for record in &journal.records {
                    hasher.update(record.as_bytes()).update(b"\n");
                    file.write_all(record.as_bytes())?;
                    file.write_all(b"\n")?;
                    records += 1;
                }
            }
            Ok(())
        })?;
        let annotations = hasher.finalize().to_hex();
        self.place(CHECKSUMS, |file| {
            writeln!(file, "{annotations}  {ANNOTATIONS}")?;
            for journal in (0..groups).filter_map(|g| self.finished_group(g)) {
                for entry in &journal.files {
                    writeln!(file, "{}  {}", entry.blake3, entry.name)?;
                }
            }
            Ok(())
        })?;
        let manifest = Manifest {
            written: records,
            complete: records == self.manifest.samples,
            failures,
            ..self.manifest.clone()
        };
        self.write_manifest(&manifest)?;
        if manifest.complete {
            let work = self.root.join(WORK);
            fs::remove_dir_all(&work).map_err(|e| Error::io(&work, e))?;
        }
        Ok(records)
    }

    fn write_manifest(&self, manifest: &Manifest) -> Result<(), Error> {
        self.write(MANIFEST, manifest.to_text().as_bytes())
            .map(|_| ())
    }

    /// Fills a scratch file and moves it to its place.
    fn place(
        &self,
        name: &str,
        fill: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
    ) -> Result<(), Error> {
        let number = self.next_scratch.fetch_add(1, Ordering::Relaxed);
        let scratch = self
            .root
            .join(WORK)
            .join("scratch")
            .join(number.to_string());
        let target = self.root.join(name);
        let written = File::create(&scratch).and_then(|file| {
            let mut file = BufWriter::with_capacity(1 << 16, file);
            fill(&mut file)?;
            file.flush()
        });
        written.map_err(|e| Error::io(&target, e))?;
        let moved = fs::rename(&scratch, &target).or_else(|_| {
            // The first file of a kind makes its folder.
            if let Some(parent) = target.parent() {
                fs::create_dir_all(parent)?;
            }
            fs::rename(&scratch, &target)
        });
        moved.map_err(|e| Error::io(&target, e))
    }

    fn clear_scratch(&self) -> Result<(), Error> {
        let scratch = self.root.join(WORK).join("scratch");
        let entries = fs::read_dir(&scratch).map_err(|e| Error::io(&scratch, e))?;
        for entry in entries.flatten() {
            fs::remove_file(entry.path()).map_err(|e| Error::io(&entry.path(), e))?;
        }
        Ok(())
    }
}

/// The manifest of a finished dataset at `root` of which every file is in place; `None` if anything is missing.
pub fn finished(root: &Path, recipe_hash: &str) -> Option<Manifest> {
    let manifest = Manifest::read(root).ok().flatten()?;
    if !manifest.complete || manifest.recipe_hash != recipe_hash {
        return None;
    }
    let checksums = fs::read_to_string(root.join(CHECKSUMS)).ok()?;
    let mut names = checksums.lines().filter_map(|l| l.split_once("  "));
    names
        .all(|(_, name)| root.join(name).is_file())
        .then_some(manifest)
}

fn journal_name(group: u64) -> String {
    format!("{WORK}/groups/{group:08}.jsonl")
}

/// Why a folder cannot take this dataset; `None` if it is empty, absent, or holds the same recipe's.
fn occupied(root: &Path, manifest: &Manifest) -> Result<Option<String>, Error> {
    let entries = match fs::read_dir(root) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(root, e)),
    };
    match Manifest::read(root)? {
        Some(found) if found.recipe_hash == manifest.recipe_hash => Ok(None),
        Some(found) if found.recipe != manifest.recipe => {
            Ok(Some(format!("holds the dataset `{}`", found.recipe)))
        }
        Some(found) if found.program != manifest.program => Ok(Some(format!(
            "holds this dataset as made by {}, this is {}",
            found.program, manifest.program
        ))),
        Some(_) => Ok(Some(
            "holds this dataset as made from another state of its recipe or scans".to_owned(),
        )),
        // A run that was killed before its manifest leaves the work folder alone.
        None => Ok(entries
            .flatten()
            .find(|e| e.file_name() != WORK)
            .map(|e| format!("holds other files, such as {}", e.file_name().display()))),
    }
}

/// Removes what a dataset consists of, and nothing else.
fn remove_dataset(root: &Path) -> Result<(), Error> {
    let mut names: Vec<String> = super::MAP_FOLDERS.iter().map(|f| (*f).to_owned()).collect();
    names.extend([super::IMAGES, ANNOTATIONS, CHECKSUMS, MANIFEST, WORK].map(str::to_owned));
    for name in names {
        let path = root.join(name);
        let removed = if path.is_dir() {
            fs::remove_dir_all(&path)
        } else if path.exists() {
            fs::remove_file(&path)
        } else {
            Ok(())
        };
        removed.map_err(|e| Error::io(&path, e))?;
    }
    Ok(())
}

fn lock(root: &Path, work: &Path) -> Result<File, Error> {
    let path = work.join("lock");
    let file = File::create(&path).map_err(|e| Error::io(&path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(Error::Locked {
            folder: root.to_owned(),
        }),
        Err(fs::TryLockError::Error(e)) => Err(Error::io(&path, e)),
    }
}
