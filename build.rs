//! Gives the program a name for the code that registers scans, so that a cache filled by other code is not taken.

use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};

/// What a registered subject depends on besides the scan.
const SOURCES: [&str; 4] = [
    "crates/facile-core/src",
    "crates/facile-flow/src",
    "assets/reference",
    "src/pipeline/stored.rs",
];

fn main() {
    let mut hasher = DefaultHasher::new();
    hasher.write(env!("CARGO_PKG_VERSION").as_bytes());
    for source in SOURCES {
        // A published package has no neighbours: its version alone names the code then.
        let mut files = Vec::new();
        collect(Path::new(source), &mut files);
        files.sort();
        for file in files {
            hasher.write(file.to_string_lossy().as_bytes());
            hasher.write(&std::fs::read(&file).unwrap_or_default());
        }
        println!("cargo::rerun-if-changed={source}");
    }
    println!(
        "cargo::rustc-env=FACILE_REGISTRATION_CODE={:016x}",
        hasher.finish()
    );
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) {
    if path.is_file() {
        files.push(path.to_owned());
    }
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        collect(&entry.path(), files);
    }
}
