//! From triangles to a tree, by `obvhs`. The only file that speaks its types.

use std::time::Duration;

use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::traverse::MAX_DEPTH;
use super::{Bvh, Node};
use crate::TraceError;
use crate::math::Vec3;

impl Bvh {
    /// The tree of a triangle list. Indices are in range and coordinates finite, which
    /// [`Geometry`](crate::Geometry) checks. Cost O(n log n): about 25 ms for 36,000 triangles.
    ///
    /// # Errors
    /// [`TraceError::TreeTooDeep`] for degenerate input whose tree the traversal's stack cannot hold.
    pub fn build(positions: &[Vec3], triangles: &[[u32; 3]]) -> Result<Self, TraceError> {
        if triangles.is_empty() {
            return Ok(Self::default());
        }
        let input: Vec<Triangle> = triangles
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.map(|v| {
                    let p = positions[v as usize];
                    glam::Vec3A::new(p.x, p.y, p.z)
                });
                Triangle { v0, v1, v2 }
            })
            .collect();
        let params = BvhBuildParams {
            pre_split: false,
            ..BvhBuildParams::medium_build()
        };
        let tree = build_bvh2_from_tris(&input, params, &mut Duration::default());
        let mut bvh = Self {
            nodes: Vec::with_capacity(tree.nodes.len()),
            triangle_ids: Vec::with_capacity(triangles.len()),
            ..Self::default()
        };
        // Lay the nodes out depth first, so that a subtree is close in memory
        bvh.nodes.push(Node::default());
        let mut pending = vec![(0_usize, 0_usize, 1_usize)];
        while let Some((source, target, depth)) = pending.pop() {
            bvh.depth = bvh.depth.max(depth);
            let node = &tree.nodes[source];
            if node.is_leaf() {
                let first = bvh.triangle_ids.len() as u32;
                let start = node.first_index as usize;
                let leaf = &tree.primitive_indices[start..start + node.prim_count as usize];
                bvh.triangle_ids.extend_from_slice(leaf);
                bvh.nodes[target].first = first;
                bvh.nodes[target].count = node.prim_count;
            } else {
                let children = bvh.nodes.len();
                bvh.nodes.extend([Node::default(); 2]);
                bvh.nodes[target].first = children as u32;
                let source = node.first_index as usize;
                pending.push((source + 1, children + 1, depth + 1));
                pending.push((source, children, depth + 1));
            }
        }
        if bvh.depth > MAX_DEPTH {
            return Err(TraceError::TreeTooDeep {
                depth: bvh.depth,
                limit: MAX_DEPTH,
            });
        }
        bvh.refit(positions, triangles);
        bvh.built_cost = bvh.cost();
        Ok(bvh)
    }
}
