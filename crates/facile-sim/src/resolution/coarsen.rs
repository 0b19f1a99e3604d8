//! Which vertices of a cage to take away, and in which order.
//!
//! The cheapest edge goes first: a short one, measured in what edges were like there, of a vertex whose triangles'
//! planes its neighbour lies near (the quadrics of Garland and Heckbert, Surface Simplification Using Quadric Error
//! Metrics, 1997). So flat skin loses more vertices than curved skin, and what was finer stays finer. A vertex goes
//! together with its mirror image; one on the mid-plane stays in it; one on a rim (lips, lids, the border of the
//! simulated skin) stays on it; none changes its role.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

use facile_core::reference::{Cage, Role};
use facile_core::{Point3, ReferenceHead, mesh};

use super::sheet::{Sheet, Undo, area_vector};
use crate::template::{Rims, split_quads};
use crate::vector::{V3, from_point};

/// Weight of a squared distance from the planes against a squared length of an edge. From 0 to 9 the mean distance of what
/// was taken away from what is left falls from 0.35 to 0.20 mm at 1,000 nodes; how well a face moves does not depend on it.
const PLANE_WEIGHT: f64 = 9.0;
/// Longest edge that a collapse may leave in a rim of lips or lids, mm: lids stay round.
const MAX_RIM_MM: f64 = 6.0;

/// A symmetric 4 x 4 form: the squared distances from planes, by area.
#[derive(Clone, Copy, Debug, Default)]
struct Quadric {
    /// Sums of `n n^T`, `n d`, `d^2` for planes `n x + d = 0`, and of their weights.
    nn: [f64; 6],
    nd: [f64; 3],
    dd: f64,
    area: f64,
}

impl Quadric {
    fn of_plane(corners: &[Point3; 3]) -> Self {
        let vector = area_vector(corners);
        let area = 0.5 * vector.norm();
        let n = vector / (2.0 * area).max(1e-300);
        let d = -n.dot(&corners[0].coords);
        Self {
            nn: [
                n.x * n.x,
                n.x * n.y,
                n.x * n.z,
                n.y * n.y,
                n.y * n.z,
                n.z * n.z,
            ]
            .map(|a| area * a),
            nd: [n.x, n.y, n.z].map(|a| area * a * d),
            dd: area * d * d,
            area,
        }
    }

    fn add(&mut self, other: &Self) {
        let sum = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        sum(&mut self.nn, &other.nn);
        sum(&mut self.nd, &other.nd);
        self.dd += other.dd;
        self.area += other.area;
    }

    /// Mean squared distance of `p` from the planes, mm^2.
    fn at(&self, p: &Point3) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.nn;
        let quadratic = p.x * (xx * p.x + 2.0 * (xy * p.y + xz * p.z))
            + p.y * (yy * p.y + 2.0 * yz * p.z)
            + zz * p.z * p.z;
        let [x, y, z] = self.nd;
        let linear = 2.0 * (x * p.x + y * p.y + z * p.z);
        ((quadratic + linear + self.dd) / self.area.max(1e-300)).max(0.0)
    }
}

/// A line that vertices leave only along itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Line {
    /// Margin of lids or lips, or a ring around it.
    Rim(usize),
    /// Border of the simulated skin.
    Border,
}

/// A cost in a total order, never NaN.
#[derive(Clone, Copy, PartialEq)]
struct Cost(f64);

impl Eq for Cost {}

