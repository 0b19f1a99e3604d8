//! The simulation mesh of the reference head: what all subjects share.
//!
//! Nodes are cage vertices with role free, and the fixed ones they touch; elements are the triangles of the cage's quads,
//! cut along the shorter diagonal of the reference, the same way on both sides of the face. Muscles are bound to nodes
//! and springs here, once, so that every subject has the same muscles in the same places. Read next [`crate::model`].

use std::collections::{BTreeMap, BTreeSet};

use facile_core::reference::{Cage, Role};
use facile_core::{ReferenceHead, mesh};

use crate::SimError;
use crate::layers::Layers;
use crate::muscle::{Actuator, MuscleSet, Reach};
use crate::skull::SkullGrid;
use crate::solver::SystemPattern;
use crate::vector::{V3, from_point, from_vector, norm, scale, sub};

/// Share of a lid's motion from which on its fascia is the tarsal plate itself.
const PLATE_WEIGHT: f64 = 0.5;

/// Reach of a palpebral ligament around a corner of the eye, mm.
const LIGAMENT_MM: f64 = 9.0;
/// Its stiffness at the corner, in that of an attachment of the fascia to the skull.
const LIGAMENT_STIFFNESS: f64 = 40.0;

/// Distance of the vestibular fold from the rim of the lips, along the skin, mm.
const VESTIBULE_MM: (f64, f64) = (9.0, 20.0);
/// Distance of its ends from the corners of the mouth, mm.
const VESTIBULE_CORNER_MM: f64 = 5.0;

/// The simulation mesh and the muscles on it, for one reference head.
#[derive(Debug)]
pub struct Template {
    /// Cage vertex of each node; free nodes first.
    pub(crate) cage_of_node: Vec<u32>,
    /// Node of each cage vertex that has one.
    pub(crate) node_of_cage: Vec<Option<u32>>,
    /// Number of free nodes.
    pub(crate) free: usize,
    /// Elements, counter-clockwise seen from outside.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Edges of the elements, `a < b`, sorted.
    pub(crate) edges: Vec<[u32; 2]>,
    /// Whether each of the `2 n` nodes (skin, then fascia) is moved by the solver.
    pub(crate) moving: Vec<bool>,
    /// Whether the fascia of each node is attached to the skull.
    pub(crate) attached: Vec<bool>,
    /// Stiffness of the ligaments that hold each node's fascia, in that of an attachment to the skull.
    pub(crate) ligament: Vec<f64>,
    /// Thickness of each node's tissue, mm.
    pub(crate) thickness: Vec<f64>,
    /// Topology of both eyes' lids and of the lips.
    pub(crate) margins: Margins,
    /// Muscles, left and right apart, bound to nodes.
    pub(crate) actuators: Vec<Actuator>,
    /// Sparsity of the solver's matrix.
    pub(crate) pattern: SystemPattern,
    /// Knots of the skull's height field.
    pub(crate) skull: SkullGrid,
    /// The muscles the template was made with.
    pub(crate) muscles: MuscleSet,
}

/// Borders of the simulated sheet.
#[derive(Debug, Default)]
pub(crate) struct Margins {
    /// Cage vertices of the lid margins of the left and right eye: innermost ring first, then two more outwards.
    pub(crate) lids: [Vec<u32>; 2],
    /// Nodes of the rim of the lips, where the skin meets the inner mouth.
    pub(crate) lips: Vec<u32>,
    /// Nodes of the upper lip's rim, each with the two of the lower one's between which it lies.
    pub(crate) lip_pairs: Vec<(u32, [u32; 2])>,
}

