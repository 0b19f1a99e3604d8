//! From `[[view]]` and `[sensor]` to viewpoints and what the camera does to the light.

use facile_trace::{Samples, Sensor};

use super::value::{in_range, length};
use crate::recipe::file::{ProjectionTable, SensorTable, ViewTable};
use crate::recipe::problem::{Place, Problem};
use crate::recipe::settings::{ImageSettings, Optics, View};

/// Viewpoints of a recipe, a protection against typing errors.
const MAX_VIEWS: usize = 1_000_000;

pub(crate) fn views(tables: &[ViewTable], place: &Place) -> Result<Vec<View>, Problem> {
    let frontal = [ViewTable::default()];
    let tables = if tables.is_empty() { &frontal } else { tables };
    let mut list = Vec::new();
    for (i, table) in tables.iter().enumerate() {
        let place = place.index(i);
        let angles = [
            ("yaw_deg", &table.yaw_deg, 180.0),
            ("pitch_deg", &table.pitch_deg, 89.0),
            ("roll_deg", &table.roll_deg, 180.0),
        ];
        for (key, values, limit) in angles {
            let place = place.key(key);
            if values.is_empty() {
                return Err(place.problem("at least one angle is needed"));
            }
            for (k, &v) in values.iter().enumerate() {
                in_range(v, -limit..=limit, key, &place.index(k))?;
            }
        }
        // Counted before there is memory for them.
        let count = angles
            .iter()
            .try_fold(1, |n: usize, (_, values, _)| n.checked_mul(values.len()));
        if count.is_none_or(|n| n + list.len() > MAX_VIEWS) {
            let message = format!("the angles have more than {MAX_VIEWS} combinations");
            return Err(place.problem(message));
        }
        let fov_y = in_range(
            table.fov_y_deg,
            1.0..=120.0,
            "fov_y_deg",
            &place.key("fov_y_deg"),
        )?;
        let distance_place = place.key("distance_mm");
        let distance = in_range(
            table.distance_mm,
            150.0..=1e5,
            "distance_mm",
            &distance_place,
        )?;
        length(table.target_mm, &place.key("target_mm"))?;
        for (k, v) in table.shift.into_iter().enumerate() {
            in_range(v, -1.0..=1.0, "shift", &place.key("shift").index(k))?;
        }
        let optics = optics(table, &place)?;
        for &yaw in &table.yaw_deg {
            for &pitch in &table.pitch_deg {
                for &roll in &table.roll_deg {
                    list.push(View {
                        yaw: yaw.to_radians(),
                        pitch: pitch.to_radians(),
                        roll: roll.to_radians(),
                        fov_y: fov_y.to_radians(),
                        distance,
                        target: table.target_mm,
                        shift: table.shift,
                        optics,
                    });
                }
            }
        }
    }
    Ok(list)
}

fn optics(table: &ViewTable, place: &Place) -> Result<Optics, Problem> {
    let aperture_place = place.key("aperture_mm");
    let aperture = in_range(
        table.aperture_mm,
        0.0..=100.0,
        "aperture_mm",
        &aperture_place,
    )?;
    let focus_place = place.key("focus_mm");
    if let Some(focus) = table.focus_mm {
        in_range(focus, 10.0..=1e5, "focus_mm", &focus_place)?;
    }
    if aperture == 0.0 {
        return match table.focus_mm {
            Some(_) => Err(focus_place.problem("without aperture_mm everything is in focus")),
            None if table.projection == ProjectionTable::Orthographic => Ok(Optics::Orthographic),
            None => Ok(Optics::Pinhole),
        };
    }
    if table.projection == ProjectionTable::Orthographic {
        return Err(aperture_place.problem("an orthographic view has no lens"));
    }
    Ok(Optics::Lens {
        aperture,
        focus: table.focus_mm,
    })
}

/// A lens is sampled, and adaptive samples look at the pinhole's image only.
pub(crate) fn check_lenses(
    tables: &[ViewTable],
    image: &ImageSettings,
    place: &Place,
) -> Result<(), Problem> {
    if matches!(image.samples, Samples::Count(2..)) {
        return Ok(());
    }
    match tables.iter().position(|t| t.aperture_mm != 0.0) {
        None => Ok(()),
        Some(i) => Err(lens_problem(&place.index(i).key("aperture_mm"))),
    }
}

/// Too few samples for a lens.
pub(super) fn lens_problem(place: &Place) -> Problem {
    let message = "a lens needs the same number of samples in each pixel, from 2 on";
    let problem = place.problem(message);
    problem.help("set image.samples to a number, such as 32")
}

pub(crate) fn jpeg_quality(table: &SensorTable, place: &Place) -> Result<Option<u8>, Problem> {
    let quality = table.jpeg_quality;
    match u8::try_from(quality).ok().filter(|q| *q <= 100) {
        Some(quality) => Ok((quality > 0).then_some(quality)),
        None => {
            let message = format!("jpeg_quality must be from 0 to 100, found {quality}");
            Err(place.key("jpeg_quality").problem(message))
        }
    }
}

pub(crate) fn sensor(table: &SensorTable, place: &Place) -> Result<Sensor, Problem> {
    let number = |key: &str, value: f64, low: f64, high: f64| {
        in_range(value, low..=high, key, &place.key(key)).map(|v| v as f32)
    };
    let mut white_balance = [1.0; 3];
    for (i, (to, from)) in white_balance
        .iter_mut()
        .zip(table.white_balance)
        .enumerate()
    {
        let place = place.key("white_balance").index(i);
        *to = in_range(from, 0.0..=10.0, "a gain", &place)? as f32;
    }
    Ok(Sensor {
        exposure_stops: number("exposure_stops", table.exposure_stops, -10.0, 10.0)?,
        white_balance,
        blur_px: number("blur_px", table.blur_px, 0.0, 20.0)?,
        photon_noise: number("photon_noise", table.photon_noise, 0.0, 1.0)?,
        read_noise: number("read_noise", table.read_noise, 0.0, 1.0)?,
    })
}
