//! The `parquet` format: tables that Hugging Face `datasets`, pandas and DuckDB open.
//!
//! A row holds a sample: image and maps as files inside the table, labels as numbers, lists and classes with names, the
//! whole record as JSON. The names and types that `datasets` shows are in the file's metadata under `huggingface`. Pages
//! are neither compressed (the images are already) nor dated, so that the same samples make the same bytes. The format is
//! that of <https://parquet.apache.org/docs/file-format>; we write the small part of it that this takes ourselves.

use std::collections::BTreeMap;
use std::io::Write as _;

use serde::Deserialize;
use serde_json::{Value, json};

use super::folder::{Folder, Scratch};
use super::journal::FileEntry;
use super::manifest::Labels;
use super::sample::EncodedSample;
use super::unit::Sink;
use crate::Error;
use column::{Column, Field, Kind};
use thrift::Struct;

mod column;
mod thrift;

/// Folder of the Parquet files in a dataset.
pub const PARQUET: &str = "parquet";
/// What may hide a landmark, in the order of its classes.
pub const VISIBILITIES: [&str; 5] = ["visible", "self", "occluder", "closed_mouth", "frame"];
const MAGIC: &[u8; 4] = b"PAR1";
/// Rows that are stored together: readers load so many at once, and we hold them in memory.
const ROWS: usize = 100;

/// Path of the Parquet file of a unit within a dataset.
pub fn parquet_name(unit: u64) -> String {
    format!("{PARQUET}/{unit:06}.parquet")
}

/// A Parquet file that is being written.
pub(super) struct ParquetSink<'a> {
    scratch: Scratch<'a>,
    unit: u64,
    labels: &'a Labels,
    offset: i64,
    /// Known from the first sample on.
    table: Option<Table>,
    row_groups: Vec<Struct>,
    rows: usize,
    all_rows: i64,
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
        for (kind, _) in sample.maps.iter() {
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
            .flat_map(|(name, field, _)| field.columns(name))
            .collect();
        Self { fields, columns }
    }

    /// Adds a row. `None` if it is not like the first one.
    fn add(&mut self, sample: &EncodedSample, row: &Row, labels: &Labels) -> Option<()> {
        let mut columns = self.columns.iter_mut();
        let mut next = || columns.next();
        let place = |names: &[String], name: &str| names.iter().position(|n| n == name);
        next()?.int(0, sample.index as i64);
        next()?.bytes(&sample.image);
        next()?.bytes(row.image.as_bytes());
        for (kind, bytes) in sample.maps.iter() {
            next()?.bytes(bytes);
            next()?.bytes(row.maps.get(*kind)?.file.as_bytes());
        }
        next()?.bytes(row.subject.id.as_bytes());
        next()?.bytes(row.subject.kind.as_bytes());
        next()?.int(0, place(&labels.expressions, &row.expression.name)? as i64);
        next()?.double(0, row.expression.intensity);
        next()?.int(0, place(&labels.lights, &row.light.name)? as i64);
        next()?.int(0, place(&labels.occluders, &row.occluder.kind)? as i64);
        let pose = &row.head_pose;
        for angle in [pose.yaw_deg, pose.pitch_deg, pose.roll_deg] {
            next()?.double(0, angle);
        }
        let column = next()?;
        for (i, v) in row.face_box_px.iter().enumerate() {
            column.double(u8::from(i > 0), *v);
        }
        for landmarks in row.landmarks.values() {
            points(next()?, &landmarks.px);
            points(next()?, &landmarks.mm);
            let column = next()?;
            for (i, visibility) in landmarks.visibility.iter().enumerate() {
                let class = VISIBILITIES.iter().position(|v| v == visibility)?;
                column.int(u8::from(i > 0), class as i64);
            }
        }
        next()?.bytes(sample.record.as_bytes());
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
fn points<const N: usize>(column: &mut Column, points: &[[f64; N]]) {
    for (i, point) in points.iter().enumerate() {
        for (k, v) in point.iter().enumerate() {
            let level = match (i, k) {
                (0, 0) => 0,
                (_, 0) => 1,
                _ => 2,
            };
            column.double(level, *v);
        }
    }
}

impl<'a> ParquetSink<'a> {
    pub(super) fn new(folder: &'a Folder, unit: u64) -> Result<Self, Error> {
        let mut sink = Self {
            scratch: folder.scratch(&parquet_name(unit))?,
            unit,
            labels: folder.labels(),
            offset: 0,
            table: None,
            row_groups: Vec::new(),
            rows: 0,
            all_rows: 0,
        };
        sink.put(MAGIC)?;
        Ok(sink)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.scratch
            .write_all(bytes)
            .map_err(|e| Error::io(self.scratch.target(), e))?;
        self.offset += bytes.len() as i64;
        Ok(())
    }

    /// Writes the rows at hand.
    fn flush(&mut self) -> Result<(), Error> {
        let Some(mut table) = self.table.take().filter(|_| self.rows > 0) else {
            return Ok(());
        };
        let start = self.offset;
        let mut chunks = Vec::new();
        for column in &mut table.columns {
            let offset = self.offset;
            let (page, metadata) = column.take_page(offset);
            self.put(&page)?;
            chunks.push(Struct::default().i64(2, offset).nested(3, metadata));
        }
        let group = Struct::default()
            .structs(1, chunks)
            .i64(2, self.offset - start)
            .i64(3, self.rows as i64);
        self.row_groups.push(group);
        self.all_rows += self.rows as i64;
        self.rows = 0;
        self.table = Some(table);
        Ok(())
    }
}

/// Bytes of a column that are written before there are [`ROWS`] rows: pages count them in 31 bits.
const LARGEST_PAGE: usize = 256 << 20;

impl Sink for ParquetSink<'_> {
    fn append(&mut self, sample: &EncodedSample) -> Result<(), Error> {
        let broken = |reason: String| Error::Internal { reason };
        let row: Row = serde_json::from_str(&sample.record)
            .map_err(|e| broken(format!("record of sample {}: {e}", sample.index)))?;
        let table = self
            .table
            .get_or_insert_with(|| Table::of(sample, &row, self.labels));
        table.add(sample, &row, self.labels).ok_or_else(|| {
            broken(format!(
                "sample {} is not like the others of its table",
                sample.index
            ))
        })?;
        let largest = table.columns.iter().map(Column::len).max();
        self.rows += 1;
        if self.rows == ROWS || largest > Some(LARGEST_PAGE) {
            self.flush()?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<FileEntry>, Error> {
        self.flush()?;
        let Some(table) = &self.table else {
            // A unit of which every sample failed has no table.
            return Ok(Vec::new());
        };
        let fields = table
            .fields
            .iter()
            .flat_map(|(name, field, _)| field.schema(name));
        let root = Struct::default()
            .text(4, "schema")
            .i32(5, table.fields.len() as i32);
        let features = Struct::default()
            .text(1, "huggingface")
            .text(2, &table.features());
        let footer = Struct::default()
            .i32(1, 1)
            .structs(2, std::iter::once(root).chain(fields))
            .i64(3, self.all_rows)
            .structs(4, std::mem::take(&mut self.row_groups))
            .structs(5, [features])
            .text(6, concat!("facile ", env!("CARGO_PKG_VERSION")))
            .end();
        self.put(&footer)?;
        self.put(&(footer.len() as u32).to_le_bytes())?;
        self.put(MAGIC)?;
        let name = parquet_name(self.unit);
        Ok(vec![self.scratch.commit(&name)?])
    }
}
