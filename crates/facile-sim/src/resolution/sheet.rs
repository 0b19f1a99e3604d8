//! A triangle mesh that loses vertices by half-edge collapses.
//!
//! A collapse moves all of a vertex's triangles over to a neighbour, so that what is left are vertices of before with
//! all that is known of them. It is allowed if the surface stays the same surface (the link condition of Dey et al.,
//! Topology preserving edge contraction, 1999), no triangle turns over and none becomes a sliver. Each vertex taken
//! away keeps its place: the triangle nearest to it of those that closed its gap.

use std::collections::BTreeSet;

use facile_core::mesh::closest_barycentric;
use facile_core::{Point3, Vector3};

/// A triangle may turn by this in one collapse (cosine).
const MIN_TURN: f64 = 0.6;
/// A triangle stays this much (cosine) on the side of the surface's first normal at its corners.
const MIN_FACING: f64 = 0.2;
/// Least quality of a triangle, `4 sqrt(3) area / sum of squared edges`: 1 if equilateral, 0 if without area. One that
/// is worse already may stay as bad.
const MIN_QUALITY: f64 = 0.25;

/// The mesh.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    pub(super) positions: Vec<Point3>,
    normals: Vec<Vector3>,
    /// Triangles; one that is gone is nothing.
    faces: Vec<Option<[u32; 3]>>,
    /// Triangles at each vertex.
    at: Vec<Vec<u32>>,
    /// Triangle of each vertex that was taken away.
    place: Vec<Option<u32>>,
    /// Vertices taken away, by triangle.
    held: Vec<Vec<u32>>,
}

/// What a collapse changed: triangles, and the lists of vertices, as they were.
pub(super) struct Undo {
    /// The vertex that was taken away.
    vertex: u32,
    faces: Vec<(u32, Option<[u32; 3]>)>,
    at: Vec<(u32, Vec<u32>)>,
}

impl Sheet {
    /// `normals`: unit, of the surface at each vertex.
    pub(super) fn new(positions: Vec<Point3>, normals: Vec<Vector3>, faces: &[[u32; 3]]) -> Self {
        let mut at = vec![Vec::new(); positions.len()];
        for (f, face) in faces.iter().enumerate() {
            for &v in face {
                at[v as usize].push(f as u32);
            }
        }
        Self {
            place: vec![None; positions.len()],
            held: vec![Vec::new(); faces.len()],
            faces: faces.iter().copied().map(Some).collect(),
            positions,
            normals,
            at,
        }
    }

    /// Triangles at a vertex.
    pub(super) fn around(&self, v: u32) -> impl Iterator<Item = [u32; 3]> {
        self.at[v as usize]
            .iter()
            .filter_map(|&f| self.faces[f as usize])
    }

    /// Vertices that share an edge with `v`.
    pub(super) fn neighbours(&self, v: u32) -> BTreeSet<u32> {
        self.around(v).flatten().filter(|&w| w != v).collect()
    }

    /// Whether triangles close around `v`. They do not at a border of the mesh.
    pub(super) fn is_inside(&self, v: u32) -> bool {
        let count = self.at[v as usize].len();
        count > 2 && self.neighbours(v).len() == count
    }

    /// Whether `v`, inside the mesh, may go to its neighbour `to`.
    pub(super) fn allows(&self, v: u32, to: u32) -> bool {
        let shared: BTreeSet<u32> = self
            .around(v)
            .filter(|t| t.contains(&to))
            .flatten()
            .collect();
        let (own, other) = (self.neighbours(v), self.neighbours(to));
        // Both ends of the edge and the two corners across.
        let is_edge = shared.len() == 4 && own.contains(&to);
        let is_link = own.intersection(&other).all(|w| shared.contains(w));
        is_edge
            && is_link
            && self
                .around(v)
                .all(|t| t.contains(&to) || self.keeps(t, v, to))
    }

    /// Whether a triangle stays one with `to` instead of `v`.
    fn keeps(&self, old: [u32; 3], v: u32, to: u32) -> bool {
        let new = old.map(|w| if w == v { to } else { w });
        let (before, after) = (self.corners(old), self.corners(new));
        let quality = quality(&after);
        let (Some(n), Some(m)) = (normal(&before), normal(&after)) else {
            return false;
        };
        let faces = |w: u32| self.normals[w as usize].dot(&m) > MIN_FACING;
        (quality >= MIN_QUALITY || quality >= self::quality(&before))
            && n.dot(&m) > MIN_TURN
            && new.into_iter().all(faces)
    }

    /// Moves the triangles of `v` to `to`. The vertices held there wait for [`Self::settle`].
    pub(super) fn collapse(&mut self, v: u32, to: u32) -> Undo {
        let touched = self.neighbours(v);
        let faces = std::mem::take(&mut self.at[v as usize]);
        let mut undo = Undo {
            vertex: v,
            faces: Vec::new(),
            at: vec![(v, faces.clone())],
        };
        let own = |w: u32| (w, self.at[w as usize].clone());
        undo.at.extend(touched.iter().map(|&w| own(w)));
        for f in faces {
            let face = self.faces[f as usize];
            undo.faces.push((f, face));
            let Some(corners) = face else { continue };
            if corners.contains(&to) {
                self.faces[f as usize] = None;
                for w in corners {
                    self.at[w as usize].retain(|&g| g != f);
                }
            } else {
                self.faces[f as usize] = Some(corners.map(|w| if w == v { to } else { w }));
                self.at[to as usize].push(f);
            }
        }
        undo
    }

