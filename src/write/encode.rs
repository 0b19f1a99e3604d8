//! Images as bytes of PNG, JPEG and WebP.

use facile_core::Plane;
use facile_trace::png_file::encode_rgb8;

use crate::Error;
use crate::recipe::ImageSettings;
use crate::recipe::file::Encoding;

/// Encodes an sRGB image as the recipe asks.
///
/// # Errors
/// [`Error::Encode`] or [`Error::Trace`] if the encoder refuses the size.
pub fn encode_image(image: &Plane<[u8; 3]>, settings: &ImageSettings) -> Result<Vec<u8>, Error> {
    let bytes = image.as_slice().as_flattened();
    let (width, height) = (image.width(), image.height());
    match settings.encoding {
        Encoding::Png => Ok(encode_rgb8(image)?),
        Encoding::Jpeg => encode_jpeg(image, settings.quality),
        Encoding::Webp => {
            let mut out = Vec::new();
            image_webp::WebPEncoder::new(&mut out)
                .encode(
                    bytes,
                    width as u32,
                    height as u32,
                    image_webp::ColorType::Rgb8,
                )
                .map_err(|e| failed(width, height, &e))?;
            Ok(out)
        }
    }
}

/// Encodes an sRGB image as JPEG of a quality from 1 to 100.
///
/// # Errors
/// [`Error::Encode`] if it is too large.
pub(crate) fn encode_jpeg(image: &Plane<[u8; 3]>, quality: u8) -> Result<Vec<u8>, Error> {
    let (width, height) = (image.width(), image.height());
    let mut out = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut out, quality);
    encoder.set_optimized_huffman_tables(true);
    let size = u16::try_from(width).ok().zip(u16::try_from(height).ok());
    let (w, h) = size.ok_or_else(|| failed(width, height, &"too large for JPEG"))?;
    encoder
        .encode(
            image.as_slice().as_flattened(),
            w,
            h,
            jpeg_encoder::ColorType::Rgb,
        )
        .map_err(|e| failed(width, height, &e))?;
    Ok(out)
}

fn failed(width: usize, height: usize, reason: &dyn std::fmt::Display) -> Error {
    let reason = reason.to_string();
    Error::Encode {
        width,
        height,
        reason,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(encoding: Encoding) -> ImageSettings {
        ImageSettings {
            width: 32,
            height: 24,
            encoding,
            quality: 95,
            truth: Vec::new(),
            landmarks: Vec::new(),
            samples: facile_trace::Samples::Count(1),
            background: [0; 3],
            box_margin: 0.0,
        }
    }

    #[test]
    fn lossless_encodings_read_back_equal() {
        let image = Plane::from_fn(32, 24, |x, y| [x as u8 * 7, y as u8 * 9, (x * y) as u8]);
        for encoding in [Encoding::Png, Encoding::Webp] {
            let bytes = encode_image(&image, &settings(encoding)).expect("encodes");
            let read = image::load_from_memory(&bytes).expect("reads").into_rgb8();
            assert_eq!(read.as_raw(), image.as_slice().as_flattened());
        }
    }

    #[test]
    fn jpeg_reads_back_alike() {
        let image = Plane::from_fn(32, 24, |x, y| [x as u8 * 7, y as u8 * 9, 100]);
        let bytes = encode_image(&image, &settings(Encoding::Jpeg)).expect("encodes");
        let read = image::load_from_memory(&bytes).expect("reads").into_rgb8();
        let pairs = read.as_raw().iter().zip(image.as_slice().as_flattened());
        let worst = pairs.map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.is_some_and(|d| d < 24), "{worst:?}");
    }
}
