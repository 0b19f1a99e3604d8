//! PNG files of images and label maps.

use std::path::Path;

use facile_core::Plane;

use crate::TraceError;

/// Writes 8-bit RGB.
///
/// # Errors
/// [`TraceError::Io`] or [`TraceError::Encode`] with the file.
pub fn write_rgb8(path: &Path, image: &Plane<[u8; 3]>) -> Result<(), TraceError> {
    write_bytes(path, &encode_rgb8(path, image)?)
}

/// Encodes 8-bit RGB; `path` is only used in errors.
///
/// # Errors
/// [`TraceError::Encode`] with the file.
pub fn encode_rgb8(path: &Path, image: &Plane<[u8; 3]>) -> Result<Vec<u8>, TraceError> {
    let format = (png::ColorType::Rgb, png::BitDepth::Eight);
    encode(path, image, format, image.as_slice().as_flattened())
}

/// Writes 8-bit grey.
///
/// # Errors
/// [`TraceError::Io`] or [`TraceError::Encode`] with the file.
pub fn write_gray8(path: &Path, image: &Plane<u8>) -> Result<(), TraceError> {
    let format = (png::ColorType::Grayscale, png::BitDepth::Eight);
    write_bytes(path, &encode(path, image, format, image.as_slice())?)
}

/// Writes 16-bit grey.
///
/// # Errors
/// [`TraceError::Io`] or [`TraceError::Encode`] with the file.
pub fn write_gray16(path: &Path, image: &Plane<u16>) -> Result<(), TraceError> {
    let samples: Vec<u8> = image
        .as_slice()
        .iter()
        .flat_map(|v| v.to_be_bytes())
        .collect();
    let format = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
    write_bytes(path, &encode(path, image, format, &samples)?)
}

fn encode<T>(
    path: &Path,
    image: &Plane<T>,
    (color, depth): (png::ColorType, png::BitDepth),
    samples: &[u8],
) -> Result<Vec<u8>, TraceError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width() as u32, image.height() as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    let finish = |encoder: png::Encoder<'_, _>| {
        let mut writer = encoder.write_header()?;
        writer.write_image_data(samples)?;
        writer.finish()
    };
    finish(encoder).map_err(|e| TraceError::Encode {
        path: path.to_owned(),
        reason: e.to_string(),
    })?;
    Ok(bytes)
}

pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), TraceError> {
    std::fs::write(path, bytes).map_err(|source| TraceError::Io {
        path: path.to_owned(),
        source,
    })
}
