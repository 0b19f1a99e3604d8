//! Gives the program names for the code that registers scans and for the code that solves equilibria, so that a cache
//! filled by other code is not taken.

use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};

/// What a registered subject depends on besides the scan.
const REGISTRATION: [&str; 4] = [
    "crates/facile-core/src",
    "crates/facile-flow/src",
    "assets/reference",
    "src/pipeline/register.rs",
];
/// What an equilibrium depends on besides shape and pose.
const SIMULATION: [&str; 5] = [
    "crates/facile-core/src",
    "crates/facile-sim/src",
    "assets/reference",
    "assets/muscles.toml",
    "src/pipeline/equilibria.rs",
];

fn main() {
    name("FACILE_REGISTRATION_CODE", &REGISTRATION);
    name("FACILE_SIMULATION_CODE", &SIMULATION);
}

fn name(variable: &str, sources: &[&str]) {
    let mut hasher = DefaultHasher::new();
    hasher.write(env!("CARGO_PKG_VERSION").as_bytes());
    for source in sources {
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
    println!("cargo::rustc-env={variable}={:016x}", hasher.finish());
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) {
    if path.is_file() {
        files.push(path.to_owned());
    }
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        collect(&entry.path(), files);
    }
}
