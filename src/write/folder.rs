//! The folder of a dataset, written so that no interruption leaves half a file or loses a finished unit.
//!
//! While a run goes on the folder holds `.facile/`: a lock, a scratch folder from which finished files are moved into
//! place, and one journal for every finished unit with its records and the hash of each of its files. When all units
//! are done the journals become `annotations.jsonl` and `checksums.b3` (in the format of `b3sum`), and `.facile/` goes;
//! if files of a finished dataset are lost the journals are made again from these, and only what is missing is remade.
//! Read next [`super::journal`], [`super::unit`] and [`super::manifest`].

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use facile_core::Plane;
use rayon::prelude::*;
use sha2::{Digest as _, Sha256};

use crate::Error;
use crate::recipe::file::Format;
use crate::threads;

use super::card::{CARD, CROISSANT, Tally};
use super::coco::{COCO, write_coco};
use super::contact::{CONTACT_SHEET, Selection};
use super::encode_rgb8;
use super::journal::{FileEntry, Journal};
use super::labels::{LABELS, labels_schema};
use super::manifest::{Failure, Labels, MANIFEST, Manifest};
use super::restore;
use super::stored::Stored;

/// Name of the records in a finished dataset.
pub const ANNOTATIONS: &str = "annotations.jsonl";
/// Name of the list of hashes in a finished dataset.
pub const CHECKSUMS: &str = "checksums.b3";
const WORK: &str = ".facile";
const UNITS: &str = ".facile/units";
const SCRATCH: &str = ".facile/scratch";

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
        for dir in [root.join(UNITS), root.join(SCRATCH)] {
            fs::create_dir_all(&dir).map_err(|e| Error::io(&dir, e))?;
        }
        let lock = lock(root)?;
        let folder = Self {
            root: root.to_owned(),
            manifest,
            next_scratch: AtomicU64::new(0),
            _lock: lock,
        };
        folder.clear_scratch()?;
        if let Some(found) = Manifest::read(root)?
            && found.complete
            && found.part.is_none()
        {
            restore::journals(&folder, &found)?;
        }
        folder.write_manifest(&folder.manifest)?;
        Ok(folder)
    }

    /// The folder's path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// How the dataset is stored.
    pub fn formats(&self) -> &[Format] {
        &self.manifest.formats
    }

    /// Names of classes.
    pub(super) fn labels(&self) -> &Labels {
        &self.manifest.labels
    }

    /// Writes one file at once: whoever looks sees all of it or nothing. Returns its size and hash.
    ///
    /// # Errors
    /// [`Error::Io`] with the file.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<FileEntry, Error> {
        self.place(name, |file| file.write_all(bytes))
    }

    /// Marks a unit as finished.
    ///
    /// # Errors
    /// [`Error::Io`] with the journal.
    pub fn finish_unit(&self, unit: u64, journal: &Journal) -> Result<(), Error> {
        self.write(&journal_name(unit), journal.to_text().as_bytes())
            .map(|_| ())
    }

    /// The finished units of which all files are still there, in order, with their numbers of samples.
    ///
    /// # Errors
    /// [`Error::Io`] if the journals cannot be listed.
    pub fn finished_units(&self) -> Result<Vec<(u64, u64)>, Error> {
        let mut units = unit_numbers(&self.root)?;
        units.sort_unstable();
        let present = |f: &FileEntry| {
            fs::metadata(self.root.join(&f.name)).is_ok_and(|m| m.is_file() && m.len() == f.bytes)
        };
        let whole = |unit| {
            let journal = read_journal(&self.root, unit)?;
            let is_whole = journal.files.iter().all(present);
            is_whole.then(|| (unit, journal.samples()))
        };
        Ok(threads::with(|| {
            units.into_par_iter().filter_map(whole).collect()
        }))
    }

    /// Writes annotations, checksums and manifest from the journals of the finished units, and removes the journals if
    /// the dataset is complete. Returns the manifest.
    ///
    /// # Errors
    /// [`Error::Io`] with the file that could not be written.
    pub fn finish(&self) -> Result<Manifest, Error> {
        threads::with(|| self.finish_here())
    }

    fn finish_here(&self) -> Result<Manifest, Error> {
        let units = self.finished_units()?;
        let journals = || {
            units
                .iter()
                .filter_map(|(u, _)| read_journal(&self.root, *u))
        };
        let mut tally = Tally::default();
        let mut written = 0;
        let mut failures = Vec::new();
        let mut selection = Selection::of(units.iter().map(|(_, samples)| samples).sum());
        let mut sha256 = Sha256::new();
        let annotations = self.place(ANNOTATIONS, |file| {
            // Journals are read and counted on all processors, a few at a time, and written in order.
            for batch in units.chunks(2 * rayon::current_num_threads()) {
                let read: Vec<(Journal, Tally)> = batch
                    .par_iter()
                    .filter_map(|(unit, _)| {
                        let journal = read_journal(&self.root, *unit)?;
                        let mut tally = Tally::default();
                        journal.records.iter().for_each(|r| tally.add(r));
                        Some((journal, tally))
                    })
                    .collect();
                for (journal, counted) in read {
                    for record in &journal.records {
                        writeln!(file, "{record}")?;
                        sha256.update(record);
                        sha256.update("\n");
                    }
                    let made = journal.records.len() as u64;
                    selection.look_at(&journal.records, journal.samples() - made);
                    written += made;
                    failures.extend(journal.failures);
                    tally.merge(counted);
                }
            }
            Ok(())
        })?;
        failures.sort();
        let failed: u64 = failures.iter().map(|f: &Failure| f.samples).sum();
        let card = tally.card(&self.manifest, failed);
        let sha256 = format!("{:x}", sha256.finalize());
        let croissant = tally.croissant(&self.manifest, &annotations, &sha256);
        let croissant = format!("{croissant:#}\n");
        let mut listed = vec![annotations];
        listed.push(self.write(CARD, card.as_bytes())?);
        listed.push(self.write(CROISSANT, croissant.as_bytes())?);
        let labels = format!("{:#}\n", labels_schema());
        listed.push(self.write(LABELS, labels.as_bytes())?);
        if let Some(sheet) = selection.draw(&Stored::new(&self.root, &self.manifest)) {
            let size = (sheet.width() as usize, sheet.height() as usize);
            let (pixels, _) = sheet.as_raw().as_chunks::<3>();
            let plane = Plane::from_vec(size.0, size.1, pixels.to_vec());
            listed.push(self.write(CONTACT_SHEET, &encode_rgb8(&plane)?)?);
        }
        if self.manifest.coco {
            listed.push(self.place(COCO, |file| {
                write_coco(file, &self.manifest.recipe, journals)
            })?);
        }
        self.place(CHECKSUMS, |file| {
            for entry in &listed {
                writeln!(file, "{}  {}", entry.blake3, entry.name)?;
            }
            for entry in journals().flat_map(|j| j.files) {
                writeln!(file, "{}  {}", entry.blake3, entry.name)?;
            }
            Ok(())
        })?;
        let manifest = Manifest {
            written,
            complete: self.manifest.part.is_none() && written + failed == self.manifest.samples,
            failures: Failure::joined(failures),
            ..self.manifest.clone()
        };
        self.write_manifest(&manifest)?;
        // A part keeps its journals, from which it is merged.
        if manifest.complete && manifest.part.is_none() {
            let work = self.root.join(WORK);
            fs::remove_dir_all(&work).map_err(|e| Error::io(&work, e))?;
        }
        Ok(manifest)
    }

    fn write_manifest(&self, manifest: &Manifest) -> Result<(), Error> {
        self.write(MANIFEST, manifest.to_text().as_bytes())
            .map(|_| ())
    }

    /// Fills a file and moves it to its place.
    fn place(
        &self,
        name: &str,
        fill: impl FnOnce(&mut Scratch<'_>) -> std::io::Result<()>,
    ) -> Result<FileEntry, Error> {
        let mut scratch = self.scratch(name)?;
        fill(&mut scratch).map_err(|e| Error::io(scratch.target(), e))?;
        scratch.commit(name)
    }

    /// Begins a file that will be called `name`.
    pub(super) fn scratch(&self, name: &str) -> Result<Scratch<'_>, Error> {
        let number = self.next_scratch.fetch_add(1, Ordering::Relaxed);
        let path = self.root.join(SCRATCH).join(number.to_string());
        let target = self.root.join(name);
        let file = File::create(&path).map_err(|e| Error::io(&target, e))?;
        Ok(Scratch {
            folder: self,
            path,
            target,
            file: BufWriter::with_capacity(1 << 16, file),
            hasher: blake3::Hasher::new(),
            bytes: 0,
        })
    }

    fn clear_scratch(&self) -> Result<(), Error> {
        let scratch = self.root.join(SCRATCH);
        let entries = fs::read_dir(&scratch).map_err(|e| Error::io(&scratch, e))?;
        for entry in entries.flatten() {
            fs::remove_file(entry.path()).map_err(|e| Error::io(&entry.path(), e))?;
        }
        Ok(())
    }
}

