//! One column of a Parquet file: its place in the schema, its values, its levels.
//!
//! Every value is there, so definition levels are all the same; repetition levels tell where lists begin.

use std::sync::Arc;

use parquet::basic::{ConvertedType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::Result;
use parquet::file::writer::SerializedColumnWriter;
use parquet::schema::types::{Type, TypePtr};

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Whole numbers.
    Int64,
    /// Numbers.
    Double,
    /// Bytes.
    Bytes,
    /// UTF-8.
    Text,
}

/// A field of the schema.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Field {
    /// One value in each row.
    Value(Kind),
    /// A file: `bytes` and `path`.
    File,
    /// A list in each row, or a list of lists.
    List(Kind, u8),
}

impl Field {
    /// The field's part of the schema.
    pub(super) fn schema(&self, name: &str) -> Result<TypePtr> {
        match self {
            Self::Value(kind) => leaf(name, *kind),
            Self::File => {
                let parts = vec![leaf("bytes", Kind::Bytes)?, leaf("path", Kind::Text)?];
                group(name, Repetition::OPTIONAL, ConvertedType::NONE, parts)
            }
            Self::List(kind, depth) => {
                let mut inner = leaf("element", *kind)?;
                for level in (0..*depth).rev() {
                    let name = if level == 0 { name } else { "element" };
                    let (none, list) = (ConvertedType::NONE, ConvertedType::LIST);
                    inner = group("list", Repetition::REPEATED, none, vec![inner])?;
                    inner = group(name, Repetition::OPTIONAL, list, vec![inner])?;
                }
                Ok(inner)
            }
        }
    }

    /// The field's columns, empty.
    pub(super) fn columns(&self) -> Vec<Column> {
        match self {
            Self::Value(kind) => vec![Column::new(*kind, 1)],
            Self::File => vec![Column::new(Kind::Bytes, 2), Column::new(Kind::Text, 2)],
            Self::List(kind, depth) => vec![Column::new(*kind, 2 * i16::from(*depth) + 1)],
        }
    }
}

fn leaf(name: &str, kind: Kind) -> Result<TypePtr> {
    let (physical, converted) = match kind {
        Kind::Int64 => (Physical::INT64, ConvertedType::NONE),
        Kind::Double => (Physical::DOUBLE, ConvertedType::NONE),
        Kind::Bytes => (Physical::BYTE_ARRAY, ConvertedType::NONE),
        Kind::Text => (Physical::BYTE_ARRAY, ConvertedType::UTF8),
    };
    let leaf = Type::primitive_type_builder(name, physical)
        .with_repetition(Repetition::OPTIONAL)
        .with_converted_type(converted);
    leaf.build().map(Arc::new)
}

fn group(
    name: &str,
    repetition: Repetition,
    converted: ConvertedType,
    fields: Vec<TypePtr>,
) -> Result<TypePtr> {
    let group = Type::group_type_builder(name)
        .with_repetition(repetition)
        .with_converted_type(converted)
        .with_fields(fields);
    group.build().map(Arc::new)
}

/// Values of one physical type.
#[derive(Debug)]
enum Values {
    Int64(Vec<i64>),
    Double(Vec<f64>),
    Bytes(Vec<ByteArray>),
}

/// The values of a column in the rows at hand.
#[derive(Debug)]
pub(super) struct Column {
    /// The definition level of every value.
    definition: i16,
    values: Values,
    /// The repetition level of each value.
    starts: Vec<i16>,
    bytes: usize,
}

impl Column {
    fn new(kind: Kind, definition: i16) -> Self {
        Self {
            definition,
            values: match kind {
                Kind::Int64 => Values::Int64(Vec::new()),
                Kind::Double => Values::Double(Vec::new()),
                Kind::Bytes | Kind::Text => Values::Bytes(Vec::new()),
            },
            starts: Vec::new(),
            bytes: 0,
        }
    }

    /// Adds a whole number; `level` is the depth of the list that goes on, 0 for a new row. `None` if the column holds
    /// something else, as for all of these.
    pub(super) fn int(&mut self, level: i16, v: i64) -> Option<()> {
        let Values::Int64(values) = &mut self.values else {
            return None;
        };
        values.push(v);
        self.note(level, size_of::<i64>());
        Some(())
    }

    /// Adds a number.
    pub(super) fn double(&mut self, level: i16, v: f64) -> Option<()> {
        let Values::Double(values) = &mut self.values else {
            return None;
        };
        values.push(v);
        self.note(level, size_of::<f64>());
        Some(())
    }

    /// Adds bytes or a text of the next row.
    pub(super) fn bytes(&mut self, v: &[u8]) -> Option<()> {
        let Values::Bytes(values) = &mut self.values else {
            return None;
        };
        values.push(v.to_vec().into());
        self.note(0, v.len());
        Some(())
    }

    fn note(&mut self, level: i16, bytes: usize) {
        self.starts.push(level);
        self.bytes += bytes;
    }

    /// Bytes at hand.
    pub(super) fn len(&self) -> usize {
        self.bytes
    }

    /// Writes the values as a chunk and forgets them.
    pub(super) fn write(&mut self, mut writer: SerializedColumnWriter<'_>) -> Result<()> {
        let definitions = vec![self.definition; self.starts.len()];
        let levels = (Some(&definitions[..]), Some(&self.starts[..]));
        match &mut self.values {
            Values::Int64(v) => {
                writer
                    .typed::<Int64Type>()
                    .write_batch(v, levels.0, levels.1)?;
                v.clear();
            }
            Values::Double(v) => {
                writer
                    .typed::<DoubleType>()
                    .write_batch(v, levels.0, levels.1)?;
                v.clear();
            }
            Values::Bytes(v) => {
                writer
                    .typed::<ByteArrayType>()
                    .write_batch(v, levels.0, levels.1)?;
                v.clear();
            }
        }
        self.starts.clear();
        self.bytes = 0;
        writer.close()
    }
}
