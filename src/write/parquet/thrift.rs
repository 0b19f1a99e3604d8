//! The part of Thrift's compact protocol that Parquet's headers need.

/// Types of fields and of elements of lists.
const I32: u8 = 5;
const I64: u8 = 6;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const STRUCT: u8 = 12;

/// A struct that is being written; its end is written by [`Self::end`].
#[derive(Debug, Default)]
pub(super) struct Struct {
    bytes: Vec<u8>,
    last: u8,
}

impl Struct {
    pub(super) fn i32(mut self, field: u8, v: i32) -> Self {
        self.header(field, I32);
        varint(&mut self.bytes, zigzag(i64::from(v)));
        self
    }

    pub(super) fn i64(mut self, field: u8, v: i64) -> Self {
        self.header(field, I64);
        varint(&mut self.bytes, zigzag(v));
        self
    }

    pub(super) fn text(mut self, field: u8, v: &str) -> Self {
        self.header(field, BINARY);
        text(&mut self.bytes, v);
        self
    }

    pub(super) fn nested(mut self, field: u8, v: Self) -> Self {
        self.header(field, STRUCT);
        self.bytes.extend(v.end());
        self
    }

    pub(super) fn structs(mut self, field: u8, list: impl IntoIterator<Item = Self>) -> Self {
        let list: Vec<Self> = list.into_iter().collect();
        self.list(field, STRUCT, list.len());
        self.bytes.extend(list.into_iter().flat_map(Self::end));
        self
    }

    pub(super) fn i32s(mut self, field: u8, list: &[i32]) -> Self {
        self.list(field, I32, list.len());
        for v in list {
            varint(&mut self.bytes, zigzag(i64::from(*v)));
        }
        self
    }

    pub(super) fn texts(mut self, field: u8, list: &[String]) -> Self {
        self.list(field, BINARY, list.len());
        for v in list {
            text(&mut self.bytes, v);
        }
        self
    }

    pub(super) fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }

    /// Fields come in the order of their numbers, less than 16 apart.
    fn header(&mut self, field: u8, kind: u8) {
        debug_assert!(field > self.last && field - self.last < 16);
        self.bytes.push((field - self.last) << 4 | kind);
        self.last = field;
    }

    fn list(&mut self, field: u8, kind: u8, len: usize) {
        self.header(field, LIST);
        if len < 15 {
            self.bytes.push((len as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            varint(&mut self.bytes, len as u64);
        }
    }
}

fn text(out: &mut Vec<u8>, v: &str) {
    varint(out, v.len() as u64);
    out.extend(v.as_bytes());
}

fn zigzag(v: i64) -> u64 {
    ((v << 1) ^ (v >> 63)) as u64
}

/// An unsigned number in groups of seven bits, the lowest first.
pub(super) fn varint(out: &mut Vec<u8>, mut v: u64) {
    while v >= 0x80 {
        out.push(v as u8 | 0x80);
        v >>= 7;
    }
    out.push(v as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structs_are_encoded_as_the_protocol_says() {
        let inner = Struct::default().text(4, "ab");
        let bytes = Struct::default()
            .i32(1, -2)
            .i64(3, 150)
            .structs(4, [inner])
            .end();
        // Field 1: i32, zigzag 3; field 3: i64, zigzag 300; field 4: one struct with its field 4: "ab".
        assert_eq!(
            bytes,
            [
                0x15, 3, 0x26, 0xac, 0x02, 0x19, 0x1c, 0x48, 2, b'a', b'b', 0, 0
            ]
        );
    }
}
