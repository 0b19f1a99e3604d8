//! The front of an eye seen close: a clear dome that bends light, before an iris that lies flat behind it.
//!
//! Measures: dome of 11.7 mm across and 2.6 mm high, index 1.336 (Gullstrand's schematic eye, the aqueous behind it
//! included), on an eyeball of 15.9 mm radius; they scale with the eyeball.

use facile_core::{Mesh, Point3, Segment};

use crate::material::{Albedo, Material, Transmission};
use crate::math::Rgb;

/// Sine of the angle from the axis to the cornea's rim.
const RIM: f64 = 0.39;
/// Height of the dome over its rim, and depth of the iris behind the rim's plane, over the eyeball's radius.
const HEIGHT: f64 = 2.6 / 15.9;
const DEPTH: f64 = 0.35 / 15.9;
const RINGS: u32 = 12;
const SECTORS: u32 = 40;

/// The dome of an eyeball of a radius, mm, about its centre, looking along `+z`.
pub(crate) fn dome(radius: f64, iris: Segment) -> Mesh {
    let rim_z = radius * libm::sqrt(1.0 - RIM * RIM);
    let mut mesh = Mesh::default();
    mesh.positions
        .push(Point3::new(0.0, 0.0, rim_z + HEIGHT * radius));
    for ring in 1..=RINGS {
        let share = f64::from(ring) / f64::from(RINGS);
        let z = rim_z + HEIGHT * radius * (1.0 - share * share);
        for k in 0..SECTORS {
            let (s, c) = libm::sincos(std::f64::consts::TAU * f64::from(k) / f64::from(SECTORS));
            let across = RIM * radius * share;
            mesh.positions.push(Point3::new(across * c, across * s, z));
        }
    }
    let vertex = |ring: u32, k: u32| 1 + (ring - 1) * SECTORS + k % SECTORS;
    for k in 0..SECTORS {
        mesh.triangles.push([0, vertex(1, k), vertex(1, k + 1)]);
        for ring in 1..RINGS {
            let [a, b] = [vertex(ring, k), vertex(ring, k + 1)];
            let [c, d] = [vertex(ring + 1, k + 1), vertex(ring + 1, k)];
            mesh.triangles.extend([[a, d, c], [a, c, b]]);
        }
    }
    mesh.segments = vec![iris; mesh.triangles.len()];
    mesh
}

/// The vertices of an eyeball whose iris lies behind the dome's rim.
pub(crate) fn with_flat_iris(eyeball: &[Point3], radius: f64) -> Vec<Point3> {
    let rim_z = radius * libm::sqrt(1.0 - RIM * RIM);
    let flat = |p: &Point3| {
        let inside = libm::hypot(p.x, p.y) < RIM * radius && p.z > 0.0;
        let z = if inside {
            p.z.min(rim_z - DEPTH * radius)
        } else {
            p.z
        };
        Point3::new(p.x, p.y, z)
    };
    eyeball.iter().map(flat).collect()
}

/// Clear and wet.
pub(crate) fn material() -> Material {
    Material {
        albedo: Albedo::Constant(Rgb::zeros()),
        specular: 0.021,
        shininess: 900.0,
        reflectivity: 0.021,
        transmission: Some(Transmission::Solid {
            ior: 1.336,
            tint: Rgb::repeat(0.98),
        }),
        ..Material::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dome_covers_the_flat_iris() {
        let radius = 15.0;
        let dome = dome(radius, Segment::LeftIris);
        let eyeball: Vec<Point3> = (0..400)
            .map(|i| {
                let (polar, turn) = (f64::from(i % 20) * 0.05, f64::from(i / 20) * 0.3);
                let (s, c) = libm::sincos(polar);
                Point3::new(s * libm::cos(turn), s * libm::sin(turn), c) * radius
            })
            .collect();
        let flat = with_flat_iris(&eyeball, radius);
        let rim_z = radius * libm::sqrt(1.0 - RIM * RIM);
        for (p, from) in flat.iter().zip(&eyeball) {
            let is_iris = libm::hypot(p.x, p.y) < RIM * radius;
            assert!(if is_iris { p.z < rim_z } else { p == from });
        }
        let top = dome.positions[0].z;
        assert!((top - rim_z - 2.6 * radius / 15.9).abs() < 1e-9);
    }
}
