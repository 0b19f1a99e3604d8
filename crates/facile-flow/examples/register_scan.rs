//! Registers one OBJ scan and writes what a person wants to look at.
//!
//! `register_scan SCAN.obj TEXTURE|- OUT_DIR [PARAMS.json]` writes to `OUT_DIR`: `head.obj` (the registered head, reference topology and
//! UV), `head.png` (its texture), `parts.obj` (eyes, teeth and tongue in place), `scan.obj` (the scan in the head
//! frame), `landmarks.txt` (ibug-68), `error.txt` (expected error per vertex) and `report.json`.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

use facile_core::{Mesh, ReferenceHead, Segment};
use facile_flow::RegistrationParams;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [scan_path, texture_path, out, ..] = &args[..] else {
        return Err("usage: register_scan SCAN.obj TEXTURE|- OUT_DIR [PARAMS.json]".into());
    };
    let params = match args.get(3) {
        Some(path) => serde_json::from_str(&std::fs::read_to_string(path)?)?,
        None => RegistrationParams::default(),
    };
    let out = Path::new(out);
    std::fs::create_dir_all(out)?;
    let texture = (texture_path != "-").then(|| Path::new(texture_path));
    let mut scan = facile_core::io::load_scan(Path::new(scan_path), texture)?;
    for notice in &scan.notices {
        eprintln!("{notice}");
    }
    let reference = ReferenceHead::embedded();
    let start = Instant::now();
    let found = facile_flow::register(reference, &scan, &params)?;
    eprintln!("{:.2} s", start.elapsed().as_secs_f64());
    let subject = &found.subject;
    write_obj(&out.join("head.obj"), &subject.mesh(reference))?;
    let flat: Vec<u8> = subject.texture.texels().iter().flatten().copied().collect();
    let size = (
        subject.texture.width() as u32,
        subject.texture.height() as u32,
    );
    image::save_buffer(
        out.join("head.png"),
        &flat,
        size.0,
        size.1,
        image::ColorType::Rgb8,
    )?;
    write_obj(&out.join("parts.obj"), &parts(reference, subject))?;
    for p in &mut scan.mesh.positions {
        *p = found.head_from_scan * *p;
    }
    write_obj(&out.join("scan.obj"), &scan.mesh)?;
    let mut text = String::new();
    for p in reference
        .scheme("ibug68")?
        .positions(&subject.positions, &reference.mesh.triangles)
    {
        let q = found.head_from_scan.inverse() * p;
        writeln!(text, "{} {} {} {} {} {}", p.x, p.y, p.z, q.x, q.y, q.z)?;
    }
    std::fs::write(out.join("landmarks.txt"), text)?;
    let errors: String = subject
        .expected_error
        .iter()
        .fold(String::new(), |mut text, e| {
            text.push_str(&e.to_string());
            text.push('\n');
            text
        });
    std::fs::write(out.join("error.txt"), errors)?;
    let report = serde_json::to_string_pretty(&found.report)?;
    eprintln!("{report}");
    std::fs::write(out.join("report.json"), report)?;
    Ok(())
}

/// Eyes at the subject's places, the rest carried by the skull, in one mesh.
fn parts(reference: &ReferenceHead, subject: &facile_core::Subject) -> Mesh {
    let mut all = Mesh::default();
    for part in &reference.parts {
        let place = subject.part_from_reference(part.segment, reference);
        let offset = all.positions.len() as u32;
        all.positions
            .extend(part.mesh.positions.iter().map(|p| place * p));
        all.triangles
            .extend(part.mesh.triangles.iter().map(|t| t.map(|v| v + offset)));
        all.segments
            .extend(part.mesh.triangles.iter().map(|_| part.segment));
    }
    all
}

fn write_obj(path: &Path, mesh: &Mesh) -> Result<(), Box<dyn Error>> {
    let mut text = String::new();
    for p in &mesh.positions {
        writeln!(text, "v {:.4} {:.4} {:.4}", p.x, p.y, p.z)?;
    }
    for t in &mesh.texcoords {
        writeln!(text, "vt {:.6} {:.6}", t[0], t[1])?;
    }
    let mut segment = None;
    for (i, t) in mesh.triangles.iter().enumerate() {
        let here = mesh.segments.get(i).copied();
        if here != segment {
            segment = here;
            writeln!(text, "g {}", here.map_or("none", Segment::name))?;
        }
        let [a, b, c] = t.map(|v| v + 1);
        match mesh.texcoord_triangles.get(i) {
            Some(uv) => {
                let [u, v, w] = uv.map(|v| v + 1);
                writeln!(text, "f {a}/{u} {b}/{v} {c}/{w}")?;
            }
            None => writeln!(text, "f {a} {b} {c}")?,
        }
    }
    std::fs::write(path, text)?;
    Ok(())
}
