//! Every parser of files from outside, on edited files: none panics, hangs, or takes memory that its input does not justify.
//!
//! An execution edits a seed, or puts random bytes behind its beginning, and parses it. An input with a new outcome (its error, names and numbers left out) becomes a
//! seed itself, so that edits get further. `cargo test` replays the corpus and makes [`USUAL`] executions of each parser;
//!
//! ```sh
//! FACILE_FUZZ=1000000 cargo test --test fuzz -- --nocapture            # so many of each parser
//! FACILE_FUZZ_KEEP=1 FACILE_FUZZ=100000 cargo test --test fuzz         # and add what is new to tests/fuzz/corpus
//! ```
//!
//! What breaks a parser is written to the corpus before the test fails: fix the parser and commit both.

mod edits;
mod parsers;

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use facile::core::rng::RandomStream;

use edits::{edited, noise};
use parsers::{PARSERS, Parser};

/// Executions of each parser in `cargo test`.
const USUAL: u64 = 400;
/// One execution in so many is on random bytes.
const NOISE: usize = 16;
/// No execution takes as long: inputs are a few kilobytes.
const SLOWEST: Duration = Duration::from_secs(20);
/// Most seeds of a parser, and most that are kept in the corpus.
const MOST_SEEDS: usize = 400;
const MOST_KEPT: usize = 20;
/// Largest seed: edits of larger ones are slow and find the same.
const LARGEST_SEED: usize = 16 << 10;
/// Memory that the process may come to need, bytes; no input of a few kilobytes justifies more.
const MOST_MEMORY: u64 = 1 << 30;

/// What is known of a parser.
struct Campaign {
    parser: &'static Parser,
    folder: PathBuf,
    seeds: Vec<Vec<u8>>,
    outcomes: BTreeSet<String>,
    keeps: bool,
}

impl Campaign {
    fn of(parser: &'static Parser) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/fuzz/corpus")
            .join(parser.name);
        let mut campaign = Self {
            parser,
            folder,
            seeds: Vec::new(),
            outcomes: BTreeSet::new(),
            keeps: false,
        };
        for seed in (parser.seeds)() {
            campaign.execute(&seed);
        }
        let found = std::fs::read_dir(&campaign.folder);
        let mut files: Vec<PathBuf> = found
            .into_iter()
            .flatten()
            .flatten()
            .map(|f| f.path())
            .collect();
        files.sort();
        for file in files {
            campaign.execute(&std::fs::read(file).expect("reads"));
        }
        campaign.keeps = std::env::var_os("FACILE_FUZZ_KEEP").is_some();
        campaign
    }

    /// Parses, and keeps an input whose outcome is new.
    fn execute(&mut self, input: &[u8]) {
        let begun = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| (self.parser.parse)(input)));
        let Ok(outcome) = outcome else {
            let place = self.save(input, "panic");
            panic!("{}: panicked on {}", self.parser.name, place.display());
        };
        if begun.elapsed() > SLOWEST {
            let place = self.save(input, "slow");
            panic!(
                "{}: {:?} for {}",
                self.parser.name,
                begun.elapsed(),
                place.display()
            );
        }
        let is_new = self.outcomes.insert(kind_of(&outcome));
        if is_new && input.len() <= LARGEST_SEED && self.seeds.len() < MOST_SEEDS {
            if self.keeps && input.len() <= 2 << 10 && self.seeds.len() < MOST_KEPT {
                self.save(input, "seed");
            }
            self.seeds.push(input.to_vec());
        }
    }

    fn save(&self, input: &[u8], what: &str) -> PathBuf {
        std::fs::create_dir_all(&self.folder).expect("makes");
        let hash = input.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
            (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3)
        });
        let place = self.folder.join(format!("{what}-{hash:016x}"));
        std::fs::write(&place, input).expect("writes");
        place
    }

    fn run(&mut self, executions: u64, random: &mut RandomStream) {
        for _ in 0..executions {
            let input = if random.index(NOISE) == 0 {
                noise(&self.seeds, random)
            } else {
                edited(&self.seeds, self.parser.words, random)
            };
            self.execute(&input);
        }
    }
}

/// The words of an outcome's first and last line before anything that they quote.
fn kind_of(outcome: &str) -> String {
    let (first, last) = (outcome.lines().next(), outcome.lines().next_back());
    let words = [first, last].into_iter().flatten().flat_map(|line| {
        let said = line.split(['`', '"', '\'']).next().unwrap_or_default();
        let letters = |c: &char| c.is_ascii_alphabetic() || *c == ' ';
        said.chars().filter(letters).take(100)
    });
    words.collect()
}

/// The most memory that this process has had, bytes; 0 where the system does not tell.
fn most_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|l| l.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) << 10
}

#[test]
fn no_edited_file_breaks_a_parser() {
    let asked = std::env::var("FACILE_FUZZ")
        .ok()
        .and_then(|n| n.parse::<u64>().ok());
    let seed = asked.map_or(1, |n| n + 1);
    for (number, parser) in PARSERS.iter().enumerate() {
        let begun = Instant::now();
        let mut campaign = Campaign::of(parser);
        let executions = (asked.unwrap_or(USUAL) / parser.cost).max(1);
        campaign.run(executions, &mut RandomStream::new(seed, number as u64));
        assert!(
            campaign.outcomes.len() >= parser.least_outcomes,
            "{}: edits reach {} outcomes: {:#?}",
            parser.name,
            campaign.outcomes.len(),
            campaign.outcomes
        );
        eprintln!(
            "{}: {executions} executions, {} outcomes, {:.0} s",
            parser.name,
            campaign.outcomes.len(),
            begun.elapsed().as_secs_f64()
        );
    }
    assert!(most_memory() < MOST_MEMORY, "{} bytes", most_memory());
}
