//! Round bodies along a path: fingers, arms, poles, cups.

use facile_core::{Mesh, Point3, Segment, Vector3};

use super::sweep::{add_ring, join_rings};

/// Corners of a cross-section.
const SIDES: usize = 16;
/// Rings of a round end.
const CAP_RINGS: usize = 4;

/// Depth of ends that are half an ellipsoid.
pub(super) const ROUND: f64 = f64::INFINITY;

/// A place on the path: where, half the width across and half the height along `up`, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Station {
    pub(super) at: Point3,
    pub(super) half: [f64; 2],
}

/// Adds a body through stations, at least two and no two neighbours equal, with ends at most `depth` mm
/// deep, [`ROUND`] for half ellipsoids. It never runs along `up`.
pub(super) fn add_limb(mesh: &mut Mesh, stations: &[Station], up: Vector3, depth: f64) {
    let base = mesh.positions.len() as u32;
    let mut rings = 0;
    let n = stations.len();
    let mut ring = |mesh: &mut Mesh, at: Point3, half: [f64; 2], tangent: Vector3| {
        add_ring(mesh, at, tangent, up, half, SIDES);
        rings += 1;
    };
    let tangent = |i: usize| {
        let way = stations[(i + 1).min(n - 1)].at - stations[i.saturating_sub(1)].at;
        way.try_normalize(1e-12).unwrap_or_else(Vector3::z)
    };
    // An end is half an ellipsoid
    let cap = |station: &Station, tangent: Vector3, step: usize, sign: f64| {
        let angle = std::f64::consts::FRAC_PI_2 * (step as f64 + 0.2) / (CAP_RINGS as f64 + 0.2);
        let (s, c) = libm::sincos(angle);
        let depth = depth.min(station.half[0]).min(station.half[1]);
        (
            station.at + tangent * (sign * depth * c),
            station.half.map(|h| h * s),
        )
    };
    for step in 0..CAP_RINGS {
        let (at, half) = cap(&stations[0], tangent(0), step, -1.0);
        ring(mesh, at, half, tangent(0));
    }
    for (i, station) in stations.iter().enumerate() {
        ring(mesh, station.at, station.half, tangent(i));
    }
    for step in (0..CAP_RINGS).rev() {
        let (at, half) = cap(&stations[n - 1], tangent(n - 1), step, 1.0);
        ring(mesh, at, half, tangent(n - 1));
    }
    let vertex = |i: u32, k: usize| base + i * SIDES as u32 + (k % SIDES) as u32;
    for i in 0..rings - 1 {
        join_rings(mesh, [vertex(i, 0), vertex(i + 1, 0)], SIDES);
    }
    for k in 1..SIDES - 1 {
        mesh.triangles
            .push([vertex(0, 0), vertex(0, k), vertex(0, k + 1)]);
        let last = rings - 1;
        mesh.triangles
            .push([vertex(last, 0), vertex(last, k + 1), vertex(last, k)]);
    }
    mesh.segments.resize(mesh.triangles.len(), Segment::Other);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limb_is_closed_and_faces_outwards() {
        let station = |x: f64, r: f64| Station {
            at: Point3::new(x, 0.0, 0.0),
            half: [r, r],
        };
        let mut mesh = Mesh::default();
        add_limb(
            &mut mesh,
            &[station(0.0, 5.0), station(20.0, 5.0)],
            Vector3::y(),
            ROUND,
        );
        let volume: f64 = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t).map(|p| p.coords);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum();
        let exact = std::f64::consts::PI * (25.0 * 20.0 + 4.0 / 3.0 * 125.0);
        assert!((volume / exact - 1.0).abs() < 0.1, "{volume} {exact}");
        let mut edges = std::collections::BTreeMap::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                *edges.entry((t[k], t[(k + 1) % 3])).or_insert(0) += 1;
            }
        }
        assert!(
            edges
                .iter()
                .all(|(&(a, b), n)| *n == 1 && edges.contains_key(&(b, a)))
        );
    }
}
