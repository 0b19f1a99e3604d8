//! Cavities with one opening, such as a mouth: how much of the light without shadows comes in.

use facile_core::Point3;

use crate::math::{Vec3, vec3_from_point};

/// The opening of a cavity, taken for a disc.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Aperture {
    /// Its middle, world, mm.
    pub center: Vec3,
    /// Its radius, mm.
    pub radius: f32,
}

impl Aperture {
    /// The disc that has the middle of a rim of points in order, and its area: half the length of the sum of its sides'
    /// cross products (Newell).
    pub fn of(rim: &[Point3]) -> Self {
        let count = rim.len().max(1) as f64;
        let sum = rim
            .iter()
            .fold(Point3::origin().coords, |s, p| s + p.coords);
        let middle = Point3::from(sum / count);
        let next = rim.iter().cycle().skip(1);
        let doubled = rim
            .iter()
            .zip(next)
            .map(|(a, b)| (a - middle).cross(&(b - middle)));
        let area = 0.5 * doubled.fold(Point3::origin().coords, |s, c| s + c).norm();
        Self {
            center: vec3_from_point(&middle),
            radius: (area / std::f64::consts::PI).sqrt() as f32,
        }
    }

    /// Share of even light that a point inside gets, in `[0, 1]`: `r^2 / (r^2 + d^2)`, the form factor of a disc of radius `r`
    /// for a point at a distance `d` on its axis that faces it. Points off the axis and surfaces at a slant get less in
    /// truth, walls that light each other more.
    pub fn share(&self, point: Vec3) -> f32 {
        let opening = self.radius * self.radius;
        let distance = (point - self.center).norm_squared();
        if distance > 0.0 {
            opening / (opening + distance)
        } else {
            1.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_opens_as_the_disc_of_its_area_does() {
        let square =
            [[0.0, 0.0], [0.0, 4.0], [4.0, 4.0], [4.0, 0.0]].map(|[x, y]| Point3::new(x, y, 7.0));
        let aperture = Aperture::of(&square);
        assert_eq!(aperture.center, Vec3::new(2.0, 2.0, 7.0));
        assert!((aperture.radius.powi(2) * std::f32::consts::PI - 16.0).abs() < 1e-5);
        let at = |depth: f32| aperture.share(Vec3::new(2.0, 2.0, 7.0 - depth));
        assert_eq!(at(0.0), 1.0);
        assert!((at(aperture.radius) - 0.5).abs() < 1e-6);
        assert!(at(50.0) < 0.003 && at(50.0) > 0.0);
        // Closed
        assert_eq!(Aperture::of(&[]).share(Vec3::z()), 0.0);
        assert_eq!(Aperture::of(&square[..1]).share(Vec3::z()), 0.0);
    }
}
