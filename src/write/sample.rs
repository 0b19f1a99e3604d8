//! The files of one sample, ready to be written.

use std::sync::Arc;

use facile_core::Plane;
use facile_core::color::srgb8_from_linear;

use super::IMAGES;
use super::coco::coco_line;
use super::{encode_gray8, encode_gray16, encode_image, encode_rgb8};
use crate::Error;
use crate::pipeline::{Maps, Sample};
use crate::recipe::Recipe;
use crate::recipe::file::{Encoding, Format};

/// Kind and PNG of each map of a view.
pub type EncodedMaps = Arc<Vec<(&'static str, Vec<u8>)>>;

/// A sample in the bytes of its files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedSample {
    /// Number of the sample.
    pub index: u64,
    /// Its record, one line of JSON.
    pub record: String,
    /// Its entries of a COCO file, one line of JSON, if the recipe asks for one.
    pub coco: Option<String>,
    /// Format of the image.
    pub encoding: Encoding,
    /// The image.
    pub image: Vec<u8>,
    /// Kind and PNG of each map; shared by the samples that differ in light alone.
    pub maps: EncodedMaps,
    /// Whether the maps' files in a folder are named after this sample.
    pub owns_maps: bool,
    /// Kind and PNG of each map that depends on the light: always this sample's own.
    pub lit_maps: Vec<(&'static str, Vec<u8>)>,
}

impl EncodedSample {
    /// The files of this sample in a folder: path within the dataset, with forward slashes, and content.
    pub fn files(&self) -> impl Iterator<Item = (String, &[u8])> {
        let image = image_name(self.index, self.encoding);
        let own = if self.owns_maps { &self.maps[..] } else { &[] };
        let maps = own
            .iter()
            .chain(&self.lit_maps)
            .map(|(kind, bytes)| (map_name(kind, self.index), &bytes[..]));
        std::iter::once((image, &self.image[..])).chain(maps)
    }

    /// The members of this sample in a tar file: what comes after the stem, and content.
    pub fn members(&self) -> impl Iterator<Item = (String, &[u8])> {
        let maps = self
            .all_maps()
            .map(|(kind, bytes)| (format!("{kind}.png"), bytes));
        [
            ("json".to_owned(), self.record.as_bytes()),
            (self.encoding.extension().to_owned(), &self.image[..]),
        ]
        .into_iter()
        .chain(maps)
    }

    /// Kind and PNG of every map of this sample.
    pub fn all_maps(&self) -> impl Iterator<Item = (&'static str, &[u8])> {
        let maps = self.maps.iter().chain(&self.lit_maps);
        maps.map(|(kind, bytes)| (*kind, &bytes[..]))
    }

    /// Size of the files, bytes.
    pub fn len(&self) -> usize {
        let maps: usize = self.all_maps().map(|(_, bytes)| bytes.len()).sum();
        self.image.len() + maps + self.record.len()
    }

    /// Whether there is nothing in it.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Encodes samples, the maps of one view once.
#[derive(Debug)]
pub struct Encoder<'a> {
    recipe: &'a Recipe,
    /// Whether every sample is stored with its maps, not only the first of a view.
    all_have_maps: bool,
    last: Option<(Arc<Maps>, EncodedMaps)>,
}

impl<'a> Encoder<'a> {
    /// An encoder for the samples of a recipe.
    pub fn new(recipe: &'a Recipe) -> Self {
        Self {
            recipe,
            all_have_maps: recipe.formats.iter().any(|f| *f != Format::Folder),
            last: None,
        }
    }

    /// Encodes a sample.
    ///
    /// # Errors
    /// [`Error::Encode`] if an encoder refuses the size.
    pub fn encode(&mut self, sample: &Sample) -> Result<EncodedSample, Error> {
        let maps = if sample.owns_maps || self.all_have_maps {
            self.maps(&sample.maps)?
        } else {
            Arc::default()
        };
        let settings = &self.recipe.image;
        Ok(EncodedSample {
            index: sample.record.index,
            record: sample.record.to_json(),
            coco: self.recipe.coco.then(|| coco_line(sample)),
            encoding: settings.encoding,
            image: encode_image(&sample.image, settings)?,
            maps,
            owns_maps: sample.owns_maps,
            lit_maps: match &sample.shadow {
                Some(shadow) => vec![("shadow", encode_gray8(shadow)?)],
                None => Vec::new(),
            },
        })
    }

    fn maps(&mut self, maps: &Arc<Maps>) -> Result<EncodedMaps, Error> {
        if let Some((of, encoded)) = &self.last
            && Arc::ptr_eq(of, maps)
        {
            return Ok(encoded.clone());
        }
        let encoded = Arc::new(encode_maps(maps)?);
        self.last = Some((maps.clone(), encoded.clone()));
        Ok(encoded)
    }
}

/// Path of an image within a dataset.
pub fn image_name(index: u64, encoding: Encoding) -> String {
    format!("{IMAGES}/{index:06}.{}", encoding.extension())
}

/// Path of a map within a dataset.
pub fn map_name(kind: &str, index: u64) -> String {
    format!("{kind}/{index:06}.png")
}

fn encode_maps(maps: &Maps) -> Result<Vec<(&'static str, Vec<u8>)>, Error> {
    let gray = |plane: &Option<Plane<u8>>| plane.as_ref().map(encode_gray8).transpose();
    let deep = |plane: &Option<Plane<f32>>| {
        let plane = plane
            .as_ref()
            .map(|plane| depth16(plane, maps.depth_steps_per_mm));
        plane.as_ref().map(encode_gray16).transpose()
    };
    let encoded = [
        ("segments", gray(&maps.segments)?),
        ("depth", deep(&maps.depth_z)?),
        (
            "normals",
            normals8(maps).as_ref().map(encode_rgb8).transpose()?,
        ),
        ("visibility", gray(&maps.visibility)?),
        ("occlusion", gray(&maps.occlusion)?),
        ("amodal", gray(&maps.amodal)?),
        ("layers", gray(&maps.layers)?),
        ("layer_depth", deep(&maps.layer_depth_z)?),
        ("coverage", gray(&maps.coverage)?),
        ("instances", gray(&maps.instances)?),
        (
            "reference",
            maps.reference
                .as_ref()
                .map(|plane| encode_gray16(&reference16(plane)))
                .transpose()?,
        ),
        (
            "albedo",
            maps.albedo
                .as_ref()
                .map(|plane| encode_rgb8(&plane.map(|c| c.map(srgb8_from_linear))))
                .transpose()?,
        ),
    ];
    let present = encoded
        .into_iter()
        .filter_map(|(kind, bytes)| Some((kind, bytes?)));
    Ok(present.collect())
}

/// Depth in steps, see [`Maps::depth_steps_per_mm`]; 0 where nothing is or beyond the last step.
fn depth16(plane: &Plane<f32>, steps_per_mm: f64) -> Plane<u16> {
    plane.map(|z| {
        let steps = (f64::from(*z) * steps_per_mm).round();
        if steps <= f64::from(u16::MAX) {
            steps as u16
        } else {
            0
        }
    })
}

/// `h` above `phi`: `64 (h + 512)` in mm, and `32768 + 32767 phi / 180` in degrees; 0 where there is no skin.
fn reference16(plane: &Plane<[f32; 2]>) -> Plane<u16> {
    let h = |h: f32| ((f64::from(h) + 512.0) * 64.0).round().clamp(1.0, 65_535.0);
    let phi = |phi: f32| {
        let turned = (f64::from(phi) / std::f64::consts::PI * 32_767.0).round();
        (32_768.0 + turned).clamp(1.0, 65_535.0)
    };
    let all = plane.as_slice();
    let code = |v: f32, code: f64| if v.is_nan() { 0 } else { code as u16 };
    let rows = all.iter().map(|[v, _]| code(*v, h(*v)));
    let codes = rows.chain(all.iter().map(|[_, v]| code(*v, phi(*v))));
    Plane::from_vec(plane.width(), 2 * plane.height(), codes.collect())
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
    fn reference_coordinates_decode_to_half_a_step() {
        let pi = std::f32::consts::PI;
        let values = [[-213.456, -pi], [120.5, pi], [0.0, 0.3], [f32::NAN; 2]];
        let codes = reference16(&Plane::from_vec(2, 2, values.to_vec()));
        assert_eq!((codes.width(), codes.height()), (2, 4));
        let codes = codes.as_slice();
        for (i, [h, phi]) in values.into_iter().take(3).enumerate() {
            let found = f64::from(codes[i]) / 64.0 - 512.0;
            assert!((found - f64::from(h)).abs() <= 0.5 / 64.0 + 1e-5);
            let found = (f64::from(codes[4 + i]) - 32_768.0) / 32_767.0 * 180.0;
            assert!((found - f64::from(phi).to_degrees()).abs() <= 90.0 / 32_767.0 + 1e-5);
        }
        assert_eq!([codes[3], codes[7]], [0, 0]);
    }

    #[test]
    fn depth_and_normals_decode_to_half_a_step() {
        let maps = Maps {
            depth_z: Some(Plane::from_vec(3, 1, vec![801.237, f32::INFINITY, 9e9])),
            depth_steps_per_mm: 32.0,
            normals: Some(Plane::from_vec(2, 1, vec![[0.6, -0.8, 0.0], [0.0; 3]])),
            ..Maps::default()
        };
        let depth = maps.depth_z.as_ref().expect("present");
        let depth = depth16(depth, maps.depth_steps_per_mm);
        assert!((f64::from(depth[(0, 0)]) / 32.0 - 801.237).abs() <= 0.5 / 32.0 + 1e-4);
        assert_eq!((depth[(1, 0)], depth[(2, 0)]), (0, 0));
        let normals = normals8(&maps).expect("present");
        for (code, v) in normals[(0, 0)].into_iter().zip([0.6, -0.8, 0.0]) {
            assert!((f64::from(code) / 127.5 - 1.0 - v).abs() < 0.004);
        }
    }
}
