//! Reads environment maps: Radiance HDR, `OpenEXR`, and pictures of 8 bits a channel, told apart by their content.

use std::io::Cursor;
use std::path::Path;

use facile_core::color::LINEAR_FROM_SRGB8;
use facile_core::io::{decode_texture, read_file};

use super::{EnvironmentMap, MAX_SIDE};
use crate::TraceError;

impl EnvironmentMap {
    /// Reads a map: Radiance HDR, `OpenEXR` (the first layer with red, green and blue), or a PNG, JPEG or WebP, whose sRGB
    /// becomes linear.
    ///
    /// # Errors
    /// [`TraceError::Core`] for a file that cannot be read or is no picture, [`TraceError::SceneFile`] with what is wrong
    /// in an HDR or EXR.
    pub fn load(path: &Path) -> Result<Self, TraceError> {
        Self::parse(&read_file(path)?, path)
    }

    /// As [`Self::load`], from the bytes of a file; `path` is only used in errors.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, TraceError> {
        let bad = |reason: String| TraceError::SceneFile {
            path: path.to_owned(),
            reason,
        };
        if bytes.starts_with(b"#?") {
            return radiance(bytes).map_err(bad);
        }
        if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            return open_exr(bytes).map_err(bad);
        }
        let picture = decode_texture(bytes, path)?;
        let linear = |t: &[u8; 3]| t.map(|v| LINEAR_FROM_SRGB8[usize::from(v)]);
        let texels = picture.texels().iter().map(linear).collect();
        Self::new(picture.width(), picture.height(), texels)
    }
}

fn checked(width: usize, height: usize, texels: Vec<[f32; 3]>) -> Result<EnvironmentMap, String> {
    EnvironmentMap::new(width, height, texels).map_err(|e| e.to_string())
}

fn open_exr(bytes: &[u8]) -> Result<EnvironmentMap, String> {
    use exr::prelude::*;
    type Texels = ([usize; 2], Vec<[f32; 3]>);
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |resolution, _| -> Texels {
                let size = [resolution.width(), resolution.height()];
                let is_size = size.iter().all(|v| *v <= MAX_SIDE);
                (
                    size,
                    vec![[0.0; 3]; if is_size { resolution.area() } else { 0 }],
                )
            },
            |(size, texels): &mut Texels, position, (r, g, b): (f32, f32, f32)| {
                let index = position.y() * size[0] + position.x();
                if let Some(texel) = texels.get_mut(index) {
                    *texel = [r, g, b];
                }
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| format!("not an EXR that can be read: {e}"))?;
    let ([width, height], texels) = image.layer_data.channel_data.pixels;
    checked(width, height, texels)
}

/// Radiance RGBE, rows from the top, run-length encoded or flat. Source: Ward, Real Pixels, Graphics Gems II, 1991.
fn radiance(bytes: &[u8]) -> Result<EnvironmentMap, String> {
    let mut rest = bytes;
    // Lines of the header up to an empty one, then the size
    let mut line = || {
        let end = rest.iter().position(|b| *b == b'\n')?;
        let line = String::from_utf8_lossy(&rest[..end]).trim().to_owned();
        rest = &rest[end + 1..];
        Some(line)
    };
    loop {
        let line = line().ok_or("the HDR's header does not end")?;
        if line.is_empty() {
            break;
        }
        if let Some(format) = line.strip_prefix("FORMAT=")
            && format != "32-bit_rle_rgbe"
        {
            return Err(format!(
                "the HDR's format must be 32-bit_rle_rgbe, found {format}"
            ));
        }
    }
    let size = line().unwrap_or_default();
    let words: Vec<&str> = size.split_ascii_whitespace().collect();
    let ["-Y", height, "+X", width] = words[..] else {
        return Err(format!(
            "the HDR's size must read `-Y HEIGHT +X WIDTH`, found `{size}`"
        ));
    };
    let side = |text: &str| {
        let value = text.parse().ok().filter(|v| (1..=MAX_SIDE).contains(v));
        value.ok_or_else(|| format!("the HDR's sides must be from 1 to {MAX_SIDE}, found {text}"))
    };
    let (width, height): (usize, usize) = (side(width)?, side(height)?);
    let mut data = rest;
    let mut texels = Vec::with_capacity((width * height).min(data.len().saturating_mul(64)));
    let mut row = vec![[0_u8; 4]; width];
    for y in 0..height {
        read_row(&mut data, &mut row)
            .ok_or_else(|| format!("the HDR ends in row {y} of {height}"))?;
        texels.extend(row.iter().map(|&[r, g, b, e]| {
            if e == 0 {
                return [0.0; 3];
            }
            let scale = libm::ldexpf(1.0, i32::from(e) - 136);
            [r, g, b].map(|v| f32::from(v) * scale)
        }));
    }
    checked(width, height, texels)
}

