//! The tree's node: 32 bytes, two to a cache line.

/// A box with either two children or a run of triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub(crate) struct Node {
    /// Smallest corner, mm.
    pub(crate) min: [f32; 3],
    /// Inner node: index of the left child, the right one follows. Leaf: first triangle in leaf order.
    pub(crate) first: u32,
    /// Largest corner, mm.
    pub(crate) max: [f32; 3],
    /// Triangles of a leaf; 0 for an inner node.
    pub(crate) count: u32,
}

const _: () = assert!(size_of::<Node>() == 32);

impl Node {
    pub(crate) fn is_leaf(&self) -> bool {
        self.count > 0
    }

    /// Half the surface of the box, mm^2.
    pub(crate) fn half_area(&self) -> f32 {
        let [x, y, z] = std::array::from_fn(|k| self.max[k] - self.min[k]);
        x * y + y * z + z * x
    }
}
