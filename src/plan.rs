//! The plan: which samples a recipe has, which share work, and what a run will cost.
//!
//! A sample's index is its position in mixed radix, subjects slowest, then expressions, occluders, views, and lightings
//! fastest. Neighbours thus share what is dear: all samples of one (subject, expression) share an equilibrium and form
//! a *group*, the unit of work and of resuming; all lightings of one view share its primary rays and maps.

use std::ops::Range;

use serde::Serialize;

use crate::recipe::Recipe;

/// The shape of the grid of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Grid {
    /// Number of subjects.
    pub subjects: u64,
    /// Number of expressions, each intensity counted.
    pub expressions: u64,
    /// Number of occluders, `none` counted.
    pub occluders: u64,
    /// Number of viewpoints.
    pub views: u64,
    /// Number of lightings.
    pub lightings: u64,
}

/// Which entry of each list makes a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Factors {
    /// Index of the subject.
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
        Self {
            subjects: recipe.subjects.len(),
            expressions: recipe.expressions.len() as u64,
            occluders: recipe.occluders.len() as u64,
            views: recipe.views.len() as u64,
            lightings: recipe.lightings.len() as u64,
        }
    }

    /// Number of samples.
    pub fn len(&self) -> u64 {
        self.groups() * self.group_len()
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of groups: pairs of subject and expression.
    pub fn groups(&self) -> u64 {
        self.subjects * self.expressions
    }

    /// Number of samples in each group.
    pub fn group_len(&self) -> u64 {
        self.occluders * self.views * self.lightings
    }

    /// The samples of group `group`.
    pub fn group_samples(&self, group: u64) -> Range<u64> {
        group * self.group_len()..(group + 1) * self.group_len()
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
            let grid = Grid { subjects, expressions, occluders, views, lightings };
            let index = (grid.len() as f64 * share) as u64;
            let factors = grid.factors(index).expect("in range");
            prop_assert_eq!(grid.index(&factors), index);
        }
    }
}
