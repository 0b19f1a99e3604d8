//! A contact sheet: the images of a dataset, and what is known of each pixel, in one picture.

use std::path::Path;

use facile_core::Segment;
use image::imageops::{FilterType, overlay, resize};
use image::{Rgb, RgbImage};
use serde::Deserialize;

use crate::Error;
use crate::write::{ANNOTATIONS, Manifest, Stored};

/// What a cell of a sheet shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// The image.
    Image,
    /// The image with the first scheme's landmarks: green where seen, red where hidden.
    Landmarks,
    /// Classes of surface, in colours.
    Segments,
    /// Depth, near is bright.
    Depth,
    /// Normals, as in their file.
    Normals,
    /// Where the head is seen.
    Visibility,
    /// What covers the head.
    Occlusion,
    /// Classes of surface as if nothing covered the head.
    Amodal,
    /// Classes of the first surfaces of each pixel, one picture below the other.
    Layers,
    /// Their depths.
    LayerDepth,
    /// Share of each pixel that shows any surface.
    Coverage,
    /// Bodies of the occluder, in colours.
    Instances,
    /// Place on the reference head: red grows over each 20 degrees, green over each 20 mm.
    Reference,
    /// Colour before any light.
    Albedo,
    /// Share of the light that arrives.
    Shadow,
}

impl Cell {
    /// Every kind of cell with its name.
    pub const ALL: [(&'static str, Self); 15] = [
        ("image", Self::Image),
        ("landmarks", Self::Landmarks),
        ("segments", Self::Segments),
        ("depth", Self::Depth),
        ("normals", Self::Normals),
        ("visibility", Self::Visibility),
        ("occlusion", Self::Occlusion),
        ("amodal", Self::Amodal),
        ("layers", Self::Layers),
        ("layer_depth", Self::LayerDepth),
        ("coverage", Self::Coverage),
        ("instances", Self::Instances),
        ("reference", Self::Reference),
        ("albedo", Self::Albedo),
        ("shadow", Self::Shadow),
    ];

    fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// What a sheet shows.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetSettings {
    /// Number of columns; `None` for about as many as rows.
    pub columns: Option<usize>,
    /// Width and height of the cells, px; `None` for the images' own size.
    pub cell: Option<u32>,
    /// One cell of each kind per sample.
    pub show: Vec<Cell>,
    /// Only samples whose record holds these values, such as `("expression.name", "smile")`.
    pub only: Vec<(String, String)>,
    /// At most so many samples.
    pub limit: usize,
}

impl Default for SheetSettings {
    fn default() -> Self {
        Self {
            columns: None,
            cell: None,
            show: vec![Cell::Image],
            only: Vec::new(),
            limit: 400,
        }
    }
}

/// The part of a record that a sheet needs.
#[derive(Deserialize)]
struct Entry {
    index: u64,
    image: String,
    #[serde(default)]
    landmarks: std::collections::BTreeMap<String, Points>,
    #[serde(default)]
    maps: std::collections::BTreeMap<String, MapFile>,
}

#[derive(Deserialize)]
struct Points {
    px: Vec<[f64; 2]>,
    visibility: Vec<String>,
}

#[derive(Deserialize)]
struct MapFile {
    file: String,
}

/// Lays out the samples of the dataset in `dir`, in whatever format it is stored.
///
/// # Errors
/// [`Error::Io`] if a file cannot be read, [`Error::Dataset`] if the dataset lacks what the sheet shows.
pub fn sheet(dir: &Path, settings: &SheetSettings) -> Result<RgbImage, Error> {
    let path = dir.join(ANNOTATIONS);
    let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, e))?;
    let broken = |reason: String| Error::Dataset {
        path: path.clone(),
        reason,
    };
    let manifest = Manifest::read(dir)?.ok_or_else(|| broken("without a manifest".to_owned()))?;
    let stored = Stored::new(dir, &manifest);
    let mut cells = Vec::new();
    let mut samples = 0;
    for (i, line) in text.lines().enumerate() {
        let bad = |e: serde_json::Error| broken(format!("line {}: {e}", i + 1));
        let value: serde_json::Value = serde_json::from_str(line).map_err(bad)?;
        if samples >= settings.limit || !settings.only.iter().all(|o| holds(&value, o)) {
            continue;
        }
        samples += 1;
        let entry: Entry = serde_json::from_value(value).map_err(bad)?;
        for cell in &settings.show {
            cells.push(draw(&stored, &entry, *cell)?);
        }
    }
    let Some(first) = cells.first() else {
        return Err(broken("no sample to show".to_owned()));
    };
    let size = settings.cell.unwrap_or(first.width());
    let per_sample = settings.show.len().max(1);
    let square = ((samples as f64 / per_sample as f64).sqrt().ceil() as usize).max(1);
    let columns = settings
        .columns
        .unwrap_or(square * per_sample)
        .min(cells.len());
    let rows = cells.len().div_ceil(columns);
    let mut sheet = RgbImage::new(columns as u32 * size, rows as u32 * size);
    for (i, cell) in cells.iter().enumerate() {
        let shrunk = fitted(cell, size);
        let (x, y) = (i % columns, i / columns);
        let center = |n: u32| i64::from(size.saturating_sub(n) / 2);
        overlay(
            &mut sheet,
            &shrunk,
            (x as u32 * size).into(),
            i64::from(y as u32 * size) + center(shrunk.height()),
        );
    }
    Ok(sheet)
}

/// An image scaled to fit a square cell.
pub(crate) fn fitted(image: &RgbImage, size: u32) -> RgbImage {
    let (w, h) = (image.width(), image.height());
    if w.max(h) == size {
        return image.clone();
    }
    let scale = f64::from(size) / f64::from(w.max(h));
    let scaled = |n: u32| ((f64::from(n) * scale).round() as u32).max(1);
    resize(image, scaled(w), scaled(h), FilterType::CatmullRom)
}

