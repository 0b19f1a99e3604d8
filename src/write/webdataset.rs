//! The `webdataset` format: tar files of consecutive samples.
//!
//! A sample is a run of members with one stem: `000042.png` (or `jpg`, `webp`), `000042.json` (the record) and one member
//! for each map, such as `000042.segments.png`. Every sample brings its maps, those that differ in light alone too. Files
//! hold no times or owners, so that the same samples make the same bytes.

use tar::{Builder, EntryType, Header};

use super::folder::{Folder, Scratch};
use super::journal::FileEntry;
use super::sample::EncodedSample;
use super::unit::Sink;
use crate::Error;

/// Folder of the tar files in a dataset.
pub const WEBDATASET: &str = "webdataset";

/// Path of the tar file of a unit within a dataset.
pub fn tar_name(unit: u64) -> String {
    format!("{WEBDATASET}/{unit:06}.tar")
}

/// A tar file that is being written.
pub(super) struct TarSink<'a> {
    builder: Builder<Scratch<'a>>,
    unit: u64,
}

impl<'a> TarSink<'a> {
    pub(super) fn new(folder: &'a Folder, unit: u64) -> Result<Self, Error> {
        let scratch = folder.scratch(&tar_name(unit))?;
        Ok(Self {
            builder: Builder::new(scratch),
            unit,
        })
    }
}

impl Sink for TarSink<'_> {
    fn append(&mut self, sample: &EncodedSample) -> Result<(), Error> {
        let stem = format!("{:06}", sample.index);
        for (ending, bytes) in sample.members() {
            let name = format!("{stem}.{ending}");
            let mut header = header(bytes.len());
            let added = header.set_path(&name).and_then(|()| {
                header.set_cksum();
                self.builder.append(&header, bytes)
            });
            added.map_err(|e| Error::io(self.builder.get_ref().target(), e))?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Vec<FileEntry>, Error> {
        let name = tar_name(self.unit);
        let target = self.builder.get_ref().target().to_owned();
        let scratch = self
            .builder
            .into_inner()
            .map_err(|e| Error::io(&target, e))?;
        Ok(vec![scratch.commit(&name)?])
    }
}

/// A header without a path or checksum.
fn header(bytes: usize) -> Header {
    let mut header = Header::new_ustar();
    header.set_entry_type(EntryType::Regular);
    header.set_size(bytes as u64);
    header.set_mode(0o644);
    header.set_mtime(0);
    header.set_uid(0);
    header.set_gid(0);
    header
}
