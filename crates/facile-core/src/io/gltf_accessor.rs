//! Buffers and accessors of a glTF file, read with every bound checked.

use std::path::Path;

use super::draft::check_count;
use super::folder::{Folder, shown};
use super::gltf_json::{Accessor, BufferView, Document};
use super::read_file;
use crate::CoreError;

/// The bytes behind a document.
pub(crate) struct Buffers<'a> {
    path: &'a Path,
    document: &'a Document,
    contents: Vec<std::borrow::Cow<'a, [u8]>>,
}

impl<'a> Buffers<'a> {
    /// Loads every buffer: the binary chunk of a GLB, data URIs, files in the folder.
    pub(crate) fn load(
        document: &'a Document,
        binary: Option<&'a [u8]>,
        path: &'a Path,
        folder: &Folder,
        notices: &mut Vec<String>,
    ) -> Result<Self, CoreError> {
        let mut contents = Vec::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let place = || Some(format!("buffer {i}"));
            let bytes: std::borrow::Cow<'_, [u8]> = match (&buffer.uri, binary) {
                (Some(uri), _) => read_uri(uri, path, place(), folder, notices)?.into(),
                (None, Some(binary)) if i == 0 => binary.into(),
                _ => {
                    let reason = "has neither a file nor the binary chunk of a GLB";
                    return Err(CoreError::format(path, place(), reason));
                }
            };
            if bytes.len() < buffer.byte_length {
                let reason = format!(
                    "the file ends early: expected {} bytes, found {}",
                    buffer.byte_length,
                    bytes.len()
                );
                return Err(CoreError::format(path, place(), reason));
            }
            contents.push(bytes);
        }
        Ok(Self {
            path,
            document,
            contents,
        })
    }

    /// The bytes of a buffer view.
    pub(crate) fn view(&self, index: usize) -> Result<(&[u8], &'a BufferView), CoreError> {
        let bad = |reason: String| {
            CoreError::format(self.path, Some(format!("buffer view {index}")), reason)
        };
        let views = &self.document.buffer_views;
        let view = views
            .get(index)
            .ok_or_else(|| bad(format!("the file has {}", views.len())))?;
        let buffer = self
            .contents
            .get(view.buffer)
            .ok_or_else(|| bad(format!("buffer {} of {}", view.buffer, self.contents.len())))?;
        view.byte_offset
            .checked_add(view.byte_length)
            .and_then(|end| buffer.get(view.byte_offset..end))
            .map(|bytes| (bytes, view))
            .ok_or_else(|| {
                bad(format!(
                    "{} bytes from {} overrun the buffer's {}",
                    view.byte_length,
                    view.byte_offset,
                    buffer.len()
                ))
            })
    }

    /// Values of an accessor, `N` per element. Components beyond the accessor's are 0 (1 for a fourth colour channel is
    /// of no use here), further ones are dropped. Normalised integers become fractions.
    pub(crate) fn read<const N: usize>(&self, index: usize) -> Result<Vec<[f64; N]>, CoreError> {
        let bad = |reason: String| self.accessor_error(index, reason);
        let accessor = self.accessor(index)?;
        let component = Component::from_code(accessor.component_type).ok_or_else(|| {
            bad(format!(
                "unknown component type {}",
                accessor.component_type
            ))
        })?;
        let components = match accessor.kind.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            kind => return Err(bad(format!("cannot use the type `{}`", shown(kind)))),
        };
        check_count(
            &format!("values in accessor {index}"),
            accessor.count,
            self.path,
        )?;
        let size = components * component.size();
        let decode = |bytes: &[u8]| -> [f64; N] {
            std::array::from_fn(|k| {
                if k < components {
                    component.decode(&bytes[k * component.size()..], accessor.normalized)
                } else {
                    0.0
                }
            })
        };
        let mut values = match accessor.buffer_view {
            None => vec![[0.0; N]; accessor.count],
            Some(view_index) => {
                let (bytes, view) = self.view(view_index)?;
                let stride = view.byte_stride.unwrap_or(size).max(1);
                let rows = rows(bytes, accessor.byte_offset, stride, size, accessor.count);
                let rows = rows.ok_or_else(|| {
                    bad(format!(
                        "{} values of {size} bytes overrun buffer view {view_index} of {} bytes",
                        accessor.count,
                        bytes.len()
                    ))
                })?;
                rows.map(decode).collect()
            }
        };
        if let Some(sparse) = &accessor.sparse {
            let name = "sparse values overrun their buffer view".to_owned();
            let index_type = Component::from_code(sparse.indices.component_type)
                .ok_or_else(|| bad("unknown type of sparse indices".to_owned()))?;
            let (bytes, _) = self.view(sparse.indices.buffer_view)?;
            let at = index_type.size();
            let places = rows(bytes, sparse.indices.byte_offset, at, at, sparse.count)
                .ok_or_else(|| bad(name.clone()))?;
            let (bytes, _) = self.view(sparse.values.buffer_view)?;
            let replacements = rows(bytes, sparse.values.byte_offset, size, size, sparse.count)
                .ok_or_else(|| bad(name))?;
            for (place, value) in places.zip(replacements) {
                let place = index_type.decode(place, false) as usize;
                let count = values.len();
                let slot = values.get_mut(place);
                *slot.ok_or_else(|| bad(format!("sparse index {place} of {count}")))? =
                    decode(value);
            }
        }
        Ok(values)
    }

    /// An accessor of vertex indices.
    pub(crate) fn indices(&self, index: usize) -> Result<Vec<u32>, CoreError> {
        let accessor = self.accessor(index)?;
        let is_unsigned = matches!(accessor.component_type, 5121 | 5123 | 5125);
        if !is_unsigned || accessor.kind != "SCALAR" {
            let reason = "vertex indices must be unsigned whole numbers".to_owned();
            return Err(self.accessor_error(index, reason));
        }
        Ok(self.read::<1>(index)?.iter().map(|v| v[0] as u32).collect())
    }

    fn accessor(&self, index: usize) -> Result<&'a Accessor, CoreError> {
        let accessors = &self.document.accessors;
        accessors
            .get(index)
            .ok_or_else(|| self.accessor_error(index, format!("the file has {}", accessors.len())))
    }

    fn accessor_error(&self, index: usize, reason: String) -> CoreError {
        CoreError::format(self.path, Some(format!("accessor {index}")), reason)
    }
}

