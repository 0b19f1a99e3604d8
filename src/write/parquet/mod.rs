//! The `parquet` format: tables that Hugging Face `datasets`, pandas and `DuckDB` open.
//!
//! A row holds a sample: image and maps as files inside the table, labels as numbers, lists and classes with names, the
//! whole record as JSON. The names and types that `datasets` shows are in the file's metadata under `huggingface`. Pages
//! are neither compressed (the images are already) nor dated, so that the same samples make the same bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use serde::Deserialize;
use serde_json::{Value, json};

use super::folder::{Folder, Scratch};
use super::journal::FileEntry;
use super::manifest::Labels;
use super::sample::EncodedSample;
use super::unit::Sink;
use crate::Error;
use column::{Column, Field, Kind};

mod column;

/// Folder of the Parquet files in a dataset.
pub const PARQUET: &str = "parquet";
/// What may hide a landmark, in the order of its classes.
pub const VISIBILITIES: [&str; 6] = [
    "visible",
    "self",
    "occluder",
    "closed_mouth",
    "frame",
    "hair",
];
/// Rows that are stored together: readers load so many at once, and we hold them in memory.
const ROWS: usize = 100;

/// Path of the Parquet file of a unit within a dataset.
pub fn parquet_name(unit: u64) -> String {
    format!("{PARQUET}/{unit:06}.parquet")
}

/// A Parquet file that is being written.
pub(super) struct ParquetSink<'a> {
    unit: u64,
    labels: &'a Labels,
    path: PathBuf,
    /// The file, until the first sample says what the table holds.
    scratch: Option<Scratch<'a>>,
    open: Option<Open<'a>>,
}

/// A table with its first samples.
struct Open<'a> {
    table: Table,
    rows: usize,
    writer: SerializedFileWriter<Scratch<'a>>,
}

/// Fields and columns.
struct Table {
    fields: Vec<(String, Field, Value)>,
    columns: Vec<Column>,
}

/// What is read of a record.
#[derive(Deserialize)]
struct Row {
    image: String,
    subject: Subject,
    expression: Expression,
    light: Named,
    occluder: Occluder,
    head_pose: HeadPose,
    face_box_px: [f64; 4],
    #[serde(default)]
    landmarks: BTreeMap<String, Landmarks>,
    #[serde(default)]
    maps: BTreeMap<String, Map>,
}

#[derive(Deserialize)]
struct Subject {
    id: String,
    kind: String,
}

#[derive(Deserialize)]
struct Expression {
    name: String,
    intensity: f64,
}

#[derive(Deserialize)]
struct Named {
    name: String,
}

#[derive(Deserialize)]
struct Occluder {
    kind: String,
}

#[derive(Deserialize)]
struct HeadPose {
    yaw_deg: f64,
    pitch_deg: f64,
    roll_deg: f64,
}

#[derive(Deserialize)]
struct Landmarks {
    px: Vec<[f64; 2]>,
    mm: Vec<[f64; 3]>,
    visibility: Vec<String>,
}

#[derive(Deserialize)]
struct Map {
    file: String,
}

impl Table {
    /// The table of samples like this one.
    fn of(sample: &EncodedSample, row: &Row, labels: &Labels) -> Self {
        let value = |dtype: &str| json!({ "dtype": dtype, "_type": "Value" });
        let class = |names: &[String]| json!({ "names": names, "_type": "ClassLabel" });
        let list = |of: Value| json!({ "feature": of, "_type": "Sequence" });
        let image = || json!({ "_type": "Image" });
        let int = Field::Value(Kind::Int64);
        let double = || (Field::Value(Kind::Double), value("float64"));
        let text = || (Field::Value(Kind::Text), value("string"));
        let mut fields = vec![
            ("index".to_owned(), int.clone(), value("int64")),
            ("image".to_owned(), Field::File, image()),
        ];
        let mut add = |name: &str, (field, feature): (Field, Value)| {
            fields.push((name.to_owned(), field, feature));
        };
        for (kind, _) in sample.all_maps() {
            add(kind, (Field::File, image()));
        }
        add("subject", text());
        add("subject_kind", text());
        add("expression", (int.clone(), class(&labels.expressions)));
        add("intensity", double());
        add("light", (int.clone(), class(&labels.lights)));
        add("occluder", (int, class(&labels.occluders)));
        for name in ["yaw_deg", "pitch_deg", "roll_deg"] {
            add(name, double());
        }
        add(
            "face_box_px",
            (Field::List(Kind::Double, 1), list(value("float64"))),
        );
        for scheme in row.landmarks.keys() {
            let points = || (Field::List(Kind::Double, 2), list(list(value("float64"))));
            add(&format!("{scheme}_px"), points());
            add(&format!("{scheme}_mm"), points());
            let names = VISIBILITIES.map(str::to_owned);
            let visibility = (Field::List(Kind::Int64, 1), list(class(&names)));
            add(&format!("{scheme}_visibility"), visibility);
        }
        add("record", text());
        let columns = fields
            .iter()
            .flat_map(|(_, field, _)| field.columns())
            .collect();
        Self { fields, columns }
    }