impl PartialOrd for Cost {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cost {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Cost, vertex, where it would go, and how often both had changed by then.
type Candidate = Reverse<(Cost, u32, u32, [u32; 2])>;

/// A cage that loses vertices.
pub(super) struct Coarsening<'a> {
    cage: &'a Cage,
    pub(super) sheet: Sheet,
    quadrics: Vec<Quadric>,
    /// Mean length of the edges that a vertex had at first, mm.
    scale: Vec<f64>,
    line: Vec<Option<Line>>,
    /// Vertices that stay.
    kept: Vec<bool>,
    changes: Vec<u32>,
    queue: BinaryHeap<Candidate>,
    /// Free vertices that are left.
    pub(super) free: usize,
}

impl<'a> Coarsening<'a> {
    pub(super) fn new(head: &'a ReferenceHead) -> Self {
        let cage = &head.cage;
        let n = cage.positions.len();
        let positions = head.mesh.positions[..n].to_vec();
        let flat: Vec<V3> = positions.iter().map(from_point).collect();
        let all: Vec<u32> = (0..cage.faces.len() as u32).collect();
        let numbers: Vec<Option<u32>> = (0..n as u32).map(Some).collect();
        let faces = split_quads(cage, &all, &flat, &numbers);
        let mut normals = mesh::vertex_normals(&head.mesh.positions, &head.mesh.triangles);
        normals.truncate(n);
        let mut quadrics = vec![Quadric::default(); n];
        for face in &faces {
            let plane = Quadric::of_plane(&face.map(|v| positions[v as usize]));
            for &v in face {
                quadrics[v as usize].add(&plane);
            }
        }
        let sheet = Sheet::new(positions, normals, &faces);
        let scale = (0..n as u32)
            .map(|v| {
                let at = |w: u32| sheet.positions[w as usize];
                let ring = sheet.neighbours(v);
                let total: f64 = ring.iter().map(|&w| (at(w) - at(v)).norm()).sum();
                (total / ring.len().max(1) as f64).max(1e-3)
            })
            .collect();
        let rims = Rims::new(cage, &flat, head.eyes.map(|e| from_point(&e.center)));
        let mut out = Self {
            line: lines(cage, &sheet, &rims),
            kept: (0..n as u32).map(|v| !sheet.is_inside(v)).collect(),
            changes: vec![0; n],
            queue: BinaryHeap::new(),
            free: cage.roles.iter().filter(|r| **r == Role::Free).count(),
            cage,
            sheet,
            quadrics,
            scale,
        };
        out.keep_corners(&rims);
        (0..n as u32).for_each(|v| out.offer(v));
        out
    }

    /// Takes vertices away until at most `free` free ones are left, or none may go. Returns how many are left.
    pub(super) fn until(&mut self, free: usize) -> usize {
        while self.free > free
            && let Some(Reverse((_, v, to, changes))) = self.queue.pop()
        {
            if changes == [v, to].map(|w| self.changes[w as usize]) {
                self.take_away(v, to);
            }
        }
        self.free
    }

    /// The corners of eyes and mouth stay: lids turn, lips touch and ligaments hold between them.
    fn keep_corners(&mut self, rims: &Rims) {
        for rim in [&rims.lids[0][0], &rims.lids[1][0], &rims.lips] {
            let x = |v: &&u32| self.sheet.positions[**v as usize].x;
            let order = |a: &&u32, b: &&u32| x(a).total_cmp(&x(b));
            let corners = [rim.iter().min_by(order), rim.iter().max_by(order)];
            for v in corners.into_iter().flatten().map(|v| *v as usize) {
                self.kept[v] = true;
                self.kept[self.cage.mirror[v] as usize] = true;
            }
        }
    }

    /// Puts the ways that `v` may go, and its neighbours to `v`, into the queue.
    fn offer(&mut self, v: u32) {
        for w in self.sheet.neighbours(v) {
            for (from, to) in [(v, w), (w, v)] {
                if self.may_go(from, to) {
                    let changes = [from, to].map(|u| self.changes[u as usize]);
                    let cost = Cost(self.cost(from, to));
                    self.queue.push(Reverse((cost, from, to, changes)));
                }
            }
        }
    }

    /// Whether roles, lines and symmetry let `v` go to `to`. Of two mirror images the first one stands for both.
    fn may_go(&self, v: u32, to: u32) -> bool {
        let (i, j) = (v as usize, to as usize);
        let mirror = |v: u32| self.cage.mirror[v as usize];
        let is_middle = |v: u32| mirror(v) == v;
        !self.kept[i]
            && v <= mirror(v)
            && to != mirror(v)
            && (!is_middle(v) || is_middle(to))
            && self.cage.roles[i] == self.cage.roles[j]
            && (self.line[i].is_none() || self.line[i] == self.line[j])
    }

