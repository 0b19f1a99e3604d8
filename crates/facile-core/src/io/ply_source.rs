//! The header of a PLY file and the stream of numbers after it: text or binary, of either byte order.

use std::path::Path;

use super::folder::shown;
use crate::CoreError;

/// Most lines of a header.
const MAX_HEADER_LINES: usize = 10_000;

/// A number's type in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of one value.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of full light in a colour of this type.
    pub(crate) fn full_light(self) -> f64 {
        match self {
            Self::F32 | Self::F64 => 1.0,
            Self::I16 | Self::U16 => 65_535.0,
            _ => 255.0,
        }
    }
}

/// A named value of an element, or a list of values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) scalar: Scalar,
    /// Type of the length if it is a list.
    pub(crate) list: Option<Scalar>,
}

/// A table of the file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: usize,
    pub(crate) properties: Vec<Property>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Text,
    Little,
    Big,
}

/// The header.
#[derive(Clone, Debug)]
pub(crate) struct Header {
    pub(crate) elements: Vec<Element>,
    /// Names after `comment TextureFile`, `MeshLab`'s way to name textures.
    pub(crate) textures: Vec<String>,
}

/// What follows the header, read from front to back.
pub(crate) struct Source<'a> {
    bytes: &'a [u8],
    encoding: Encoding,
    path: &'a Path,
    /// Line of the next word of a text file, from 1.
    line: usize,
    /// What is being read, for errors.
    element: String,
    row: usize,
}

/// Parses the header and returns the stream of what follows.
pub(crate) fn open<'a>(bytes: &'a [u8], path: &'a Path) -> Result<(Header, Source<'a>), CoreError> {
    let mut header = Header {
        elements: Vec::new(),
        textures: Vec::new(),
    };
    let mut encoding = None;
    let mut rest = bytes;
    for number in 1..=MAX_HEADER_LINES {
        let bad = |reason: String| CoreError::format(path, Some(format!("line {number}")), reason);
        let end = rest.iter().position(|b| *b == b'\n');
        let Some(end) = end else {
            return Err(bad("the header has no `end_header`".to_owned()));
        };
        let line = String::from_utf8_lossy(&rest[..end]).into_owned();
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["ply"] if number == 1 => {}
            _ if number == 1 => {
                return Err(bad("does not begin with `ply`".to_owned()));
            }
            ["format", name, ..] => {
                encoding = Some(match name {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    _ => return Err(bad(format!("unknown format `{}`", shown(name)))),
                });
            }
            ["element", name, count] => header.elements.push(Element {
                name: name.to_owned(),
                count: count.parse().map_err(|_| {
                    bad(format!(
                        "expected a number of elements, found `{}`",
                        shown(count)
                    ))
                })?,
                properties: Vec::new(),
            }),
            ["property", ..] => {
                let property = parse_property(&words[1..])
                    .ok_or_else(|| bad(format!("cannot read the property `{}`", shown(&line))))?;
                let element = header.elements.last_mut();
                element
                    .ok_or_else(|| bad("a property before any element".to_owned()))?
                    .properties
                    .push(property);
            }
            ["comment", "TextureFile", ..] => {
                let name = line.split_once("TextureFile").map_or("", |(_, name)| name);
                header.textures.push(name.trim().to_owned());
            }
            ["end_header"] => {
                let encoding =
                    encoding.ok_or_else(|| bad("the header has no `format`".to_owned()))?;
                let source = Source {
                    bytes: rest,
                    encoding,
                    path,
                    line: number + 1,
                    element: String::new(),
                    row: 0,
                };
                return Ok((header, source));
            }
            [] | ["comment" | "obj_info", ..] => {}
            _ => return Err(bad(format!("unknown statement `{}`", shown(&line)))),
        }
    }
    let reason = format!("the header is longer than {MAX_HEADER_LINES} lines");
    Err(CoreError::format(path, None, reason))
}

fn parse_property(words: &[&str]) -> Option<Property> {
    Some(match words {
        ["list", length, scalar, name] => Property {
            name: (*name).to_owned(),
            scalar: Scalar::from_name(scalar)?,
            list: Some(Scalar::from_name(length)?),
        },
        [scalar, name] => Property {
            name: (*name).to_owned(),
            scalar: Scalar::from_name(scalar)?,
            list: None,
        },
        _ => return None,
    })
}

