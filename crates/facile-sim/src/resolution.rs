//! Finer simulation meshes: what a solve costs and how far it is from the truth at other numbers of nodes.
//!
//! A [`Resolution`] is the reference head with its fine vertices, or a part of them, as the cage; annotations between old
//! vertices are means, so that muscles, lips, lids and borders stay where they are. [`Resolution::subject`] takes a
//! subject along.

use std::collections::BTreeMap;

use facile_core::reference::{Cage, Role};
use facile_core::subdivision::{Subdivision, catmull_clark};
use facile_core::{Mesh, Point3, ReferenceHead, Subject, Vector3};

use crate::params::PaperParams;

/// How a cage is cut finer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    /// A new vertex in each face, joined with its corners: twice the nodes.
    Centres,
    /// Each quad in four: four times the nodes.
    Quarters,
}

/// A reference head with another simulation mesh.
#[derive(Clone, Debug)]
pub struct Resolution {
    /// The head. What only pictures need, texture coordinates and segments, is left out.
    pub head: ReferenceHead,
    /// Fine vertex of the head it was made from under each of its cage's vertices.
    source: Vec<u32>,
}

/// What a new vertex is the mean of.
struct Parents(Vec<u32>);

impl Resolution {
    /// Cuts the simulation mesh of `head` finer. Cage vertices of `head` keep their numbers. Cost O(n log n).
    pub fn finer(head: &ReferenceHead, cut: Cut) -> Self {
        let old = &head.cage;
        let n = old.positions.len();
        let edges = edges_of(old);
        let mut parents: Vec<Parents> = (0..n as u32).map(|v| Parents(vec![v])).collect();
        let mut source: Vec<u32> = (0..n as u32).collect();
        let centre = |f: usize| (n + edges.len() + f) as u32;
        let first_edge = n as u32;
        if cut == Cut::Quarters {
            parents.extend(edges.keys().map(|&(a, b)| Parents(vec![a, b])));
            source.extend(edges.values().map(|e| first_edge + e));
        }
        let first_face = parents.len() as u32;
        parents.extend(old.faces.iter().map(|f| Parents(f.clone())));
        source.extend((0..old.faces.len()).map(centre));
        let mut faces = Vec::new();
        for (f, face) in old.faces.iter().enumerate() {
            let middle = first_face + f as u32;
            let m = face.len();
            for k in 0..m {
                let (before, v, after) = (face[(k + m - 1) % m], face[k], face[(k + 1) % m]);
                let edge = |a: u32, b: u32| first_edge + edges[&(a.min(b), a.max(b))];
                faces.push(match cut {
                    Cut::Centres => vec![v, after, middle],
                    Cut::Quarters => vec![v, edge(v, after), middle, edge(before, v)],
                });
            }
        }
        let positions = source
            .iter()
            .map(|&v| head.mesh.positions[v as usize])
            .collect();
        let cage = annotated(old, &parents, faces, positions);
        let subdivision = catmull_clark(cage.positions.len(), &cage.faces);
        let mesh = Mesh {
            positions: refined(&subdivision, &cage.positions),
            triangles: subdivision
                .quads
                .iter()
                .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
                .collect(),
            ..Mesh::default()
        };
        Self {
            head: ReferenceHead {
                cage,
                subdivision,
                mesh,
                ..head.clone()
            },
            source,
        }
    }

    /// A subject of the head this was made from.
    pub fn subject(&self, subject: &Subject) -> Subject {
        let cage: Vec<Point3> = self
            .source
            .iter()
            .map(|&v| subject.positions[v as usize])
            .collect();
        let positions = refined(&self.head.subdivision, &cage);
        Subject {
            expected_error: vec![0.0; positions.len()],
            positions,
            ..subject.clone()
        }
    }

    /// The paper's constants for `nodes` nodes a layer where they were meant for `usual`: those of single springs between
    /// the layers are shared out, all others go by area or shape as they are.
    pub fn params(usual: usize, nodes: usize) -> PaperParams {
        let params = PaperParams::default();
        PaperParams {
            skin_fascia_stiffness: params.skin_fascia_stiffness * usual as f64 / nodes as f64,
            ..params
        }
    }
}