/// Reads a row of RGBE; `None` if the data end.
fn read_row(data: &mut &[u8], row: &mut [[u8; 4]]) -> Option<()> {
    let width = row.len();
    let is_packed = (8..32_768).contains(&width)
        && data.len() >= 4
        && data[..2] == [2, 2]
        && usize::from(data[2]) << 8 | usize::from(data[3]) == width;
    if !is_packed {
        let (flat, rest) = data.split_at_checked(4 * width)?;
        for (texel, bytes) in row.iter_mut().zip(flat.chunks_exact(4)) {
            texel.copy_from_slice(bytes);
        }
        *data = rest;
        return Some(());
    }
    *data = &data[4..];
    let mut take = || {
        let (first, rest) = data.split_first()?;
        *data = rest;
        Some(*first)
    };
    for channel in 0..4 {
        let mut x = 0;
        while x < width {
            let count = usize::from(take()?);
            let run = count > 128;
            let count = if run { count - 128 } else { count };
            if count == 0 || x + count > width {
                return None;
            }
            let mut value = if run { take()? } else { 0 };
            for texel in &mut row[x..x + count] {
                if !run {
                    value = take()?;
                }
                texel[channel] = value;
            }
            x += count;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec3;

    const HEADER: &[u8] = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n";

    fn hdr(size: &str, data: &[u8]) -> Result<EnvironmentMap, String> {
        radiance(&[HEADER, size.as_bytes(), b"\n", data].concat())
    }

    #[test]
    fn flat_and_packed_rows_are_the_same() {
        let texel = |x: u8| [x, 2 * x, 3 * x, 129 + x % 2];
        let flat: Vec<u8> = (0..20).flat_map(|x| texel(x % 10)).collect();
        let flat = hdr("-Y 2 +X 10", &flat).expect("valid");
        let mut packed = Vec::new();
        for _ in 0..2 {
            packed.extend([2, 2, 0, 10]);
            for channel in 0..4 {
                packed.push(10);
                packed.extend((0..10).map(|x| texel(x)[channel]));
            }
        }
        assert_eq!(hdr("-Y 2 +X 10", &packed).expect("valid"), flat);
        let mut runs = Vec::new();
        runs.extend([2, 2, 0, 10]);
        for value in [128, 64, 0, 129] {
            runs.extend([138, value]);
        }
        let grey = hdr("-Y 1 +X 10", &runs).expect("valid");
        // 128 / 256 times 2 to the power 1
        assert_eq!(grey.light(Vec3::x()).as_slice(), [1.0, 0.5, 0.0]);
    }

    #[test]
    fn damage_is_named() {
        assert!(
            hdr("-Y 2 +X 10", &[0; 79])
                .expect_err("short")
                .contains("row 1 of 2")
        );
        assert!(
            hdr("+Y 2 +X 10", &[])
                .expect_err("upside down")
                .contains("-Y HEIGHT")
        );
        assert!(
            hdr("-Y 2 +X 99999", &[])
                .expect_err("wide")
                .contains("from 1 to")
        );
        assert!(radiance(b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n").is_err());
        assert!(EnvironmentMap::parse(b"none", Path::new("x")).is_err());
        assert!(open_exr(&[0x76, 0x2f, 0x31, 0x01, 2]).is_err());
    }

    #[test]
    fn an_exr_reads_back() {
        use exr::prelude::*;
        let mut bytes = Vec::new();
        let channels =
            SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, 7.5_f32, at.y() as f32));
        let image = Image::from_channels((6, 3), channels);
        image
            .write()
            .non_parallel()
            .to_buffered(Cursor::new(&mut bytes))
            .expect("writes");
        let map = EnvironmentMap::parse(&bytes, Path::new("x.exr")).expect("valid");
        assert_eq!((map.width, map.height), (6, 3));
        assert_eq!(map.texels[0], [0.0, 7.5, 0.0]);
        assert_eq!(map.texels[17], [5.0, 7.5, 2.0]);
    }
}
