//! The files of one sample.

use facile_core::Plane;

use super::IMAGES;
use super::{encode_gray8, encode_gray16, encode_image, encode_rgb8};
use crate::Error;
use crate::pipeline::{Maps, Sample};
use crate::recipe::ImageSettings;
use crate::recipe::file::Encoding;

/// A file, ready to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedFile {
    /// Path within the dataset, with forward slashes.
    pub name: String,
    /// Content.
    pub bytes: Vec<u8>,
}

/// Path of an image within a dataset.
pub fn image_name(index: u64, encoding: Encoding) -> String {
    format!("{IMAGES}/{index:06}.{}", encoding.extension())
}

/// Path of a map within a dataset.
pub fn map_name(kind: &str, index: u64) -> String {
    format!("{kind}/{index:06}.png")
}

/// The image of a sample, and its maps unless they belong to a neighbour.
///
/// # Errors
/// [`Error::Encode`] or [`Error::Trace`] if an encoder refuses the size.
pub fn encode_sample(sample: &Sample, settings: &ImageSettings) -> Result<Vec<EncodedFile>, Error> {
    let mut files = vec![EncodedFile {
        name: sample.record.image.clone(),
        bytes: encode_image(&sample.image, settings)?,
    }];
    if sample.owns_maps {
        let maps = &sample.maps;
        let mut add = |kind: &str, bytes: Option<Vec<u8>>| {
            files.extend(bytes.map(|bytes| EncodedFile {
                name: map_name(kind, sample.record.index),
                bytes,
            }));
        };
        add(
            "segments",
            maps.segments.as_ref().map(encode_gray8).transpose()?,
        );
        add(
            "depth",
            depth16(maps).as_ref().map(encode_gray16).transpose()?,
        );
        add(
            "normals",
            normals8(maps).as_ref().map(encode_rgb8).transpose()?,
        );
        add(
            "visibility",
            maps.visibility.as_ref().map(encode_gray8).transpose()?,
        );
        add(
            "occlusion",
            maps.occlusion.as_ref().map(encode_gray8).transpose()?,
        );
    }
    Ok(files)
}

/// Depth in steps, see [`Maps::depth_steps_per_mm`]; 0 where nothing is or beyond the last step.
fn depth16(maps: &Maps) -> Option<Plane<u16>> {
    maps.depth_z.as_ref().map(|plane| {
        plane.map(|z| {
            let steps = (f64::from(*z) * maps.depth_steps_per_mm).round();
            if steps <= f64::from(u16::MAX) {
                steps as u16
            } else {
                0
            }
        })
    })
}

/// Normals as `127.5 (n + 1)`; grey where nothing is.
fn normals8(maps: &Maps) -> Option<Plane<[u8; 3]>> {
    maps.normals
        .as_ref()
        .map(|plane| plane.map(|n| n.map(|v| ((v + 1.0) * 127.5).round().clamp(0.0, 255.0) as u8)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_and_normals_decode_to_half_a_step() {
        let maps = Maps {
            depth_z: Some(Plane::from_vec(3, 1, vec![801.237, f32::INFINITY, 9e9])),
            depth_steps_per_mm: 32.0,
            normals: Some(Plane::from_vec(2, 1, vec![[0.6, -0.8, 0.0], [0.0; 3]])),
            ..Maps::default()
        };
        let depth = depth16(&maps).expect("present");
        assert!((f64::from(depth[(0, 0)]) / 32.0 - 801.237).abs() <= 0.5 / 32.0 + 1e-4);
        assert_eq!((depth[(1, 0)], depth[(2, 0)]), (0, 0));
        let normals = normals8(&maps).expect("present");
        for (code, v) in normals[(0, 0)].into_iter().zip([0.6, -0.8, 0.0]) {
            assert!((f64::from(code) / 127.5 - 1.0 - v).abs() < 0.004);
        }
    }
}
