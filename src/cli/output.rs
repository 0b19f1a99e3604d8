//! What the program says: results to standard output, everything else to standard error.

use std::fmt::Display;
use std::io::Write as _;

/// Prints a line of the result. A reader that went away is no error.
pub(super) fn line(text: &dyn Display) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// Tells the user something that is not the result.
pub(super) fn note(text: &dyn Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Tells what went wrong, with the causes that are not already in the text.
pub(super) fn error(error: &anyhow::Error) {
    let mut text = format!("error: {error}");
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text = format!("{text}\n  because: {cause}");
        }
    }
    note(&text);
}
