//! Changes of a file: bytes, words, numbers, pieces of another file; checksums and lengths are put right half of the time.

use facile::core::rng::RandomStream;

/// Numbers at the borders of types, and no numbers.
const NUMBERS: [&str; 16] = [
    "0",
    "-1",
    "1",
    "255",
    "256",
    "65535",
    "65536",
    "2147483647",
    "2147483648",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "1e308",
    "nan",
    "-inf",
];
/// Little-endian words at the borders of types.
const WORDS: [u32; 8] = [
    0,
    1,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
];

/// One of the seeds with one to six changes. `words` are pieces that mean something in the format.
pub(crate) fn edited(seeds: &[Vec<u8>], words: &[&str], random: &mut RandomStream) -> Vec<u8> {
    let mut bytes = seeds[random.index(seeds.len())].clone();
    for _ in 0..=random.index(6) {
        edit(&mut bytes, seeds, words, random);
    }
    if random.index(2) == 0 {
        right_png(&mut bytes);
        right_glb(&mut bytes);
    }
    bytes
}

/// Random bytes behind the first ones of a seed, by which parsers know their format.
pub(crate) fn noise(seeds: &[Vec<u8>], random: &mut RandomStream) -> Vec<u8> {
    let seed = &seeds[random.index(seeds.len())];
    let kept = random.index(40).min(seed.len());
    let length = random.index(300);
    let mut bytes = seed[..kept].to_vec();
    bytes.extend((0..length).map(|_| random.bits() as u8));
    bytes
}

fn edit(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], words: &[&str], random: &mut RandomStream) {
    let at = random.index(bytes.len() + 1);
    let end = (at + random.index(12)).min(bytes.len());
    match random.index(11) {
        // Other bits, another byte
        0 if at < bytes.len() => bytes[at] ^= 1 << random.index(8),
        1 if at < bytes.len() => bytes[at] = random.bits() as u8,
        // Less, or the same again, or much of it
        2 => drop(bytes.drain(at..end)),
        3 => {
            let piece = bytes[at..end].to_vec();
            let times = if random.index(20) == 0 { 200 } else { 2 };
            bytes.splice(at..at, piece.repeat(times));
        }
        4 => bytes.truncate(at),
        // A piece of another seed
        5 => {
            let other = &seeds[random.index(seeds.len())];
            let from = random.index(other.len() + 1);
            let to = (from + random.index(40)).min(other.len());
            bytes.splice(at..end, other[from..to].iter().copied());
        }
        // A word of the format
        6 | 7 if !words.is_empty() => {
            let word = words[random.index(words.len())];
            bytes.splice(at..end, word.bytes());
        }
        // Another number in the place of one
        8 | 9 => {
            let is_number = |b: &u8| b.is_ascii_digit() || *b == b'.' || *b == b'-';
            let Some(start) = bytes[at..].iter().position(is_number).map(|i| at + i) else {
                return;
            };
            let length = bytes[start..].iter().take_while(|b| is_number(b)).count();
            let number = if random.index(2) == 0 {
                NUMBERS[random.index(NUMBERS.len())].to_owned()
            } else {
                random.index(30).to_string()
            };
            bytes.splice(start..start + length, number.bytes());
        }
        _ => {
            let word = WORDS[random.index(WORDS.len())];
            let order = random.index(2) == 0;
            let word = if order {
                word.to_le_bytes()
            } else {
                word.to_be_bytes()
            };
            let end = (at + 4).min(bytes.len());
            bytes[at..end].copy_from_slice(&word[..end - at]);
        }
    }
}

/// Puts the checksums of a PNG's chunks right, so that what is in them is looked at.
fn right_png(bytes: &mut [u8]) {
    if !bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return;
    }
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 8) {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let Some(end) = (at + 8)
            .checked_add(length)
            .filter(|e| e + 4 <= bytes.len())
        else {
            return;
        };
        let sum = crc32(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
}

/// Puts the lengths of a GLB and of its JSON chunk right, so that edits of the text reach its tables.
fn right_glb(bytes: &mut Vec<u8>) {
    const TEXT: usize = 20;
    let Some(end) = bytes.windows(4).position(|w| w == b"BIN\0") else {
        return;
    };
    let Some(end) = end.checked_sub(4).filter(|end| *end >= TEXT) else {
        return;
    };
    if !bytes.starts_with(b"glTF") {
        return;
    }
    let padded = (end - TEXT).next_multiple_of(4) + TEXT;
    bytes.splice(end..end, std::iter::repeat_n(b' ', padded - end));
    bytes[12..16].copy_from_slice(&((padded - TEXT) as u32).to_le_bytes());
    let total = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&total.to_le_bytes());
}

/// The checksum of PNG (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    let step = |sum: u32, byte: &u8| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| {
            if sum & 1 == 1 {
                sum >> 1 ^ 0xedb8_8320
            } else {
                sum >> 1
            }
        })
    };
    !bytes.iter().fold(!0, step)
}
