//! `contact_sheet.png`: some of a dataset's images in one picture, evenly over the dataset.

use image::imageops::overlay;
use image::{Rgb, RgbImage};
use serde::Deserialize;

use super::stored::Stored;
use crate::sheet::fitted;

/// Name of the picture in a dataset.
pub const CONTACT_SHEET: &str = "contact_sheet.png";
/// Columns and rows of the picture.
const COLUMNS: usize = 6;
const ROWS: usize = 4;
/// Largest width and height of an image in it, px.
const LARGEST_CELL: u32 = 128;

/// Which images are shown: the first one from each of equal parts of the samples on.
#[derive(Debug)]
pub(super) struct Selection {
    samples: u64,
    /// Samples gone by, failed ones included.
    passed: u64,
    shown: Vec<Shown>,
}

/// What is read of a record.
#[derive(Debug, Deserialize)]
struct Shown {
    index: u64,
    image: String,
    size: [u32; 2],
}

impl Selection {
    /// Of so many samples.
    pub(super) fn of(samples: u64) -> Self {
        Self {
            samples,
            passed: 0,
            shown: Vec::new(),
        }
    }

    /// Looks at the records of the next samples; `failed` of these have none.
    pub(super) fn look_at(&mut self, records: &[String], failed: u64) {
        let cells = (COLUMNS * ROWS) as u64;
        for record in records {
            let due = self.shown.len() as u64 * self.samples / cells;
            if self.passed >= due
                && self.shown.len() < COLUMNS * ROWS
                && let Ok(shown) = serde_json::from_str(record)
            {
                self.shown.push(shown);
            }
            self.passed += 1;
        }
        self.passed += failed;
    }

    /// The picture; `None` without images. An image that cannot be read leaves its cell grey.
    pub(super) fn draw(&self, stored: &Stored<'_>) -> Option<RgbImage> {
        let [width, height] = self.shown.first()?.size;
        let cell = width.max(height).min(LARGEST_CELL);
        let columns = COLUMNS.min(self.shown.len());
        let rows = self.shown.len().div_ceil(columns);
        let size = [columns as u32 * cell, rows as u32 * cell];
        let mut sheet = RgbImage::from_pixel(size[0], size[1], Rgb([128; 3]));
        for (i, shown) in self.shown.iter().enumerate() {
            let bytes = stored.file(shown.index, &shown.image, None);
            let image = bytes.ok().and_then(|b| image::load_from_memory(&b).ok());
            let Some(image) = image else {
                continue;
            };
            let image = fitted(&image.into_rgb8(), cell);
            let within = |cell_at: usize, size: u32| {
                i64::from(cell_at as u32 * cell) + i64::from((cell - size.min(cell)) / 2)
            };
            let (x, y) = (
                within(i % columns, image.width()),
                within(i / columns, image.height()),
            );
            overlay(&mut sheet, &image, x, y);
        }
        Some(sheet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_chosen_evenly_whatever_failed() {
        let record = |i: u64| format!("{{\"index\":{i},\"image\":\"a\",\"size\":[8,8]}}");
        let mut selection = Selection::of(240);
        let first: Vec<String> = (0..100).map(record).collect();
        let rest: Vec<String> = (125..240).map(record).collect();
        selection.look_at(&first, 25);
        selection.look_at(&rest, 0);
        let shown: Vec<u64> = selection.shown.iter().map(|s| s.index).collect();
        assert_eq!(shown.len(), 24);
        assert_eq!(shown[..10], [0, 10, 20, 30, 40, 50, 60, 70, 80, 90]);
        // Three places fell into what failed: they are filled from what comes next.
        assert_eq!(shown[10..14], [125, 126, 127, 130]);
        let mut few = Selection::of(2);
        few.look_at(&[record(0), record(1)], 0);
        assert_eq!(few.shown.len(), 2);
    }
}
