//! Image files as textures: format found from the content, size limited before memory is taken.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageEncoder as _, ImageError, ImageReader, Limits};

use crate::{CoreError, Texture};

/// Largest width and height of a texture.
const MAX_SIDE: u32 = 32_768;

/// Most bytes that decoding one texture may take: 18,900 x 18,900 texels.
const MAX_DECODED_BYTES: u64 = 1 << 30;

/// Images below this size, decoded, are taken whatever their file's size.
const SMALL_DECODED_BYTES: u64 = 16 << 20;

/// Most bytes of pixels for each byte of a file. Deflate reaches 1,032: a PNG that claims more is cut short or lies.
const MAX_RATIO: u64 = 1_100;

/// Decodes a PNG, JPEG, WebP or BMP, whatever its name ends with. Grey and 16-bit images are converted to 8-bit RGB,
/// transparency is dropped. `path` is only used in errors. What an image claims is checked before memory is taken.
///
/// # Errors
/// [`CoreError::Format`] if the image is damaged, larger than 32,768 texels a side or 1 GiB, larger than its file can hold,
/// or of another format.
pub fn decode_texture(bytes: &[u8], path: &Path) -> Result<Texture, CoreError> {
    decode_texture_at(bytes, path, None)
}

/// As [`decode_texture`], for an image inside a file.
pub(crate) fn decode_texture_at(
    bytes: &[u8],
    path: &Path,
    place: Option<&str>,
) -> Result<Texture, CoreError> {
    let bad = |reason: String| CoreError::format(path, place.map(str::to_owned), reason);
    if bytes.is_empty() {
        return Err(bad("the image file is empty".to_owned()));
    }
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| bad(e.to_string()))?;
    let Some(format) = reader.format() else {
        return Err(bad("is not a PNG, JPEG, WebP or BMP image".to_owned()));
    };
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    reader.limits(limits);
    let claimed = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions();
    let (width, height) = claimed.map_err(|e| bad(reason_of(&e)))?;
    let claimed = 3 * u64::from(width) * u64::from(height);
    if claimed > SMALL_DECODED_BYTES && claimed > MAX_RATIO * bytes.len() as u64 {
        return Err(bad(format!(
            "the image claims {width} x {height} texels in {} bytes, more than any image packs",
            bytes.len()
        )));
    }
    let image = reader.decode().map_err(|e| bad(reason_of(&e)))?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    if width == 0 || height == 0 {
        return Err(bad("the image has no pixels".to_owned()));
    }
    let rgb = match image {
        DynamicImage::ImageRgb8(rgb) => rgb,
        other => other.into_rgb8(),
    };
    let texels = rgb
        .as_raw()
        .chunks_exact(3)
        .map(|t| [t[0], t[1], t[2]])
        .collect();
    Ok(Texture::new(width, height, texels))
}

/// Reads and decodes an image file.
pub(crate) fn load_texture(path: &Path) -> Result<Texture, CoreError> {
    decode_texture(&super::read_file(path)?, path)
}

fn reason_of(error: &ImageError) -> String {
    match error {
        ImageError::Limits(_) => {
            format!("the image is larger than the limit of {MAX_SIDE} x {MAX_SIDE} texels or 1 GiB")
        }
        other => format!("the image cannot be decoded: {other}"),
    }
}

/// How a texture is packed into a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// Lossless.
    Png,
    /// Lossy, with a quality of 1 to 100.
    Jpeg(u8),
}

impl Packing {
    /// The media type in a glTF file.
    pub(crate) fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg(_) => "image/jpeg",
        }
    }
}

/// Encodes a texture. `path` is only used in errors.
pub(crate) fn encode_texture(
    texture: &Texture,
    packing: Packing,
    path: &Path,
) -> Result<Vec<u8>, CoreError> {
    use image::ExtendedColorType::Rgb8;
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let mut bytes = Vec::new();
    let (data, width, height) = (
        texture.texels().as_flattened(),
        texture.width() as u32,
        texture.height() as u32,
    );
    match packing {
        Packing::Png => {
            PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
                .write_image(data, width, height, Rgb8)
        }
        Packing::Jpeg(quality) => {
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality.clamp(1, 100))
                .write_image(data, width, height, Rgb8)
        }
    }
    .map_err(|e| CoreError::format(path, None, format!("the texture cannot be encoded: {e}")))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(bytes: &[u8]) -> String {
        decode_texture(bytes, Path::new("t.png"))
            .expect_err("invalid")
            .to_string()
    }

    #[test]
    fn png_round_trips_exactly() {
        let texels = (0..35).map(|i| [i, 2 * i, 255 - i]).collect();
        let texture = Texture::new(7, 5, texels);
        let path = Path::new("t.png");
        let bytes = encode_texture(&texture, Packing::Png, path).expect("encodes");
        assert_eq!(decode_texture(&bytes, path).expect("decodes"), texture);
        let jpeg = encode_texture(&texture, Packing::Jpeg(90), path).expect("encodes");
        assert_eq!(decode_texture(&jpeg, path).expect("decodes").width(), 7);
        assert!(message(&bytes[..bytes.len() / 2]).contains("cannot be decoded"));
    }

    #[test]
    fn what_is_no_image_is_named() {
        assert_eq!(message(b""), "t.png: the image file is empty");
        assert_eq!(
            message(b"hello, I am text"),
            "t.png: is not a PNG, JPEG, WebP or BMP image"
        );
    }

    #[test]
    fn a_file_that_claims_more_than_it_can_hold_is_refused() {
        let texture = Texture::constant([1, 2, 3]);
        let small = encode_texture(&texture, Packing::Png, Path::new("t.png")).expect("png");
        // 16,384 x 16,384 in the header, and its checksum put right
        let mut bomb = small.clone();
        bomb[16..24].copy_from_slice(&[0, 0, 0x40, 0, 0, 0, 0x40, 0]);
        let step = |sum: u32, byte: &u8| {
            (0..8).fold(sum ^ u32::from(*byte), |s, _| {
                s >> 1 ^ (0xedb8_8320 & (s & 1).wrapping_neg())
            })
        };
        let sum = !bomb[12..29].iter().fold(!0, step);
        bomb[29..33].copy_from_slice(&sum.to_be_bytes());
        assert!(
            message(&bomb).contains("claims 16384 x 16384"),
            "{}",
            message(&bomb)
        );
        // A plain colour packs well, and is taken.
        let plain = Texture::new(2_600, 2_600, vec![[7; 3]; 2_600 * 2_600]);
        let bytes = encode_texture(&plain, Packing::Png, Path::new("t.png")).expect("png");
        assert!(decode_texture(&bytes, Path::new("t.png")).is_ok());
    }

    #[test]
    fn an_absurd_size_is_refused_before_memory_is_taken() {
        let texture = Texture::constant([1, 2, 3]);
        let mut bytes = encode_texture(&texture, Packing::Png, Path::new("t.png")).expect("png");
        // Width in the IHDR chunk, then the chunk's checksum.
        bytes[16..20].copy_from_slice(&0x7fff_ffff_u32.to_be_bytes());
        let text = message(&bytes);
        assert!(
            text.contains("limit") || text.contains("cannot be decoded"),
            "{text}"
        );
    }
}
