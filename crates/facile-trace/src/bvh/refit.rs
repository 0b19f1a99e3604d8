//! Moves a tree with its vertices: leaves first, since children lie behind their parents.

use super::{Bvh, Node};
use crate::math::Vec3;

/// Boxes grow by this share of their coordinates, so that a ray along a face of a box is inside it.
const PADDING: f32 = 1.0 / 1_048_576.0;

impl Bvh {
    /// Takes over moved vertices of the mesh that the tree was built from. Cost O(n): about 0.6 ms for 36,000
    /// triangles. Any motion gives right answers; a large one makes queries slower, see [`Bvh::wear`].
    ///
    /// # Panics
    /// If the mesh has another number of triangles than the one the tree was built from.
    pub fn refit(&mut self, positions: &[Vec3], triangles: &[[u32; 3]]) {
        assert_eq!(
            triangles.len(),
            self.triangle_ids.len(),
            "a refit keeps the triangles"
        );
        self.corners.clear();
        self.corners.extend(
            self.triangle_ids
                .iter()
                .map(|&id| triangles[id as usize].map(|v| positions[v as usize].into())),
        );
        for index in (0..self.nodes.len()).rev() {
            let node = self.nodes[index];
            let first = node.first as usize;
            let (min, max) = if node.is_leaf() {
                leaf_box(&self.corners[first..first + node.count as usize])
            } else {
                union(&self.nodes[first], &self.nodes[first + 1])
            };
            self.nodes[index] = Node { min, max, ..node };
        }
    }
}

fn leaf_box(corners: &[[[f32; 3]; 3]]) -> ([f32; 3], [f32; 3]) {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in corners.iter().flatten() {
        min = std::array::from_fn(|k| min[k].min(p[k]));
        max = std::array::from_fn(|k| max[k].max(p[k]));
    }
    for (low, high) in min.iter_mut().zip(&mut max) {
        let padding = PADDING * low.abs().max(high.abs()) + f32::MIN_POSITIVE;
        *low -= padding;
        *high += padding;
    }
    (min, max)
}

fn union(a: &Node, b: &Node) -> ([f32; 3], [f32; 3]) {
    (
        std::array::from_fn(|k| a.min[k].min(b.min[k])),
        std::array::from_fn(|k| a.max[k].max(b.max[k])),
    )
}