impl Template {
    /// The simulation mesh of `reference` with these muscles.
    ///
    /// # Errors
    /// [`SimError::Muscle`] for a muscle that misses the simulated skin.
    pub fn new(reference: &ReferenceHead, muscles: &MuscleSet) -> Result<Self, SimError> {
        let cage = &reference.cage;
        let positions: Vec<V3> = reference.mesh.positions[..cage.positions.len()]
            .iter()
            .map(from_point)
            .collect();
        let faces = simulated_faces(cage);
        let (cage_of_node, free) = number_nodes(cage, &faces);
        let mut node_of_cage = vec![None; positions.len()];
        for (node, &v) in cage_of_node.iter().enumerate() {
            node_of_cage[v as usize] = Some(node as u32);
        }
        let triangles = split_quads(cage, &faces, &positions, &node_of_cage);
        let edges = edges_of(&triangles);
        let n = cage_of_node.len();
        let per_node = |f: &dyn Fn(usize) -> bool| -> Vec<bool> {
            cage_of_node.iter().map(|&v| f(v as usize)).collect()
        };
        let plate = per_node(&|v| cage.lid[v].abs() >= PLATE_WEIGHT && cage.roles[v] == Role::Free);
        let moving: Vec<bool> = (0..2 * n)
            .map(|i| i % n < free && !(i >= n && plate[i - n]))
            .collect();
        let thickness: Vec<f64> = cage_of_node
            .iter()
            .map(|&v| cage.thickness[v as usize])
            .collect();
        let eyes = reference.eyes.map(|e| from_point(&e.center));
        let mut margins = Margins::new(&Rims::new(cage, &positions, eyes), &node_of_cage);
        margins.lip_pairs = lip_pairs(cage, &positions, &cage_of_node, &margins.lips);
        let mut attached = per_node(&|v| cage.attached[v]);
        for i in vestibule(cage, &positions, &cage_of_node, &edges, &margins.lips) {
            attached[i] = true;
        }
        let held = |i: usize| attached[i] || !moving[i] || !moving[n + i];
        for i in loose(&edges, n, held) {
            attached[i] = true;
        }
        let pattern = SystemPattern::new(&triangles, &edges, &margins.lip_pairs, &moving)?;
        let layers = layers(
            &triangles,
            &cage_of_node,
            &thickness,
            reference,
            &reference.mesh.positions,
        )?;
        let mut template = Self {
            attached,
            ligament: palpebral_ligaments(&positions, &cage_of_node, &margins),
            margins,
            pattern,
            skull: SkullGrid::new(&layers),
            actuators: Vec::new(),
            muscles: muscles.clone(),
            cage_of_node,
            node_of_cage,
            free,
            triangles,
            edges,
            moving,
            thickness,
        };
        let mirror: Vec<u32> = template
            .cage_of_node
            .iter()
            .map(|&v| template.node_of_cage[cage.mirror[v as usize] as usize])
            .map(|m| {
                m.ok_or(SimError::SizeMismatch {
                    what: "mirrored nodes",
                    expected: n,
                    got: 0,
                })
            })
            .collect::<Result<_, _>>()?;
        template.actuators = Reach::new(&template, &layers, &mirror).bind_all(muscles)?;
        Ok(template)
    }

    /// The muscles on the mesh.
    pub fn muscles(&self) -> &MuscleSet {
        &self.muscles
    }

    /// Number of nodes a layer, free and fixed.
    pub fn node_count(&self) -> usize {
        self.cage_of_node.len()
    }

    /// Number of free nodes a layer.
    pub fn free_count(&self) -> usize {
        self.free
    }

    /// Skin and fascia on a shape of the fine reference mesh.
    pub(crate) fn layers(
        &self,
        reference: &ReferenceHead,
        fine: &[facile_core::Point3],
    ) -> Result<Layers, SimError> {
        layers(
            &self.triangles,
            &self.cage_of_node,
            &self.thickness,
            reference,
            fine,
        )
    }
}

fn layers(
    triangles: &[[u32; 3]],
    cage_of_node: &[u32],
    thickness: &[f64],
    reference: &ReferenceHead,
    fine: &[facile_core::Point3],
) -> Result<Layers, SimError> {
    let normals = mesh::vertex_normals(fine, &reference.mesh.triangles);
    let pick = |v: &u32| from_point(&fine[*v as usize]);
    let skin: Vec<V3> = cage_of_node.iter().map(pick).collect();
    let inward: Vec<V3> = cage_of_node
        .iter()
        .map(|&v| scale(from_vector(&normals[v as usize]), -1.0))
        .collect();
    Layers::new(triangles, skin, &inward, thickness)
}

/// Faces with a free vertex and no passive one.
fn simulated_faces(cage: &Cage) -> Vec<u32> {
    let has = |face: &[u32], role: Role| face.iter().any(|&v| cage.roles[v as usize] == role);
    (0..cage.faces.len() as u32)
        .filter(|&f| {
            let face = &cage.faces[f as usize];
            has(face, Role::Free) && !has(face, Role::Passive)
        })
        .collect()
}

fn number_nodes(cage: &Cage, faces: &[u32]) -> (Vec<u32>, usize) {
    let used: BTreeSet<u32> = faces
        .iter()
        .flat_map(|&f| cage.faces[f as usize].iter().copied())
        .collect();
    let is_free = |v: &u32| cage.roles[*v as usize] == Role::Free;
    let mut nodes: Vec<u32> = used.iter().copied().filter(is_free).collect();
    let free = nodes.len();
    nodes.extend(used.iter().copied().filter(|v| !is_free(v)));
    (nodes, free)
}

