//! A fringe: ribbons of hair that fall over the forehead, towards the eyes.

use facile_core::rng::RandomStream;
use facile_core::{Mesh, Point3, Segment, Vector3};

use super::Prop;
use super::fit::FaceFit;

/// Ribbons, and steps of each from root to tip.
const RIBBONS: usize = 260;
const STEPS: usize = 14;

/// The ribbons and the direction of hair at each of their vertices.
pub(super) fn fringe(style: &Prop, fit: &FaceFit<'_>) -> (Mesh, Vec<Vector3>) {
    let scale = fit.half_eye_distance() / 29.0;
    let brow = fit.landmark(19).y.midpoint(fit.landmark(24).y);
    let half_width = 50.0 * scale;
    // Roots lie behind the hairline, where hair of its own covers them
    let (hairline, tip) = (brow + 74.0 * scale, brow - 6.0 * scale + style.y_mm);
    let length = (hairline - tip) * style.size;
    let mut stream = RandomStream::new(11, 0);
    let (mut mesh, mut strands) = (Mesh::default(), Vec::new());
    for ribbon in 0..RIBBONS {
        let s = 2.0 * (ribbon as f64 + stream.unit()) / RIBBONS as f64 - 1.0;
        let (drift, lift) = (stream.uniform(-9.0, 9.0), stream.uniform(0.8, 5.0));
        let (reach, width) = (stream.uniform(0.8, 1.08), stream.uniform(0.5, 1.5) * scale);
        let set_back = 12.0 * scale * stream.unit();
        // The hairline falls to the sides
        let root = hairline - 22.0 * scale * s * s - set_back;
        let base = mesh.positions.len() as u32;
        let mut last = None;
        // Below the brow hair hangs: it does not follow the skin back into the eyes
        let mut hang = f64::NEG_INFINITY;
        for step in 0..=STEPS {
            let t = step as f64 / STEPS as f64;
            let x = s * half_width * (1.0 + 0.06 * t) + drift * t * t * scale;
            let y = root - length * reach * t;
            // Clear of the skin over the ribbon's whole width
            let under = [-width, 0.0, width].map(|dx| fit.front(x + dx, y));
            let Some(z) = under.into_iter().flatten().reduce(f64::max) else {
                break;
            };
            hang = hang.max(z);
            let bow = 4.0 * libm::sin(std::f64::consts::PI * t) + lift;
            let center = Point3::new(x, y, hang + (1.0 + bow * t.min(0.25) * 4.0) * scale);
            let along = last.map_or(-Vector3::y(), |l: Point3| center - l);
            last = Some(center);
            // Thin at the root, where hair parts, and at the tip
            let half = width * (1.0 - 0.85 * t * t) * (0.35 + 0.65 * (4.0 * t).min(1.0));
            let side = Vector3::x() * half;
            mesh.positions.extend([center - side, center + side]);
            strands.extend([along; 2]);
        }
        let rings = (mesh.positions.len() as u32 - base) / 2;
        for ring in 1..rings {
            let a = base + 2 * (ring - 1);
            mesh.triangles
                .extend([[a, a + 2, a + 3], [a, a + 3, a + 1]]);
        }
    }
    mesh.segments = vec![Segment::Other; mesh.triangles.len()];
    (mesh, strands)
}
