//! A reference head from a population: the mean of at least a hundred registered faces (paper, section 3.1).
//!
//! Each round registers every scan to the current head, lays the results on each other rigidly, averages shape and
//! colour, and makes the mean symmetric; the next round registers to that, until the mean stays where it is. Topology
//! and annotations are the first head's. Source of the iteration: generalised Procrustes analysis, Gower 1975.

use facile_core::io::Scan;
use facile_core::{
    Eye, HeadShape, Isometry3, Point3, ReferenceHead, Similarity3, Subject, Texture, Vector3,
};
use rayon::prelude::*;

use crate::template::Template;
use crate::{FlowError, Registrar, RegistrationParams, eyes};
use facile_core::color::srgb8_from_linear;

/// Scans that are in memory at once.
const AT_ONCE: usize = 8;

/// When a mean is good enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PopulationParams {
    /// Fewer registered faces make no mean.
    pub at_least: usize,
    /// The mean is there when a round moves the face's surface by less than this, RMS, mm.
    pub tolerance_mm: f64,
    /// Most rounds.
    pub max_rounds: usize,
}

impl Default for PopulationParams {
    /// A hundred faces, as in the paper, to 0.1 mm.
    fn default() -> Self {
        Self {
            at_least: 100,
            tolerance_mm: 0.1,
            max_rounds: 12,
        }
    }
}

impl PopulationParams {
    fn validate(&self) -> Result<(), FlowError> {
        let tolerance = (
            "tolerance_mm",
            self.tolerance_mm,
            1e-6,
            1e3,
            "1e-6 to 1000 mm",
        );
        let rounds = ("max_rounds", self.max_rounds as f64, 1.0, 1e3, "1 to 1000");
        for (name, found, low, high, allowed) in [tolerance, rounds] {
            if !(low..=high).contains(&found) {
                return Err(FlowError::Parameter {
                    name,
                    found,
                    allowed,
                });
            }
        }
        Ok(())
    }
}

/// One round over the population.
#[derive(Clone, Debug)]
pub struct Round {
    /// Faces that were registered.
    pub faces: usize,
    /// Scans that were not, by their number, and why.
    pub failed: Vec<(usize, String)>,
    /// How far the mean face's surface moved, RMS, mm.
    pub moved_mm: f64,
    /// How far its vertices slid along the surface, RMS, mm: flat skin is not pinned by anything.
    pub slid_mm: f64,
    /// Spread of the population about its mean, RMS over the face, mm.
    pub spread_mm: f64,
}

/// A reference head and how it came to be.
#[derive(Clone, Debug)]
pub struct PopulationMean {
    /// The mean head.
    pub head: ReferenceHead,
    /// The rounds, first to last.
    pub rounds: Vec<Round>,
    /// Whether the last round moved the mean by less than the tolerance.
    pub converged: bool,
}

/// Builds the mean of `count` scans on the topology of `start`.
///
/// `load` reads a scan by its number, once in every round; `progress` hears of every round. Deterministic for any
/// number of threads. Cost: rounds x count registrations; memory: a few scans.
///
/// # Errors
/// [`FlowError::Population`] if fewer than `at_least` scans can be registered; [`FlowError::Parameter`] for values of
/// `stop` out of range; errors of [`Registrar::new`].
pub fn build_reference<E: std::fmt::Display>(
    start: &ReferenceHead,
    count: usize,
    load: impl Fn(usize) -> Result<Scan, E> + Sync,
    params: &RegistrationParams,
    stop: PopulationParams,
    mut progress: impl FnMut(&Round),
) -> Result<PopulationMean, FlowError> {
    stop.validate()?;
    let mut mean = PopulationMean {
        head: start.clone(),
        rounds: Vec::new(),
        converged: false,
    };
    while !mean.converged && mean.rounds.len() < stop.max_rounds {
        let (head, round) = one_round(&mean.head, count, &load, params, stop.at_least)?;
        progress(&round);
        mean.converged = round.moved_mm < stop.tolerance_mm;
        mean.head = head;
        mean.rounds.push(round);
    }
    Ok(mean)
}

