//! No text makes the recipe's parser panic, and errors point into it.

use std::path::Path;

use facile::core::rng::RandomStream;
use facile::plan::Grid;
use facile::{Error, Recipe};

const RECIPE: &str = r#"
[dataset]
name = "edited"
formats = ["folder", "parquet"]

[image]
size = [32, 32]
samples = "adaptive"
landmarks = ["ibug68"]

[subjects]
sampled = 4

[[expression]]
name = "smirk"
muscles = { "zygomatic_major.left" = 0.8, risorius = 0.4 }
action_units = { AU4 = 0.5 }

[[light]]
name = "key"
sources = [{ kind = "spot", position = [300, 250, 700], target = [0, 0, 0], angle_deg = 20 }]

[[view]]
yaw_deg = [-30, 0]

[[occluder]]
kind = "glasses"
size = 1.1

[sampling]
count = 43
pattern = "sobol"
expression = { weights = { smirk = 1 }, intensity = { normal = [0.5, 0.2], within = [0, 1] } }
light = { turn_deg = { uniform = [-70, 70] }, z_mm = { choice = [0, 100], weights = [1, 2] } }

[[sampling.constraint]]
of = ["light.turn_deg", "intensity"]
absolute = true
max_sum = 60
"#;

/// A piece of a recipe in the place of another, or anything.
fn edited(random: &mut RandomStream) -> String {
    const PIECES: [&str; 18] = [
        "-1",
        "1e308",
        "nan",
        "inf",
        "9223372036854775807",
        "0",
        "\"\"",
        "[]",
        "{}",
        "[[",
        "]]",
        "=",
        "\n",
        "#",
        "true",
        "[0, 0]",
        "\u{fffd}",
        "../x",
    ];
    let mut text = RECIPE.to_owned();
    for _ in 0..=random.index(3) {
        let bounds: Vec<usize> = text.char_indices().map(|(i, _)| i).collect();
        let mut at = random.index(bounds.len());
        let mut end = (at + random.index(12)).min(bounds.len() - 1);
        let piece = match random.index(6) {
            0 => String::new(),
            1 => PIECES[random.index(PIECES.len())].to_owned(),
            2 => {
                let from = random.index(bounds.len());
                let to = (from + random.index(20)).min(bounds.len() - 1);
                text[bounds[from]..bounds[to]].to_owned()
            }
            // Another digit: most of these recipes are right.
            _ => {
                let is_digit = |i: &usize| text.as_bytes()[bounds[*i]].is_ascii_digit();
                let digits: Vec<usize> = (0..bounds.len() - 1).filter(is_digit).collect();
                at = digits[random.index(digits.len())];
                end = at + 1;
                random.index(10).to_string()
            }
        };
        text.replace_range(bounds[at]..bounds[end], &piece);
    }
    text
}

/// Parses so many edited recipes; returns how many were accepted.
fn survive(executions: u32, seed: u64) -> u32 {
    let mut random = RandomStream::new(seed, 0);
    let mut accepted = 0;
    for _ in 0..executions {
        let text = edited(&mut random);
        match Recipe::parse(&text, Path::new("r.toml"), Path::new("")) {
            Ok(recipe) => {
                accepted += 1;
                // What is accepted can be planned.
                let last = Grid::of(&recipe).len() - 1;
                let scene = recipe.scene(last);
                assert!(
                    matches!(scene, Ok(_) | Err(Error::Draw { .. })),
                    "{scene:?}\n{text}"
                );
            }
            Err(Error::Recipe(error)) => assert!(!error.to_string().is_empty()),
            Err(error) => panic!("{error}\n{text}"),
        }
    }
    accepted
}

#[test]
fn edited_recipes_are_refused_or_planned() {
    let accepted = survive(1_500, 1);
    assert!(
        (50..1_450).contains(&accepted),
        "{accepted} of 1500 accepted"
    );
}

#[test]
#[ignore = "takes minutes: the long run of the release check"]
fn a_hundred_thousand_edited_recipes_are_refused_or_planned() {
    survive(100_000, 2);
}