/// The `count` rows of `size` bytes that begin every `stride` bytes; `None` if they overrun `bytes`.
fn rows(
    bytes: &[u8],
    offset: usize,
    stride: usize,
    size: usize,
    count: usize,
) -> Option<impl Iterator<Item = &[u8]>> {
    let needed = match count.checked_sub(1) {
        None => 0,
        Some(last) => last.checked_mul(stride)?.checked_add(size)?,
    };
    let bytes = bytes.get(offset..)?;
    (needed <= bytes.len()).then(|| (0..count).map(move |i| &bytes[i * stride..i * stride + size]))
}

/// A number's type in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn from_code(code: u32) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The first value of `bytes`, which hold at least one.
    fn decode(self, bytes: &[u8], normalized: bool) -> f64 {
        let (value, largest) = match self {
            Self::I8 => (f64::from(bytes[0] as i8), 127.0),
            Self::U8 => (f64::from(bytes[0]), 255.0),
            Self::I16 => (
                f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
                32_767.0,
            ),
            Self::U16 => (
                f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
                65_535.0,
            ),
            Self::U32 => {
                let word = [bytes[0], bytes[1], bytes[2], bytes[3]];
                return f64::from(u32::from_le_bytes(word));
            }
            Self::F32 => {
                let word = [bytes[0], bytes[1], bytes[2], bytes[3]];
                return f64::from(f32::from_le_bytes(word));
            }
        };
        if normalized {
            (value / largest).max(-1.0)
        } else {
            value
        }
    }
}

