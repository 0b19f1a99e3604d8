//! Which fascia a muscle moves, and how: once per reference head ([`Reach`]), then per subject ([`Bound`]).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::path::{Local, Path};
use super::{Muscle, MuscleSet, Side, Symmetry};
use crate::SimError;
use crate::layers::Layers;
use crate::template::Template;
use crate::vector::{V3, add_scaled, cross, dot, norm, scale, sub};

/// Distance of the points that carry a muscle's line from the reference head to a subject, mm.
const KNOT_MM: f64 = 6.0;
/// Fascia farther than this share of the width along the surface is on the other side of a slit.
const DETOUR: f64 = 1.6;

/// One muscle of one side on the simulation mesh.
#[derive(Clone, Debug)]
pub(crate) struct Actuator {
    /// Place in the [`MuscleSet`].
    pub(crate) muscle: usize,
    /// Side, `None` for a muscle that crosses the mid-plane.
    pub(crate) side: Option<Side>,
    /// Points of the centre line: corners of an element and barycentric weights.
    knots: Vec<([u32; 3], V3)>,
    /// Normalised arc length where the first control segment ends.
    first_segment: f64,
    /// Nodes whose fascia the muscle moves.
    nodes: Vec<u32>,
    /// Edges of the mesh with both ends in `nodes`: edge, place of its ends in `nodes`.
    edges: Vec<[u32; 3]>,
}

/// An actuator on a subject.
#[derive(Clone, Debug)]
pub(crate) struct Bound {
    path: Path,
    locals: Vec<Local>,
    /// Edges as in [`Actuator`].
    pub(crate) edges: Vec<[u32; 3]>,
    /// Nodes on the first segment of a linear muscle, where it holds on to the skull.
    pub(crate) anchors: Vec<u32>,
    origin: f64,
    shortening: f64,
}

impl Bound {
    /// Where the muscle's nodes would be at contraction `c` if nothing held them, eq. 7-10, in the order of the
    /// actuator's nodes. At `c = 0` their places at rest, to rounding.
    pub(crate) fn contracted(&self, c: f64) -> Vec<V3> {
        let keep = 1.0 - self.shortening * c;
        self.locals
            .iter()
            .map(|local| {
                let d = self.origin + keep * (local.fraction - self.origin);
                self.path.place(d, local.offset)
            })
            .collect()
    }

    /// Length of the centre line at rest, mm.
    pub(crate) fn length(&self) -> f64 {
        self.path.length()
    }
}

impl Actuator {
    /// The actuator on a subject's fascia.
    pub(crate) fn on(&self, muscle: &Muscle, fascia: &[V3]) -> Result<Bound, SimError> {
        let path = self.path(muscle, fascia)?;
        let locals: Vec<Local> = self
            .nodes
            .iter()
            .map(|&i| path.project(fascia[i as usize]))
            .collect();
        let anchors = match muscle.kind {
            super::MuscleKind::Sphincter => Vec::new(),
            super::MuscleKind::Linear => self
                .nodes
                .iter()
                .zip(&locals)
                .filter(|(_, l)| l.fraction <= self.first_segment)
                .map(|(&i, _)| i)
                .collect(),
        };
        Ok(Bound {
            path,
            locals,
            edges: self.edges.clone(),
            anchors,
            origin: muscle.kind.origin(),
            shortening: muscle.shortening,
        })
    }

    fn path(&self, muscle: &Muscle, fascia: &[V3]) -> Result<Path, SimError> {
        let knots: Vec<V3> = self
            .knots
            .iter()
            .map(|(corners, w)| {
                (0..3).fold([0.0; 3], |sum, k| {
                    add_scaled(sum, fascia[corners[k] as usize], w[k])
                })
            })
            .collect();
        Path::through(&knots).ok_or_else(|| SimError::Muscle {
            name: muscle.name.clone(),
            reason: "its centre line has no length".to_owned(),
        })
    }

