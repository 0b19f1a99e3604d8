//! Headphones: two cups over the ears and a bow over the head.

use facile_core::{Mesh, Point3, Vector3};

use super::Prop;
use super::fit::FaceFit;
use super::limb::{ROUND, Station, add_limb};

/// Steps of the bow from one cup to the other.
const STEPS: usize = 48;
const CLEARANCE: f64 = 6.0;
/// Half the width of the bow at the top, mm.
const HALF_WIDTH: f64 = 9.0;

pub(super) fn headphones(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    let scale = fit.half_eye_distance() / 29.0;
    let mut mesh = Mesh::default();
    let mut cups = Vec::new();
    for (side, ear) in [(1.0, 0), (-1.0, 1)] {
        let [low, high] = fit.ears[ear];
        let middle = Point3::from(low.coords.lerp(&high.coords, 0.5));
        // The cushion rests on the outermost of the ear
        let inner = (low.x * side).max(high.x * side) - 3.0;
        let radius = (0.5 * (high.y - low.y) + 5.0) * style.size;
        let station = |x: f64, r: f64| Station {
            at: Point3::new(side * x, middle.y + style.y_mm, middle.z),
            half: [r * 0.86, r],
        };
        let cup = [
            station(inner, radius * 0.9),
            station(inner + 7.0, radius),
            station(inner + 11.0, radius * 0.93),
            station(inner + 15.0, radius),
            station(inner + 25.0, radius * 0.92),
            station(inner + 31.0, radius * 0.6),
        ];
        add_limb(&mut mesh, &cup, Vector3::y(), 3.0);
        cups.push(Point3::new(
            side * (inner + 18.0),
            middle.y + style.y_mm + radius * 0.8,
            middle.z,
        ));
    }
    add_limb(&mut mesh, &bow(&cups, fit, scale), Vector3::z(), ROUND);
    mesh
}

/// From cup to cup over the skull: the smallest round arch that clears it.
fn bow(cups: &[Point3], fit: &FaceFit<'_>, scale: f64) -> Vec<Station> {
    let (left, right) = (cups[0], cups[1]);
    let (center, half) = (
        Point3::new(
            left.x.midpoint(right.x),
            left.y.midpoint(right.y),
            left.z.midpoint(right.z),
        ),
        (left.x - right.x) / 2.0,
    );
    let out = |angle: f64| {
        let (s, c) = libm::sincos(angle);
        Vector3::new(c, s, -0.06 * s)
    };
    let angles = (0..=STEPS).map(|i| std::f64::consts::PI * i as f64 / STEPS as f64);
    // An ellipse through the cups, as high as the skull asks for
    let height = angles
        .clone()
        .filter_map(|angle| {
            let (s, c) = libm::sincos(angle);
            let direction = out(angle).try_normalize(1e-9)?;
            // The bow is as wide as two fingers
            let reaches = [-1.0, 0.0, 1.0].map(|edge| {
                let from = center + Vector3::z() * (edge * HALF_WIDTH * scale);
                fit.reach(from, direction)
            });
            let reach = reaches.into_iter().flatten().fold(0.0, f64::max) + CLEARANCE;
            let (x, y) = (reach * c / half, reach * s);
            (s > 0.3 && x.abs() < 0.97).then(|| y / libm::sqrt(1.0 - x * x))
        })
        .fold(half, f64::max);
    angles
        .map(|angle| {
            let (s, c) = libm::sincos(angle);
            Station {
                at: center + Vector3::new(c * half, s * height, -0.06 * s * height),
                half: [2.6 * scale, HALF_WIDTH * scale * (0.45 + 0.55 * s)],
            }
        })
        .collect()
}
