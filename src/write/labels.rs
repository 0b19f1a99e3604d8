//! `labels.schema.json`: what records and maps hold, as JSON Schema with units and conventions.

use facile_core::Segment;
use serde_json::{Value, json};

use super::parquet::VISIBILITIES;

/// Name of the schema in a dataset.
pub const LABELS: &str = "labels.schema.json";

const CONVENTIONS: &str = "Lengths are in millimetres, angles in degrees, positions in images in pixels from the upper \
    left corner, where the centre of the first pixel is (0.5, 0.5). Positions in mm are in the head's frame: x to the \
    subject's left, y up, z out of the face; the origin is that of the reference head. Cameras are OpenCV's: x right, y \
    down, z forward. Left and right are the subject's own.";

/// A list of `n` numbers.
fn numbers(n: usize, description: &str) -> Value {
    json!({
        "type": "array", "items": { "type": "number" }, "minItems": n, "maxItems": n, "description": description,
    })
}

/// An object of which all properties are always there.
fn object(description: &str, properties: Value) -> Value {
    let required: Vec<&String> = properties
        .as_object()
        .into_iter()
        .flat_map(|p| p.keys())
        .collect();
    let mut schema = json!({ "type": "object", "description": description, "required": required });
    schema["properties"] = properties;
    schema
}

fn text(description: &str) -> Value {
    json!({ "type": "string", "description": description })
}

fn number(description: &str) -> Value {
    json!({ "type": "number", "description": description })
}

fn rows(description: &str) -> Value {
    json!({ "type": "array", "items": numbers(3, "a row"), "minItems": 3, "maxItems": 3, "description": description })
}

/// The schema of a line of `annotations.jsonl`.
pub(super) fn labels_schema() -> Value {
    let box_of = |what: &str| {
        numbers(
            4,
            &format!("left, top, right, bottom of {what}, px; may reach beyond the image"),
        )
    };
    let mut schema = object(
        CONVENTIONS,
        json!({
            "index": { "type": "integer", "minimum": 0, "description": "number of the sample in the recipe" },
            "image": text("file of the image within the dataset, 8-bit sRGB"),
            "size": { "type": "array", "items": { "type": "integer" }, "description": "columns and rows" },
            "recipe": text("hash of the recipe, the scans and the program's version"),
            "subject": subject(),
            "expression": expression(),
            "light": object("the lighting", json!({
                "name": text("name in the recipe"),
                "sources": { "type": "array", "description": "sources that shine together; intensity 1 lights a white surface \
                    that faces the source to 1, of point and spot sources at 1,000 mm; positions in mm" },
            })),
            "camera": camera(),
            "head_pose": object("turn of the head against a camera that looks it in the face", json!({
                "yaw_deg": number("to the left in the image"),
                "pitch_deg": number("upwards"),
                "roll_deg": number("counter-clockwise in the image"),
            })),
            "occluder": { "type": "object", "required": ["kind"], "properties": {
                "kind": text("none, glasses, sunglasses, surgical_mask, scarf, cap, hat, head_band, headphones, hand, bar, fringe or model"),
            }, "description": "what is in front of the face, with its own numbers" },
            "background": { "type": "object", "required": ["kind"], "properties": {
                "kind": text("color, gradient, room, images or environment"),
                "file": text("the picture"),
            }, "description": "what is behind the head" },
            "face_box_px": box_of("the face, occluded or not: skin in front of the ears from hairline to chin"),
            "face_square_px": box_of("the smallest square around face_box_px with the same middle"),
            "face_margin_px": box_of("that square with the recipe's box_margin of its side added on each side"),
        }),
    );
    schema["properties"]["landmarks"] = landmarks();
    schema["properties"]["maps"] = maps();
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("labels of one image");
    schema
}

fn camera() -> Value {
    let mut camera = object(
        "pixel = K (R x + t), divided by its third component",
        json!({
            "K": rows("intrinsics, px; px / mm of an orthographic camera"),
            "R": rows("camera from head"),
            "t_mm": numbers(3, "camera from head"),
        }),
    );
    camera["properties"]["projection"] = text(
        "orthographic: pixel = K v, where v is R x + t with its third component set to 1; perspective if not given",
    );
    camera["properties"]["aperture_mm"] =
        number("diameter of the lens's opening; all labels are those of the pinhole in its middle");
    camera["properties"]["focus_mm"] = number("depth that the lens has in focus");
    camera
}

