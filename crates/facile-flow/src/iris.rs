//! The colour of a scan's irises, as the name of the nearest of the reference head's eye textures.
//!
//! Scans have the eyes painted on the surface. Hue tells the colours apart and brightness does not: light falls into the
//! orbits from everywhere. The median over both irises keeps highlights, lids and lashes out.

use facile_core::{Eye, Point3, ReferenceHead, Texture, Vector3};

use crate::scan::WorkingScan;

/// Angle from the optical axis at the border of an eye texture, radians; see `assets/README.md`.
const TEXTURE_ANGLE: f64 = 108.0 / 180.0 * std::f64::consts::PI;
/// Iris without pupil and limbus, angles from the optical axis, radians.
const IRIS: [f64; 2] = [0.15, 0.35];
/// Rings and spokes that are looked at.
const RINGS: usize = 6;
const SPOKES: usize = 24;
/// The scan's surface lies this near to the eyeball, mm.
const REACH: f64 = 6.0;
/// Darkest linear value in ratios of colours.
const DARK: f32 = 0.004;
/// A hue further than this from those of all eye textures is none: small or badly lit eyes.
const CLEAR: f32 = 0.6;
/// The colour of eyes that cannot be seen: most people's.
const UNSEEN: &str = "brown";

/// Name of the eye texture whose iris looks most like the scan's.
pub(crate) fn eye_color(
    reference: &ReferenceHead,
    scan: &WorkingScan<'_>,
    eyes: &[Eye; 2],
) -> String {
    let seen: Vec<[f32; 2]> = eyes
        .iter()
        .flat_map(|eye| {
            directions().filter_map(|d| {
                let hit = scan.nearest(&(eye.center + d * eye.radius), REACH)?;
                scan.color(hit.triangle, hit.barycentric).map(hue)
            })
        })
        .collect();
    let textures = reference.eye_textures.iter();
    let unseen = || UNSEEN.to_owned();
    if seen.len() < RINGS * SPOKES {
        return unseen();
    }
    let own = median(seen);
    textures
        .map(|(name, texture)| (distance(own, iris_of(texture)), name))
        .filter(|(distance, _)| *distance < CLEAR)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(unseen, |(_, name)| name.clone())
}

/// Unit directions over the iris of an eye that looks along `+z`.
fn directions() -> impl Iterator<Item = Vector3> {
    (0..RINGS * SPOKES).map(|i| {
        let share = (i / SPOKES) as f64 / (RINGS - 1) as f64;
        let angle = IRIS[0] + (IRIS[1] - IRIS[0]) * share;
        let spoke = (i % SPOKES) as f64 / SPOKES as f64 * std::f64::consts::TAU;
        let out = libm::sin(angle);
        Vector3::new(
            out * libm::cos(spoke),
            out * libm::sin(spoke),
            libm::cos(angle),
        )
    })
}

/// Median hue of the iris of an eye texture.
fn iris_of(texture: &Texture) -> [f32; 2] {
    let at = |d: Vector3| {
        let distance = 0.5 * libm::acos(d.z.clamp(-1.0, 1.0)) / TEXTURE_ANGLE;
        let out = Point3::new(d.x, d.y, 0.0).coords.normalize() * distance;
        texture.sample([(0.5 + out.x) as f32, (0.5 + out.y) as f32])
    };
    median(directions().map(|d| hue(at(d))).collect())
}

/// Logarithms of red and blue against green.
fn hue([red, green, blue]: [f32; 3]) -> [f32; 2] {
    [red, blue].map(|v| libm::logf((v.max(0.0) + DARK) / (green.max(0.0) + DARK)))
}

fn median(mut values: Vec<[f32; 2]>) -> [f32; 2] {
    let middle = values.len() / 2;
    std::array::from_fn(|k| {
        values.sort_unstable_by(|a, b| a[k].total_cmp(&b[k]));
        values[middle][k]
    })
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_eye_texture_has_a_hue_of_its_own() {
        let textures = &ReferenceHead::embedded().eye_textures;
        let hues: Vec<_> = textures.values().map(iris_of).collect();
        for (i, a) in hues.iter().enumerate() {
            for b in &hues[..i] {
                assert!(distance(*a, *b) > 0.3, "{a:?} and {b:?}");
            }
        }
        assert!(iris_of(&textures["blue"])[0] < iris_of(&textures["brown"])[0]);
    }

    #[test]
    fn the_median_keeps_highlights_out() {
        let mut values = vec![[0.1, -0.2]; 9];
        values.extend([[5.0, 5.0]; 4]);
        assert_eq!(median(values), [0.1, -0.2]);
    }
}
