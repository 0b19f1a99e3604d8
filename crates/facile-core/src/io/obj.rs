//! Wavefront OBJ: positions, vertex colours, texture coordinates, polygons with their group and material.
//!
//! A reader of our own, since the known crates accept NaN, drop vertex colours or lose the file's vertex indices, and
//! none names the line of a bad index. Unknown statements are skipped, as the format asks.

use std::collections::HashMap;
use std::path::Path;

use super::folder::shown;
use crate::{CoreError, Point3};

/// Marks a corner without a texture coordinate.
pub const NO_TEXCOORD: u32 = u32::MAX;

/// The content of an OBJ file, polygons not yet split.
#[derive(Clone, Debug, Default)]
pub struct ObjFile {
    /// Positions in the file's unit and order.
    pub positions: Vec<Point3>,
    /// sRGB colours in `[0, 1]`, one per position, or empty if any vertex has none.
    pub colors: Vec<[f32; 3]>,
    /// Texture coordinates.
    pub texcoords: Vec<[f32; 2]>,
    /// Position and texture coordinate index of every corner of every polygon.
    pub corners: Vec<[u32; 2]>,
    /// Polygons in the file's order.
    pub polygons: Vec<Polygon>,
    /// Names of groups, in order of appearance.
    pub groups: Vec<String>,
    /// Names of materials, in order of appearance.
    pub materials: Vec<String>,
    /// Material libraries, as written.
    pub material_libraries: Vec<String>,
}

/// One face of an [`ObjFile`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Polygon {
    /// First corner in [`ObjFile::corners`].
    pub start: u32,
    /// Number of corners, at least 3.
    pub len: u32,
    /// Index in [`ObjFile::groups`].
    pub group: Option<u32>,
    /// Index in [`ObjFile::materials`].
    pub material: Option<u32>,
    /// Line in the file, from 1.
    pub line: u32,
}

impl ObjFile {
    /// Parses the bytes of a file; `path` is only used in errors. Cost O(bytes): some 100 MB a second.
    ///
    /// # Errors
    /// [`CoreError::Format`] with the line for a number that does not parse, a coordinate that is not finite, an index
    /// out of range or a face of fewer than three corners.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, CoreError> {
        let mut parser = Parser {
            file: Self::default(),
            path,
            line: 0,
            group: None,
            material: None,
            group_index: HashMap::new(),
            material_index: HashMap::new(),
        };
        let mut joined: Vec<u8> = Vec::new();
        for line in bytes.split(|b| *b == b'\n') {
            parser.line += 1;
            // A back slash at the end of a line continues it.
            let line = line.strip_suffix(b"\r").unwrap_or(line);
            if let Some(part) = line.strip_suffix(b"\\") {
                joined.extend_from_slice(part);
                joined.push(b' ');
            } else if joined.is_empty() {
                parser.statement(line)?;
            } else {
                joined.extend_from_slice(line);
                parser.statement(&std::mem::take(&mut joined))?;
            }
        }
        parser.statement(&joined)?;
        parser.check_indices()?;
        if parser.file.colors.len() != parser.file.positions.len() {
            parser.file.colors.clear();
        }
        Ok(parser.file)
    }

    /// The corners of a polygon.
    pub fn corners_of(&self, polygon: &Polygon) -> &[[u32; 2]] {
        &self.corners[polygon.start as usize..(polygon.start + polygon.len) as usize]
    }
}

struct Parser<'a> {
    file: ObjFile,
    path: &'a Path,
    line: u32,
    group: Option<u32>,
    material: Option<u32>,
    group_index: HashMap<Vec<u8>, u32>,
    material_index: HashMap<Vec<u8>, u32>,
}