fn refined(subdivision: &Subdivision, cage: &[Point3]) -> Vec<Point3> {
    let coords: Vec<Vector3> = cage.iter().map(|p| p.coords).collect();
    let fine = subdivision.stencils.apply(&coords, Vector3::zeros());
    fine.into_iter().map(Point3::from).collect()
}

/// Number of each edge, in the order of [`catmull_clark`].
fn edges_of(cage: &Cage) -> BTreeMap<(u32, u32), u32> {
    let mut edges = BTreeMap::new();
    for face in &cage.faces {
        for (k, &a) in face.iter().enumerate() {
            let b = face[(k + 1) % face.len()];
            edges.insert((a.min(b), a.max(b)), 0);
        }
    }
    for (edge, number) in edges.values_mut().zip(0..) {
        *edge = number;
    }
    edges
}

/// A cage whose vertices lie between those of `old`.
fn annotated(
    old: &Cage,
    parents: &[Parents],
    faces: Vec<Vec<u32>>,
    positions: Vec<Point3>,
) -> Cage {
    let mean = |values: &[f64]| -> Vec<f64> {
        let of =
            |p: &Parents| p.0.iter().map(|&v| values[v as usize]).sum::<f64>() / p.0.len() as f64;
        parents.iter().map(of).collect()
    };
    let role = |p: &Parents| {
        let has = |role: Role| p.0.iter().any(|&v| old.roles[v as usize] == role);
        if has(Role::Passive) {
            Role::Passive
        } else if has(Role::Free) {
            Role::Free
        } else {
            Role::Fixed
        }
    };
    let sorted = |mut key: Vec<u32>| {
        key.sort_unstable();
        key
    };
    let numbers: BTreeMap<Vec<u32>, u32> = parents
        .iter()
        .map(|p| sorted(p.0.clone()))
        .zip(0..)
        .collect();
    let mirror = |p: &Parents| {
        let other = p.0.iter().map(|&v| old.mirror[v as usize]).collect();
        // What has no mirror image is its own, as in the cage.
        let own = numbers[&sorted(p.0.clone())];
        numbers.get(&sorted(other)).copied().unwrap_or(own)
    };
    Cage {
        roles: parents.iter().map(role).collect(),
        jaw: mean(&old.jaw),
        lid: mean(&old.lid),
        thickness: mean(&old.thickness),
        attached: parents
            .iter()
            .map(|p| p.0.iter().all(|&v| old.attached[v as usize]))
            .collect(),
        mirror: parents.iter().map(mirror).collect(),
        faces,
        positions,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FaceRig, MuscleSet, Pose, Solver, SolverParams, mean_subject};

    #[test]
    fn a_finer_face_moves_as_the_face_does() {
        let head = ReferenceHead::embedded();
        let muscles = MuscleSet::embedded();
        let mut pose = Pose::default();
        pose.set(muscles, "zygomatic_major", 0.6).expect("known");
        pose.jaw.open_rad = 0.1;
        let way = |head: &ReferenceHead, subject: &Subject, usual: usize| {
            let rig = FaceRig::new(head, muscles).expect("muscles reach");
            let nodes = rig.template().free_count();
            let params = Resolution::params(usual.max(1), if usual == 0 { 1 } else { nodes });
            let model = rig.model_with(head, subject, params).expect("built");
            let face = Solver::new()
                .solve(&model, &pose, &SolverParams::default())
                .expect("certifies");
            let moved: Vec<Vector3> = face
                .positions
                .iter()
                .zip(&subject.positions)
                .map(|(p, q)| p - q)
                .collect();
            (nodes, moved)
        };
        let subject = mean_subject(head);
        let (few, usual) = way(head, &subject, 0);
        let finer = Resolution::finer(head, Cut::Centres);
        let (many, fine) = way(&finer.head, &finer.subject(&subject), few);
        assert!(many > 19 * few / 10 && many < 21 * few / 10, "{few} {many}");
        let n = head.cage.positions.len();
        let apart = |v: usize| (fine[v] - usual[v]).norm();
        let mean = (0..n).map(apart).sum::<f64>() / n as f64;
        let motion = usual[..n].iter().map(Vector3::norm).sum::<f64>() / n as f64;
        // The paper's constants of shape are those of single prisms: twice as many are a stiffer face.
        assert!(mean < 0.35 * motion, "{mean} of {motion} mm");
    }
}
