//! Transfer error of registrations: how far the same place of two people is apart after both are registered.
//!
//! It needs people who share a topology that the registration does not know: each is scanned with other triangles, and
//! kept as its truth. For each reference vertex, the point of truth A nearest to its place on A is carried to truth B by
//! the topology; the error is the distance to its place on B. What counts is the face: within 25 mm of one of the 68
//! ibug landmarks, more than 8 mm from the truth's border, within 4 mm of its surface.

use std::path::Path;

use facile_core::io::{Scan, load_scan, read_file};
use facile_core::mesh::closest_barycentric;
use facile_core::{CoreError, Mesh, Point3};

/// Parts of the face by the ibug-68 landmarks they begin with.
const PARTS: [usize; 5] = [0, 17, 27, 36, 48];
/// Names of the parts of the face that [`TransferError::part`] counts through.
pub const PART_NAMES: [&str; PARTS.len()] = ["jaw", "brows", "nose", "eyes", "mouth"];

const NEAR_LANDMARK_MM: f64 = 25.0;
const FROM_BORDER_MM: f64 = 8.0;
const FROM_SURFACE_MM: f64 = 4.0;

/// Scans of people with the truths they were made from, which share a topology.
#[derive(Clone, Debug)]
pub struct TransferSet {
    /// The scans, mm.
    pub scans: Vec<Scan>,
    truths: Vec<Mesh>,
    /// Vertices of the truths at the ibug-68 landmarks.
    landmarks: Vec<usize>,
}

/// Error of one reference vertex between two people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransferError {
    /// The people, by their place in [`TransferSet::scans`].
    pub people: [usize; 2],
    /// The part of the face, in [`PART_NAMES`].
    pub part: usize,
    /// The distance, mm.
    pub distance_mm: f64,
}

/// Where a registered vertex lies on a person's truth.
#[derive(Clone, Copy, Debug)]
struct Spot {
    triangle: usize,
    weights: [f64; 3],
    part: usize,
}

/// A person's registration in the truth's frame.
struct Placed<'t> {
    truth: &'t Mesh,
    positions: Vec<Point3>,
    /// `None` where a vertex does not count.
    spots: Vec<Option<Spot>>,
}

impl TransferSet {
    /// Reads `scan_K.obj`, `truth_K.obj`, K from 0, at most `limit`, and `landmarks.txt` of a folder, as
    /// `bench/peers/ict_scans.py` writes them.
    ///
    /// # Errors
    /// [`CoreError`] with the file that cannot be read, does not follow its format or does not fit the others.
    pub fn load(folder: &Path, limit: usize) -> Result<Self, CoreError> {
        let path = folder.join("landmarks.txt");
        let landmarks = parse_landmarks(&path, &String::from_utf8_lossy(&read_file(&path)?))?;
        let (mut scans, mut truths) = (Vec::new(), Vec::<Mesh>::new());
        for k in 0..limit {
            let [scan, truth] = ["scan", "truth"].map(|n| folder.join(format!("{n}_{k}.obj")));
            if k >= 2 && !scan.exists() {
                break;
            }
            scans.push(load_scan(&scan, None)?);
            let mesh = load_scan(&truth, None)?.mesh;
            if let Some(first) = truths.first()
                && first.triangles != mesh.triangles
            {
                return Err(wrong(&truth, "other triangles than `truth_0.obj`"));
            }
            let vertices = mesh.positions.len();
            if let Some(beyond) = landmarks.iter().find(|v| **v >= vertices) {
                let reason = format!("{vertices} vertices, but a landmark at vertex {beyond}");
                return Err(wrong(&truth, reason));
            }
            truths.push(mesh);
        }
        Ok(Self {
            scans,
            truths,
            landmarks,
        })
    }

    /// Errors of all ordered pairs of different people. `placed` holds the fine reference vertices registered to each
    /// scan, in its coordinates. Cost O(people x vertices x (triangles + people)).
    pub fn errors(&self, placed: Vec<Vec<Point3>>) -> Vec<TransferError> {
        let truths = self.truths.iter().zip(placed);
        let placed: Vec<Placed<'_>> = truths
            .map(|(truth, positions)| place(truth, positions, &self.landmarks))
            .collect();
        let mut errors = Vec::new();
        for (i, a) in placed.iter().enumerate() {
            for (j, b) in placed.iter().enumerate().filter(|(j, _)| *j != i) {
                for (spot, there) in a.spots.iter().zip(&b.positions) {
                    let Some(spot) = spot else { continue };
                    let carried = at(&b.truth.corners(spot.triangle), &spot.weights);
                    errors.push(TransferError {
                        people: [i, j],
                        part: spot.part,
                        distance_mm: (carried - there).norm(),
                    });
                }
            }
        }
        errors
    }
}

fn wrong(path: &Path, reason: impl Into<String>) -> CoreError {
    CoreError::Format {
        path: path.to_owned(),
        place: None,
        reason: reason.into(),
    }
}