    /// Adds a row. `None` if it is not like the first one.
    fn add(&mut self, sample: &EncodedSample, row: &Row, labels: &Labels) -> Option<()> {
        let mut columns = self.columns.iter_mut();
        let mut next = || columns.next();
        let place = |names: &[String], name: &str| names.iter().position(|n| n == name);
        next()?.int(0, sample.index as i64)?;
        next()?.bytes(&sample.image)?;
        next()?.bytes(row.image.as_bytes())?;
        for (kind, bytes) in sample.all_maps() {
            next()?.bytes(bytes)?;
            next()?.bytes(row.maps.get(kind)?.file.as_bytes())?;
        }
        next()?.bytes(row.subject.id.as_bytes())?;
        next()?.bytes(row.subject.kind.as_bytes())?;
        next()?.int(0, place(&labels.expressions, &row.expression.name)? as i64)?;
        next()?.double(0, row.expression.intensity)?;
        next()?.int(0, place(&labels.lights, &row.light.name)? as i64)?;
        next()?.int(0, place(&labels.occluders, &row.occluder.kind)? as i64)?;
        let pose = &row.head_pose;
        for angle in [pose.yaw_deg, pose.pitch_deg, pose.roll_deg] {
            next()?.double(0, angle)?;
        }
        let column = next()?;
        for (i, v) in row.face_box_px.iter().enumerate() {
            column.double(i16::from(i > 0), *v)?;
        }
        for landmarks in row.landmarks.values() {
            points(next()?, &landmarks.px)?;
            points(next()?, &landmarks.mm)?;
            let column = next()?;
            for (i, visibility) in landmarks.visibility.iter().enumerate() {
                let class = VISIBILITIES.iter().position(|v| v == visibility)?;
                column.int(i16::from(i > 0), class as i64)?;
            }
        }
        next()?.bytes(sample.record.as_bytes())?;
        Some(())
    }

    /// The metadata that `datasets` reads its features from.
    fn features(&self) -> String {
        let features: serde_json::Map<String, Value> = self
            .fields
            .iter()
            .map(|(name, _, feature)| (name.clone(), feature.clone()))
            .collect();
        json!({ "info": { "features": features } }).to_string()
    }
}

/// A list of points as a list of lists.
fn points<const N: usize>(column: &mut Column, points: &[[f64; N]]) -> Option<()> {
    for (i, point) in points.iter().enumerate() {
        for (k, v) in point.iter().enumerate() {
            let level = match (i, k) {
                (0, 0) => 0,
                (_, 0) => 1,
                _ => 2,
            };
            column.double(level, *v)?;
        }
    }
    Some(())
}

impl<'a> Open<'a> {
    fn new(table: Table, scratch: Scratch<'a>) -> Result<Self, ParquetError> {
        let fields = table.fields.iter();
        let schema = Type::group_type_builder("schema")
            .with_fields(
                fields
                    .map(|(name, field, _)| field.schema(name))
                    .collect::<Result<_, _>>()?,
            )
            .build()?;
        let features = KeyValue::new("huggingface".to_owned(), table.features());
        let properties = WriterProperties::builder()
            .set_compression(Compression::UNCOMPRESSED)
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_write_batch_size(BATCH)
            .set_created_by(concat!("facile ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_key_value_metadata(Some(vec![features]))
            .build();
        let writer = SerializedFileWriter::new(scratch, Arc::new(schema), Arc::new(properties))?;
        Ok(Self {
            table,
            rows: 0,
            writer,
        })
    }

    /// Writes the rows at hand.
    fn flush(&mut self) -> Result<(), ParquetError> {
        if self.rows == 0 {
            return Ok(());
        }
        self.rows = 0;
        let mut group = self.writer.next_row_group()?;
        for column in &mut self.table.columns {
            if let Some(writer) = group.next_column()? {
                column.write(writer)?;
            }
        }
        group.close().map(|_| ())
    }
}

impl<'a> ParquetSink<'a> {
    pub(super) fn new(folder: &'a Folder, unit: u64) -> Result<Self, Error> {
        let scratch = folder.scratch(&parquet_name(unit))?;
        Ok(Self {
            unit,
            labels: folder.labels(),
            path: scratch.target().to_owned(),
            scratch: Some(scratch),
            open: None,
        })
    }
}

/// Bytes of a column that are written before there are [`ROWS`] rows: readers load them at once.
const LARGEST_CHUNK: usize = 64 << 20;
/// Values after which a page may end: images are large, so few.
const BATCH: usize = 8;

impl Sink for ParquetSink<'_> {
    fn append(&mut self, sample: &EncodedSample) -> Result<(), Error> {
        let broken = |reason: String| Error::Internal { reason };
        let row: Row = serde_json::from_str(&sample.record)
            .map_err(|e| broken(format!("record of sample {}: {e}", sample.index)))?;
        let failed = |e| unwritten(&self.path, e);
        if let Some(scratch) = self.scratch.take() {
            let table = Table::of(sample, &row, self.labels);
            self.open = Some(Open::new(table, scratch).map_err(failed)?);
        }
        let Some(open) = &mut self.open else {
            return Err(broken("rows after a table that could not begin".to_owned()));
        };
        open.table.add(sample, &row, self.labels).ok_or_else(|| {
            broken(format!(
                "sample {} is not like the others of its table",
                sample.index
            ))
        })?;
        let largest = open.table.columns.iter().map(Column::len).max();
        open.rows += 1;
        if open.rows == ROWS || largest > Some(LARGEST_CHUNK) {
            open.flush().map_err(failed)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<Vec<FileEntry>, Error> {
        let Some(mut open) = self.open else {
            // A unit of which every sample failed has no table.
            return Ok(Vec::new());
        };
        let failed = |e| unwritten(&self.path, e);
        open.flush().map_err(failed)?;
        let scratch = open.writer.into_inner().map_err(failed)?;
        Ok(vec![scratch.commit(&parquet_name(self.unit))?])
    }
}

/// What went wrong with a file.
fn unwritten(path: &Path, error: ParquetError) -> Error {
    Error::io(path, std::io::Error::other(error))
}
