//! `[image]` and `[sensor]`: size, encoding, ground truth, and what the camera does to the light.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[image]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ImageTable {
    /// Width and height in pixels, each from 8 to 8192.
    pub size: [i64; 2],
    /// File format of the images. Maps are always PNG.
    pub encoding: Encoding,
    /// Quality of JPEG images, from 1 to 100.
    pub quality: i64,
    /// Ground truth to write.
    pub truth: Vec<Truth>,
    /// Landmark schemes to write, by name: `five`, `ibug51`, `ibug68`, `wflw98`, `dense` (every vertex of the reference
    /// mesh); `ibug68_contour` and `wflw98_contour` have the jaw on the visible contour.
    pub landmarks: Vec<String>,
    /// Samples per pixel, from 1 to 256, or `adaptive`: 16 where neighbouring pixels differ, 1 elsewhere.
    pub samples: SamplesTable,
    /// sRGB colour behind the head, from 0 to 255.
    pub background: [u8; 3],
    /// What `face_margin_px` adds on each side of the square around the face, as a share of its side, from 0 to 2.
    pub box_margin: f64,
}

impl Default for ImageTable {
    fn default() -> Self {
        Self {
            size: [256, 256],
            encoding: Encoding::Png,
            quality: 92,
            truth: vec![Truth::Landmarks],
            landmarks: vec!["ibug68".to_owned()],
            samples: SamplesTable::Word("adaptive".to_owned()),
            background: [125, 134, 142],
            box_margin: 0.25,
        }
    }
}

/// A number of samples or the word `adaptive`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum SamplesTable {
    /// The same number in every pixel.
    Count(i64),
    /// `adaptive`.
    Word(String),
}

/// File format of images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// Lossless.
    Png,
    /// Lossy, small.
    Jpeg,
    /// Lossless WebP.
    Webp,
}

impl Encoding {
    /// Ending of the file's name.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
            Self::Webp => "webp",
        }
    }
}

/// A kind of ground truth.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Truth {
    /// Landmarks in pixels and mm, visible or what hides them.
    Landmarks,
    /// Class of the surface at each pixel, 8 bit.
    Segments,
    /// Distance along the optical axis, 16 bit.
    Depth,
    /// Unit normals in the camera's frame, 8-bit RGB.
    Normals,
    /// Where the head is seen, directly or through a lens: 255, elsewhere 0.
    Visibility,
    /// 0 no head, 1 seen, 2 covered by an occluder, 3 seen through something transparent.
    Occlusion,
    /// Class of the surface at each pixel as if there were no occluders, 8 bit: the amodal mask of the face.
    Amodal,
    /// Classes and distances of the first four surfaces of each pixel, the nearest on top, the others below it in the same
    /// files `layers` (8 bit) and `layer_depth` (16 bit): what lies under glasses, masks and hair.
    Layers,
    /// Share of each pixel that shows any surface, 8 bit: alpha.
    Coverage,
    /// Number of the occluder's body that is seen, 8 bit: glasses have a frame, 1, and lenses, 2; others are one body.
    Instances,
    /// Cylindrical coordinates `h` and `phi` of the reference head's point that the skin corresponds to, 16 bit.
    Reference,
    /// Diffuse colour of the surface before any light, 8-bit sRGB.
    Albedo,
    /// Share of the light from sources with a place or direction that arrives, 8 bit; the one map that changes with light.
    Shadow,
}

/// `[sensor]`: blur, then brightness, then noise, then compression. Nothing is changed by default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorTable {
    /// Brightness in stops, each of which doubles the light, from -10 to 10.
    pub exposure_stops: f64,
    /// Gain of red, green and blue, each from 0 to 10.
    pub white_balance: [f64; 3],
    /// Standard deviation of the lens's blur, from 0 to 20 px.
    pub blur_px: f64,
    /// Variance of the noise over the light's value, where white is 1, from 0 to 1: 0.0005 for daylight, 0.005 for a dim
    /// room.
    pub photon_noise: f64,
    /// Standard deviation of the noise in the dark, from 0 to 1.
    pub read_noise: f64,
    /// Quality from 1 to 100 of a JPEG that the image went through, whatever the file's format: blocks and blurred colours.
    /// 0 for none.
    pub jpeg_quality: i64,
}

impl Default for SensorTable {
    fn default() -> Self {
        Self {
            exposure_stops: 0.0,
            white_balance: [1.0; 3],
            blur_px: 0.0,
            photon_noise: 0.0,
            read_noise: 0.0,
            jpeg_quality: 0,
        }
    }
}
