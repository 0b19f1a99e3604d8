//! Transfer error of registrations: how far the same place of two people is apart after both are registered.
//!
//! `transfer_error DIR [--scans N] [--params FILE.json]...`, with the files that `bench/peers/ict_scans.py` writes to
//! DIR. For each reference vertex, the point of truth A nearest to its place on A is carried to truth B; the error is
//! the distance to its place on B. Prints the mean, median and 95th percentile over all pairs, in mm.

use std::error::Error;
use std::path::Path;

use facile_core::io::{Scan, load_scan};
use facile_core::mesh::closest_barycentric;
use facile_core::{Mesh, Point3, ReferenceHead};
use facile_flow::{Registrar, RegistrationParams};

/// Parts of the face by the ibug-68 landmarks they begin with.
const REGIONS: [(&str, usize); 5] = [
    ("jaw", 0),
    ("brows", 17),
    ("nose", 27),
    ("eyes", 36),
    ("mouth", 48),
];

/// A scan with the truth it was made from, both registered to the reference.
struct Person<'t> {
    truth: &'t Mesh,
    /// Registered fine vertices in the truth's frame, mm.
    placed: Vec<Point3>,
    /// Whether each lies in the region that counts.
    counts: Vec<bool>,
    /// Place in [`REGIONS`] of the landmark nearest to each.
    region: Vec<usize>,
    /// Nearest triangle of the truth and barycentric weights.
    on_truth: Vec<(u32, [f64; 3])>,
}

/// One scan with its truth.
struct Input {
    scan: Scan,
    truth: Mesh,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let dir = args
        .next()
        .ok_or("usage: transfer_error DIR [--scans N] [--params FILE]...")?;
    let dir = Path::new(&dir);
    let mut count = usize::MAX;
    let mut variants = Vec::new();
    while let (Some(key), Some(value)) = (args.next(), args.next()) {
        match key.as_str() {
            "--scans" => count = value.parse()?,
            "--params" => {
                let params = serde_json::from_str(&std::fs::read_to_string(&value)?)?;
                variants.push((value, params));
            }
            _ => return Err(format!("unknown option {key}").into()),
        }
    }
    if variants.is_empty() {
        variants.push(("defaults".to_owned(), RegistrationParams::default()));
    }
    let landmarks: Vec<usize> = std::fs::read_to_string(dir.join("landmarks.txt"))?
        .split_whitespace()
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    let mut inputs = Vec::new();
    while inputs.len() < count && dir.join(format!("scan_{}.obj", inputs.len())).exists() {
        let k = inputs.len();
        inputs.push(Input {
            scan: load_scan(&dir.join(format!("scan_{k}.obj")), None)?,
            truth: load_scan(&dir.join(format!("truth_{k}.obj")), None)?.mesh,
        });
    }
    for (name, params) in variants {
        measure(&name, params, &inputs, &landmarks)?;
    }
    Ok(())
}

fn measure(
    name: &str,
    mut params: RegistrationParams,
    inputs: &[Input],
    landmarks: &[usize],
) -> Result<(), Box<dyn Error>> {
    params.texture_size = 16;
    let registrar = Registrar::new(ReferenceHead::embedded(), params)?;
    let mut people = Vec::new();
    let (mut stages, mut folded) = (Vec::<(&str, f64)>::new(), 0);
    for input in inputs {
        let found = registrar.register(&input.scan)?;
        for (k, time) in found.times.iter().enumerate() {
            match stages.get_mut(k) {
                Some(stage) => stage.1 += time.seconds,
                None => stages.push((time.stage, time.seconds)),
            }
        }
        folded += found.report.folded_triangles;
        let scan_from_head = found.head_from_scan.inverse();
        let placed = found
            .subject
            .positions
            .iter()
            .map(|p| scan_from_head * p)
            .collect();
        people.push(person(&input.truth, placed, landmarks));
    }
    let mut all = Vec::new();
    let mut by_person = vec![(0.0, 0.0); people.len()];
    for (i, a) in people.iter().enumerate() {
        for (j, b) in people.iter().enumerate() {
            if i != j {
                let errors: Vec<(f64, usize)> = transfer(a, b).collect();
                let sum: f64 = errors.iter().map(|e| e.0).sum();
                for k in [i, j] {
                    by_person[k].0 += sum;
                    by_person[k].1 += errors.len() as f64;
                }
                all.extend(errors);
            }
        }
    }
    let mut by_region = [(0.0, 0.0); REGIONS.len()];
    for (error, region) in &all {
        by_region[*region].0 += error;
        by_region[*region].1 += 1.0;
    }
    let mut all: Vec<f64> = all.into_iter().map(|e| e.0).collect();
    all.sort_unstable_by(f64::total_cmp);
    let quantile = |q: f64| all[((all.len() - 1) as f64 * q) as usize];
    let n = inputs.len() as f64;
    let seconds: f64 = stages.iter().map(|s| s.1).sum::<f64>() / n;
    eprint!(
        "{name}: mean {:.3} median {:.3} p95 {:.3} mm ({} points); folded {:.1}; {seconds:.2} s:",
        all.iter().sum::<f64>() / all.len() as f64,
        quantile(0.5),
        quantile(0.95),
        all.len(),
        folded as f64 / n,
    );
    for (stage, sum) in stages {
        eprint!(" {stage} {:.3}", sum / n);
    }
    for ((name, _), (sum, count)) in REGIONS.iter().zip(by_region) {
        eprint!(" | {name} {:.2}", sum / count);
    }
    eprint!(" | scans");
    for (sum, count) in by_person {
        eprint!(" {:.2}", sum / count);
    }
    eprintln!();
    Ok(())
}