/// The bytes behind a URI of a buffer or an image.
pub(crate) fn read_uri(
    uri: &str,
    path: &Path,
    place: Option<String>,
    folder: &Folder,
    notices: &mut Vec<String>,
) -> Result<Vec<u8>, CoreError> {
    let bad = |place, reason: String| CoreError::format(path, place, reason);
    if let Some(data) = uri.strip_prefix("data:") {
        let Some((_, text)) = data.split_once(";base64,") else {
            return Err(bad(place, "only base64 data URIs are read".to_owned()));
        };
        return decode_base64(text)
            .ok_or_else(|| bad(place, "the base64 data is damaged".to_owned()));
    }
    if uri.contains("://") {
        let reason = format!("`{}` is not a file in the folder", shown(uri));
        return Err(bad(place, reason));
    }
    let name = percent_decoded(uri);
    match folder.require_inside(&name, path, place.clone(), notices)? {
        Some(file) => read_file(&file),
        None => Err(bad(
            place,
            format!("the file `{}` is missing", shown(&name)),
        )),
    }
}

/// Decodes base64 (RFC 4648, padding optional). `None` if a character is not of its alphabet.
fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=');
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    for chunk in text.as_bytes().chunks(4) {
        let mut bits = 0_u32;
        for &c in chunk {
            let value = match c {
                b'A'..=b'Z' => c - b'A',
                b'a'..=b'z' => c - b'a' + 26,
                b'0'..=b'9' => c - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            bits = bits << 6 | u32::from(value);
        }
        let count = match chunk.len() {
            4 => 3,
            3 => 2,
            2 => 1,
            _ => return None,
        };
        bits <<= 6 * (4 - chunk.len());
        bytes.extend_from_slice(&bits.to_be_bytes()[1..=count]);
    }
    Some(bytes)
}

/// Replaces `%20` and the like. What does not decode stays as it is.
fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        let pair = bytes
            .get(i + 1..i + 3)
            .and_then(|p| std::str::from_utf8(p).ok());
        let value = pair.and_then(|p| u8::from_str_radix(p, 16).ok());
        match (bytes[i], value) {
            (b'%', Some(value)) => {
                decoded.push(value);
                i += 3;
            }
            (byte, _) => {
                decoded.push(byte);
                i += 1;
            }
        }
    }
    String::from_utf8_lossy(&decoded).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_decodes_the_test_vectors_of_the_rfc() {
        for (text, bytes) in [
            ("", ""),
            ("Zg==", "f"),
            ("Zm8=", "fo"),
            ("Zm9v", "foo"),
            ("Zm9vYg==", "foob"),
            ("Zm9vYmE=", "fooba"),
            ("Zm9vYmFy", "foobar"),
        ] {
            assert_eq!(decode_base64(text).as_deref(), Some(bytes.as_bytes()));
        }
        assert_eq!(decode_base64("Z"), None);
        assert_eq!(decode_base64("Zm 9v"), None);
    }

    #[test]
    fn percent_codes_are_replaced() {
        assert_eq!(percent_decoded("my%20skin%2.png%"), "my skin%2.png%");
    }

    #[test]
    fn rows_never_overrun() {
        assert_eq!(rows(&[0; 10], 2, 4, 4, 2).expect("fits").count(), 2);
        assert!(rows(&[0; 10], 3, 4, 4, 2).is_none());
        assert!(rows(&[0; 10], 11, 4, 4, 0).is_none());
        assert!(rows(&[0; 10], 0, usize::MAX, 4, 3).is_none());
    }

    #[test]
    fn normalised_integers_are_fractions() {
        assert!((Component::U8.decode(&[255], true) - 1.0).abs() < 1e-15);
        assert!((Component::I8.decode(&[0x80], true) + 1.0).abs() < 1e-15);
        assert!((Component::U16.decode(&[1, 1], false) - 257.0).abs() < 1e-15);
    }
}
