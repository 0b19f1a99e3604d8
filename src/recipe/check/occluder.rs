//! From `[[occluder]]` to what is put in front of a face.

use std::path::Path;
use std::sync::Arc;

use facile_trace::occluder::{Anchor, Glasses, Model, Prop, PropKind, RimShape};

use super::value::{in_range, unused};
use crate::recipe::file::{AnchorTable, OccluderKind, OccluderTable, RimTable};
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::Occluder;

pub(crate) fn occluders(
    tables: &[OccluderTable],
    base: &Path,
    place: &Place,
) -> Result<Vec<Occluder>, Problem> {
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        list.push(occluder(table, base, &place.index(i))?);
    }
    if list.is_empty() {
        list.push(Occluder::None);
    }
    Ok(list)
}

fn occluder(table: &OccluderTable, base: &Path, place: &Place) -> Result<Occluder, Problem> {
    let given = [
        ("color", table.color.is_some()),
        ("shape", table.shape.is_some()),
        ("tint", table.tint.is_some()),
        ("diopters", table.diopters.is_some()),
        ("rim_mm", table.rim_mm.is_some()),
        ("size", table.size.is_some()),
        ("x_mm", table.x_mm.is_some()),
        ("y_mm", table.y_mm.is_some()),
        ("z_mm", table.z_mm.is_some()),
        ("turn_deg", table.turn_deg.is_some()),
        ("file", table.file.is_some()),
        ("anchor", table.anchor.is_some()),
        ("scale", table.scale.is_some()),
        ("clear", table.clear.is_some()),
    ];
    let name = table.kind.name();
    let only = |allowed: &[&str]| {
        unused(
            place,
            &format!("an occluder of kind `{name}`"),
            &given,
            allowed,
        )
    };
    let lenses = ["color", "shape", "tint", "diopters", "rim_mm", "size"];
    let kind = match table.kind {
        OccluderKind::None => {
            only(&[])?;
            return Ok(Occluder::None);
        }
        OccluderKind::Glasses => {
            only(&lenses)?;
            return Ok(Occluder::Glasses(glasses(
                table,
                Glasses::default(),
                place,
            )?));
        }
        OccluderKind::Sunglasses => {
            only(&lenses)?;
            return Ok(Occluder::Sunglasses(glasses(
                table,
                Glasses::sunglasses(),
                place,
            )?));
        }
        OccluderKind::Model => {
            only(&[
                "x_mm", "y_mm", "z_mm", "turn_deg", "file", "anchor", "scale", "clear",
            ])?;
            return Ok(Occluder::Model(model(table, base, place)?));
        }
        OccluderKind::SurgicalMask => PropKind::SurgicalMask,
        OccluderKind::Scarf => PropKind::Scarf,
        OccluderKind::Cap => PropKind::Cap,
        OccluderKind::Hat => PropKind::Hat,
        OccluderKind::HeadBand => PropKind::HeadBand,
        OccluderKind::Headphones => PropKind::Headphones,
        OccluderKind::Hand => PropKind::Hand,
        OccluderKind::Bar => PropKind::Bar,
        OccluderKind::Fringe => PropKind::Fringe,
    };
    only(&[&["color", "size"], kind.places()].concat())?;
    let usual = Prop::new(kind);
    Ok(Occluder::Prop(Prop {
        color: table.color,
        size: in_range(
            table.size.unwrap_or(1.0),
            0.7..=1.3,
            "size",
            &place.key("size"),
        )?,
        x_mm: offset(table.x_mm, "x_mm", place)?,
        y_mm: offset(table.y_mm, "y_mm", place)?,
        turn_deg: occluder_turn(table, place)?,
        ..usual
    }))
}

fn offset(value: Option<f64>, key: &str, place: &Place) -> Result<f64, Problem> {
    in_range(value.unwrap_or(0.0), -150.0..=150.0, key, &place.key(key))
}

fn occluder_turn(table: &OccluderTable, place: &Place) -> Result<f64, Problem> {
    let turn = table.turn_deg.unwrap_or(0.0);
    in_range(turn, -180.0..=180.0, "turn_deg", &place.key("turn_deg"))
}

fn model(table: &OccluderTable, base: &Path, place: &Place) -> Result<Model, Problem> {
    let file_place = place.key("file");
    let message = "an occluder of kind `model` needs the key `file`";
    let file = table
        .file
        .clone()
        .ok_or_else(|| file_place.problem(message))?;
    let mesh = facile_core::io::load_scan(&base.join(&file), None)
        .map_err(|e| file_place.problem(e.to_string()))?;
    let is_metres = [".glb", ".gltf"]
        .iter()
        .any(|e| file.to_lowercase().ends_with(e));
    let scale = table.scale.unwrap_or(if is_metres { 1000.0 } else { 1.0 });
    Ok(Model {
        file,
        anchor: match table.anchor {
            None | Some(AnchorTable::Nose) => Anchor::Nose,
            Some(AnchorTable::Eyes) => Anchor::Eyes,
            Some(AnchorTable::Mouth) => Anchor::Mouth,
            Some(AnchorTable::Chin) => Anchor::Chin,
            Some(AnchorTable::Forehead) => Anchor::Forehead,
            Some(AnchorTable::LeftEar) => Anchor::LeftEar,
            Some(AnchorTable::RightEar) => Anchor::RightEar,
            Some(AnchorTable::Head) => Anchor::Head,
        },
        scale: in_range(scale, 1e-3..=1e4, "scale", &place.key("scale"))?,
        offset_mm: [
            offset(table.x_mm, "x_mm", place)?,
            offset(table.y_mm, "y_mm", place)?,
            offset(table.z_mm, "z_mm", place)?,
        ],
        turn_deg: occluder_turn(table, place)?,
        clear: table.clear.unwrap_or(true),
        mesh: Arc::new(mesh),
    })
}

fn glasses(table: &OccluderTable, style: Glasses, place: &Place) -> Result<Glasses, Problem> {
    let mut tint = style.tint;
    for (i, (to, from)) in tint.iter_mut().zip(table.tint.iter().flatten()).enumerate() {
        let place = place.key("tint").index(i);
        *to = in_range(*from, 0.0..=1.0, "a share of light", &place)? as f32;
    }
    let rim_mm = table.rim_mm.unwrap_or(style.rim_mm);
    let size = table.size.unwrap_or(style.size);
    Ok(Glasses {
        shape: match table.shape {
            Some(RimTable::Round) => RimShape::Round,
            Some(RimTable::Rectangular) => RimShape::Rectangular,
            None => style.shape,
        },
        color: table.color.unwrap_or(style.color),
        tint,
        diopters: in_range(
            table.diopters.unwrap_or(style.diopters),
            -8.0..=8.0,
            "diopters",
            &place.key("diopters"),
        )?,
        rim_mm: in_range(rim_mm, 0.5..=8.0, "rim_mm", &place.key("rim_mm"))?,
        size: in_range(size, 0.7..=1.3, "size", &place.key("size"))?,
    })
}