fn one_round<E: std::fmt::Display>(
    head: &ReferenceHead,
    count: usize,
    load: &(impl Fn(usize) -> Result<Scan, E> + Sync),
    params: &RegistrationParams,
    at_least: usize,
) -> Result<(ReferenceHead, Round), FlowError> {
    let registrar = Registrar::new(head, params.clone())?;
    let mut sum = Sum::new(registrar.template());
    let mut failed = Vec::new();
    let numbers: Vec<usize> = (0..count).collect();
    for some in numbers.chunks(AT_ONCE) {
        let registered: Vec<_> = some
            .par_iter()
            .map(|&number| {
                let scan = load(number).map_err(|e| e.to_string())?;
                let has_color = scan.texture.is_some() || !scan.mesh.colors.is_empty();
                let registration = registrar.register(&scan).map_err(|e| e.to_string())?;
                Ok((registration.subject, has_color))
            })
            .collect();
        // Sums in the order of the scans, so that bits repeat.
        for (number, result) in some.iter().zip(registered) {
            match result {
                Ok((subject, has_color)) => sum.add(&subject, has_color),
                Err(reason) => failed.push((*number, reason)),
            }
        }
    }
    if sum.faces < at_least.max(1) {
        return Err(FlowError::Population {
            registered: sum.faces,
            given: count,
            needed: at_least.max(1),
            example: failed.into_iter().next().map(|f| f.1),
        });
    }
    let shape = sum.mean();
    let next = head.reshaped(shape);
    let [moved_mm, slid_mm] = sum.motion(&next.mesh.positions);
    let round = Round {
        faces: sum.faces,
        failed,
        moved_mm,
        slid_mm,
        spread_mm: sum.spread(),
    };
    Ok((next, round))
}

/// Sums over the registered faces.
struct Sum<'a> {
    template: &'a Template<'a>,
    /// Area of each vertex of the face, 0 elsewhere.
    weights: Vec<f64>,
    faces: usize,
    positions: Vec<Vector3>,
    /// Sum of the weighted squared distances to the head that was registered to.
    squares: f64,
    colored: usize,
    /// Sums of linear colours at the texels of the head's texture.
    texels: Vec<[f32; 3]>,
}

impl<'a> Sum<'a> {
    fn new(template: &'a Template<'a>) -> Self {
        let inside = template.face.iter().zip(&template.areas);
        Self {
            template,
            weights: (inside.map(|(face, area)| if *face { *area } else { 0.0 })).collect(),
            faces: 0,
            positions: vec![Vector3::zeros(); template.areas.len()],
            squares: 0.0,
            colored: 0,
            texels: vec![[0.0; 3]; template.reference.texture.texels().len()],
        }
    }

    /// Lays a face on the current mean, turned and moved but not scaled, and adds it.
    fn add(&mut self, subject: &Subject, has_color: bool) {
        let mean = &self.template.reference.mesh.positions;
        let motion = rigid_fit(&subject.positions, mean, &self.weights);
        for ((sum, p), (at, w)) in
            (self.positions.iter_mut().zip(&subject.positions)).zip(mean.iter().zip(&self.weights))
        {
            let place = motion * p;
            *sum += place.coords;
            self.squares += w * (place - at).norm_squared();
        }
        self.faces += 1;
        if has_color {
            self.colored += 1;
            let width = self.template.reference.texture.width();
            let height = self.template.reference.texture.height();
            for (i, sum) in self.texels.iter_mut().enumerate() {
                let (x, y) = (i % width, i / width);
                let u = (x as f32 + 0.5) / width as f32;
                let v = 1.0 - (y as f32 + 0.5) / height as f32;
                for (s, t) in sum.iter_mut().zip(subject.texture.sample([u, v])) {
                    *s += t;
                }
            }
        }
    }

