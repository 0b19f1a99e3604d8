//! What any table's value may have to satisfy: ranges, files that exist, keys that mean something.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use crate::recipe::problem::{Place, Problem};

/// Lengths beyond this are typing errors, mm.
const MAX_LENGTH: f64 = 1e6;

pub(crate) fn matching_files(
    pattern: &str,
    base: &Path,
    place: &Place,
) -> Result<Vec<PathBuf>, Problem> {
    // The recipe's own folder is taken literally, whatever characters its name has.
    let full = Path::new(&glob::Pattern::escape(&base.to_string_lossy())).join(pattern);
    let paths = glob::glob(&full.to_string_lossy())
        .map_err(|e| place.problem(format!("`{pattern}` is not a valid glob: {e}")))?;
    let mut files = Vec::new();
    for path in paths {
        let path = path.map_err(|e| place.problem(e.to_string()))?;
        if path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(place.problem(format!(
            "no file matches `{pattern}` in {}",
            if base.as_os_str().is_empty() {
                Path::new(".").display()
            } else {
                base.display()
            }
        )));
    }
    Ok(files)
}

/// A finite number within a range; `what` begins the error's sentence.
pub(crate) fn in_range(
    value: f64,
    range: RangeInclusive<f64>,
    what: &str,
    place: &Place,
) -> Result<f64, Problem> {
    if range.contains(&value) {
        return Ok(value);
    }
    let (low, high) = (range.start(), range.end());
    Err(place.problem(format!(
        "{what} must be from {low} to {high}, found {value}"
    )))
}

pub(crate) fn length(v: [f64; 3], place: &Place) -> Result<[f64; 3], Problem> {
    for (i, c) in v.into_iter().enumerate() {
        in_range(c, -MAX_LENGTH..=MAX_LENGTH, "a coordinate", &place.index(i))?;
    }
    Ok(v)
}

/// Refuses keys that have no meaning for what they were given to.
pub(crate) fn unused(
    place: &Place,
    owner: &str,
    keys: &[(&str, bool)],
    allowed: &[&str],
) -> Result<(), Problem> {
    let surplus = |(key, given): &&(&str, bool)| *given && !allowed.contains(key);
    match keys.iter().find(surplus) {
        Some((key, _)) => Err(place
            .key(key)
            .problem(format!("{owner} has no key `{key}`"))),
        None => Ok(()),
    }
}