/// Finds each registered vertex on the truth, and whether it lies in the region that `notes/peers.md` defines: within
/// 25 mm of a landmark, more than 8 mm from the border, within 4 mm of the surface.
fn person<'a>(truth: &'a Mesh, placed: Vec<Point3>, landmarks: &[usize]) -> Person<'a> {
    let border = border_points(truth);
    let spots: Vec<Point3> = landmarks.iter().map(|&v| truth.positions[v]).collect();
    let centers: Vec<(Point3, f64)> = (0..truth.triangles.len())
        .map(|t| {
            let c = truth.corners(t);
            let center = Point3::from((c[0].coords + c[1].coords + c[2].coords) / 3.0);
            let radius = c.iter().map(|p| (p - center).norm()).fold(0.0, f64::max);
            (center, radius)
        })
        .collect();
    let near = |list: &[Point3], p: &Point3, r: f64| list.iter().any(|q| (q - p).norm() < r);
    let (mut counts, mut on_truth, mut region) = (Vec::new(), Vec::new(), Vec::new());
    for p in &placed {
        let nearest = (0..spots.len())
            .min_by(|a, b| (spots[*a] - p).norm().total_cmp(&(spots[*b] - p).norm()))
            .unwrap_or(0);
        region.push(REGIONS.iter().rposition(|r| r.1 <= nearest).unwrap_or(0));
        if !near(&spots, p, 25.0) || near(&border, p, 8.0) {
            counts.push(false);
            on_truth.push((0, [1.0, 0.0, 0.0]));
            continue;
        }
        let mut best = (f64::INFINITY, 0, [1.0, 0.0, 0.0]);
        for (t, (center, radius)) in centers.iter().enumerate() {
            if (center - p).norm() - radius > best.0 {
                continue;
            }
            let corners = truth.corners(t);
            let weights = closest_barycentric(p, &corners);
            let q = at(&corners, &weights);
            let distance = (q - p).norm();
            if distance < best.0 {
                best = (distance, t as u32, weights);
            }
        }
        counts.push(best.0 < 4.0);
        on_truth.push((best.1, best.2));
    }
    Person {
        truth,
        placed,
        counts,
        region,
        on_truth,
    }
}

fn at(corners: &[Point3; 3], w: &[f64; 3]) -> Point3 {
    Point3::from(corners[0].coords * w[0] + corners[1].coords * w[1] + corners[2].coords * w[2])
}

fn border_points(mesh: &Mesh) -> Vec<Point3> {
    let mut edges: Vec<(u32, u32)> = mesh
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    edges.sort_unstable();
    let mut points = Vec::new();
    for run in edges.chunk_by(|a, b| a == b) {
        if run.len() == 1 {
            points.push(mesh.positions[run[0].0 as usize]);
            points.push(mesh.positions[run[0].1 as usize]);
        }
    }
    points
}

fn transfer<'a>(a: &'a Person<'_>, b: &'a Person<'_>) -> impl Iterator<Item = (f64, usize)> + 'a {
    (0..a.placed.len()).filter(|&v| a.counts[v]).map(|v| {
        let (t, weights) = a.on_truth[v];
        let carried = at(&b.truth.corners(t as usize), &weights);
        ((carried - b.placed[v]).norm(), a.region[v])
    })
}
