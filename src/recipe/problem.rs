//! Where a recipe is wrong: places in the tree of tables, and the error that shows them in the text.

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};

/// An error in a recipe, with its place in the file, what is wrong there and what is allowed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecipeError {
    /// The recipe.
    pub path: PathBuf,
    /// Line from 1; 0 if the error has no place in the text.
    pub line: usize,
    /// Column from 1, in characters.
    pub column: usize,
    /// Number of characters that are wrong, at least 1.
    pub width: usize,
    /// The text of the line.
    pub source_line: String,
    /// What is wrong.
    pub message: String,
    /// What is allowed.
    pub help: Option<String>,
}

impl RecipeError {
    /// An error at a byte range of the recipe's text.
    pub(crate) fn at(
        path: &Path,
        text: &str,
        span: Option<Range<usize>>,
        message: String,
        help: Option<String>,
    ) -> Self {
        let mut error = Self {
            path: path.to_owned(),
            line: 0,
            column: 0,
            width: 1,
            source_line: String::new(),
            message,
            help,
        };
        let Some(span) = span.filter(|s| s.start <= text.len()) else {
            return error;
        };
        let start = text[..span.start].rfind('\n').map_or(0, |i| i + 1);
        let end = text[span.start..]
            .find('\n')
            .map_or(text.len(), |i| span.start + i);
        error.line = text[..span.start].matches('\n').count() + 1;
        error.column = text[start..span.start].chars().count() + 1;
        error.width = text[span.start..span.end.clamp(span.start, end)]
            .chars()
            .count()
            .max(1);
        text[start..end]
            .trim_end()
            .clone_into(&mut error.source_line);
        error
    }

    /// An error of the TOML reader, with the allowed names told apart from the wrong one.
    pub(crate) fn from_toml(path: &Path, text: &str, error: &toml::de::Error) -> Self {
        let (message, help) = explain(error.message());
        Self::at(path, text, error.span(), message, help)
    }

    /// A problem of the checked values, placed in the text they came from.
    pub(crate) fn from_problem(path: &Path, text: &str, problem: Problem) -> Self {
        let span = problem.place.span(text);
        let message = match &span {
            Some(_) => problem.message,
            None => format!("{}: {}", problem.place, problem.message),
        };
        Self::at(path, text, span, message, problem.help)
    }
}

impl fmt::Display for RecipeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        if self.line == 0 {
            write!(f, ": {}", self.message)?;
        } else {
            let margin = self.line.to_string().len();
            write!(f, ":{}:{}: {}", self.line, self.column, self.message)?;
            write!(
                f,
                "\n{:margin$} |\n{} | {}",
                "", self.line, self.source_line
            )?;
            let (indent, marks) = (self.column - 1, "^".repeat(self.width));
            write!(f, "\n{:margin$} | {:indent$}{marks}", "", "")?;
        }
        match &self.help {
            Some(help) => write!(f, "\n  = {help}"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for RecipeError {}

/// One step down the tree of tables and lists.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Step {
    Key(String),
    Index(usize),
}

/// A place in the tree of tables and lists.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Place {
    steps: Vec<Step>,
}

impl Place {
    /// The value of `key` in this table.
    pub(crate) fn key(&self, key: &str) -> Self {
        self.then(Step::Key(key.to_owned()))
    }

    /// Entry `i` of this list.
    pub(crate) fn index(&self, i: usize) -> Self {
        self.then(Step::Index(i))
    }

    fn then(&self, step: Step) -> Self {
        let mut steps = self.steps.clone();
        steps.push(step);
        Self { steps }
    }

    /// A problem here.
    pub(crate) fn problem(&self, message: impl Into<String>) -> Problem {
        Problem {
            place: self.clone(),
            message: message.into(),
            help: None,
        }
    }

    /// A name here that nothing carries, with the known names and the one that was probably meant.
    pub(crate) fn unknown(&self, kind: &str, name: &str, known: &[String]) -> Problem {
        self.problem(format!("unknown {kind} `{name}`"))
            .help(suggestion(name, known.iter().map(String::as_str)))
    }

