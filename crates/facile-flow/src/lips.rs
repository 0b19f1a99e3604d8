//! Closes the mouth: the two sides of the slit between the lips keep the distance they have on the reference.
//!
//! A scan of a closed mouth shows one surface and no slit. Drawn to it, upper and lower lip part or cross by parts of
//! a millimetre, and the teeth show. Each vertex of the slit and its partner across share the correction, which runs
//! out smoothly over the lips.

use facile_core::{Point3, ReferenceHead, Segment, Vector3};

use crate::adjacency::Adjacency;

/// Vertices of the two lips closer than this on the reference touch, mm.
const TOUCHING: f64 = 1.5;
/// Rings of fine vertices over which the correction runs out.
const RINGS: u32 = 5;
/// Sweeps that smooth the correction between the slit and the last ring.
const SWEEPS: usize = 24;
/// Sweeps of these that even out the slit's own corrections: partners across are not each other's nearest everywhere.
const SLIT_SWEEPS: usize = 3;

/// The slit of one reference.
pub(crate) struct Slit {
    /// Each vertex of the slit with its partner across.
    pairs: Vec<(u32, u32)>,
    /// Vertices around the slit that follow, by index; and whether each belongs to the slit.
    around: Vec<(u32, bool)>,
}

impl Slit {
    /// Finds the vertices of the lips that touch on the reference. Cost O(n^2) in the vertices of the lips.
    pub(crate) fn new(reference: &ReferenceHead, adjacency: &Adjacency) -> Self {
        let mesh = &reference.mesh;
        let mut upper = vec![false; mesh.positions.len()];
        let mut lower = vec![false; mesh.positions.len()];
        for (t, s) in mesh.triangles.iter().zip(&mesh.segments) {
            for &v in t {
                match s {
                    Segment::UpperLip => upper[v as usize] = true,
                    Segment::LowerLip => lower[v as usize] = true,
                    _ => {}
                }
            }
        }
        let list = |on: &[bool], off: &[bool]| -> Vec<usize> {
            (0..on.len()).filter(|&v| on[v] && !off[v]).collect()
        };
        let (upper, lower) = (list(&upper, &lower), list(&lower, &upper));
        let normals = mesh.vertex_normals();
        let mut pairs = Vec::new();
        for (from, to, up) in [(&upper, &lower, -1.0), (&lower, &upper, 1.0)] {
            for &v in from {
                let p = mesh.positions[v];
                let nearest = to
                    .iter()
                    .map(|&u| ((mesh.positions[u] - p).norm(), u))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                // The side that faces the other lip.
                let faces = up * normals[v].y > 0.2;
                if let Some((distance, u)) = nearest
                    && distance < TOUCHING
                    && faces
                {
                    pairs.push((v as u32, u as u32));
                }
            }
        }
        let mut on_slit = vec![false; mesh.positions.len()];
        for &(a, _) in &pairs {
            on_slit[a as usize] = true;
        }
        let seeds = (0..on_slit.len()).filter(|v| on_slit[*v]);
        let rings = adjacency.rings_from(seeds, RINGS);
        let around = (0..on_slit.len())
            .filter(|v| rings[*v] <= RINGS)
            .map(|v| (v as u32, on_slit[v]))
            .collect();
        Self { pairs, around }
    }

    /// Moves the lips together. `size` is the head's against the reference's.
    pub(crate) fn close(
        &self,
        reference: &ReferenceHead,
        adjacency: &Adjacency,
        positions: &mut [Point3],
        size: f64,
    ) {
        let rest = &reference.mesh.positions;
        let mut shift = vec![Vector3::zeros(); positions.len()];
        for &(a, b) in &self.pairs {
            let (a, b) = (a as usize, b as usize);
            let wrong = (positions[a] - positions[b]) - (rest[a] - rest[b]) * size;
            shift[a] = -0.5 * wrong;
        }
        // All at once from the sweep before: in turns, one side of the mouth would lead.
        let mut next: Vec<Vector3> = vec![Vector3::zeros(); self.around.len()];
        for sweep in 0..SWEEPS {
            for (&(v, on_slit), next) in self.around.iter().zip(&mut next) {
                let (own, neighbors) = (shift[v as usize], adjacency.of(v as usize));
                let sum = (neighbors.iter()).fold(Vector3::zeros(), |s, u| s + shift[*u as usize]);
                let mean = sum / neighbors.len().max(1) as f64;
                // The slit is evened out a little and then holds; what lies outside the last ring holds still.
                *next = match on_slit {
                    false => mean,
                    true if sweep < SLIT_SWEEPS => own * 0.8 + mean * 0.2,
                    true => own,
                };
            }
            for (&(v, _), next) in self.around.iter().zip(&next) {
                shift[v as usize] = *next;
            }
        }
        for &(v, _) in &self.around {
            positions[v as usize] += shift[v as usize];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parted_lips_close_and_closed_ones_stay() {
        let reference = ReferenceHead::embedded();
        let mesh = &reference.mesh;
        let adjacency = Adjacency::from_triangles(mesh.positions.len(), &mesh.triangles);
        let slit = Slit::new(reference, &adjacency);
        assert!(slit.pairs.len() > 40, "{} pairs", slit.pairs.len());
        let mut closed = mesh.positions.clone();
        slit.close(reference, &adjacency, &mut closed, 1.0);
        assert_eq!(closed, mesh.positions);
        let mut parted = mesh.positions.clone();
        for (t, s) in mesh.triangles.iter().zip(&mesh.segments) {
            if *s == Segment::UpperLip {
                for &v in t {
                    parted[v as usize].y = mesh.positions[v as usize].y + 1.2;
                }
            }
        }
        for _ in 0..3 {
            slit.close(reference, &adjacency, &mut parted, 1.0);
        }
        let gap = |(a, b): &(u32, u32)| {
            let rest = mesh.positions[*a as usize] - mesh.positions[*b as usize];
            ((parted[*a as usize] - parted[*b as usize]) - rest).norm()
        };
        let mean = slit.pairs.iter().map(gap).sum::<f64>() / slit.pairs.len() as f64;
        assert!(mean < 0.3, "{mean} mm of 1.2");
    }
}