impl Parser<'_> {
    fn error(&self, reason: impl Into<String>) -> CoreError {
        self.error_at(self.line, reason)
    }

    fn error_at(&self, line: u32, reason: impl Into<String>) -> CoreError {
        CoreError::format(self.path, Some(format!("line {line}")), reason)
    }

    fn statement(&mut self, line: &[u8]) -> Result<(), CoreError> {
        let line = line.trim_ascii();
        let end = line
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(line.len());
        let (keyword, rest) = (&line[..end], line[end..].trim_ascii_start());
        match keyword {
            b"v" => self.position(rest),
            b"vt" => self.texcoord(rest),
            b"f" => self.face(rest),
            b"g" | b"o" => {
                self.group = Some(intern(&mut self.file.groups, &mut self.group_index, rest));
                Ok(())
            }
            b"usemtl" => {
                let (names, index) = (&mut self.file.materials, &mut self.material_index);
                self.material = Some(intern(names, index, rest));
                Ok(())
            }
            b"mtllib" => {
                let name = String::from_utf8_lossy(rest).into_owned();
                self.file.material_libraries.push(name);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn position(&mut self, rest: &[u8]) -> Result<(), CoreError> {
        let mut values = words(rest);
        let mut next = |name| self.number(values.next(), name);
        let position = Point3::new(next("x")?, next("y")?, next("z")?);
        // Three more numbers are a colour; one more is a weight, which polygons do not use.
        if self.file.colors.len() == self.file.positions.len() {
            let extra = [values.next(), values.next(), values.next()];
            if extra[2].is_some() {
                let mut color = [0.0; 3];
                for (channel, word) in color.iter_mut().zip(extra) {
                    *channel = self.number(word, "vertex colour")? as f32;
                }
                self.file.colors.push(color);
            }
        }
        self.file.positions.push(position);
        Ok(())
    }

    fn texcoord(&mut self, rest: &[u8]) -> Result<(), CoreError> {
        let mut values = words(rest);
        let u = self.number(values.next(), "texture coordinate u")?;
        let v = match values.next() {
            Some(word) => self.number(Some(word), "texture coordinate v")?,
            None => 0.0,
        };
        self.file.texcoords.push([u as f32, v as f32]);
        Ok(())
    }

    fn face(&mut self, rest: &[u8]) -> Result<(), CoreError> {
        let start = self.file.corners.len();
        for word in words(rest) {
            let mut parts = word.split(|b| *b == b'/');
            let position = self.index(parts.next(), self.file.positions.len(), "vertex")?;
            let texcoord = match parts.next() {
                None | Some(b"") => NO_TEXCOORD,
                part => self.index(part, self.file.texcoords.len(), "texture coordinate")?,
            };
            self.file.corners.push([position, texcoord]);
        }
        let len = self.file.corners.len() - start;
        if len < 3 {
            return Err(self.error(format!("a face needs at least 3 corners, found {len}")));
        }
        self.file.polygons.push(Polygon {
            start: start as u32,
            len: len as u32,
            group: self.group,
            material: self.material,
            line: self.line,
        });
        Ok(())
    }

    fn number(&self, word: Option<&[u8]>, what: &str) -> Result<f64, CoreError> {
        let word = word.ok_or_else(|| self.error(format!("{what} is missing")))?;
        let value: Option<f64> = std::str::from_utf8(word).ok().and_then(|w| w.parse().ok());
        match value {
            Some(v) if v.is_finite() => Ok(v),
            _ => {
                let found = shown(&String::from_utf8_lossy(word));
                Err(self.error(format!("{what}: expected a finite number, found `{found}`")))
            }
        }
    }

    /// A corner's index from 0. Negative ones count back from what the file has so far; positive ones may point ahead
    /// and are checked at the end.
    fn index(&self, word: Option<&[u8]>, count: usize, what: &str) -> Result<u32, CoreError> {
        let word = word.unwrap_or_default();
        let (is_negative, digits) = match word {
            [b'-', digits @ ..] => (true, digits),
            [b'+', digits @ ..] | digits => (false, digits),
        };
        let is_number = !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
        let value = digits.iter().fold(0_u64, |v, d| {
            v.saturating_mul(10)
                .saturating_add(u64::from(d.wrapping_sub(b'0')))
        });
        let index = if is_negative {
            (count as u64).checked_sub(value)
        } else {
            value.checked_sub(1)
        };
        match index {
            Some(index) if is_number && index < u64::from(NO_TEXCOORD) => Ok(index as u32),
            _ => {
                let text = shown(&String::from_utf8_lossy(word));
                Err(self.error(if is_number {
                    format!("{what} index {text} is out of range, the file has {count} so far")
                } else {
                    format!("{what} index: expected a whole number, found `{text}`")
                }))
            }
        }
    }

    fn check_indices(&self) -> Result<(), CoreError> {
        let (positions, texcoords) = (self.file.positions.len(), self.file.texcoords.len());
        for polygon in &self.file.polygons {
            for &[p, t] in self.file.corners_of(polygon) {
                let (what, index, count) = if p as usize >= positions {
                    ("vertex", p, positions)
                } else if t != NO_TEXCOORD && t as usize >= texcoords {
                    ("texture coordinate", t, texcoords)
                } else {
                    continue;
                };
                let reason = format!(
                    "{what} index {} is out of range, the file has {count}",
                    u64::from(index) + 1
                );
                return Err(self.error_at(polygon.line, reason));
            }
        }
        Ok(())
    }
}

fn words(rest: &[u8]) -> impl Iterator<Item = &[u8]> {
    rest.split(u8::is_ascii_whitespace)
        .filter(|w| !w.is_empty())
}

fn intern(names: &mut Vec<String>, index: &mut HashMap<Vec<u8>, u32>, name: &[u8]) -> u32 {
    if let Some(at) = index.get(name) {
        return *at;
    }
    let at = names.len() as u32;
    names.push(String::from_utf8_lossy(name).into_owned());
    index.insert(name.to_owned(), at);
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<ObjFile, CoreError> {
        ObjFile::parse(text.as_bytes(), Path::new("a.obj"))
    }

    #[test]
    fn quads_groups_and_negative_indices_are_read() {
        let file =
            parse("v 0 0 0\nv 1 0 0\r\nv 1 1 0\nv 0 1 0\nvt 0 0\ng nose\nf 1/1 2/1 -2/1 -1/1\n")
                .expect("valid");
        assert_eq!(file.corners, vec![[0, 0], [1, 0], [2, 0], [3, 0]]);
        assert_eq!(file.polygons[0].group, Some(0));
        assert_eq!(file.groups, ["nose"]);
    }

    #[test]
    fn faces_may_come_first_and_lines_may_continue() {
        let file = parse("f 1 2 \\\n3\nv 0 0 0\nv 1 0 0\nv 1 \\\r\n 1 0\n").expect("valid");
        assert_eq!(
            file.corners,
            vec![[0, NO_TEXCOORD], [1, NO_TEXCOORD], [2, NO_TEXCOORD]]
        );
        assert_eq!(file.positions[2], Point3::new(1.0, 1.0, 0.0));
    }

    #[test]
    fn errors_name_file_and_line() {
        let message = |text| parse(text).expect_err("invalid").to_string();
        assert_eq!(
            message("v 0 0 nan"),
            "a.obj, line 1: z: expected a finite number, found `nan`"
        );
        assert_eq!(
            message("v 0 0 0\nf 1 2 3"),
            "a.obj, line 2: vertex index 2 is out of range, the file has 1"
        );
        assert_eq!(
            message("v 0 0 0\nf 1 -2 1"),
            "a.obj, line 2: vertex index -2 is out of range, the file has 1 so far"
        );
        assert!(message("v 0 0 0\nf 1/1 1/1 1/1").contains("texture coordinate index 1 is out"));
        assert!(message("v 0 0 0\nf 0 1 1").contains("vertex index 0 is out of range"));
        assert!(message("f 99999999999999999999 1 1").contains("out of range"));
        assert!(message("f 1.5 1 1").contains("expected a whole number, found `1.5`"));
        assert!(message("v 1 2").contains("z is missing"));
        assert!(message("v 0 0 0\nv 0 0 1\nf 1 2").contains("at least 3 corners, found 2"));
    }

    #[test]
    fn vertex_colours_are_kept_only_if_all_have_them() {
        assert_eq!(
            parse("v 0 0 0 1 0 0\nv 0 0 1 0 1 0")
                .expect("valid")
                .colors
                .len(),
            2
        );
        assert!(
            parse("v 0 0 0 1 0 0\nv 0 0 1")
                .expect("valid")
                .colors
                .is_empty()
        );
    }
}