    /// Squared length of the edge and distance from the planes, over the length of edges there, mm.
    fn cost(&self, v: u32, to: u32) -> f64 {
        let (i, j) = (v as usize, to as usize);
        let length = (self.sheet.positions[i] - self.sheet.positions[j]).norm_squared();
        let planes = PLANE_WEIGHT * self.quadrics[i].at(&self.sheet.positions[j]);
        (length + planes) / libm::sqrt(self.scale[i] * self.scale[j])
    }

    /// Collapses an edge and its mirror image, or neither.
    fn take_away(&mut self, v: u32, to: u32) {
        let pair = [v, to].map(|w| self.cage.mirror[w as usize]);
        let Some(first) = self.try_collapse(v, to) else {
            return;
        };
        let mut done = vec![(v, to, first)];
        if pair[0] != v {
            match self.try_collapse(pair[0], pair[1]) {
                Some(second) => done.push((pair[0], pair[1], second)),
                None => {
                    let (_, _, first) = done.remove(0);
                    return self.sheet.restore(first);
                }
            }
        }
        let mut ring = BTreeSet::new();
        for (v, to, undo) in done {
            self.sheet.settle(&undo);
            let own = self.quadrics[v as usize];
            self.quadrics[to as usize].add(&own);
            self.free -= usize::from(self.cage.roles[v as usize] == Role::Free);
            self.changes[v as usize] += 1;
            ring.insert(to);
            ring.extend(self.sheet.neighbours(to));
        }
        for &w in &ring {
            self.changes[w as usize] += 1;
        }
        for w in ring {
            self.offer(w);
        }
    }

    fn try_collapse(&mut self, v: u32, to: u32) -> Option<Undo> {
        let allowed = self.sheet.allows(v, to) && self.is_rim_short(v, to);
        allowed.then(|| self.sheet.collapse(v, to))
    }

    /// Whether a rim without `v` has no long edge.
    fn is_rim_short(&self, v: u32, to: u32) -> bool {
        let line = self.line[v as usize];
        let at = |w: u32| self.sheet.positions[w as usize];
        !matches!(line, Some(Line::Rim(_)))
            || self
                .sheet
                .neighbours(v)
                .into_iter()
                .filter(|&w| self.line[w as usize] == line)
                .all(|w| (at(w) - at(to)).norm() <= MAX_RIM_MM)
    }
}

/// The line of each vertex that is on one.
fn lines(cage: &Cage, sheet: &Sheet, rims: &Rims) -> Vec<Option<Line>> {
    let mut out: Vec<Option<Line>> = (0..cage.roles.len() as u32)
        .map(|v| {
            let is_free = |w: &u32| cage.roles[*w as usize] == Role::Free;
            let is_border =
                cage.roles[v as usize] == Role::Fixed && sheet.neighbours(v).iter().any(is_free);
            is_border.then_some(Line::Border)
        })
        .collect();
    let rings = rims.lids.iter().flatten().chain([&rims.lips]);
    for (k, ring) in rings.enumerate() {
        for &v in ring {
            out[v as usize] = Some(Line::Rim(k));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadric_is_the_mean_squared_distance_from_its_planes() {
        let corner = |x, y, z| Point3::new(x, y, z);
        let floor = [
            corner(0.0, 0.0, 1.0),
            corner(2.0, 0.0, 1.0),
            corner(0.0, 2.0, 1.0),
        ];
        let wall = [
            corner(3.0, 0.0, 0.0),
            corner(3.0, 2.0, 0.0),
            corner(3.0, 0.0, 2.0),
        ];
        let mut both = Quadric::of_plane(&floor);
        assert!((both.at(&corner(7.0, -2.0, 3.0)) - 4.0).abs() < 1e-12);
        both.add(&Quadric::of_plane(&wall));
        assert!((both.at(&corner(7.0, -2.0, 3.0)) - 10.0).abs() < 1e-12);
    }
}