    /// The same on the other side.
    fn mirrored(&self, mirror: &[u32], edge_index: impl Fn([u32; 2]) -> Option<u32>) -> Self {
        let nodes: Vec<u32> = self.nodes.iter().map(|&i| mirror[i as usize]).collect();
        let edges = self
            .edges
            .iter()
            .filter_map(|&[_, a, b]| {
                let (p, q) = (nodes[a as usize], nodes[b as usize]);
                edge_index([p.min(q), p.max(q)]).map(|e| [e, a, b])
            })
            .collect();
        Self {
            side: Some(Side::Right),
            knots: self
                .knots
                .iter()
                .map(|(c, w)| (c.map(|i| mirror[i as usize]), *w))
                .collect(),
            nodes,
            edges,
            ..self.clone()
        }
    }
}

/// Finds what muscles reach on the reference head.
pub(crate) struct Reach<'a> {
    template: &'a Template,
    layers: &'a Layers,
    mirror: &'a [u32],
    neighbours: Vec<Vec<(u32, f64)>>,
}

impl<'a> Reach<'a> {
    pub(crate) fn new(template: &'a Template, layers: &'a Layers, mirror: &'a [u32]) -> Self {
        let mut neighbours = vec![Vec::new(); layers.fascia.len()];
        for &[a, b] in &template.edges {
            let length = norm(sub(layers.skin[a as usize], layers.skin[b as usize]));
            neighbours[a as usize].push((b, length));
            neighbours[b as usize].push((a, length));
        }
        Self {
            template,
            layers,
            mirror,
            neighbours,
        }
    }

    /// Binds every muscle, the left one and its mirror image for pairs.
    pub(crate) fn bind_all(&self, set: &MuscleSet) -> Result<Vec<Actuator>, SimError> {
        let mut out = Vec::new();
        for (index, muscle) in set.muscles().iter().enumerate() {
            let actuator = self.bind(index, muscle)?;
            match muscle.side {
                Symmetry::Midline => out.push(actuator),
                Symmetry::Both => {
                    let edges = &self.template.edges;
                    let right = actuator.mirrored(self.mirror, |e| {
                        edges.binary_search(&e).ok().map(|i| i as u32)
                    });
                    out.extend([actuator, right]);
                }
            }
        }
        Ok(out)
    }

    fn bind(&self, index: usize, muscle: &Muscle) -> Result<Actuator, SimError> {
        let bad = |reason: String| SimError::Muscle {
            name: muscle.name.clone(),
            reason,
        };
        let (places, first_knot) = control_line(muscle);
        let mut knots = Vec::new();
        for [h, phi] in places {
            let hit = self.surface_at(h, phi).ok_or_else(|| {
                let phi = phi.to_degrees();
                bad(format!(
                    "its line leaves the simulated skin at h = {h:.1} mm, phi = {phi:.1} degrees"
                ))
            })?;
            knots.push(hit);
        }
        let mut actuator = Actuator {
            muscle: index,
            side: (muscle.side == Symmetry::Both).then_some(Side::Left),
            knots,
            first_segment: 0.0,
            nodes: Vec::new(),
            edges: Vec::new(),
        };
        let path = actuator.path(muscle, &self.layers.fascia)?;
        let joint = actuator.knots[first_knot];
        let joint = (0..3).fold([0.0; 3], |sum, k| {
            add_scaled(sum, self.layers.fascia[joint.0[k] as usize], joint.1[k])
        });
        actuator.first_segment = path.project(joint).fraction;
        actuator.nodes = self.nodes_near(&actuator.knots, &path, muscle.width_mm);
        actuator.edges = self.edges_within(&actuator.nodes);
        if actuator.edges.is_empty() {
            return Err(bad(
                "no spring of the fascia lies within its width".to_owned()
            ));
        }
        Ok(actuator)
    }

