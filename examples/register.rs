//! Registers a scan: `cargo run --release --example register -- SCAN OUT.glb`, or a built-in one: `builtin:amara`.
//!
//! The reference head takes the scan's shape and colours; the report says how far it can be trusted.

use std::error::Error;
use std::path::Path;

use facile::core::io::{self, Scan};
use facile::core::{ReferenceHead, builtin};
use facile::flow::{RegistrationParams, register};

fn load(word: &str) -> Result<Scan, Box<dyn Error>> {
    Ok(match word.strip_prefix("builtin:") {
        Some(name) => builtin::load(name)?.0,
        None => io::load_scan(Path::new(word), None)?,
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scan, output] = &arguments[..] else {
        return Err("usage: register SCAN|builtin:NAME OUT.glb".into());
    };
    let reference = ReferenceHead::embedded();
    let scan = load(scan)?;
    for notice in &scan.notices {
        eprintln!("{notice}");
    }
    let found = register(reference, &scan, &RegistrationParams::default())?;
    eprintln!("{:#?}", found.report);

    // Landmarks of the reference are landmarks of the subject: same triangles, other positions.
    let chin = reference.scheme("ibug68")?.points[8];
    let [a, b, c] = reference.mesh.triangles[chin.triangle as usize];
    let corner = |v: u32| found.subject.positions[v as usize];
    eprintln!(
        "the chin is between {}, {} and {}",
        corner(a),
        corner(b),
        corner(c)
    );

    found.subject.save(Path::new(output), reference)?;
    Ok(())
}
