//! Samples drawn from distributions: `[sampling]` of a recipe.
//!
//! Draws come in three stages, as the work is shared: *poses* (expression, muscles, jaw, gaze), *views* of a pose
//! (camera, occluder) and *lights* of a view. Each stage draws a point of its own space for its own number, so a sample
//! is a function of recipe and index alone. A draw that breaks a constraint is drawn again, in the stage that comes last
//! among what the constraint is about. Read next `pattern`, [`distribution`] and `apply`.

use crate::Error;
use crate::plan::Grid;
use crate::recipe::Recipe;

mod apply;
pub mod distribution;
mod pattern;

pub use apply::Scene;
pub use distribution::{Distribution, Weights};
pub use pattern::Pattern;

use pattern::{Points, mix, permuted};

/// What is drawn together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Expression, muscles, jaw, gaze: one equilibrium.
    Pose = 0,
    /// Camera and occluder: one set of primary rays.
    View = 1,
    /// Lighting: one image.
    Light = 2,
}

impl Stage {
    const ALL: [Self; 3] = [Self::Pose, Self::View, Self::Light];
}

/// A number that is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// Name in constraints, such as `yaw_deg` or `muscles.risorius`.
    pub name: String,
    /// How it is distributed.
    pub distribution: Distribution,
}

/// What one stage draws: an entry of each list, then numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Draws {
    /// How often each entry of each list comes: expressions; views and occluders; lights.
    pub picks: Vec<Weights>,
    /// The numbers.
    pub quantities: Vec<Quantity>,
}

/// What must hold for numbers that are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint {
    /// The numbers: stage and place among its quantities.
    pub of: Vec<(Stage, usize)>,
    /// Whether their signs are dropped.
    pub absolute: bool,
    /// Smallest sum.
    pub min_sum: f64,
    /// Largest sum.
    pub max_sum: f64,
    /// Only where these lists' entries are among these: stage, list, entries.
    pub when: Vec<(Stage, usize, Vec<usize>)>,
}

/// How samples are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampling {
    /// Number of samples.
    pub count: u64,
    /// How draws fill their space.
    pub pattern: Pattern,
    /// Poses of a subject that follow each other.
    pub poses_per_subject: u64,
    /// Views of each pose.
    pub views_per_pose: u64,
    /// Lightings of each view.
    pub lights_per_view: u64,
    /// How often a draw is tried.
    pub max_tries: u32,
    /// Whether expressions are drawn at an intensity, which is then the first quantity of poses.
    pub has_intensity: bool,
    /// What each stage draws.
    pub draws: [Draws; 3],
    /// What must hold.
    pub constraints: Vec<Constraint>,
    /// sRGB colours of occluders; their own if there are none.
    pub occluder_colors: Vec<[u8; 3]>,
    /// Whether projections are drawn, too: 0 through one point, 1 in parallel.
    pub has_projection: bool,
}

/// What one stage drew.
#[derive(Clone, Debug, PartialEq)]
struct Drawn {
    picks: Vec<usize>,
    values: Vec<f64>,
}

impl Sampling {
    /// The shape of the samples: subjects are visits to a subject, expressions its poses.
    pub(crate) fn grid(&self) -> Grid {
        let poses = self
            .count
            .div_ceil(self.views_per_pose * self.lights_per_view);
        Grid {
            subjects: poses.div_ceil(self.poses_per_subject),
            expressions: self.poses_per_subject,
            occluders: 1,
            views: self.views_per_pose,
            lightings: self.lights_per_view,
            samples: self.count,
        }
    }

    /// Whose turn visit number `visit` is: all of `subjects` once in a random order, then all once again in another.
    pub(crate) fn subject(seed: u64, visit: u64, subjects: u64) -> u64 {
        let turn = visit / subjects;
        permuted(visit % subjects, subjects, mix(seed ^ mix(turn) ^ 0x5eed))
    }

    /// The draws of sample `index`.
    fn draw(&self, seed: u64, index: u64) -> Result<[Drawn; 3], Error> {
        let poses = self.views_per_pose * self.lights_per_view;
        let numbers = [index / poses, index / self.lights_per_view, index];
        let lens = [
            self.count.div_ceil(poses),
            self.count.div_ceil(self.lights_per_view),
            self.count,
        ];
        let empty = || Drawn {
            picks: Vec::new(),
            values: Vec::new(),
        };
        let mut drawn = [empty(), empty(), empty()];
        for stage in Stage::ALL {
            let k = stage as usize;
            let points = Points {
                pattern: self.pattern,
                seed: mix(seed ^ mix(k as u64 + 11)),
                len: lens[k],
            };
            let mut point = vec![0.0; self.draws[k].dimensions()];
            let is_met = (0..self.max_tries).any(|retry| {
                points.point(numbers[k], retry, &mut point);
                drawn[k] = self.draws[k].at(&point);
                self.broken(stage, &drawn).is_none()
            });
            if !is_met {
                return Err(Error::Draw {
                    index,
                    tries: self.max_tries,
                    constraint: self.broken(stage, &drawn).unwrap_or(0),
                });
            }
        }
        Ok(drawn)
    }

    /// The first constraint that what was drawn up to `stage` breaks, of those that `stage` decides.
    fn broken(&self, stage: Stage, drawn: &[Drawn; 3]) -> Option<usize> {
        self.constraints.iter().position(|c| {
            let last =
                c.of.iter()
                    .map(|(s, _)| *s)
                    .chain(c.when.iter().map(|(s, _, _)| *s))
                    .max();
            last == Some(stage) && !c.holds(drawn)
        })
    }

    /// Sample `index` of a recipe.
    ///
    /// # Errors
    /// [`Error::Draw`] if a constraint is not met after all tries.
    pub(crate) fn scene<'a>(&self, recipe: &'a Recipe, index: u64) -> Result<Scene<'a>, Error> {
        let visit = index / (self.poses_per_subject * self.views_per_pose * self.lights_per_view);
        let subject = Self::subject(recipe.seed, visit, recipe.subjects.len());
        let [pose, view, light] = self.draw(recipe.seed, index)?;
        apply::scene(recipe, self, subject, [&pose, &view, &light])
    }

    /// Whether any pose may differ from the face at rest by what is added to its expression.
    pub(crate) fn moves(&self) -> bool {
        let poses = &self.draws[Stage::Pose as usize].quantities;
        poses
            .iter()
            .skip(usize::from(self.has_intensity))
            .any(|q| q.distribution.range() != [0.0; 2])
    }
}

impl Draws {
    fn dimensions(&self) -> usize {
        self.picks.len() + self.quantities.len()
    }

    fn at(&self, point: &[f64]) -> Drawn {
        let (picks, numbers) = point.split_at(self.picks.len());
        Drawn {
            picks: self
                .picks
                .iter()
                .zip(picks)
                .map(|(w, u)| w.at(*u))
                .collect(),
            values: self
                .quantities
                .iter()
                .zip(numbers)
                .map(|(q, u)| q.distribution.at(*u))
                .collect(),
        }
    }
}

impl Constraint {
    fn holds(&self, drawn: &[Drawn; 3]) -> bool {
        let concerns = |(stage, list, entries): &(Stage, usize, Vec<usize>)| {
            entries.contains(&drawn[*stage as usize].picks[*list])
        };
        if !self.when.iter().all(concerns) {
            return true;
        }
        let value = |(stage, i): &(Stage, usize)| {
            let v = drawn[*stage as usize].values[*i];
            if self.absolute { v.abs() } else { v }
        };
        let sum: f64 = self.of.iter().map(value).sum();
        (self.min_sum..=self.max_sum).contains(&sum)
    }
}
