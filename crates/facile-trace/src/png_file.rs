//! PNG images and label maps, as bytes and as files.

use std::path::Path;

use facile_core::Plane;

use crate::TraceError;

/// Encodes 8-bit RGB.
///
/// # Errors
/// [`TraceError::Png`] for a size that PNG cannot hold.
pub fn encode_rgb8(image: &Plane<[u8; 3]>) -> Result<Vec<u8>, TraceError> {
    let format = (png::ColorType::Rgb, png::BitDepth::Eight);
    encode(image, format, image.as_slice().as_flattened())
}

/// Encodes 8-bit grey.
///
/// # Errors
/// [`TraceError::Png`] for a size that PNG cannot hold.
pub fn encode_gray8(image: &Plane<u8>) -> Result<Vec<u8>, TraceError> {
    let format = (png::ColorType::Grayscale, png::BitDepth::Eight);
    encode(image, format, image.as_slice())
}

/// Encodes 16-bit grey.
///
/// # Errors
/// [`TraceError::Png`] for a size that PNG cannot hold.
pub fn encode_gray16(image: &Plane<u16>) -> Result<Vec<u8>, TraceError> {
    let samples = image.as_slice().iter().flat_map(|v| v.to_be_bytes());
    let format = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
    encode(image, format, &samples.collect::<Vec<u8>>())
}

/// Writes 8-bit RGB.
///
/// # Errors
/// As [`encode_rgb8`], or [`TraceError::Io`] with the file.
pub fn write_rgb8(path: &Path, image: &Plane<[u8; 3]>) -> Result<(), TraceError> {
    write_bytes(path, &encode_rgb8(image)?)
}

/// Writes 8-bit grey.
///
/// # Errors
/// As [`encode_gray8`], or [`TraceError::Io`] with the file.
pub fn write_gray8(path: &Path, image: &Plane<u8>) -> Result<(), TraceError> {
    write_bytes(path, &encode_gray8(image)?)
}

/// Writes 16-bit grey.
///
/// # Errors
/// As [`encode_gray16`], or [`TraceError::Io`] with the file.
pub fn write_gray16(path: &Path, image: &Plane<u16>) -> Result<(), TraceError> {
    write_bytes(path, &encode_gray16(image)?)
}

fn encode<T>(
    image: &Plane<T>,
    (color, depth): (png::ColorType, png::BitDepth),
    samples: &[u8],
) -> Result<Vec<u8>, TraceError> {
    let mut bytes = Vec::with_capacity(samples.len() / 2);
    let mut encoder = png::Encoder::new(&mut bytes, image.width() as u32, image.height() as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    let finish = |encoder: png::Encoder<'_, _>| {
        let mut writer = encoder.write_header()?;
        writer.write_image_data(samples)?;
        writer.finish()
    };
    finish(encoder).map_err(|e| TraceError::Png {
        width: image.width(),
        height: image.height(),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_and_maps_read_back_equal() {
        let image = Plane::from_fn(32, 24, |x, y| [x as u8 * 7, y as u8 * 9, (x * y) as u8]);
        let bytes = encode_rgb8(&image).expect("encodes");
        let read = image::load_from_memory(&bytes).expect("reads").into_rgb8();
        assert_eq!(read.as_raw(), image.as_slice().as_flattened());
        let map = Plane::from_fn(5, 4, |x, y| (x * 10_000 + y * 257) as u16);
        let bytes = encode_gray16(&map).expect("encodes");
        let read = image::load_from_memory(&bytes).expect("reads");
        assert_eq!(read.into_luma16().as_raw(), map.as_slice());
    }

    #[test]
    fn an_empty_image_is_refused() {
        let error = encode_gray8(&Plane::filled(0, 3, 0)).expect_err("no columns");
        assert!(error.to_string().contains("0 x 3"), "{error}");
    }
}
