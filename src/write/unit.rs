//! A unit that is being written: samples in order into every format of the recipe, then its journal.

use super::folder::Folder;
use super::journal::{FileEntry, Journal};
use super::manifest::Failure;
use super::parquet::ParquetSink;
use super::sample::EncodedSample;
use super::webdataset::TarSink;
use crate::Error;
use crate::recipe::file::Format;

/// Stores the samples of one unit in one format.
pub(super) trait Sink {
    /// Stores a sample; samples come in the order of their numbers.
    fn append(&mut self, sample: &EncodedSample) -> Result<(), Error>;

    /// Puts what was stored in its place.
    fn finish(self: Box<Self>) -> Result<Vec<FileEntry>, Error>;
}

/// A unit that is being written. Dropped before [`Self::finish`] it leaves nothing that counts.
pub struct UnitWriter<'a> {
    folder: &'a Folder,
    unit: u64,
    sinks: Vec<Box<dyn Sink + Send + 'a>>,
    journal: Journal,
}

impl<'a> UnitWriter<'a> {
    /// Begins a unit in every format of the dataset.
    ///
    /// # Errors
    /// [`Error::Io`] if the folder cannot be written.
    pub fn new(folder: &'a Folder, unit: u64) -> Result<Self, Error> {
        let sink = |format: &Format| -> Result<Box<dyn Sink + Send + 'a>, Error> {
            Ok(match format {
                Format::Folder => Box::new(FileSink {
                    folder,
                    files: Vec::new(),
                }),
                Format::Webdataset => Box::new(TarSink::new(folder, unit)?),
                Format::Parquet => Box::new(ParquetSink::new(folder, unit)?),
            })
        };
        Ok(Self {
            folder,
            unit,
            sinks: folder
                .formats()
                .iter()
                .map(sink)
                .collect::<Result<_, _>>()?,
            journal: Journal::default(),
        })
    }

    /// Stores the next sample.
    ///
    /// # Errors
    /// [`Error::Io`] with the file.
    pub fn append(&mut self, sample: EncodedSample) -> Result<(), Error> {
        for sink in &mut self.sinks {
            sink.append(&sample)?;
        }
        self.journal.records.push(sample.record);
        self.journal.coco.extend(sample.coco);
        Ok(())
    }

    /// Notes what could not be made.
    pub fn fail(&mut self, failure: Failure) {
        self.journal.failures.push(failure);
    }

    /// Puts all files in their places, then the journal.
    ///
    /// # Errors
    /// [`Error::Io`] with the file.
    pub fn finish(mut self) -> Result<(), Error> {
        for sink in self.sinks {
            self.journal.files.extend(sink.finish()?);
        }
        self.journal.failures.sort();
        self.folder.finish_unit(self.unit, &self.journal)
    }
}

/// The `folder` format: each file by itself.
struct FileSink<'a> {
    folder: &'a Folder,
    files: Vec<FileEntry>,
}

impl Sink for FileSink<'_> {
    fn append(&mut self, sample: &EncodedSample) -> Result<(), Error> {
        for (name, bytes) in sample.files() {
            self.files.push(self.folder.write(&name, bytes)?);
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Vec<FileEntry>, Error> {
        Ok(self.files)
    }
}