    /// The outermost point of the skin at `(h, phi)`.
    fn surface_at(&self, h: f64, phi: f64) -> Option<([u32; 3], V3)> {
        let (origin, direction) = ([0.0, h, 0.0], [libm::sin(phi), 0.0, libm::cos(phi)]);
        let mut best: Option<(f64, [u32; 3], V3)> = None;
        for t in &self.template.triangles {
            let corners = t.map(|i| self.layers.skin[i as usize]);
            if let Some((distance, weights)) = ray_triangle(origin, direction, corners)
                && best.is_none_or(|(d, _, _)| distance > d)
            {
                best = Some((distance, *t, weights));
            }
        }
        best.map(|(_, t, w)| (t, w))
    }

    /// Nodes within `width` of the line, that are not much farther along the surface.
    fn nodes_near(&self, knots: &[([u32; 3], V3)], path: &Path, width: f64) -> Vec<u32> {
        let n = self.layers.fascia.len();
        let mut along = vec![f64::INFINITY; n];
        let mut queue = BinaryHeap::new();
        for (corners, weights) in knots {
            let point = (0..3).fold([0.0; 3], |sum, k| {
                add_scaled(sum, self.layers.skin[corners[k] as usize], weights[k])
            });
            for &i in corners {
                let d = norm(sub(self.layers.skin[i as usize], point));
                if d < along[i as usize] {
                    along[i as usize] = d;
                    queue.push(Reverse((OrderedLength(d), i)));
                }
            }
        }
        while let Some(Reverse((OrderedLength(d), i))) = queue.pop() {
            if d > along[i as usize] || d > DETOUR * width + KNOT_MM {
                continue;
            }
            for &(j, length) in &self.neighbours[i as usize] {
                if d + length < along[j as usize] {
                    along[j as usize] = d + length;
                    queue.push(Reverse((OrderedLength(d + length), j)));
                }
            }
        }
        (0..n as u32)
            .filter(|&i| along[i as usize] <= DETOUR * width + 0.5 * KNOT_MM)
            .filter(|&i| path.project(self.layers.fascia[i as usize]).distance < width)
            .collect()
    }

    fn edges_within(&self, nodes: &[u32]) -> Vec<[u32; 3]> {
        let place = |i: u32| nodes.binary_search(&i).ok().map(|k| k as u32);
        self.template
            .edges
            .iter()
            .enumerate()
            .filter_map(|(e, &[a, b])| Some([e as u32, place(a)?, place(b)?]))
            .collect()
    }
}

/// A length that is never NaN, in a total order.
#[derive(Clone, Copy, PartialEq)]
struct OrderedLength(f64);

impl Eq for OrderedLength {}

