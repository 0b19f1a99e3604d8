//! What follows the simulated skin: the inner mouth, the eye sockets, and the fine mesh.
//!
//! Passive cage vertices take the rigid motion of skull, jaw and lids below them, plus a smooth correction that equals
//! the simulated skin's own motion at its rim and dies out with depth: a screened harmonic field, factored once per
//! reference head. Every displacement of the cage then reaches the fine vertices through the subdivision stencils.

use facile_core::reference::Role;
use facile_core::subdivision::Stencils;
use facile_core::{Point3, ReferenceHead};

use crate::SimError;
use crate::sparse::{Factor, Pattern};
use crate::vector::{V3, ZERO, add_scaled, from_point, norm, sub, to_vector};

/// Depth over which the correction dies out, mm.
const DEPTH_MM: f64 = 18.0;

/// The harmonic field of a reference head.
#[derive(Debug)]
pub(crate) struct Follow {
    /// Passive cage vertices.
    passive: Vec<u32>,
    /// For each of them, neighbours that are not passive and their weights.
    rim: Vec<Vec<(u32, f64)>>,
    pattern: Pattern,
    factor: Factor,
    stencils: Stencils,
}

impl Follow {
    pub(crate) fn new(reference: &ReferenceHead) -> Result<Self, SimError> {
        let cage = &reference.cage;
        let positions: Vec<V3> = cage.positions.iter().map(from_point).collect();
        let passive: Vec<u32> = (0..positions.len() as u32)
            .filter(|&v| cage.roles[v as usize] == Role::Passive)
            .collect();
        let row = |v: u32| passive.binary_search(&v).ok();
        let mut edges: Vec<[u32; 2]> = cage
            .faces
            .iter()
            .flat_map(|f| (0..f.len()).map(|k| [f[k], f[(k + 1) % f.len()]]))
            .map(|[a, b]| [a.min(b), a.max(b)])
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let inner = edges
            .iter()
            .filter_map(|e| Some((row(e[0])? as u32, row(e[1])? as u32)));
        let pattern = Pattern::new(passive.len(), "inner mouth", inner)?;
        let mut matrix = vec![0.0; pattern.entries()];
        let mut rim = vec![Vec::new(); passive.len()];
        for &[a, b] in &edges {
            let length = norm(sub(positions[a as usize], positions[b as usize])).max(0.05);
            let weight = 1.0 / length;
            // Each end carries half the edge as its part of the screening term.
            let screen = weight + 0.5 * length / (DEPTH_MM * DEPTH_MM);
            for (v, other) in [(a, b), (b, a)] {
                if let Some(i) = row(v) {
                    matrix[pattern.slot(i as u32, i as u32) as usize] += screen;
                    match row(other) {
                        Some(j) if i < j => {
                            matrix[pattern.slot(i as u32, j as u32) as usize] -= weight;
                        }
                        Some(_) => {}
                        None => rim[i].push((other, weight)),
                    }
                }
            }
        }
        // Vertices that no edge reaches stay where skull and jaw take them.
        for i in 0..passive.len() as u32 {
            let diagonal = &mut matrix[pattern.slot(i, i) as usize];
            if *diagonal == 0.0 {
                *diagonal = 1.0;
            }
        }
        let mut factor = Factor::new(&pattern);
        factor.refactor_one(&pattern, "inner mouth", &matrix)?;
        Ok(Self {
            passive,
            rim,
            pattern,
            factor,
            stencils: reference.subdivision.stencils.clone(),
        })
    }

    /// Fills in the displacements of passive vertices.
    ///
    /// `displacement`: of all cage vertices, mm, passive ones not yet known. `carried`: displacement of every vertex by
    /// skull, jaw and lids alone.
    pub(crate) fn complete(&self, displacement: &mut [V3], carried: &[V3]) {
        let mut sides: Vec<V3> = self
            .rim
            .iter()
            .map(|rim| {
                rim.iter().fold(ZERO, |s, &(v, w)| {
                    add_scaled(s, sub(displacement[v as usize], carried[v as usize]), w)
                })
            })
            .collect();
        self.factor.solve(&self.pattern, &mut sides);
        for (own, &v) in sides.iter().zip(&self.passive) {
            displacement[v as usize] = add_scaled(carried[v as usize], *own, 1.0);
        }
    }

    /// Fine vertices: their rest positions plus the stencils of the cage's displacement.
    pub(crate) fn fine(&self, rest: &[Point3], displacement: &[V3]) -> Vec<Point3> {
        (0..rest.len())
            .map(|i| {
                let moved = self.stencils.row(i).iter().fold(ZERO, |s, &(v, w)| {
                    add_scaled(s, displacement[v as usize], w)
                });
                rest[i] + to_vector(moved)
            })
            .collect()
    }
}
