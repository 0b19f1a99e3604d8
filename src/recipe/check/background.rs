//! From the file's tables to checked settings: backgrounds, and the pictures of surroundings that lights share.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use facile_trace::EnvironmentMap;

use super::value::{in_range, matching_files, unused};
use crate::recipe::file::{BackgroundKind, BackgroundTable};
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::{Background, WeightedBackground};

/// Softness of a room whose recipe does not say, a share of the picture's side.
const ROOM_BLUR: f64 = 0.06;

/// Pictures of surroundings by name, each read once.
pub(crate) struct Surroundings<'a> {
    base: &'a Path,
    read: RefCell<BTreeMap<String, Arc<EnvironmentMap>>>,
}

impl<'a> Surroundings<'a> {
    /// Files are relative to `base`.
    pub(crate) fn new(base: &'a Path) -> Self {
        Self {
            base,
            read: RefCell::default(),
        }
    }

    /// With what was read before, and nothing else.
    pub(crate) fn known(maps: BTreeMap<String, Arc<EnvironmentMap>>) -> Self {
        Self {
            base: Path::new(""),
            read: RefCell::new(maps),
        }
    }

    pub(crate) fn map(&self, file: &str, place: &Place) -> Result<Arc<EnvironmentMap>, Problem> {
        if let Some(map) = self.read.borrow().get(file) {
            return Ok(map.clone());
        }
        let map = EnvironmentMap::load(&self.base.join(file)).map_err(|e| {
            let help = "an equirectangular picture: Radiance HDR, OpenEXR, PNG, JPEG or WebP";
            place.problem(e.to_string()).help(help)
        })?;
        let map = Arc::new(map);
        self.read.borrow_mut().insert(file.to_owned(), map.clone());
        Ok(map)
    }
}

pub(crate) fn backgrounds(
    tables: &[BackgroundTable],
    surroundings: &Surroundings<'_>,
    place: &Place,
) -> Result<Vec<WeightedBackground>, Problem> {
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        let place = place.index(i);
        list.push(WeightedBackground {
            weight: in_range(table.weight, 0.0..=1e9, "a weight", &place.key("weight"))?,
            background: background(table, surroundings, &place)?,
        });
    }
    if !list.is_empty() && list.iter().all(|b| b.weight == 0.0) {
        return Err(place.problem("at least one background must have a weight over 0"));
    }
    Ok(list)
}

fn background(
    table: &BackgroundTable,
    surroundings: &Surroundings<'_>,
    place: &Place,
) -> Result<Background, Problem> {
    let given = [
        ("color", table.color.is_some()),
        ("bottom", table.bottom.is_some()),
        ("blur", table.blur.is_some()),
        ("files", table.files.is_some()),
        ("file", table.file.is_some()),
        ("intensity", table.intensity.is_some()),
        ("turn_deg", table.turn_deg.is_some()),
    ];
    let (name, allowed): (&str, &[&str]) = match table.kind {
        BackgroundKind::Color => ("color", &["color"]),
        BackgroundKind::Gradient => ("gradient", &["color", "bottom"]),
        BackgroundKind::Room => ("room", &["blur"]),
        BackgroundKind::Images => ("images", &["files", "intensity"]),
        BackgroundKind::Environment => ("environment", &["file", "intensity", "turn_deg"]),
    };
    unused(
        place,
        &format!("a background of kind `{name}`"),
        &given,
        allowed,
    )?;
    let color = |key: &str, value: Option<[u8; 3]>| {
        let message = format!("a background of kind `{name}` needs the key `{key}`");
        value.ok_or_else(|| place.key(key).problem(message))
    };
    let intensity = table.intensity.unwrap_or(1.0);
    let intensity = in_range(intensity, 0.0..=1e3, "intensity", &place.key("intensity"))? as f32;
    Ok(match table.kind {
        BackgroundKind::Color => Background::Color(color("color", table.color)?),
        BackgroundKind::Gradient => Background::Gradient {
            top: color("color", table.color)?,
            bottom: color("bottom", table.bottom)?,
        },
        BackgroundKind::Room => {
            let blur = table.blur.unwrap_or(ROOM_BLUR);
            let blur = in_range(blur, 0.0..=0.2, "blur", &place.key("blur"))?;
            Background::Room { blur }
        }
        BackgroundKind::Images => {
            let place = place.key("files");
            let mut files: Vec<PathBuf> = Vec::new();
            for (k, pattern) in table.files.iter().flatten().enumerate() {
                files.extend(matching_files(pattern, surroundings.base, &place.index(k))?);
            }
            files.sort();
            files.dedup();
            if files.is_empty() {
                let message = "a background of kind `images` needs the key `files`";
                return Err(place.problem(message).help("such as [\"rooms/*.jpg\"]"));
            }
            Background::Images { files, intensity }
        }
        BackgroundKind::Environment => {
            let turn = table.turn_deg.unwrap_or(0.0);
            let turn = in_range(turn, -360.0..=360.0, "turn_deg", &place.key("turn_deg"))?;
            let map = table.file.as_ref().map(|file| {
                let map = surroundings.map(file, &place.key("file"))?;
                Ok((file.clone(), map))
            });
            Background::Environment {
                map: map.transpose()?,
                turn: turn.to_radians() as f32,
                intensity,
            }
        }
    })
}