impl PartialOrd for OrderedLength {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for OrderedLength {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Places `(h mm, phi rad)` along a smooth line through the control points, about [`KNOT_MM`] apart, and which of them
/// is the second control point.
fn control_line(muscle: &Muscle) -> (Vec<[f64; 2]>, usize) {
    // Unrolled at a typical radius of the face, so that both coordinates are lengths.
    const RADIUS_MM: f64 = 80.0;
    let flat: Vec<V3> = muscle
        .points
        .iter()
        .map(|[h, phi]| [*h, phi.to_radians() * RADIUS_MM, 0.0])
        .collect();
    let Some(line) = Path::through(&flat) else {
        return (Vec::new(), 0);
    };
    let joints: Vec<f64> = flat.iter().map(|p| line.project(*p).fraction).collect();
    let mut out = vec![[flat[0][0], flat[0][1] / RADIUS_MM]];
    let mut first = 0;
    for (k, w) in joints.windows(2).enumerate() {
        let length = (w[1] - w[0]) * line.length();
        let steps = (length / KNOT_MM).round().max(1.0) as usize;
        for s in 1..=steps {
            let f = w[0] + (w[1] - w[0]) * s as f64 / steps as f64;
            let p = line.place(f, [0.0; 3]);
            out.push([p[0], p[1] / RADIUS_MM]);
        }
        if k == 0 {
            first = out.len() - 1;
        }
    }
    (out, first)
}

/// Distance and barycentric weights where a ray meets a triangle.
fn ray_triangle(origin: V3, direction: V3, [a, b, c]: [V3; 3]) -> Option<(f64, V3)> {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let p = cross(direction, ac);
    let det = dot(ab, p);
    if det.abs() < 1e-12 {
        return None;
    }
    let s = scale(sub(origin, a), 1.0 / det);
    let v = dot(s, p);
    let q = cross(s, ab);
    let w = dot(direction, q);
    let distance = dot(ac, q);
    let tolerance = -1e-9;
    (v >= tolerance && w >= tolerance && v + w <= 1.0 - tolerance && distance > 0.0)
        .then_some((distance, [1.0 - v - w, v, w]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::muscle::MuscleKind;

    fn bound(kind: MuscleKind, shortening: f64) -> Bound {
        let fascia = vec![
            [0.0; 3],
            [10.0, 0.0, 0.0],
            [20.0, 3.0, 0.0],
            [5.0, -2.0, 1.0],
        ];
        let muscle = Muscle {
            name: "m".into(),
            kind,
            side: Symmetry::Midline,
            width_mm: 5.0,
            origin_hold: 1.0,
            shortening,
            lid: None,
            points: vec![[0.0, 0.0], [1.0, 0.0]],
            note: String::new(),
        };
        let one = |i: u32| ([i, i, i], [1.0, 0.0, 0.0]);
        let actuator = Actuator {
            muscle: 0,
            side: None,
            knots: vec![one(0), one(1), one(2)],
            first_segment: 0.4,
            nodes: vec![0, 1, 2, 3],
            edges: vec![[0, 0, 1]],
        };
        actuator.on(&muscle, &fascia).expect("has a length")
    }

    #[test]
    fn no_contraction_is_the_identity() {
        for kind in [MuscleKind::Linear, MuscleKind::Sphincter] {
            let rest = bound(kind, 1.0).contracted(0.0);
            assert!(norm(sub(rest[1], [10.0, 0.0, 0.0])) < 1e-12);
            assert!(norm(sub(rest[3], [5.0, -2.0, 1.0])) < 1e-12);
        }
    }

    #[test]
    fn full_contraction_ends_at_the_attachment_or_in_the_middle() {
        let linear = bound(MuscleKind::Linear, 1.0);
        let points = linear.contracted(1.0);
        assert!(norm(points[1]) < 1e-9 && norm(points[2]) < 1e-9);
        let sphincter = bound(MuscleKind::Sphincter, 1.0);
        let points = sphincter.contracted(1.0);
        let middle = sphincter.path.place(0.5, [0.0; 3]);
        assert!(norm(sub(points[0], middle)) < 1e-9 && norm(sub(points[2], middle)) < 1e-9);
    }

    #[test]
    fn half_a_shortening_leaves_half_the_length() {
        let points = bound(MuscleKind::Linear, 0.5).contracted(1.0);
        let all = bound(MuscleKind::Linear, 1.0).contracted(0.5);
        assert!(norm(sub(points[2], all[2])) < 1e-12);
        assert!(norm(points[2]) < 11.0 && norm(points[2]) > 9.0);
    }

    #[test]
    fn anchors_are_on_the_first_segment() {
        assert_eq!(bound(MuscleKind::Linear, 1.0).anchors, [0, 3]);
        assert!(bound(MuscleKind::Sphincter, 1.0).anchors.is_empty());
    }

    #[test]
    fn the_contraction_is_continuous() {
        let linear = bound(MuscleKind::Linear, 1.0);
        let mut before = linear.contracted(0.0);
        for k in 1..=1000 {
            let now = linear.contracted(f64::from(k) / 1000.0);
            for (p, q) in before.iter().zip(&now) {
                assert!(norm(sub(*p, *q)) < 0.05);
            }
            before = now;
        }
    }
}