    /// The symmetric mean. Without colours in the population the head keeps its own.
    fn mean(&self) -> HeadShape {
        let head = self.template.reference;
        let share = 1.0 / self.faces as f64;
        let positions: Vec<Point3> = (self.positions.iter())
            .map(|sum| Point3::from(sum * share))
            .collect();
        let cage = symmetric(head, &head.cage_from_fine(&positions));
        let fine = (self.template).fine(&cage.iter().map(|p| p.coords).collect::<Vec<_>>());
        let [left, right] = eyes::place_eyes(head, &fine);
        let texture = if self.colored > 0 {
            let share = 1.0 / self.colored as f32;
            let texels = self.texels.iter();
            let encode = |c: &[f32; 3]| c.map(|v| srgb8_from_linear(v * share));
            let own = &head.texture;
            Texture::new(own.width(), own.height(), texels.map(encode).collect())
        } else {
            head.texture.clone()
        };
        HeadShape {
            cage,
            eyes: symmetric_eyes(left, right),
            skull_from_reference: symmetric_motion(&eyes::place_skull(head, &fine)),
            texture,
        }
    }

    /// RMS motion over the face from the head that was registered to: of the surface and along it, mm.
    fn motion(&self, positions: &[Point3]) -> [f64; 2] {
        let mesh = &self.template.reference.mesh;
        let normals = mesh.vertex_normals();
        let mut squares = [0.0; 2];
        for v in 0..positions.len() {
            let step = positions[v] - mesh.positions[v];
            let across = step.dot(&normals[v]);
            squares[0] += self.weights[v] * across.powi(2);
            squares[1] += self.weights[v] * (step - normals[v] * across).norm_squared();
        }
        let total: f64 = self.weights.iter().sum();
        squares.map(|s| (s / total).sqrt())
    }

    /// RMS distance over the face of the population to the head that was registered to, mm.
    fn spread(&self) -> f64 {
        (self.squares / self.faces as f64 / self.weights.iter().sum::<f64>()).sqrt()
    }
}

/// The rotation and translation that lay `from` on `to` with the least weighted squares.
fn rigid_fit(from: &[Point3], to: &[Point3], weights: &[f64]) -> Isometry3 {
    let Some(fit) = facile_core::math::fit_similarity(from, to, weights) else {
        return Isometry3::identity();
    };
    let total: f64 = weights.iter().sum();
    let center = (from.iter().zip(weights)).fold(Vector3::zeros(), |s, (p, w)| s + p.coords * *w);
    let center = Point3::from(center / total);
    let rotation = fit.isometry.rotation;
    let shift = (fit * center).coords - rotation * center.coords;
    Isometry3::from_parts(shift.into(), rotation)
}

/// Mean of a cage and its mirror image.
fn symmetric(head: &ReferenceHead, cage: &[Point3]) -> Vec<Point3> {
    (cage.iter().zip(&head.cage.mirror))
        .map(|(p, m)| {
            let q = cage[*m as usize];
            Point3::new(0.5 * (p.x - q.x), 0.5 * (p.y + q.y), 0.5 * (p.z + q.z))
        })
        .collect()
}

fn symmetric_eyes(left: Eye, right: Eye) -> [Eye; 2] {
    let (l, r) = (left.center, right.center);
    let center = Point3::new(0.5 * (l.x - r.x), 0.5 * (l.y + r.y), 0.5 * (l.z + r.z));
    let radius = 0.5 * (left.radius + right.radius);
    let mirrored = Point3::new(-center.x, center.y, center.z);
    [center, mirrored].map(|center| Eye { center, radius })
}

/// A motion without its part across the mid-plane: turned about x only, moved along y and z.
fn symmetric_motion(motion: &Similarity3) -> Similarity3 {
    let (turn, _, _) = motion.isometry.rotation.euler_angles();
    let mut shift = motion.isometry.translation;
    shift.vector.x = 0.0;
    let rotation = facile_core::UnitQuaternion::from_euler_angles(turn, 0.0, 0.0);
    Similarity3::from_parts(shift, rotation, motion.scaling())
}
