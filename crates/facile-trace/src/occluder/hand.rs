//! What is held in front of a face: a hand, a bar. Pushed out until nothing of it touches the face.

use std::sync::OnceLock;

use facile_core::{Mesh, Point3, Vector3};

use super::Prop;
use super::fit::FaceFit;
use super::flesh::{Bone, surface};
use super::limb::{ROUND, Station, add_limb};

/// Distance from the face, mm.
const CLEARANCE: f64 = 2.0;
/// Size of the triangles of a hand, mm. Bodies with larger ones are probed in their middles too.
const STEP_MM: f64 = 2.4;

/// Length and half width of the fingers from the little finger to the index, mm, and where they begin across the palm.
const FINGERS: [([f64; 2], [f64; 2]); 4] = [
    ([58.0, 6.9], [-29.0, 26.0]),
    ([74.0, 7.7], [-11.0, 34.0]),
    ([80.0, 8.1], [8.0, 36.0]),
    ([71.0, 8.0], [27.0, 32.0]),
];
/// Shares of a finger's length where it begins, at its joints and at its tip, how wide it is there, and how far it bends
/// towards the face, mm.
const JOINTS: [[f64; 3]; 4] = [
    [-0.16, 1.1, 0.0],
    [0.4, 1.0, -0.5],
    [0.72, 0.9, -5.0],
    [0.94, 0.72, -12.0],
];
/// The thumb's joints, mm, and its half widths.
const THUMB: [([f64; 3], f64); 4] = [
    ([16.0, -58.0, 4.0], 15.0),
    ([44.0, -22.0, 1.0], 12.0),
    ([61.0, 10.0, -4.0], 10.0),
    ([69.0, 33.0, -10.0], 7.6),
];
/// Factors on the colour of skin over joints and finger tips, and of nails.
const FLUSHED: [f32; 3] = [1.0, 0.78, 0.74];
const NAIL: [f32; 3] = [1.08, 0.92, 0.94];

/// A right hand over the face, its palm towards it, fingers up; `color` is that of its skin, linear.
pub(super) fn hand(style: &Prop, fit: &FaceFit<'_>, color: [f32; 3]) -> Mesh {
    static HAND: OnceLock<(Mesh, Vec<[f32; 3]>)> = OnceLock::new();
    let (mesh, tints) = HAND.get_or_init(usual_hand);
    let mut mesh = mesh.clone();
    let tinted = |tint: &[f32; 3]| std::array::from_fn(|k| (color[k] * tint[k]).min(1.0));
    mesh.colors = tints.iter().map(tinted).collect();
    place(&mut mesh, style, fit);
    mesh
}

/// A hand about its own middle, and factors on its colour at each vertex.
fn usual_hand() -> (Mesh, Vec<[f32; 3]>) {
    let point = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
    let bone = |ends: [Point3; 2], radii: [f64; 2], flatness: f64| Bone {
        ends,
        radii,
        flatness,
    };
    // Palm: a fan of bones from the wrist to the knuckles, and the ball of the thumb
    let wrist = point(0.0, -92.0, 8.0);
    let mut palm = vec![
        bone([point(0.0, -170.0, 34.0), wrist], [26.0, 23.0], 0.74),
        bone([wrist, point(14.0, -40.0, -3.0)], [22.0, 19.0], 0.8),
    ];
    let mut parts = Vec::new();
    let (mut nails, mut flushed) = (Vec::new(), Vec::new());
    for ([length, width], [x, y]) in FINGERS {
        // Fingers spread
        let spread = x / 210.0;
        let joints = JOINTS.map(|[share, wide, bend]| {
            let along = length * share;
            (point(x + spread * along, y + along, bend), width * wide)
        });
        palm.push(bone(
            [point(0.35 * x, -78.0, 5.0), joints[0].0],
            [12.0, 11.0],
            1.0,
        ));
        let chain = joints
            .windows(2)
            .map(|pair| bone([pair[0].0, pair[1].0], [pair[0].1, pair[1].1], 0.95));
        let swollen = joints[1..3]
            .iter()
            .map(|(at, half)| bone([*at; 2], [half * 1.07; 2], 0.98));
        parts.push(chain.chain(swollen).collect());
        flushed.extend(joints.map(|(at, half)| (at, 1.3 * half)));
        nails.push((joints[2].0, joints[3]));
    }
    let joints = THUMB.map(|([x, y, z], half)| (point(x, y, z), half));
    parts.push(
        joints
            .windows(2)
            .map(|pair| bone([pair[0].0, pair[1].0], [pair[0].1, pair[1].1], 0.95))
            .collect(),
    );
    flushed.extend(joints[2..].iter().map(|(at, half)| (*at, 1.3 * half)));
    nails.push((joints[2].0, joints[3]));
    parts.insert(0, palm);
    let mut mesh = surface(&parts, STEP_MM);
    let skin = mesh.positions.len();
    for (joint, (tip, half)) in nails {
        add_nail(&mut mesh, joint, tip, half);
    }
    let tint = |(i, p): (usize, &Point3)| {
        if i >= skin {
            return NAIL;
        }
        let near = flushed
            .iter()
            .map(|(at, reach)| libm::exp(-(p - at).norm_squared() / (reach * reach)));
        let share = near.fold(0.0, f64::max) as f32;
        FLUSHED.map(|v| 1.0 + (v - 1.0) * share)
    };
    let tints = mesh.positions.iter().enumerate().map(tint).collect();
    (mesh, tints)
}

/// A nail on the back of a finger's tip.
fn add_nail(mesh: &mut Mesh, joint: Point3, tip: Point3, half: f64) {
    let way = (tip - joint).try_normalize(1e-9).unwrap_or_else(Vector3::y);
    let back = (Vector3::z() - way * way.z)
        .try_normalize(1e-9)
        .unwrap_or_else(Vector3::z);
    let station = |along: f64, wide: f64| Station {
        at: tip + way * (along * half) + back * (0.74 * half),
        half: [wide * half, 0.24 * half],
    };
    let stations = [station(-0.75, 0.55), station(-0.1, 0.64), station(0.5, 0.5)];
    add_limb(mesh, &stations, back, ROUND);
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
    let middles = (0..mesh.triangles.len()).filter_map(|t| {
        let [a, b, c] = mesh.corners(t);
        let is_large = (b - a).norm().max((c - a).norm()) > 2.0 * STEP_MM;
        is_large.then(|| Point3::from((a.coords + b.coords + c.coords) / 3.0))
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