/// A file that is being written: hashed on the way, and in its place only when it is whole.
pub(super) struct Scratch<'a> {
    folder: &'a Folder,
    path: PathBuf,
    target: PathBuf,
    file: BufWriter<File>,
    hasher: blake3::Hasher,
    bytes: u64,
}

impl Scratch<'_> {
    /// Where the file will be.
    pub(super) fn target(&self) -> &Path {
        &self.target
    }

    /// Moves the file to its place.
    pub(super) fn commit(mut self, name: &str) -> Result<FileEntry, Error> {
        let moved = self.file.flush().and_then(|()| {
            fs::rename(&self.path, &self.target).or_else(|e| {
                // The first file of a kind makes its folder; where the dataset's own folder is gone nothing is made.
                if !self.path.is_file() {
                    return Err(e);
                }
                if let Some(parent) = self.target.parent() {
                    fs::create_dir_all(parent)?;
                }
                fs::rename(&self.path, &self.target)
            })
        });
        moved.map_err(|e| Error::io(&self.folder.root.join(name), e))?;
        Ok(FileEntry {
            name: name.to_owned(),
            bytes: self.bytes,
            blake3: self.hasher.finalize().to_hex().to_string(),
        })
    }
}

impl Write for Scratch<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let taken = self.file.write(bytes)?;
        self.hasher.update(&bytes[..taken]);
        self.bytes += taken as u64;
        Ok(taken)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// The manifest of a finished dataset at `root` of which every file is in place; `None` if anything is missing.
