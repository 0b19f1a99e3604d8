//! `coco.json`: boxes, keypoints and masks as COCO has them, for readers such as `pycocotools`.
//!
//! One category, `face`, with the keypoints of the recipe's first landmark scheme. Positions are continuous, from the
//! upper left corner of the image. A keypoint's flag is 0 outside the image, 1 where something hides it, 2 where it is
//! seen. The mask is the visible face: skin in front of ears and neck, eyes, lips, what the mouth shows.

use std::io::Write;

use facile_core::{Plane, Segment};
use serde_json::{Value, json};

use super::Journal;
use crate::pipeline::Sample;

/// Name of the file in a dataset.
pub const COCO: &str = "coco.json";
const CATEGORY: u64 = 1;

/// The entries of a sample, as one line of JSON.
pub(super) fn coco_line(sample: &Sample) -> String {
    let record = &sample.record;
    let [left, top, right, bottom] = record.face_box_px;
    let [width, height] = record.size;
    let mut annotation = json!({
        // Readers take 0 for none.
        "id": record.index + 1,
        "image_id": record.index,
        "category_id": CATEGORY,
        "iscrowd": 0,
        "bbox": [left, top, right - left, bottom - top],
    });
    if let Some(landmarks) = record.landmarks.values().next() {
        let mut keypoints = Vec::with_capacity(3 * landmarks.px.len());
        let mut labelled = 0;
        for (px, visibility) in landmarks.px.iter().zip(&landmarks.visibility) {
            let (px, flag) = match *visibility {
                "frame" => ([0.0; 2], 0),
                "visible" => (*px, 2),
                _ => (*px, 1),
            };
            labelled += u64::from(flag > 0);
            keypoints.extend([json!(px[0]), json!(px[1]), json!(flag)]);
        }
        annotation["keypoints"] = Value::Array(keypoints);
        annotation["num_keypoints"] = json!(labelled);
    }
    if let Some(segments) = &sample.maps.segments {
        let (counts, area) = run_lengths(segments);
        annotation["segmentation"] = json!({ "size": [height, width], "counts": counts });
        annotation["area"] = json!(area);
    }
    let image = json!({
        "id": record.index,
        "file_name": record.image,
        "width": width,
        "height": height,
    });
    json!({ "image": image, "annotation": annotation }).to_string()
}

fn is_in_mask(id: u8) -> bool {
    const FACE: [Segment; 18] = [
        Segment::Skin,
        Segment::LeftBrow,
        Segment::RightBrow,
        Segment::LeftEyelid,
        Segment::RightEyelid,
        Segment::EyeSocket,
        Segment::Nose,
        Segment::UpperLip,
        Segment::LowerLip,
        Segment::InnerMouth,
        Segment::UpperTeeth,
        Segment::LowerTeeth,
        Segment::Tongue,
        Segment::LeftEye,
        Segment::RightEye,
        Segment::LeftIris,
        Segment::RightIris,
        Segment::Lashes,
    ];
    FACE.iter().any(|s| s.id() == id)
}

/// Lengths of runs outside and inside the mask in turn, down the columns, beginning outside; and its area, px.
fn run_lengths(segments: &Plane<u8>) -> (Vec<u64>, u64) {
    let mut counts = vec![0];
    let (mut inside, mut area) = (false, 0);
    for x in 0..segments.width() {
        for y in 0..segments.height() {
            let here = is_in_mask(segments[(x, y)]);
            if here != inside {
                counts.push(0);
                inside = here;
            }
            area += u64::from(here);
            if let Some(run) = counts.last_mut() {
                *run += 1;
            }
        }
    }
    (counts, area)
}

/// Writes the file from the journals of all units, which are gone through twice.
pub(super) fn write_coco<I: Iterator<Item = Journal>>(
    out: &mut dyn Write,
    name: &str,
    journals: impl Fn() -> I,
) -> std::io::Result<()> {
    let info = json!({ "description": name, "contributor": "facile" });
    write!(out, "{{\"info\":{info},\"licenses\":[],\"images\":[")?;
    let keypoints = entries(out, "image", journals())?;
    write!(out, "],\"annotations\":[")?;
    let keypoints = keypoints.max(entries(out, "annotation", journals())?);
    let names: Vec<String> = (0..keypoints).map(|i| format!("{i}")).collect();
    let category = json!({
        "id": CATEGORY,
        "name": "face",
        "supercategory": "person",
        "keypoints": names,
        "skeleton": [],
    });
    write!(out, "],\"categories\":[{category}]}}")
}

/// Writes one kind of entry of all journals, with commas between; returns the largest number of keypoints seen.
fn entries(
    out: &mut dyn Write,
    kind: &str,
    journals: impl Iterator<Item = Journal>,
) -> std::io::Result<usize> {
    let mut keypoints = 0;
    let mut is_first = true;
    for line in journals.flat_map(|j| j.coco) {
        let mut entry: Value = serde_json::from_str(&line)?;
        let entry = entry[kind].take();
        keypoints = keypoints.max(entry["keypoints"].as_array().map_or(0, |k| k.len() / 3));
        if !is_first {
            out.write_all(b",\n")?;
        }
        is_first = false;
        write!(out, "{entry}")?;
    }
    Ok(keypoints)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_go_down_the_columns_and_begin_outside() {
        // Columns: skin over nothing, then eye over skin.
        let (skin, eye) = (Segment::Skin.id(), Segment::LeftEye.id());
        let plane = Plane::from_vec(2, 2, vec![skin, eye, 0, skin]);
        assert_eq!(run_lengths(&plane), (vec![0, 1, 1, 2], 3));
        let neck = Plane::from_vec(1, 2, vec![Segment::Neck.id(), 0]);
        assert_eq!(run_lengths(&neck), (vec![2], 0));
    }
}
