//! One ray through the tree: the plain form of the query, and the oracle of the packets.
//!
//! Source of the box test: Ize, Robust BVH Ray Traversal, JCGT 2(2), 2013: far distances grow by more than their
//! rounding error, so no box that holds a hit is missed.

use super::{Bvh, Node};
use crate::cutout::Admit;
use crate::math::Vec3;
use crate::ray::Ray;
use crate::triangle::{RayShear, intersect};

/// Levels that the traversal's stack can hold.
pub(crate) const MAX_DEPTH: usize = 96;

/// Factor on far distances in box tests. More than rounding needs, so that hits at almost equal distance are all
/// compared and ties end the same way in any order of traversal.
pub(crate) const FAR_SLACK: f32 = 1.0 + 4e-6;

/// `1 / direction`, large instead of infinite where a component is 0.
fn inverse_direction(direction: Vec3) -> Vec3 {
    direction.map(|d| {
        if d.abs() < 1e-25 {
            1e25_f32.copysign(d)
        } else {
            1.0 / d
        }
    })
}

/// A hit of one tree: distance, triangle of the mesh, weights of its second and third corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TreeHit {
    pub(crate) t: f32,
    pub(crate) triangle: u32,
    pub(crate) u: f32,
    pub(crate) v: f32,
}

/// Distance at which a ray enters a box before `t_max`, or infinity.
fn entry(node: &Node, ray: &Ray, inverse: &Vec3, t_max: f32) -> f32 {
    let (mut near, mut far) = (ray.t_min, t_max);
    for k in 0..3 {
        let a = (node.min[k] - ray.origin[k]) * inverse[k];
        let b = (node.max[k] - ray.origin[k]) * inverse[k];
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    if near <= far * FAR_SLACK {
        near
    } else {
        f32::INFINITY
    }
}

impl Bvh {
    /// The nearest hit before `ray.t_max` that `admit` lets count. Of hits at the same distance the triangle of lower index
    /// wins.
    pub(crate) fn closest_hit(&self, ray: &Ray, admit: impl Admit) -> Option<TreeHit> {
        let shear = RayShear::new(ray.direction);
        let mut best = TreeHit {
            t: ray.t_max,
            triangle: 0,
            u: 0.0,
            v: 0.0,
        };
        let mut found = false;
        self.visit_leaves(ray, ray.t_max, |tree, first, count| {
            for slot in first..first + count {
                let Some((t, u, v)) = intersect(ray, &shear, &tree.corners[slot].map(Vec3::from))
                else {
                    continue;
                };
                let triangle = tree.triangle_ids[slot];
                let is_closer = t < best.t || (t <= best.t && triangle < best.triangle);
                if is_closer && admit.admits(triangle, u, v) {
                    best = TreeHit { t, triangle, u, v };
                    found = true;
                }
            }
            Some(best.t)
        });
        found.then_some(best)
    }

    /// Whether anything that `admit` lets count is hit before `ray.t_max`.
    pub(crate) fn any_hit(&self, ray: &Ray, admit: impl Admit) -> bool {
        let shear = RayShear::new(ray.direction);
        let mut found = false;
        self.visit_leaves(ray, ray.t_max, |tree, first, count| {
            found = (first..first + count).any(|slot| {
                intersect(ray, &shear, &tree.corners[slot].map(Vec3::from)).is_some_and(
                    |(t, u, v)| t < ray.t_max && admit.admits(tree.triangle_ids[slot], u, v),
                )
            });
            (!found).then_some(ray.t_max)
        });
        found
    }

    /// Calls `visit(tree, first, count)` for every leaf whose box the ray meets, near ones first. The visitor returns
    /// the distance beyond which nothing matters any more, or `None` to stop.
    fn visit_leaves(
        &self,
        ray: &Ray,
        mut t_max: f32,
        mut visit: impl FnMut(&Self, usize, usize) -> Option<f32>,
    ) {
        let inverse = inverse_direction(ray.direction);
        let Some(root) = self.nodes.first() else {
            return;
        };
        let mut stack = [(0_u32, 0.0_f32); MAX_DEPTH + 1];
        let mut height = 1;
        stack[0] = (0, entry(root, ray, &inverse, t_max));
        while height > 0 {
            height -= 1;
            let (index, near) = stack[height];
            if near > t_max * FAR_SLACK || near == f32::INFINITY {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.is_leaf() {
                match visit(self, node.first as usize, node.count as usize) {
                    Some(limit) => t_max = limit,
                    None => return,
                }
                continue;
            }
            let left = entry(&self.nodes[node.first as usize], ray, &inverse, t_max);
            let right = entry(&self.nodes[node.first as usize + 1], ray, &inverse, t_max);
            let order = if left <= right {
                [(node.first + 1, right), (node.first, left)]
            } else {
                [(node.first, left), (node.first + 1, right)]
            };
            for child in order {
                if child.1 < f32::INFINITY {
                    stack[height] = child;
                    height += 1;
                }
            }
        }
    }
}