/// Triangles of some faces. A quad is cut along its shorter diagonal; a quad on the right as its mirror image.
pub(crate) fn split_quads(
    cage: &Cage,
    faces: &[u32],
    positions: &[V3],
    node_of_cage: &[Option<u32>],
) -> Vec<[u32; 3]> {
    let diagonal = |a: u32, b: u32| norm(sub(positions[a as usize], positions[b as usize]));
    let mut cuts: BTreeMap<Vec<u32>, (u32, u32)> = BTreeMap::new();
    let sorted = |face: &mut dyn Iterator<Item = u32>| {
        let mut key: Vec<u32> = face.collect();
        key.sort_unstable();
        key
    };
    let mirrored = |v: u32| cage.mirror[v as usize];
    for &f in faces {
        if let [a, b, c, d] = cage.faces[f as usize][..] {
            let cut = if diagonal(a, c) <= diagonal(b, d) {
                (a, c)
            } else {
                (b, d)
            };
            let face = [a, b, c, d];
            let x: f64 = face.iter().map(|&v| positions[v as usize][0]).sum();
            if x >= 0.0 {
                cuts.insert(sorted(&mut face.iter().copied()), cut);
                cuts.insert(
                    sorted(&mut face.iter().map(|&v| mirrored(v))),
                    (mirrored(cut.0), mirrored(cut.1)),
                );
            } else {
                cuts.entry(sorted(&mut face.iter().copied())).or_insert(cut);
            }
        }
    }
    let mut triangles = Vec::new();
    for &f in faces {
        let face = &cage.faces[f as usize];
        let start = match cuts.get(&sorted(&mut face.iter().copied())) {
            Some(cut) => face.iter().position(|&v| v == cut.0).unwrap_or(0),
            None => 0,
        };
        let corner = |k: usize| face[(start + k) % face.len()];
        for k in 1..face.len() - 1 {
            let t = [corner(0), corner(k), corner(k + 1)].map(|v| node_of_cage[v as usize]);
            if let [Some(a), Some(b), Some(c)] = t {
                triangles.push([a, b, c]);
            }
        }
    }
    triangles
}

fn edges_of(triangles: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let set: BTreeSet<[u32; 2]> = triangles
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    set.into_iter().collect()
}

/// Where the simulated skin ends at lids and lips, as cage vertices.
#[derive(Debug, Default)]
pub(crate) struct Rims {
    /// Of the left and right eye: the lids' margin and the two rings around it, from the inside out.
    pub(crate) lids: [[BTreeSet<u32>; 3]; 2],
    /// Rim of the lips.
    pub(crate) lips: BTreeSet<u32>,
}

impl Rims {
    /// Finds them: free vertices next to passive ones, near an eye or not.
    pub(crate) fn new(cage: &Cage, positions: &[V3], eyes: [V3; 2]) -> Self {
        let mut around = vec![BTreeSet::new(); positions.len()];
        for face in &cage.faces {
            for (k, &v) in face.iter().enumerate() {
                let w = face[(k + 1) % face.len()];
                around[v as usize].insert(w);
                around[w as usize].insert(v);
            }
        }
        let passive = |v: u32| cage.roles[v as usize] == Role::Passive;
        let near = |v: usize, e: usize| norm(sub(positions[v], eyes[e])) < 30.0;
        let mut out = Self::default();
        for v in 0..positions.len() {
            if cage.roles[v] == Role::Free && around[v].iter().any(|&w| passive(w)) {
                match (near(v, 0), near(v, 1)) {
                    (true, _) => out.lids[0][0].insert(v as u32),
                    (_, true) => out.lids[1][0].insert(v as u32),
                    _ => out.lips.insert(v as u32),
                };
            }
        }
        for rings in &mut out.lids {
            let mut seen = rings[0].clone();
            for k in 1..rings.len() {
                rings[k] = rings[k - 1]
                    .iter()
                    .flat_map(|&v| around[v as usize].iter().copied())
                    .filter(|&w| !passive(w) && !seen.contains(&w))
                    .collect();
                seen.extend(&rings[k]);
            }
        }
        out
    }
}

impl Margins {
    fn new(rims: &Rims, node_of_cage: &[Option<u32>]) -> Self {
        let in_order = |rings: &[BTreeSet<u32>; 3]| rings.iter().flatten().copied().collect();
        Self {
            lids: [in_order(&rims.lids[0]), in_order(&rims.lids[1])],
            lips: rims
                .lips
                .iter()
                .filter_map(|&v| node_of_cage[v as usize])
                .collect(),
            lip_pairs: Vec::new(),
        }
    }
}

