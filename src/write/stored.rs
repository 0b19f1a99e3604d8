//! Reads single files back out of a dataset, whatever format it is stored in.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use parquet::column::reader::get_typed_column_reader;
use parquet::data_type::ByteArrayType;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader as _, SerializedFileReader};

use super::manifest::Manifest;
use super::parquet::parquet_name;
use super::webdataset::tar_name;
use crate::Error;
use crate::recipe::file::Format;

/// A dataset on disk, finished or in the making.
#[derive(Debug)]
pub(crate) struct Stored<'a> {
    root: &'a Path,
    manifest: &'a Manifest,
}

impl<'a> Stored<'a> {
    /// The dataset at `root`.
    pub(crate) fn new(root: &'a Path, manifest: &'a Manifest) -> Self {
        Self { root, manifest }
    }

    /// The bytes of the file that the record of sample `index` names: its image, or the map of a kind.
    ///
    /// # Errors
    /// [`Error::Io`] with the file, [`Error::Dataset`] if it is not in it.
    pub(crate) fn file(&self, index: u64, name: &str, map: Option<&str>) -> Result<Vec<u8>, Error> {
        let formats = &self.manifest.formats;
        let unit = index / self.manifest.samples_per_unit.max(1);
        let (path, found) = if formats.contains(&Format::Folder) {
            let path = self.root.join(name);
            let found = fs::read(&path).map(Some);
            (path, found)
        } else if formats.contains(&Format::Webdataset) {
            let ending = name.rsplit('.').next().unwrap_or_default();
            let member = match map {
                Some(kind) => format!("{index:06}.{kind}.{ending}"),
                None => format!("{index:06}.{ending}"),
            };
            let path = self.root.join(tar_name(unit));
            let found = tar_member(&path, &member);
            (path, found)
        } else {
            let path = self.root.join(parquet_name(unit));
            let column = format!("{}.bytes", map.unwrap_or("image"));
            let found = table_cell(&path, index, &column);
            (path, found)
        };
        let missing = |path: PathBuf| Error::Dataset {
            path,
            reason: format!("holds no `{name}` of sample {index}"),
        };
        match found {
            Ok(Some(bytes)) => Ok(bytes),
            Ok(None) => Err(missing(path)),
            Err(e) => Err(Error::io(&path, e)),
        }
    }
}

fn tar_member(path: &Path, name: &str) -> std::io::Result<Option<Vec<u8>>> {
    let mut archive = tar::Archive::new(File::open(path)?);
    for entry in archive.entries_with_seek()? {
        let mut entry = entry?;
        if *entry.path_bytes() == *name.as_bytes() {
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes)?;
            return Ok(Some(bytes));
        }
    }
    Ok(None)
}

/// What column `column` of a table holds of sample `index`.
pub(crate) fn table_cell(
    path: &Path,
    index: u64,
    column: &str,
) -> std::io::Result<Option<Vec<u8>>> {
    cell(path, index, column).map_err(std::io::Error::other)
}

fn cell(path: &Path, index: u64, column: &str) -> Result<Option<Vec<u8>>, ParquetError> {
    let reader = SerializedFileReader::new(File::open(path)?)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let place = |wanted: &str| {
        let columns = schema.columns().iter();
        columns
            .enumerate()
            .find(|(_, c)| c.path().string() == wanted)
            .map(|(i, _)| i)
    };
    let (Some(indices), Some(files)) = (place("index"), place(column)) else {
        return Ok(None);
    };
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group)?;
        let rows = group.metadata().num_rows() as usize;
        let mut numbers = Vec::new();
        get_typed_column_reader::<parquet::data_type::Int64Type>(group.get_column_reader(indices)?)
            .read_records(rows, None, None, &mut numbers)?;
        let Some(row) = numbers.iter().position(|n| *n == index as i64) else {
            continue;
        };
        let mut cells = get_typed_column_reader::<ByteArrayType>(group.get_column_reader(files)?);
        cells.skip_records(row)?;
        let mut cell = Vec::new();
        cells.read_records(1, None, None, &mut cell)?;
        return Ok(cell.pop().map(|bytes| bytes.data().to_vec()));
    }
    Ok(None)
}