    /// The byte range of this value in the text; of the nearest table above it if it is not there.
    fn span(&self, text: &str) -> Option<Range<usize>> {
        let root = DeTable::parse(text).ok()?;
        let mut table = Some(root.get_ref());
        let mut value: Option<&DeValue<'_>> = None;
        let mut span = None;
        for step in &self.steps {
            let next = match step {
                Step::Key(key) => {
                    let map = table.or_else(|| value.and_then(DeValue::as_table))?;
                    let found = map.iter().find(|(k, _)| k.get_ref() == key);
                    found.map(|(k, v)| match v.get_ref() {
                        DeValue::Table(_) => (k.span(), v),
                        _ => (v.span(), v),
                    })
                }
                Step::Index(i) => value
                    .and_then(DeValue::as_array)
                    .and_then(|list| list.get(*i))
                    .map(|v| (v.span(), v)),
            };
            let Some((next_span, next_value)) = next else {
                return span;
            };
            table = None;
            value = Some(next_value.get_ref());
            span = Some(next_span);
        }
        span
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, step) in self.steps.iter().enumerate() {
            match step {
                Step::Key(key) if i == 0 => write!(f, "{key}")?,
                Step::Key(key) => write!(f, ".{key}")?,
                Step::Index(i) => write!(f, "[{i}]")?,
            }
        }
        Ok(())
    }
}

/// Something wrong at a place of the tree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    place: Place,
    message: String,
    help: Option<String>,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

impl Problem {
    /// Says what is allowed.
    pub(crate) fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Adds a sentence to what is allowed.
    pub(crate) fn note(mut self, note: &str) -> Self {
        self.help = Some(match self.help {
            Some(help) => format!("{help}; {note}"),
            None => note.to_owned(),
        });
        self
    }
}

/// The known names, and before them the one nearest to a wrong name if it is near.
fn suggestion<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let known: Vec<&str> = known.collect();
    let nearest = known
        .iter()
        .map(|k| (strsim::jaro_winkler(name, k), *k))
        .filter(|(likeness, _)| *likeness > 0.8)
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let allowed = format!("allowed: {}", known.join(", "));
    match nearest {
        Some((_, meant)) => format!("did you mean `{meant}`? {allowed}"),
        None => allowed,
    }
}

/// Splits messages such as "unknown field `a`, expected `b` or `c`" into what is wrong and what is allowed.
fn explain(message: &str) -> (String, Option<String>) {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let unknown = |what: &str, name: &str, known: &[&str]| {
        let help = suggestion(name, known.iter().copied());
        (format!("unknown {what} `{name}`"), Some(help))
    };
    match quoted[..] {
        [name, ref known @ ..] if message.starts_with("unknown field") => {
            unknown("key", name, known)
        }
        [name, ref known @ ..] if message.starts_with("unknown variant") => {
            unknown("value", name, known)
        }
        [name, ..] if message.starts_with("missing field") => {
            (format!("the key `{name}` is missing"), None)
        }
        _ => (message.to_owned(), None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "[dataset]\nname = \"a\"\n\n[[view]]\nyaw_deg = [0, 900]\n";

    #[test]
    fn places_are_found_in_the_text() {
        let place = Place::default()
            .key("view")
            .index(0)
            .key("yaw_deg")
            .index(1);
        assert_eq!(place.to_string(), "view[0].yaw_deg[1]");
        let span = place.span(TEXT).expect("present");
        assert_eq!(&TEXT[span], "900");
    }

    #[test]
    fn a_missing_value_points_at_the_table_that_lacks_it() {
        let place = Place::default().key("dataset").key("output");
        let span = place.span(TEXT).expect("table present");
        assert!(TEXT[span].contains("dataset"));
    }

    #[test]
    fn the_error_shows_line_column_and_marks() {
        let place = Place::default()
            .key("view")
            .index(0)
            .key("yaw_deg")
            .index(1);
        let problem = place.problem("too large").help("at most 180");
        let error = RecipeError::from_problem(Path::new("a.toml"), TEXT, problem);
        assert_eq!(
            error.to_string(),
            "a.toml:5:15: too large\n  |\n5 | yaw_deg = [0, 900]\n  |               ^^^\n  = at most 180"
        );
    }

    #[test]
    fn near_names_are_suggested_and_far_ones_are_not() {
        let known = ["risorius", "mentalis"];
        assert!(suggestion("rizorius", known.into_iter()).starts_with("did you mean `risorius`?"));
        assert!(suggestion("zzz", known.into_iter()).starts_with("allowed: "));
    }
}