/// Pairs the nodes of the upper lip's rim with places on the lower one's. Which lip a node belongs to follows from the
/// jaw. Beyond the corners of the lower lip there is nothing to touch.
fn lip_pairs(
    cage: &Cage,
    positions: &[V3],
    cage_of_node: &[u32],
    rim: &[u32],
) -> Vec<(u32, [u32; 2])> {
    let along = |i: &u32| positions[cage_of_node[*i as usize] as usize][0];
    let on_jaw = |i: &u32| cage.jaw[cage_of_node[*i as usize] as usize] > 0.5;
    let (mut lower, upper): (Vec<u32>, Vec<u32>) = rim.iter().partition(|i| on_jaw(i));
    lower.sort_by(|a, b| along(a).total_cmp(&along(b)));
    upper
        .into_iter()
        .filter_map(|node| {
            let k = lower.partition_point(|i| along(i) <= along(&node));
            match lower.get(k.checked_sub(1)?..=k)? {
                &[a, b] => Some((node, [a, b])),
                _ => None,
            }
        })
        .collect()
}

/// Stiffness of the palpebral ligaments, which bind the corners of each eye to the rim of the orbit. They fade out around
/// the corners. Without them a strong orbicularis oculi has two places for the flesh at the inner corner, and the outer
/// corner is a hair's breadth from buckling.
fn palpebral_ligaments(positions: &[V3], cage_of_node: &[u32], margins: &Margins) -> Vec<f64> {
    let mut corners = Vec::new();
    for rim in &margins.lids {
        let mut places: Vec<V3> = rim.iter().map(|&v| positions[v as usize]).collect();
        places.sort_by(|a, b| a[0].total_cmp(&b[0]));
        corners.extend(
            [places.first(), places.last()]
                .into_iter()
                .flatten()
                .copied(),
        );
    }
    cage_of_node
        .iter()
        .map(|&v| {
            let reach = corners
                .iter()
                .map(|c| norm(sub(positions[v as usize], *c)) / LIGAMENT_MM)
                .fold(1.0, f64::min);
            LIGAMENT_STIFFNESS * (1.0 - reach * reach) * (1.0 - reach * reach)
        })
        .collect()
}

/// Nodes of islands of the mesh in which no node is held: nothing says where they are, so they go with the skull.
fn loose(edges: &[[u32; 2]], nodes: usize, held: impl Fn(usize) -> bool) -> Vec<usize> {
    let mut reached: Vec<bool> = (0..nodes).map(held).collect();
    // Sweeps there and back: a handful on a face.
    loop {
        let mut changed = false;
        let mut spread = |&[a, b]: &[u32; 2]| {
            let (a, b) = (a as usize, b as usize);
            if reached[a] != reached[b] {
                (reached[a], reached[b]) = (true, true);
                changed = true;
            }
        };
        edges.iter().for_each(&mut spread);
        edges.iter().rev().for_each(&mut spread);
        if !changed {
            break;
        }
    }
    (0..nodes).filter(|&i| !reached[i]).collect()
}

/// Nodes over the vestibular fold, where the lips' lining is bound to the gums: a band around the rim of the lips, away
/// from the corners of the mouth, over upper or lower jaw but not over the blend of both. Without it an opening jaw
/// leaves the lower lip behind.
fn vestibule(
    cage: &Cage,
    positions: &[V3],
    cage_of_node: &[u32],
    edges: &[[u32; 2]],
    rim: &[u32],
) -> Vec<usize> {
    let at = |i: u32| positions[cage_of_node[i as usize] as usize];
    let corner = rim.iter().map(|&i| at(i)[0].abs()).fold(0.0, f64::max);
    let mut along = vec![f64::INFINITY; cage_of_node.len()];
    for &i in rim {
        along[i as usize] = 0.0;
    }
    // The band is a few edges wide: sweeps over all edges settle within a few rounds.
    loop {
        let mut changed = false;
        for &[a, b] in edges {
            let length = norm(sub(at(a), at(b)));
            for (i, j) in [(a as usize, b as usize), (b as usize, a as usize)] {
                let through = along[j] + length;
                if through < along[i] && through < VESTIBULE_MM.1 {
                    along[i] = through;
                    changed = true;
                }
            }
        }
        if !changed {
            break;
        }
    }
    (0..cage_of_node.len())
        .filter(|&i| along[i] >= VESTIBULE_MM.0 && along[i] < VESTIBULE_MM.1)
        .filter(|&i| {
            let v = cage_of_node[i] as usize;
            let pure = cage.jaw[v] > 0.9 || cage.jaw[v] < 0.1;
            pure && positions[v][0].abs() < corner - VESTIBULE_CORNER_MM
        })
        .collect()
}
