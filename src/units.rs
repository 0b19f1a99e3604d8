//! How a run is cut: into units that are stored and resumed as a whole, chunks that one thread makes, and parts that one
//! process makes.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::plan::Grid;
use crate::recipe::Recipe;

/// Fewest samples of a chunk where groups are small, and most.
const USUAL_CHUNK: u64 = 16;
const LARGEST_CHUNK: u64 = 256;

/// The samples of a run cut into *units* of consecutive ones, and these into *chunks*.
///
/// A unit is stored, hashed and resumed as a whole: a few groups in a folder of images, one file in sharded formats. A
/// chunk is made by one thread from start to end. Both depend on the recipe alone, never on threads or shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Units {
    samples: u64,
    unit_len: u64,
    group_len: u64,
    chunk_len: u64,
}

impl Units {
    /// The units of the first `samples` samples of a recipe.
    pub fn of(recipe: &Recipe, samples: u64) -> Self {
        Self::new(&Grid::of(recipe), recipe.images_per_file(), samples)
    }

    /// Units of `unit_len` samples; of whole groups if that is `None`.
    fn new(grid: &Grid, unit_len: Option<u64>, samples: u64) -> Self {
        let group_len = grid.group_len();
        let chunk_len = if group_len <= LARGEST_CHUNK {
            group_len * (USUAL_CHUNK / group_len).max(1)
        } else {
            // Lightings of one view stay together.
            let pieces = group_len.div_ceil(LARGEST_CHUNK);
            group_len.div_ceil(pieces).next_multiple_of(grid.lightings)
        };
        Self {
            samples: samples.min(grid.len()),
            unit_len: unit_len.unwrap_or(chunk_len.max(group_len)),
            group_len,
            chunk_len,
        }
    }

    /// Number of units.
    pub fn len(&self) -> u64 {
        self.samples.div_ceil(self.unit_len)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.samples == 0
    }

    /// Number of samples in all units but the last.
    pub fn unit_len(&self) -> u64 {
        self.unit_len
    }

    /// The samples of unit `unit`.
    pub fn samples(&self, unit: u64) -> Range<u64> {
        let start = unit.saturating_mul(self.unit_len);
        start.min(self.samples)..start.saturating_add(self.unit_len).min(self.samples)
    }

    /// The chunks of unit `unit`, in order.
    pub fn chunks(&self, unit: u64) -> Vec<Range<u64>> {
        let Range { mut start, end } = self.samples(unit);
        let mut chunks = Vec::new();
        while start < end {
            let stop = self.next_boundary(start).min(end);
            chunks.push(start..stop);
            start = stop;
        }
        chunks
    }

    fn next_boundary(&self, index: u64) -> u64 {
        if self.chunk_len >= self.group_len {
            return (index / self.chunk_len + 1) * self.chunk_len;
        }
        let group = index / self.group_len * self.group_len;
        let within = (index - group) / self.chunk_len + 1;
        group + (within * self.chunk_len).min(self.group_len)
    }

    /// The units of one part of the run, or of all of it.
    pub fn of_part(&self, part: Option<Part>) -> Range<u64> {
        let Some(part) = part else {
            return 0..self.len();
        };
        let cut = |k: u64| (u128::from(self.len()) * u128::from(k) / u128::from(part.count)) as u64;
        cut(part.index - 1)..cut(part.index)
    }
}

/// One of several equal parts of a run, each made by a process of its own: `I/N`, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Part {
    index: u64,
    count: u64,
}

impl Part {
    /// Part `index` of `count`, counted from 1; `None` if there is no such part.
    pub fn new(index: u64, count: u64) -> Option<Self> {
        (1..=count)
            .contains(&index)
            .then_some(Self { index, count })
    }

    /// Its number, from 1.
    pub fn index(self) -> u64 {
        self.index
    }

    /// The number of parts.
    pub fn count(self) -> u64 {
        self.count
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Part {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| {
            Part::new(index.trim().parse().ok()?, count.trim().parse().ok()?)
        });
        numbers
            .ok_or_else(|| format!("expected I/N with I from 1 to N, such as 1/4, found `{text}`"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn chunks_tile_units_and_units_tile_the_samples(
            samples in 0_u64..5_000, views in 1_u64..200, lightings in 1_u64..9, shard in 0_u64..700,
        ) {
            let grid = Grid::product([9_000, 1, 1, views, lightings]);
            let units = Units::new(&grid, (shard > 0).then_some(shard), samples);
            let mut next = 0;
            for unit in 0..units.len() {
                prop_assert_eq!(units.samples(unit).start, next);
                for chunk in units.chunks(unit) {
                    prop_assert_eq!(chunk.start, next);
                    prop_assert!(chunk.end > chunk.start && chunk.end - chunk.start <= LARGEST_CHUNK + lightings);
                    next = chunk.end;
                }
                prop_assert_eq!(units.samples(unit).end, next);
            }
            prop_assert_eq!(next, samples);
        }

        #[test]
        fn parts_tile_the_units(samples in 0_u64..5_000, count in 1_u64..12) {
            let grid = Grid::product([9_000, 1, 1, 3, 2]);
            let units = Units::new(&grid, Some(50), samples);
            let mut next = 0;
            for index in 1..=count {
                let share = units.of_part(Part::new(index, count));
                prop_assert_eq!(share.start, next);
                next = share.end;
            }
            prop_assert_eq!(next, units.len());
        }
    }

    #[test]
    fn a_part_reads_as_it_prints() {
        let part: Part = "2/7".parse().expect("a part");
        assert_eq!((part.index(), part.count()), (2, 7));
        assert_eq!(part.to_string(), "2/7");
        for bad in ["0/3", "4/3", "1/0", "1", "a/b", ""] {
            assert!(bad.parse::<Part>().is_err(), "{bad}");
        }
    }
}
