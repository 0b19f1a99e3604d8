//! Cavities with one opening, such as a mouth: how much of the light without shadows comes in.

use facile_core::Point3;

use crate::math::{Vec3, vec3_from_point};

/// The opening of a cavity: a slit of the shape that a disc leaves which is moved along a line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Aperture {
    /// Both ends of the line, world, mm.
    pub ends: [Vec3; 2],
    /// The disc's radius, mm.
    pub radius: f32,
}

impl Aperture {
    /// The slit inside a rim of points in order, between the first and the one half-way around: it has the rim's area (half
    /// the length of the sum of its sides' cross products, Newell) and length.
    pub fn of(rim: &[Point3]) -> Self {
        let Some((first, across)) = rim.first().zip(rim.get(rim.len() / 2)) else {
            return Self::default();
        };
        let next = rim.iter().cycle().skip(1);
        let doubled = rim
            .iter()
            .zip(next)
            .map(|(a, b)| (a - first).cross(&(b - first)));
        let area = 0.5 * doubled.fold(Point3::origin().coords, |s, c| s + c).norm();
        // Area of the slit: that of its disc, and of the rectangle along its line
        let (length, pi) = ((across - first).norm(), std::f64::consts::PI);
        let radius = area / (length + (length * length + (pi - 4.0) * area).max(0.0).sqrt());
        let radius = if radius.is_finite() {
            radius.min(0.5 * length)
        } else {
            0.0
        };
        let inwards = (across - first) * (radius / length.max(1e-9));
        Self {
            ends: [first + inwards, across - inwards].map(|p| vec3_from_point(&p)),
            radius: radius as f32,
        }
    }

    /// Share of even light that a point inside gets, in `[0, 1]`: `a b / sqrt((a^2 + d^2) (b^2 + d^2))` at a distance `d` from
    /// the line, `a` the slit's radius and `b` half of its length. A disc gives the form factor on its axis,
    /// `a^2 / (a^2 + d^2)`, an endless slit that of a strip. Surfaces at a slant get less in truth, walls that light each other
    /// more.
    pub fn share(&self, point: Vec3) -> f32 {
        let [a, b] = self.ends;
        let (along, from) = (b - a, point - a);
        let squared = along.norm_squared();
        let t = if squared > 0.0 {
            (from.dot(&along) / squared).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let depth = (from - along * t).norm_squared();
        let (half_width, half_length) = (self.radius, self.radius + 0.5 * squared.sqrt());
        let seen = |half: f32| half / (half * half + depth).sqrt();
        if depth > 0.0 {
            seen(half_width) * seen(half_length)
        } else {
            1.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slit_has_length_and_area_of_its_rim() {
        // A lens of 40 by 12 mm, area 240
        let rim = [[0.0, 0.0], [20.0, 6.0], [40.0, 0.0], [20.0, -6.0]]
            .map(|[x, y]| Point3::new(x, y, 7.0));
        let slit = Aperture::of(&rim);
        let r = slit.radius;
        let line = (slit.ends[1] - slit.ends[0]).norm();
        assert!((line + 2.0 * r - 40.0).abs() < 1e-4);
        assert!(
            (std::f32::consts::PI * r * r + 2.0 * r * line - 240.0).abs() < 1e-2,
            "{slit:?}"
        );
        let at = |x: f32, depth: f32| slit.share(Vec3::new(x, 0.0, 7.0 - depth));
        assert_eq!(at(20.0, 0.0), 1.0);
        // As much anywhere along the line, less beyond its ends
        assert!((at(20.0, r) - at(10.0, r)).abs() < 1e-6 && at(20.0, r) > at(39.0, r));
        assert!((0.6..0.71).contains(&at(20.0, r)), "nearly a strip's");
        assert!((0.001..0.03).contains(&at(20.0, 60.0)), "at the back");
        let disc = Aperture {
            ends: [Vec3::zeros(); 2],
            radius: 5.0,
        };
        assert!((disc.share(Vec3::new(0.0, 0.0, 5.0)) - 0.5).abs() < 1e-6);
        // Closed
        assert_eq!(Aperture::of(&[]).share(Vec3::z()), 0.0);
        assert_eq!(Aperture::of(&rim[..1]).share(Vec3::z()), 0.0);
        assert_eq!(Aperture::of(&[rim[0], rim[2]]).share(Vec3::z()), 0.0);
    }
}
