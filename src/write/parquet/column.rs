//! One column of a Parquet file: its place in the schema, its values in plain encoding, its levels.
//!
//! Every value is there, so definition levels are all the same; repetition levels tell where lists begin.

use super::thrift::{Struct, varint};

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

impl Kind {
    /// `parquet.thrift`, `Type`.
    fn physical(self) -> i32 {
        match self {
            Self::Int64 => 2,
            Self::Double => 5,
            Self::Bytes | Self::Text => 6,
        }
    }
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

/// `FieldRepetitionType` and `ConvertedType` of `parquet.thrift`.
const OPTIONAL: i32 = 1;
const REPEATED: i32 = 2;
const UTF8: i32 = 0;
const LIST: i32 = 3;
/// `Encoding`.
const PLAIN: i32 = 0;
const RLE: i32 = 3;

impl Field {
    /// The field's elements of the schema, in depth-first order.
    pub(super) fn schema(&self, name: &str) -> Vec<Struct> {
        let leaf = |name: &str, kind: Kind| {
            let element = Struct::default()
                .i32(1, kind.physical())
                .i32(3, OPTIONAL)
                .text(4, name);
            if kind == Kind::Text {
                element.i32(6, UTF8)
            } else {
                element
            }
        };
        let group = |name: &str, repetition: i32, children: i32| {
            Struct::default()
                .i32(3, repetition)
                .text(4, name)
                .i32(5, children)
        };
        match self {
            Self::Value(kind) => vec![leaf(name, *kind)],
            Self::File => vec![
                group(name, OPTIONAL, 2),
                leaf("bytes", Kind::Bytes),
                leaf("path", Kind::Text),
            ],
            Self::List(kind, depth) => {
                let mut elements = Vec::new();
                for level in 0..*depth {
                    let name = if level == 0 { name } else { "element" };
                    elements.push(group(name, OPTIONAL, 1).i32(6, LIST));
                    elements.push(group("list", REPEATED, 1));
                }
                elements.push(leaf("element", *kind));
                elements
            }
        }
    }

    /// The field's columns, empty.
    pub(super) fn columns(&self, name: &str) -> Vec<Column> {
        let column = |path: &[&str], kind, definition, repetition| Column {
            path: path.iter().map(|p| (*p).to_owned()).collect(),
            kind,
            definition,
            repetition,
            values: Vec::new(),
            starts: Vec::new(),
        };
        match self {
            Self::Value(kind) => vec![column(&[name], *kind, 1, 0)],
            Self::File => vec![
                column(&[name, "bytes"], Kind::Bytes, 2, 0),
                column(&[name, "path"], Kind::Text, 2, 0),
            ],
            Self::List(kind, depth) => {
                let mut path = vec![name];
                for _ in 0..*depth {
                    path.extend(["list", "element"]);
                }
                vec![column(&path, *kind, 2 * depth + 1, *depth)]
            }
        }
    }
}

/// The values of a column in the rows at hand.
#[derive(Debug)]
pub(super) struct Column {
    path: Vec<String>,
    kind: Kind,
    /// Largest levels.
    definition: u8,
    repetition: u8,
    values: Vec<u8>,
    /// The repetition level of each value.
    starts: Vec<u8>,
}

impl Column {
    /// Adds a whole number; `level` is the depth of the list that goes on, 0 for a new row.
    pub(super) fn int(&mut self, level: u8, v: i64) {
        self.values.extend(v.to_le_bytes());
        self.starts.push(level);
    }

    /// Adds a number.
    pub(super) fn double(&mut self, level: u8, v: f64) {
        self.values.extend(v.to_le_bytes());
        self.starts.push(level);
    }

    /// Adds bytes or a text of the next row.
    pub(super) fn bytes(&mut self, v: &[u8]) {
        self.values.extend((v.len() as u32).to_le_bytes());
        self.values.extend(v);
        self.starts.push(0);
    }

    /// Bytes at hand.
    pub(super) fn len(&self) -> usize {
        self.values.len()
    }

    /// Takes the values as one page: its bytes, and the column's metadata for a chunk that begins at `offset`.
    pub(super) fn take_page(&mut self, offset: i64) -> (Vec<u8>, Struct) {
        let count = self.starts.len() as i32;
        let mut data = Vec::with_capacity(self.values.len() + 64);
        if self.repetition > 0 {
            levels(&mut data, packed(&self.starts));
        }
        levels(&mut data, repeated(self.starts.len(), self.definition));
        data.append(&mut self.values);
        self.starts.clear();
        let size = data.len() as i32;
        let header = Struct::default()
            .i32(1, 0)
            .i32(2, size)
            .i32(3, size)
            .nested(
                5,
                Struct::default()
                    .i32(1, count)
                    .i32(2, PLAIN)
                    .i32(3, RLE)
                    .i32(4, RLE),
            );
        let mut page = header.end();
        page.append(&mut data);
        let total = page.len() as i64;
        let metadata = Struct::default()
            .i32(1, self.kind.physical())
            .i32s(2, &[PLAIN, RLE])
            .texts(3, &self.path)
            .i32(4, 0)
            .i64(5, i64::from(count))
            .i64(6, total)
            .i64(7, total)
            .i64(9, offset);
        (page, metadata)
    }
}

/// Levels with their length before them.
fn levels(out: &mut Vec<u8>, encoded: Vec<u8>) {
    out.extend((encoded.len() as u32).to_le_bytes());
    out.extend(encoded);
}

/// `n` times the same level of at most 8 bits.
fn repeated(n: usize, level: u8) -> Vec<u8> {
    let mut out = Vec::new();
    varint(&mut out, (n as u64) << 1);
    out.push(level);
    out
}

/// Levels of at most 2, packed in groups of eight.
fn packed(levels: &[u8]) -> Vec<u8> {
    let width = if levels.contains(&2) { 2 } else { 1 };
    let groups = levels.len().div_ceil(8);
    let mut out = Vec::new();
    varint(&mut out, (groups as u64) << 1 | 1);
    for group in levels.chunks(8) {
        let bits = group.iter().enumerate().fold(0_u32, |bits, (i, level)| {
            bits | u32::from(*level) << (i * width)
        });
        out.extend(&bits.to_le_bytes()[..width]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_packed_from_the_lowest_bit() {
        // The example of the format's description, "Encodings": 0 to 7 in three bits; here of one and two bits.
        assert_eq!(packed(&[0, 1, 1, 0, 1, 0, 0, 0, 1]), [5, 0b0001_0110, 1]);
        assert_eq!(packed(&[0, 2, 1, 2]), [3, 0b1001_1000, 0]);
        assert_eq!(repeated(300, 5), [0xd8, 0x04, 5]);
    }
}
