//! A bounding volume hierarchy over the triangles of one mesh.
//!
//! [`build`](Bvh::build) asks `obvhs` for the tree (PLOC with reinsertion, no spatial splits), then lays it out anew:
//! children behind their parents and side by side, triangles copied in leaf order. [`refit`](Bvh::refit) moves boxes
//! and triangles in place when vertices move. Queries: `closest_hit` and `any_hit` for one ray, the oracle, and
//! the same for packets of eight. Of two hits at the same distance the triangle of
//! lower index wins, so that any order of traversal gives the same answer.

mod build;
mod node;
mod refit;
mod traverse;

pub(crate) use node::Node;
pub(crate) use traverse::{FAR_SLACK, MAX_DEPTH, TreeHit};

use crate::math::Vec3;

/// The tree of one mesh.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    /// Root first, children adjacent and behind their parent. Empty for an empty mesh.
    pub(crate) nodes: Vec<Node>,
    /// Corners of each triangle in leaf order, mm.
    pub(crate) corners: Vec<[[f32; 3]; 3]>,
    /// Mesh index of each triangle in leaf order.
    pub(crate) triangle_ids: Vec<u32>,
    depth: usize,
    built_cost: f32,
}

impl Bvh {
    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.triangle_ids.len()
    }

    /// Whether there is nothing to hit.
    pub fn is_empty(&self) -> bool {
        self.triangle_ids.is_empty()
    }

    /// Levels of the tree: 0 when empty, 1 for a single leaf.
    pub fn depth(&self) -> usize {
        self.depth
    }

    /// Smallest and largest corner of the box around all triangles, mm. `None` when empty.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.nodes
            .first()
            .map(|n| (Vec3::from(n.min), Vec3::from(n.max)))
    }

    /// Surface-area cost of the tree over its cost when built: 1 after a build, larger the worse refits have made it.
    pub fn wear(&self) -> f32 {
        if self.built_cost > 0.0 {
            self.cost() / self.built_cost
        } else {
            1.0
        }
    }

    fn cost(&self) -> f32 {
        let Some(root) = self.nodes.first() else {
            return 0.0;
        };
        let area = root.half_area().max(f32::MIN_POSITIVE);
        self.nodes
            .iter()
            .map(|n| n.half_area() * n.count.max(1) as f32)
            .sum::<f32>()
            / area
    }
}
