//! Coarser and finer simulation meshes: what a solve costs and how far it is from the truth at other numbers of nodes.
//!
//! A [`Resolution`] is the reference head with another cage. [`Resolution::finer`] takes the fine vertices, or a part of
//! them, as the cage; annotations between old vertices are means, so that muscles, lips, lids and borders stay where they
//! are. [`Resolution::coarser`] takes vertices away and keeps the others with all that is known of them.
//! [`Resolution::subject`] takes a subject along, [`Resolution::carry`] brings back how its skin moved.

use std::collections::BTreeMap;

use facile_core::reference::{Cage, Role};
use facile_core::subdivision::{Subdivision, catmull_clark};
use facile_core::{Mesh, Point3, ReferenceHead, Subject, Vector3};

use crate::SimError;
use crate::params::PaperParams;

mod coarsen;
mod sheet;

/// Steps of [`interpolated`]: what is left is below a millionth of what subdivision rounds off.
const INTERPOLATION_STEPS: usize = 60;

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
    origin: Origin,
}

/// How a cage lies on the one it was made from.
#[derive(Clone, Debug)]
struct Origin {
    /// Fine vertex of the old head under each new cage vertex.
    source: Vec<u32>,
    /// Whether the skin goes through those vertices. A finer cage is the next net of the same smooth surface instead.
    is_exact: bool,
    /// Where each old cage vertex lies on the new cage: corners and barycentric weights.
    places: Vec<([u32; 3], [f64; 3])>,
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
        let places = (0..n as u32).map(|v| ([v; 3], [1.0, 0.0, 0.0])).collect();
        let origin = Origin {
            source,
            is_exact: false,
            places,
        };
        Self::new(head, &parents, faces, origin)
    }

    /// Takes vertices out of the simulation mesh of `head` until `nodes` free ones a layer are left, or one less: edges
    /// collapse, the cheapest first, with their mirror images. Rims of lips and lids and the border of the simulated
    /// skin keep their lines, the mesh its topology. Quads become triangles. Cost O(n log n).
    ///
    /// Source: Garland and Heckbert 1997, with half-edge collapses and the length of edges.
    ///
    /// # Errors
    /// [`SimError::OutOfRange`] if `head` has fewer nodes, or so few cannot carry its shape, with how few can.
    pub fn coarser(head: &ReferenceHead, nodes: usize) -> Result<Self, SimError> {
        let out_of_range = |min: usize, max: usize| SimError::OutOfRange {
            what: "nodes a layer of a coarser mesh".to_owned(),
            value: nodes as f64,
            min: min as f64,
            max: max as f64,
        };
        let old = &head.cage;
        let mut coarsening = coarsen::Coarsening::new(head);
        let all = coarsening.free;
        let left = coarsening.until(nodes);
        if nodes > all || left > nodes {
            return Err(out_of_range(coarsening.until(0), all));
        }
        let sheet = coarsening.sheet;
        let source: Vec<u32> = (0..old.positions.len() as u32)
            .filter(|&v| sheet.is_left(v))
            .collect();
        let mut number = vec![0; old.positions.len()];
        for (k, &v) in source.iter().enumerate() {
            number[v as usize] = k as u32;
        }
        let renumbered = |face: [u32; 3]| face.map(|v| number[v as usize]);
        let faces = sheet.triangles().map(|t| renumbered(t).to_vec()).collect();
        let places = (0..old.positions.len() as u32)
            .map(|v| sheet.place(v))
            .map(|(face, weights)| (renumbered(face), weights))
            .collect();
        let parents: Vec<Parents> = source.iter().map(|&v| Parents(vec![v])).collect();
        let origin = Origin {
            source,
            is_exact: true,
            places,
        };
        Ok(Self::new(head, &parents, faces, origin))
    }

    fn new(
        head: &ReferenceHead,
        parents: &[Parents],
        faces: Vec<Vec<u32>>,
        origin: Origin,
    ) -> Self {
        let subdivision = catmull_clark(parents.len(), &faces);
        let positions = origin.net(&subdivision, &head.mesh.positions);
        let mesh = Mesh {
            positions: refined(&subdivision, &positions),
            triangles: subdivision
                .quads
                .iter()
                .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
                .collect(),
            ..Mesh::default()
        };
        Self {
            head: ReferenceHead {
                cage: annotated(&head.cage, parents, faces, positions),
                subdivision,
                mesh,
                ..head.clone()
            },
            origin,
        }
    }

    /// A subject of the head this was made from.
    pub fn subject(&self, subject: &Subject) -> Subject {
        let subdivision = &self.head.subdivision;
        let cage = self.origin.net(subdivision, &subject.positions);
        let positions = refined(subdivision, &cage);
        Subject {
            expected_error: vec![0.0; positions.len()],
            positions,
            ..subject.clone()
        }
    }

    /// How the cage vertices of the head this was made from move, if those of the new cage move like `moved` (which may go
    /// on with other fine vertices): linear in each face, at the place of the face nearest to a vertex that was taken away.
    ///
    /// # Panics
    /// If `moved` has fewer entries than the new cage has vertices.
    pub fn carry(&self, moved: &[Vector3]) -> Vec<Vector3> {
        let at = |(corners, weights): &([u32; 3], [f64; 3])| -> Vector3 {
            let parts = corners.iter().zip(weights);
            parts.map(|(&v, w)| moved[v as usize] * *w).sum()
        };
        self.origin.places.iter().map(at).collect()
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

impl Origin {
    /// The new cage over a shape of the old head's fine mesh: its vertices, or what subdivision takes to them.
    fn net(&self, subdivision: &Subdivision, fine: &[Point3]) -> Vec<Point3> {
        let points: Vec<Point3> = self.source.iter().map(|&v| fine[v as usize]).collect();
        if self.is_exact {
            interpolated(subdivision, &points)
        } else {
            points
        }
    }
}

fn refined(subdivision: &Subdivision, cage: &[Point3]) -> Vec<Point3> {
    let coords: Vec<Vector3> = cage.iter().map(|p| p.coords).collect();
    let fine = subdivision.stencils.apply(&coords, Vector3::zeros());
    fine.into_iter().map(Point3::from).collect()
}

/// The cage whose subdivision goes through `points`, one for each of its vertices: what the stencils round off is put
/// back until nothing is left.
fn interpolated(subdivision: &Subdivision, points: &[Point3]) -> Vec<Point3> {
    let stencils = &subdivision.stencils;
    let mut cage: Vec<Vector3> = points.iter().map(|p| p.coords).collect();
    for _ in 0..INTERPOLATION_STEPS {
        let missing: Vec<Vector3> = points
            .iter()
            .enumerate()
            .map(|(v, p)| {
                let row = stencils.row(v).iter();
                p.coords
                    - row
                        .map(|&(w, weight)| cage[w as usize] * weight)
                        .sum::<Vector3>()
            })
            .collect();
        cage.iter_mut().zip(missing).for_each(|(p, d)| *p += d);
    }
    cage.into_iter().map(Point3::from).collect()
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
mod tests;