fn subject() -> Value {
    let mut subject = object(
        "whose face",
        json!({
            "id": text("name, unique in the dataset"),
            "kind": { "enum": ["scan", "builtin", "sampled"], "description": "where the person comes from" },
            "attributes": { "type": "object", "description": "sex, ancestry, age, eye_color, hair, source, license, as far as known" },
            "registration": { "type": ["object", "null"], "description": "how well the scan was registered, lengths in mm; null for sampled subjects" },
        }),
    );
    subject["properties"]["hair"] = object(
        "cards of hair; without them the head shows what is painted on its skin",
        json!({
            "style": text("name of the style"),
            "color": numbers(3, "mean sRGB colour of the strands, 0 to 255"),
        }),
    );
    subject["properties"]["clothes"] = numbers(3, "sRGB colour of the shirt, 0 to 255");
    subject
}

fn expression() -> Value {
    let side = || json!({ "left": number("in [0, 1]"), "right": number("in [0, 1]") });
    object(
        "what the face does",
        json!({
            "name": text("name in the recipe"),
            "intensity": number("from 0 to 1, of the expression of that name"),
            "contractions": {
                "type": "object", "description": "every muscle",
                "additionalProperties": object("contraction", side()),
            },
            "action_units": { "type": "object", "description": "FACS action units that the recipe names, in [0, 1]" },
            "jaw": object("position of the jaw", json!({
                "open_deg": number("opening"),
                "protrusion_mm": number("forwards"),
                "lateral_mm": number("to the left"),
            })),
            "gaze_deg": numbers(2, "turn of the eyes to the left, and upwards, as asked for"),
            "equilibrium": { "type": ["object", "null"], "description": "certificate of the simulated equilibrium: residual (relative force), \
                max_penetration_mm, lip_overlap_mm, inverted_elements, flipped_triangles, iterations, energy; null for the face at rest" },
        }),
    )
}

fn landmarks() -> Value {
    let point = |n: usize, what: &str| json!({ "type": "array", "items": numbers(n, "a point"), "description": what });
    json!({
        "type": "object",
        "description": "by scheme, in the scheme's order: five (right eye, left eye, tip of the nose, right and left corner of the \
            mouth), ibug51, ibug68, wflw98, mesh478 (the order of MediaPipe's face mesh, irises last), dense (vertices of the reference mesh); with _contour the jaw lies on the visible \
            contour, else where the jaw's line is projected to, seen or not",
        "additionalProperties": object("one scheme", json!({
            "px": point(2, "places in the image"),
            "mm": point(3, "places on the face, head frame"),
            "visibility": {
                "type": "array", "items": { "enum": VISIBILITIES },
                "description": "visible, or what hides it: the head itself, its hair, an occluder, the other lip, the image's frame",
            },
        })),
    })
}

fn maps() -> Value {
    let segments: serde_json::Map<String, Value> = Segment::ALL
        .iter()
        .map(|s| (s.id().to_string(), Value::from(s.name())))
        .collect();
    let map = |description: &str, more: Value| {
        let mut map = json!({
            "type": "object", "required": ["file"], "description": description,
            "properties": { "file": text("PNG within the dataset; images that differ in light alone share it") },
        });
        if let (Some(map), Some(more)) = (map.as_object_mut(), more.as_object()) {
            map.extend(more.clone());
        }
        map
    };
    json!({
        "type": "object",
        "description": "by kind of truth",
        "properties": {
            "segments": map("class of the surface at each pixel's centre, 8 bit", json!({ "classes": segments })),
            "depth": map("depth along the optical axis, 16 bit: value / steps_per_mm; 0 where nothing is", json!({})),
            "normals": map("unit normals in the camera's frame: value / 127.5 - 1; grey where nothing is", json!({})),
            "visibility": map("255 where the head is seen, directly or through a lens", json!({})),
            "amodal": map("class of the surface at each pixel's centre as if there were no occluders, 8 bit", json!({})),
            "layers": map("classes of the first four surfaces of each pixel, 8 bit: four images one below the other, the nearest surface on top; 0 where there is none", json!({})),
            "layer_depth": map("their depths along the optical axis, 16 bit, likewise: value / steps_per_mm; 0 where there is none", json!({})),
            "coverage": map("share of the pixel that shows any surface: value / 255", json!({})),
            "instances": map("number of the occluder's body that is seen at each pixel's centre, 8 bit: of glasses 1 the frame, 2 the lenses, of others 1; 0 elsewhere", json!({})),
            "reference": map("cylindrical coordinates of the reference head's point that the skin at each pixel's centre corresponds to, 16 bit: two images one below the other, h_mm = value / 64 - 512 on top, phi_deg = (value - 32768) 180 / 32767, to the subject's left; 0 where there is no skin", json!({})),
            "albedo": map("diffuse colour of the surface at each pixel's centre before any light, 8-bit sRGB; black where nothing is", json!({})),
            "shadow": map("share of the light from sources with a place or direction that arrives at each pixel's centre: value / 255; 255 where none could. Each image has its own", json!({})),
            "occlusion": map("0 no head, 1 seen, 2 covered by an occluder, 3 seen through something transparent", json!({})),
        },
    })
}