impl Source<'_> {
    /// Starts an element: checks that its rows can fit into what is left of the file, before memory is taken for them.
    pub(crate) fn begin(&mut self, element: &Element) -> Result<(), CoreError> {
        self.element.clone_from(&element.name);
        self.row = 0;
        let least: usize = element
            .properties
            .iter()
            .map(|p| match (self.encoding, p.list) {
                // A digit and a space; the last space may be missing.
                (Encoding::Text, _) => 2,
                (_, Some(length)) => length.size(),
                (_, None) => p.scalar.size(),
            })
            .sum();
        let needed = element.count.saturating_mul(least);
        if needed > self.bytes.len() + 1 {
            let reason = format!(
                "the file ends early: {} rows of `{}` need at least {needed} bytes, {} are left",
                element.count,
                shown(&element.name),
                self.bytes.len()
            );
            return Err(CoreError::format(self.path, None, reason));
        }
        Ok(())
    }

    /// Says which row the next values belong to.
    pub(crate) fn set_row(&mut self, row: usize) {
        self.row = row;
    }

    /// An error at the current row, and line of a text file.
    pub(crate) fn error(&self, reason: impl Into<String>) -> CoreError {
        let mut place = format!("{} {}", shown(&self.element), self.row);
        if self.encoding == Encoding::Text {
            place = format!("line {}, {place}", self.line);
        }
        CoreError::format(self.path, Some(place), reason)
    }

    /// The next value.
    pub(crate) fn value(&mut self, scalar: Scalar) -> Result<f64, CoreError> {
        match self.encoding {
            Encoding::Text => self.word(),
            Encoding::Little => Ok(match scalar {
                Scalar::I8 => i8::from_le_bytes(self.take()?).into(),
                Scalar::U8 => u8::from_le_bytes(self.take()?).into(),
                Scalar::I16 => i16::from_le_bytes(self.take()?).into(),
                Scalar::U16 => u16::from_le_bytes(self.take()?).into(),
                Scalar::I32 => i32::from_le_bytes(self.take()?).into(),
                Scalar::U32 => u32::from_le_bytes(self.take()?).into(),
                Scalar::F32 => f32::from_le_bytes(self.take()?).into(),
                Scalar::F64 => f64::from_le_bytes(self.take()?),
            }),
            Encoding::Big => Ok(match scalar {
                Scalar::I8 => i8::from_be_bytes(self.take()?).into(),
                Scalar::U8 => u8::from_be_bytes(self.take()?).into(),
                Scalar::I16 => i16::from_be_bytes(self.take()?).into(),
                Scalar::U16 => u16::from_be_bytes(self.take()?).into(),
                Scalar::I32 => i32::from_be_bytes(self.take()?).into(),
                Scalar::U32 => u32::from_be_bytes(self.take()?).into(),
                Scalar::F32 => f32::from_be_bytes(self.take()?).into(),
                Scalar::F64 => f64::from_be_bytes(self.take()?),
            }),
        }
    }

    /// The values of a property: one, or a list with its length before it. `values` is cleared first.
    pub(crate) fn values(
        &mut self,
        property: &Property,
        values: &mut Vec<f64>,
    ) -> Result<(), CoreError> {
        values.clear();
        let Some(length) = property.list else {
            values.push(self.value(property.scalar)?);
            return Ok(());
        };
        let length = self.value(length)?;
        if !(length >= 0.0 && length.fract() == 0.0) {
            let name = shown(&property.name);
            return Err(self.error(format!("`{name}` has the length {length}")));
        }
        // Values are read one by one, so that a false length runs into the end of the file, not of memory.
        for _ in 0..length as usize {
            values.push(self.value(property.scalar)?);
        }
        Ok(())
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], CoreError> {
        match self.bytes.split_first_chunk::<N>() {
            Some((value, rest)) => {
                self.bytes = rest;
                Ok(*value)
            }
            None => Err(self.error("the file ends early")),
        }
    }

    fn word(&mut self) -> Result<f64, CoreError> {
        let start = self.bytes.iter().position(|b| !b.is_ascii_whitespace());
        let Some(start) = start else {
            return Err(self.error("the file ends early"));
        };
        for byte in &self.bytes[..start] {
            self.line += usize::from(*byte == b'\n');
        }
        let rest = &self.bytes[start..];
        let end = rest.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = rest.split_at(end.unwrap_or(rest.len()));
        let value = std::str::from_utf8(word).ok().and_then(|w| w.parse().ok());
        let Some(value) = value else {
            let found = shown(&String::from_utf8_lossy(word));
            return Err(self.error(format!("expected a number, found `{found}`")));
        };
        self.bytes = rest;
        Ok(value)
    }
}