    /// Takes a collapse back, the last one first.
    pub(super) fn restore(&mut self, undo: Undo) {
        for (f, face) in undo.faces {
            self.faces[f as usize] = face;
        }
        for (v, at) in undo.at {
            self.at[v as usize] = at;
        }
    }

    /// Gives the vertex that a collapse took away, and those in its triangles, their new triangles.
    pub(super) fn settle(&mut self, undo: &Undo) {
        let mut homeless = vec![undo.vertex];
        for &(f, _) in &undo.faces {
            homeless.append(&mut self.held[f as usize]);
        }
        for v in homeless {
            let point = self.positions[v as usize];
            let candidates = undo.faces.iter().filter_map(|&(f, _)| {
                let corners = self.corners(self.faces[f as usize]?);
                let weights = closest_barycentric(&point, &corners);
                Some(((blend(&corners, weights) - point).norm_squared(), f))
            });
            let nearest = candidates.min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, f)) = nearest {
                self.place[v as usize] = Some(f);
                self.held[f as usize].push(v);
            }
        }
    }

    /// Triangles that are left.
    pub(super) fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.faces.iter().copied().flatten()
    }

    /// Where a vertex of before lies: corners and barycentric weights, its own if it is left.
    pub(super) fn place(&self, v: u32) -> ([u32; 3], [f64; 3]) {
        match self.place[v as usize].and_then(|f| self.faces[f as usize]) {
            Some(face) => {
                let point = &self.positions[v as usize];
                (face, closest_barycentric(point, &self.corners(face)))
            }
            None => ([v; 3], [1.0, 0.0, 0.0]),
        }
    }

    pub(super) fn is_left(&self, v: u32) -> bool {
        self.place[v as usize].is_none()
    }

    fn corners(&self, face: [u32; 3]) -> [Point3; 3] {
        face.map(|v| self.positions[v as usize])
    }
}

/// Twice the area along the normal.
pub(super) fn area_vector([a, b, c]: &[Point3; 3]) -> Vector3 {
    (b - a).cross(&(c - a))
}

fn normal(corners: &[Point3; 3]) -> Option<Vector3> {
    area_vector(corners).try_normalize(1e-9)
}

fn quality(corners: &[Point3; 3]) -> f64 {
    let [a, b, c] = corners;
    let edges = (b - a).norm_squared() + (c - b).norm_squared() + (a - c).norm_squared();
    2.0 * libm::sqrt(3.0) * area_vector(corners).norm() / edges.max(1e-300)
}

fn blend(corners: &[Point3; 3], weights: [f64; 3]) -> Point3 {
    let sum = corners.iter().zip(weights).map(|(p, w)| p.coords * w);
    Point3::from(sum.sum::<Vector3>())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat sheet of 4 x 4 squares, each cut in two.
    fn sheet() -> Sheet {
        let positions = (0..25)
            .map(|v| Point3::new(f64::from(v % 5), f64::from(v / 5), 0.0))
            .collect();
        let faces: Vec<[u32; 3]> = (0..16)
            .map(|k| k / 4 * 5 + k % 4)
            .flat_map(|v| [[v, v + 1, v + 6], [v, v + 6, v + 5]])
            .collect();
        Sheet::new(positions, vec![Vector3::z(); 25], &faces)
    }

    fn area(sheet: &Sheet) -> f64 {
        let twice: f64 = sheet
            .triangles()
            .map(|t| area_vector(&sheet.corners(t)).z)
            .sum();
        0.5 * twice
    }

    #[test]
    fn a_collapse_keeps_a_sheet_whole_and_what_it_took_away_in_its_place() {
        let mut sheet = sheet();
        assert!(sheet.is_inside(12) && !sheet.is_inside(2));
        assert!(sheet.allows(12, 13));
        let undo = sheet.collapse(12, 13);
        sheet.settle(&undo);
        assert_eq!(sheet.triangles().count(), 30);
        assert!((area(&sheet) - 16.0).abs() < 1e-12);
        assert!(!sheet.is_left(12) && sheet.is_left(13));
        let (corners, weights) = sheet.place(12);
        let back = blend(&sheet.corners(corners), weights);
        assert!((back - Point3::new(2.0, 2.0, 0.0)).norm() < 1e-12);
        assert!(corners.iter().all(|&v| sheet.is_left(v)));
    }

    #[test]
    fn what_folds_or_breaks_a_sheet_is_refused_and_what_was_done_can_be_undone() {
        let mut sheet = sheet();
        // Not neighbours.
        assert!(!sheet.allows(12, 14));
        let before: Vec<[u32; 3]> = sheet.triangles().collect();
        let undo = sheet.collapse(12, 13);
        sheet.restore(undo);
        assert!(before.iter().copied().eq(sheet.triangles()));
        assert!(sheet.allows(12, 13));
        // A neighbour beyond the far side of the ring turns triangles over.
        sheet.positions[13] = Point3::new(2.0, 5.0, 0.0);
        assert!(!sheet.allows(12, 13));
    }
}
