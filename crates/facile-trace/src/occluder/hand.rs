//! What is held in front of a face: a hand, a bar. Pushed out until nothing of it touches the face.

use facile_core::{Mesh, Point3, Vector3};

use super::Prop;
use super::fit::FaceFit;
use super::limb::{ROUND, Station, add_limb};

/// Distance from the face, mm.
const CLEARANCE: f64 = 2.0;

/// Length and half width of the fingers from the little finger to the index, mm, and where they begin across the palm.
const FINGERS: [([f64; 2], f64); 4] = [
    ([56.0, 7.0], -31.0),
    ([72.0, 8.0], -11.0),
    ([78.0, 8.3], 10.0),
    ([70.0, 8.0], 30.0),
];

/// A right hand over the face, its palm towards it, fingers up.
pub(super) fn hand(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    let mut mesh = Mesh::default();
    let station = |x: f64, y: f64, z: f64, half: [f64; 2]| Station {
        at: Point3::new(x, y, z),
        half,
    };
    let front = Vector3::z();
    // Palm and wrist
    let palm = [
        station(0.0, -150.0, 30.0, [27.0, 21.0]),
        station(0.0, -90.0, 12.0, [27.0, 19.0]),
        station(0.0, -48.0, 3.0, [31.0, 16.0]),
        station(0.0, -15.0, 0.0, [40.0, 15.0]),
        station(0.0, 22.0, 0.0, [42.0, 13.0]),
        station(0.0, 38.0, -1.0, [38.0, 10.0]),
    ];
    add_limb(&mut mesh, &palm, front, ROUND);
    for ([length, width], x) in FINGERS {
        // Fingers spread, and bend towards the face
        let spread = x / 160.0;
        let at = |share: f64, z: f64, half: f64| {
            station(
                x + spread * length * share,
                34.0 + length * share,
                z,
                [half, half * 0.95],
            )
        };
        let stations = [
            at(0.0, 0.0, width),
            at(0.3, 1.0, width * 1.02),
            at(0.62, -3.0, width * 0.94),
            at(0.9, -10.0, width * 0.8),
        ];
        add_limb(&mut mesh, &stations, front, ROUND);
    }
    let thumb = [
        station(30.0, -30.0, 2.0, [12.0, 12.0]),
        station(52.0, -4.0, -2.0, [11.0, 11.0]),
        station(62.0, 20.0, -6.0, [9.5, 9.5]),
        station(66.0, 38.0, -11.0, [7.5, 7.5]),
    ];
    add_limb(&mut mesh, &thumb, front, ROUND);
    place(&mut mesh, style, fit);
    mesh
}

/// A pole across the image.
pub(super) fn bar(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    let mut mesh = Mesh::default();
    let station = |x: f64| Station {
        at: Point3::new(x, 0.0, 0.0),
        half: [11.0, 11.0],
    };
    let stations: Vec<Station> = (-6..=6).map(|k| station(60.0 * f64::from(k))).collect();
    add_limb(&mut mesh, &stations, Vector3::z(), ROUND);
    place(&mut mesh, style, fit);
    mesh
}

/// Sizes, turns and moves what is given about its own middle to the middle of the face, then away until it is clear.
fn place(mesh: &mut Mesh, style: &Prop, fit: &FaceFit<'_>) {
    let scale = fit.half_eye_distance() / 29.0;
    let thickness = scale * style.size;
    let middle = Point3::from((fit.landmark(33).coords + fit.landmark(51).coords) / 2.0);
    let (sin, cos) = libm::sincos(style.turn_deg.to_radians());
    for p in &mut mesh.positions {
        let (x, y) = (p.x * thickness, p.y * thickness);
        *p = Point3::new(
            middle.x + style.x_mm + x * cos - y * sin,
            middle.y + style.y_mm + x * sin + y * cos,
            middle.z + p.z * thickness,
        );
    }
    clear(mesh, fit);
}

/// Moves a body away from the face, along `z`, until its back is clear of it.
pub(super) fn clear(mesh: &mut Mesh, fit: &FaceFit<'_>) {
    let corners = mesh.positions.iter().copied();
    let middles = (0..mesh.triangles.len()).map(|t| {
        let [a, b, c] = mesh.corners(t);
        Point3::from((a.coords + b.coords + c.coords) / 3.0)
    });
    let lack = corners
        .chain(middles)
        .filter_map(|p| Some(fit.front(p.x, p.y)? + CLEARANCE - p.z))
        .fold(f64::NEG_INFINITY, f64::max);
    if lack.is_finite() {
        for p in &mut mesh.positions {
            p.z += lack;
        }
    }
}