fn parse_landmarks(path: &Path, text: &str) -> Result<Vec<usize>, CoreError> {
    let numbers: Result<Vec<usize>, _> = text.split_whitespace().map(str::parse).collect();
    let found = numbers.map_err(|e| wrong(path, format!("expected vertex numbers: {e}")))?;
    if found.len() != 68 {
        let reason = format!("expected 68 vertex numbers, found {}", found.len());
        return Err(wrong(path, reason));
    }
    Ok(found)
}

fn place<'t>(truth: &'t Mesh, positions: Vec<Point3>, landmarks: &[usize]) -> Placed<'t> {
    let border = border_points(truth);
    let landmarks: Vec<Point3> = landmarks.iter().map(|&v| truth.positions[v]).collect();
    let balls: Vec<(Point3, f64)> = (0..truth.triangles.len())
        .map(|t| {
            let c = truth.corners(t);
            let center = Point3::from((c[0].coords + c[1].coords + c[2].coords) / 3.0);
            let radius = c.iter().map(|p| (p - center).norm()).fold(0.0, f64::max);
            (center, radius)
        })
        .collect();
    let spot = |p: &Point3| {
        let distances = landmarks.iter().map(|l| (l - p).norm());
        let (nearest, distance) = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let is_far = distance >= NEAR_LANDMARK_MM;
        if is_far || border.iter().any(|q| (q - p).norm() < FROM_BORDER_MM) {
            return None;
        }
        let (distance, triangle, weights) = closest(truth, &balls, p);
        (distance < FROM_SURFACE_MM).then(|| Spot {
            triangle,
            weights,
            part: PARTS.iter().rposition(|p| *p <= nearest).unwrap_or(0),
        })
    };
    Placed {
        truth,
        spots: positions.iter().map(spot).collect(),
        positions,
    }
}

/// Distance to the mesh, the nearest triangle, and the weights of its corners at the nearest point. `balls` hold the
/// triangles.
fn closest(mesh: &Mesh, balls: &[(Point3, f64)], p: &Point3) -> (f64, usize, [f64; 3]) {
    let mut best = (f64::INFINITY, 0, [1.0, 0.0, 0.0]);
    for (t, (center, radius)) in balls.iter().enumerate() {
        if (center - p).norm() - radius > best.0 {
            continue;
        }
        let corners = mesh.corners(t);
        let weights = closest_barycentric(p, &corners);
        let distance = (at(&corners, &weights) - p).norm();
        if distance < best.0 {
            best = (distance, t, weights);
        }
    }
    best
}

fn at(corners: &[Point3; 3], w: &[f64; 3]) -> Point3 {
    Point3::from(corners[0].coords * w[0] + corners[1].coords * w[1] + corners[2].coords * w[2])
}

/// Ends of the edges that belong to one triangle alone.
fn border_points(mesh: &Mesh) -> Vec<Point3> {
    let mut edges: Vec<(u32, u32)> = mesh
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    edges.sort_unstable();
    let lonely = edges.chunk_by(|a, b| a == b).filter(|run| run.len() == 1);
    lonely
        .flat_map(|run| [run[0].0, run[0].1])
        .map(|v| mesh.positions[v as usize])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::ReferenceHead;

    #[test]
    fn true_places_have_no_error_and_moved_ones_how_far_they_were_moved() {
        let reference = ReferenceHead::embedded();
        // The reference's head, and one that is deeper
        let truths = vec![1.0, 1.2].into_iter().map(|depth| {
            let mut mesh = reference.mesh.clone();
            for p in &mut mesh.positions {
                p.z *= depth;
            }
            mesh
        });
        let set = TransferSet {
            scans: Vec::new(),
            truths: truths.collect(),
            landmarks: (0..68).map(|k| 11 * k).collect(),
        };
        let mut placed: Vec<Vec<Point3>> = set.truths.iter().map(|t| t.positions.clone()).collect();
        let errors = set.errors(placed.clone());
        assert!(errors.len() > 1000);
        let worst = errors.iter().map(|e| e.distance_mm).fold(0.0, f64::max);
        assert!(worst < 1e-9, "{worst}");
        // What is carried to the second person misses by what that one was moved.
        for p in &mut placed[1] {
            p.x += 3.0;
        }
        let errors = set.errors(placed);
        for error in errors.iter().filter(|e| e.people == [0, 1]) {
            assert!((error.distance_mm - 3.0).abs() < 1e-9, "{error:?}");
        }
    }

    #[test]
    fn bad_folders_are_refused_by_name() {
        let path = Path::new("landmarks.txt");
        let few = parse_landmarks(path, "1 2 3").expect_err("too few");
        assert!(
            few.to_string()
                .contains("expected 68 vertex numbers, found 3")
        );
        let word = parse_landmarks(path, "one").expect_err("no number");
        assert!(
            word.to_string()
                .starts_with("landmarks.txt: expected vertex numbers")
        );
        assert!(TransferSet::load(Path::new("nowhere"), 5).is_err());
    }
}
