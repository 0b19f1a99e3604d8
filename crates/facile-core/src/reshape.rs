//! A reference head in another mean shape: same topology and annotations, so that subjects, muscles and modes fit both.

use crate::{Eye, Mesh, Part, Point3, ReferenceHead, Similarity3, Texture, Vector3};

/// Rounds of [`cage_from_fine`]: each takes at least a quarter of what is missing.
const ROUNDS: usize = 60;

/// What makes the mean of a population, in the head frame.
#[derive(Clone, Debug)]
pub struct HeadShape {
    /// Positions of the cage, mm.
    pub cage: Vec<Point3>,
    /// Left and right eye.
    pub eyes: [Eye; 2],
    /// Places teeth, tongue and the jaw's hinge, from where the old head has them.
    pub skull_from_reference: Similarity3,
    /// Mean skin in the reference UV.
    pub texture: Texture,
}

impl ReferenceHead {
    /// This head in another shape and colour.
    ///
    /// # Panics
    /// If the cage has another number of vertices.
    #[must_use]
    pub fn reshaped(&self, shape: HeadShape) -> Self {
        let mut head = self.clone();
        assert_eq!(shape.cage.len(), head.cage.positions.len(), "same topology");
        let coords: Vec<Vector3> = shape.cage.iter().map(|p| p.coords).collect();
        let fine = self.subdivision.stencils.apply(&coords, Vector3::zeros());
        head.mesh.positions = fine.into_iter().map(Point3::from).collect();
        head.cage.positions = shape.cage;
        head.parts = (self.parts.iter())
            .map(|part| {
                let place = self.part_place(part.segment, &shape.eyes, &shape.skull_from_reference);
                let positions = part.mesh.positions.iter().map(|p| place * p).collect();
                Part {
                    segment: part.segment,
                    mesh: Mesh {
                        positions,
                        ..part.mesh.clone()
                    },
                }
            })
            .collect();
        head.jaw.hinge_left = shape.skull_from_reference * self.jaw.hinge_left;
        head.jaw.hinge_right = shape.skull_from_reference * self.jaw.hinge_right;
        head.eyes = shape.eyes;
        head.texture = shape.texture;
        head
    }

    /// The cage whose subdivision has its vertex points at the first of these fine positions.
    ///
    /// Cage vertex `i` is fine vertex `i`; the Catmull-Clark stencils smooth, so the cage lies a little outside. Cost
    /// O(vertices).
    pub fn cage_from_fine(&self, fine: &[Point3]) -> Vec<Point3> {
        let stencils = &self.subdivision.stencils;
        let count = self.cage.positions.len();
        let mut cage: Vec<Vector3> = fine[..count].iter().map(|p| p.coords).collect();
        for _ in 0..ROUNDS {
            let missing: Vec<Vector3> = (0..count)
                .map(|i| {
                    let smoothed = (stencils.row(i).iter())
                        .fold(Vector3::zeros(), |s, &(v, w)| s + cage[v as usize] * w);
                    fine[i].coords - smoothed
                })
                .collect();
            for (place, step) in cage.iter_mut().zip(missing) {
                *place += step;
            }
        }
        cage.into_iter().map(Point3::from).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cage_comes_back_from_its_subdivision() {
        let head = ReferenceHead::embedded();
        let cage = head.cage_from_fine(&head.mesh.positions);
        for (found, expected) in cage.iter().zip(&head.cage.positions) {
            assert!((found - expected).norm() < 1e-4, "{found} for {expected}");
        }
    }

    #[test]
    fn a_head_in_its_own_shape_is_itself() {
        let head = ReferenceHead::embedded();
        let same = head.reshaped(HeadShape {
            cage: head.cage.positions.clone(),
            eyes: head.eyes,
            skull_from_reference: Similarity3::identity(),
            texture: head.texture.clone(),
        });
        assert_eq!(same.mesh.positions, head.mesh.positions);
        assert_eq!(same.topology_digest(), head.topology_digest());
        for (a, b) in same.parts.iter().zip(&head.parts) {
            for (p, q) in a.mesh.positions.iter().zip(&b.mesh.positions) {
                assert!((p - q).norm() < 1e-9);
            }
        }
    }
}