/// Whether a record holds a value: `key` is a path with dots, numbers and words compare as text.
fn holds(record: &serde_json::Value, (key, wanted): &(String, String)) -> bool {
    let found = key.split('.').try_fold(record, |v, k| v.get(k));
    found.is_some_and(|v| match v {
        serde_json::Value::String(s) => s == wanted,
        serde_json::Value::Number(n) => wanted
            .parse()
            .is_ok_and(|w: f64| n.as_f64().is_some_and(|n| (n - w).abs() < 1e-9)),
        serde_json::Value::Bool(b) => wanted.parse() == Ok(*b),
        _ => false,
    })
}

fn draw(stored: &Stored<'_>, entry: &Entry, cell: Cell) -> Result<RgbImage, Error> {
    let broken = |reason: String| Error::Dataset {
        path: Path::new(&entry.image).to_owned(),
        reason,
    };
    let open = |name: &str, map: Option<&str>| {
        let bytes = stored.file(entry.index, name, map)?;
        image::load_from_memory(&bytes).map_err(|e| broken(e.to_string()))
    };
    let map = || {
        let kind = cell.name();
        let map = entry.maps.get(kind);
        let map = map.ok_or_else(|| broken(format!("the dataset has no map of kind `{kind}`")))?;
        open(&map.file, Some(kind))
    };
    Ok(match cell {
        Cell::Image => open(&entry.image, None)?.into_rgb8(),
        Cell::Landmarks => {
            let mut image = open(&entry.image, None)?.into_rgb8();
            if let Some(points) = entry.landmarks.values().next() {
                for (px, seen) in points.px.iter().zip(&points.visibility) {
                    mark(&mut image, *px, seen == "visible");
                }
            }
            image
        }
        Cell::Segments | Cell::Amodal | Cell::Layers | Cell::Instances => {
            colored(&map()?.into_luma8(), segment_color)
        }
        Cell::Occlusion => colored(&map()?.into_luma8(), |code| match code {
            1 => [90, 160, 90],
            2 => [190, 60, 50],
            3 => [70, 120, 190],
            _ => [0; 3],
        }),
        Cell::Depth | Cell::LayerDepth => depth_image(&map()?.into_luma16()),
        Cell::Reference => reference_image(&map()?.into_luma16()),
        Cell::Normals | Cell::Visibility | Cell::Coverage | Cell::Albedo | Cell::Shadow => {
            map()?.into_rgb8()
        }
    })
}

/// Sixteen bits a pixel.
type Deep = image::ImageBuffer<image::Luma<u16>, Vec<u16>>;

/// `h` and `phi` of the reference head, which lie one below the other, in one picture.
fn reference_image(map: &Deep) -> RgbImage {
    let height = map.height() / 2;
    // Codes of 20 mm, and of 20 degrees
    let share = |code: u16, period: f64| (f64::from(code) / period).fract() * 255.0;
    RgbImage::from_fn(map.width(), height, |x, y| {
        let [h, phi] = [y, y + height].map(|row| map.get_pixel(x, row)[0]);
        if h == 0 {
            return Rgb([0; 3]);
        }
        let (green, red) = (share(h, 20.0 * 64.0), share(phi, 32_767.0 / 9.0));
        Rgb([red as u8, green as u8, 90])
    })
}

fn colored(map: &image::GrayImage, color: impl Fn(u8) -> [u8; 3]) -> RgbImage {
    RgbImage::from_fn(map.width(), map.height(), |x, y| {
        Rgb(color(map.get_pixel(x, y)[0]))
    })
}

/// Bright is near; the range is the image's own.
fn depth_image(map: &Deep) -> RgbImage {
    let present = || map.as_raw().iter().copied().filter(|v| *v > 0);
    let (near, far) = (present().min().unwrap_or(0), present().max().unwrap_or(1));
    let range = f64::from(far.saturating_sub(near).max(1));
    RgbImage::from_fn(map.width(), map.height(), |x, y| {
        let v = map.get_pixel(x, y)[0];
        let share = f64::from(far.saturating_sub(v)) / range;
        let level = if v == 0 { 0.0 } else { 55.0 + 200.0 * share };
        Rgb([level as u8; 3])
    })
}

/// A colour for each class: hues a golden angle apart, left and right of a pair alike in lightness.
fn segment_color(id: u8) -> [u8; 3] {
    if id == Segment::Background.id() {
        return [0; 3];
    }
    if id == Segment::Skin.id() {
        return [214, 170, 140];
    }
    let hue = (f64::from(id) * 137.508).rem_euclid(360.0) / 60.0;
    let channel = |offset: f64| {
        let k = (hue + offset).rem_euclid(6.0);
        let v = 0.9 - 0.62 * k.min(4.0 - k).clamp(0.0, 1.0);
        (v * 255.0) as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// A dot of about one percent of the image's width.
fn mark(image: &mut RgbImage, [x, y]: [f64; 2], is_seen: bool) {
    let radius = (f64::from(image.width()) / 160.0).max(0.8);
    let color = if is_seen {
        [40, 230, 60]
    } else {
        [235, 50, 40]
    };
    let reach = radius.ceil() as i64;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let (px, py) = (x.floor() as i64 + dx, y.floor() as i64 + dy);
            let (cx, cy) = (px as f64 + 0.5 - x, py as f64 + 0.5 - y);
            let inside = px >= 0 && py >= 0;
            if inside
                && cx.hypot(cy) <= radius
                && let Some(pixel) = image.get_pixel_mut_checked(px as u32, py as u32)
            {
                *pixel = Rgb(color);
            }
        }
    }
}