pub fn finished(root: &Path, recipe_hash: &str) -> Option<Manifest> {
    let manifest = Manifest::read(root).ok().flatten()?;
    if !manifest.complete || manifest.part.is_some() || manifest.recipe_hash != recipe_hash {
        return None;
    }
    let checksums = fs::read_to_string(root.join(CHECKSUMS)).ok()?;
    let mut names = checksums.lines().filter_map(|l| l.split_once("  "));
    names
        .all(|(_, name)| root.join(name).is_file())
        .then_some(manifest)
}

fn journal_name(unit: u64) -> String {
    format!("{UNITS}/{unit:08}.jsonl")
}

/// The journal of a unit, if it is there and whole.
pub(super) fn read_journal(root: &Path, unit: u64) -> Option<Journal> {
    Journal::from_text(&fs::read_to_string(root.join(journal_name(unit))).ok()?)
}

/// The units that have a journal, in no order.
pub(super) fn unit_numbers(root: &Path) -> Result<Vec<u64>, Error> {
    let dir = root.join(UNITS);
    let entries = fs::read_dir(&dir).map_err(|e| Error::io(&dir, e))?;
    let number = |entry: fs::DirEntry| {
        let name = entry.file_name();
        name.to_str()?.strip_suffix(".jsonl")?.parse().ok()
    };
    Ok(entries.flatten().filter_map(number).collect())
}

/// Why a folder cannot take this dataset; `None` if it is empty, absent, or holds the same recipe's.
fn occupied(root: &Path, manifest: &Manifest) -> Result<Option<String>, Error> {
    let entries = match fs::read_dir(root) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(root, e)),
    };
    match Manifest::read(root)? {
        Some(found) if found.recipe_hash == manifest.recipe_hash && found.part != manifest.part => {
            Ok(Some(match found.part {
                Some(part) => format!("holds part {part} of this dataset"),
                None => "holds all of this dataset".to_owned(),
            }))
        }
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
    let others = [
        CARD,
        CROISSANT,
        CONTACT_SHEET,
        LABELS,
        super::IMAGES,
        super::WEBDATASET,
        super::PARQUET,
        ANNOTATIONS,
        CHECKSUMS,
        COCO,
        MANIFEST,
        WORK,
    ];
    names.extend(others.map(str::to_owned));
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

fn lock(root: &Path) -> Result<File, Error> {
    let path = root.join(WORK).join("lock");
    let file = File::create(&path).map_err(|e| Error::io(&path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(Error::Locked {
            folder: root.to_owned(),
        }),
        Err(fs::TryLockError::Error(e)) => Err(Error::io(&path, e)),
    }
}
