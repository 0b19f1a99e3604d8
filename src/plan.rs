//! The plan: which samples a recipe has, which share work, and what a run will cost.
//!
//! A sample's index is its position in mixed radix, subjects slowest, then expressions, occluders, views, and lightings
//! fastest. Neighbours thus share what is dear: all samples of one (subject, expression) share an equilibrium and form
//! a *group*, the unit of work and of resuming; all lightings of one view share its primary rays and maps. Samples that
//! are drawn (`[sampling]`) have the same shape: visits to a subject, poses of a visit, views of a pose, lights of a view.

use std::borrow::Cow;
use std::ops::Range;

use serde::Serialize;

use crate::Error;
use crate::recipe::Recipe;
use crate::sampling::{Sampling, Scene};

/// The shape of the grid of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Grid {
    /// Number of subjects; of visits to one where samples are drawn.
    pub subjects: u64,
    /// Number of expressions, each intensity counted; of poses of a visit where samples are drawn.
    pub expressions: u64,
    /// Number of occluders, `none` counted.
    pub occluders: u64,
    /// Number of viewpoints.
    pub views: u64,
    /// Number of lightings.
    pub lightings: u64,
    /// Number of samples: the product of the others, or less where samples are drawn and the last visit is cut short.
    pub samples: u64,
}

/// Which entry of each list makes a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Factors {
    /// Index of the subject, or of the visit to one.
    pub subject: u64,
    /// Index of the expression.
    pub expression: usize,
    /// Index of the occluder.
    pub occluder: usize,
    /// Index of the viewpoint.
    pub view: usize,
    /// Index of the lighting.
    pub lighting: usize,
}

impl Grid {
    /// The grid of a recipe.
    pub fn of(recipe: &Recipe) -> Self {
        if let Some(sampling) = &recipe.sampling {
            return sampling.grid();
        }
        Self::product([
            recipe.subjects.len(),
            recipe.expressions.len() as u64,
            recipe.occluders.len() as u64,
            recipe.views.len() as u64,
            recipe.lightings.len() as u64,
        ])
    }

    /// The grid of all combinations of so many subjects, expressions, occluders, views and lightings.
    pub fn product([subjects, expressions, occluders, views, lightings]: [u64; 5]) -> Self {
        Self {
            subjects,
            expressions,
            occluders,
            views,
            lightings,
            samples: subjects * expressions * occluders * views * lightings,
        }
    }

    /// Number of samples.
    pub fn len(&self) -> u64 {
        self.samples
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of groups: pairs of subject and expression.
    pub fn groups(&self) -> u64 {
        self.samples.div_ceil(self.group_len())
    }

    /// Number of samples in each group.
    pub fn group_len(&self) -> u64 {
        self.occluders * self.views * self.lightings
    }

    /// The samples of group `group`.
    pub fn group_samples(&self, group: u64) -> Range<u64> {
        let start = group * self.group_len();
        start.min(self.samples)..(start + self.group_len()).min(self.samples)
    }

    /// The samples of a subject, or of a visit to one.
    pub fn subject_samples(&self, subject: u64) -> Range<u64> {
        let len = self.group_len() * self.expressions;
        (subject * len).min(self.samples)..((subject + 1) * len).min(self.samples)
    }

    /// Subject and expression of group `group`.
    pub fn group_factors(&self, group: u64) -> (u64, usize) {
        (
            group / self.expressions,
            (group % self.expressions) as usize,
        )
    }

    /// The factors of sample `index`; `None` from [`Self::len`] on.
    pub fn factors(&self, index: u64) -> Option<Factors> {
        if index >= self.len() {
            return None;
        }
        let mut rest = index;
        let mut digit = |radix: u64| {
            let digit = rest % radix;
            rest /= radix;
            digit
        };
        let (lighting, view) = (digit(self.lightings), digit(self.views));
        let (occluder, expression) = (digit(self.occluders), digit(self.expressions));
        Some(Factors {
            subject: rest,
            expression: expression as usize,
            occluder: occluder as usize,
            view: view as usize,
            lighting: lighting as usize,
        })
    }

    /// The index of the sample with these factors.
    pub fn index(&self, f: &Factors) -> u64 {
        let digits = [
            (f.expression as u64, self.expressions),
            (f.occluder as u64, self.occluders),
            (f.view as u64, self.views),
            (f.lighting as u64, self.lightings),
        ];
        digits
            .iter()
            .fold(f.subject, |index, (digit, radix)| index * radix + digit)
    }
}

impl Recipe {
    /// What sample `index` shows.
    ///
    /// # Errors
    /// [`Error::Index`] beyond the last sample; [`Error::Draw`] if no draw meets the constraints.
    pub fn scene(&self, index: u64) -> Result<Scene<'_>, Error> {
        let grid = Grid::of(self);
        let len = grid.len();
        let Some(factors) = grid.factors(index) else {
            return Err(Error::Index { index, len });
        };
        match &self.sampling {
            Some(sampling) => sampling.scene(self, index),
            None => Ok(Scene {
                subject: factors.subject,
                expression: Cow::Borrowed(&self.expressions[factors.expression]),
                occluder: Cow::Borrowed(&self.occluders[factors.occluder]),
                view: self.views[factors.view],
                lighting: Cow::Borrowed(&self.lightings[factors.lighting]),
            }),
        }
    }

    /// The subject of a visit, which is its number unless samples are drawn.
    pub fn subject_of_visit(&self, visit: u64) -> u64 {
        if self.sampling.is_some() {
            Sampling::subject(self.seed, visit, self.subjects.len())
        } else {
            visit
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GRID: Grid = Grid {
        subjects: 3,
        expressions: 4,
        occluders: 2,
        views: 5,
        lightings: 3,
        samples: 360,
    };

    #[test]
    fn lightings_run_fastest_and_subjects_slowest() {
        assert_eq!(GRID.len(), 360);
        assert_eq!(GRID.factors(1).expect("in range").lighting, 1);
        assert_eq!(GRID.factors(3).expect("in range").view, 1);
        assert_eq!(GRID.factors(359).expect("in range").subject, 2);
        assert_eq!(GRID.factors(360), None);
    }

    #[test]
    fn groups_tile_the_samples() {
        let mut next = 0;
        for group in 0..GRID.groups() {
            let samples = GRID.group_samples(group);
            assert_eq!(samples.start, next);
            next = samples.end;
            for index in samples {
                let f = GRID.factors(index).expect("in range");
                assert_eq!((f.subject, f.expression), GRID.group_factors(group));
            }
        }
        assert_eq!(next, GRID.len());
    }

    proptest! {
        #[test]
        fn factors_invert_the_index(
            subjects in 1_u64..1_000_000_000, expressions in 1_u64..40, occluders in 1_u64..5,
            views in 1_u64..50, lightings in 1_u64..10, share in 0.0..1.0_f64,
        ) {
            let grid = Grid::product([subjects, expressions, occluders, views, lightings]);
            let index = (grid.len() as f64 * share) as u64;
            let factors = grid.factors(index).expect("in range");
            prop_assert_eq!(grid.index(&factors), index);
        }
    }
}
