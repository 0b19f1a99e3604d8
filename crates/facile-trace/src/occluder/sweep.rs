//! Tubes: a cross-section carried along a path.

use facile_core::{Mesh, Point3, Segment, Vector3};

/// Adds the corners of a section across `tangent`: an ellipse, half as wide as the first of `half` perpendicular to `up` and
/// half as high as the second in the direction of `up`, mm.
pub(super) fn add_ring(
    mesh: &mut Mesh,
    at: Point3,
    tangent: Vector3,
    up: Vector3,
    half: [f64; 2],
    sides: usize,
) {
    let side = tangent
        .cross(&up)
        .try_normalize(1e-12)
        .unwrap_or_else(Vector3::x);
    let along = side
        .cross(&tangent)
        .try_normalize(1e-12)
        .unwrap_or_else(Vector3::y);
    for k in 0..sides {
        let (s, c) = libm::sincos(std::f64::consts::TAU * k as f64 / sides as f64);
        let offset = side * (c * half[0]) + along * (s * half[1]);
        mesh.positions.push(at + offset);
    }
}

/// Adds the band between two rings, given by their first corners.
pub(super) fn join_rings(mesh: &mut Mesh, rings: [u32; 2], sides: usize) {
    let vertex = |ring: u32, k: usize| ring + (k % sides) as u32;
    for k in 0..sides {
        let [a, b] = [vertex(rings[0], k), vertex(rings[0], k + 1)];
        let [c, d] = [vertex(rings[1], k + 1), vertex(rings[1], k)];
        mesh.triangles.extend([[a, c, b], [a, d, c]]);
    }
}

/// Adds a tube of elliptic section around `path` to `mesh`: half as wide as `across` perpendicular to `up`, half as
/// high as `along` in the direction of `up` (both mm). A closed path joins its ends; an open one is capped. The path has at least
/// two points (three if closed), no two neighbours equal, and never runs along `up(i)`.
pub(crate) fn add_tube(
    mesh: &mut Mesh,
    path: &[Point3],
    is_closed: bool,
    up: impl Fn(usize) -> Vector3,
    [across, along]: [f64; 2],
    segment: Segment,
) {
    const SIDES: usize = 10;
    let n = path.len();
    let base = mesh.positions.len() as u32;
    for (i, center) in path.iter().enumerate() {
        let (before, after) = if is_closed {
            ((i + n - 1) % n, (i + 1) % n)
        } else {
            (i.saturating_sub(1), (i + 1).min(n - 1))
        };
        let tangent = path[after] - path[before];
        let half = [across / 2.0, along / 2.0];
        add_ring(mesh, *center, tangent, up(i), half, SIDES);
    }
    let vertex = |i: usize, k: usize| base + ((i % n) * SIDES + k % SIDES) as u32;
    let spans = if is_closed { n } else { n - 1 };
    for i in 0..spans {
        join_rings(mesh, [vertex(i, 0), vertex(i + 1, 0)], SIDES);
    }
    if !is_closed {
        for (i, is_start) in [(0, true), (n - 1, false)] {
            let middle = mesh.positions.len() as u32;
            mesh.positions.push(path[i]);
            for k in 0..SIDES {
                let (a, b) = (vertex(i, k), vertex(i, k + 1));
                mesh.triangles.push(if is_start {
                    [middle, a, b]
                } else {
                    [middle, b, a]
                });
            }
        }
    }
    mesh.segments.resize(mesh.triangles.len(), segment);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the enclosed volume: positive if triangles face outwards.
    fn signed_volume(mesh: &Mesh) -> f64 {
        (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t).map(|p| p.coords);
                a.dot(&b.cross(&c))
            })
            .sum()
    }

    #[test]
    fn an_open_tube_is_a_closed_surface_that_faces_outwards() {
        let mut mesh = Mesh::default();
        let path = [
            Point3::new(0.0, 0.0, 0.0),
            Point3::new(5.0, 0.0, 1.0),
            Point3::new(9.0, 1.0, 2.0),
        ];
        add_tube(
            &mut mesh,
            &path,
            false,
            |_| Vector3::y(),
            [2.0, 3.0],
            Segment::Other,
        );
        // An ellipse has area pi/4 * 2 * 3 = 4.7, its decagon 4.4; the path is 9.3 long
        let volume = signed_volume(&mesh) / 6.0;
        assert!((volume - 4.4 * 9.25).abs() < 2.0, "{volume}");
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

    #[test]
    fn a_closed_tube_is_a_ring() {
        let mut mesh = Mesh::default();
        let path: Vec<Point3> = (0..48)
            .map(|i| {
                let angle = std::f64::consts::TAU * f64::from(i) / 48.0;
                Point3::new(20.0 * angle.cos(), 20.0 * angle.sin(), 0.0)
            })
            .collect();
        add_tube(
            &mut mesh,
            &path,
            true,
            |_| Vector3::z(),
            [2.0, 2.0],
            Segment::Other,
        );
        let volume = signed_volume(&mesh) / 6.0;
        let exact = 2.94 * std::f64::consts::TAU * 20.0;
        assert!((volume - exact).abs() < 0.03 * exact, "{volume} {exact}");
    }
}
