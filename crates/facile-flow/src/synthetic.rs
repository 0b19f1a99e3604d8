//! Scans whose truth is known: people of the identity model, seen by a scanner that turns around the head.
//!
//! The scanner's own cylinder is tilted against the head's, so its triangles share nothing with the reference's; it
//! shows the outermost surface only, eyeballs included, and breaks where that jumps. Noise, holes, pose and unit are
//! added. The true place of every reference vertex is known. For tests, benches and the calibration of errors.

use facile_core::io::Scan;
use facile_core::rng::RandomStream;
use facile_core::{
    Mesh, Point3, ReferenceHead, Segment, Similarity3, Subject, UnitQuaternion, Vector3,
};
use nalgebra::Translation3;

use crate::Registration;
use crate::radial_map::{CylinderGrid, HOLE, RadialMap};

/// How a person is scanned.
#[derive(Clone, Copy, Debug)]
pub struct Scanner {
    /// Side of the scanner's cells at a radius of 80 mm, mm: 1.2 gives some 45,000 triangles.
    pub cell_mm: f64,
    /// Standard deviation of the noise along the scanner's rays, mm.
    pub noise_mm: f64,
    /// Share of the triangles lost in round holes of 8 mm radius, `[0, 1)`.
    pub holes: f64,
    /// Scan file's coordinates from the head's.
    pub place: Similarity3,
    /// Whether the scan's vertices have colours.
    pub with_color: bool,
    /// Seed of noise, holes and the scanner's tilt.
    pub seed: u64,
}

impl Default for Scanner {
    fn default() -> Self {
        Self {
            cell_mm: 1.2,
            noise_mm: 0.0,
            holes: 0.0,
            place: Similarity3::identity(),
            with_color: true,
            seed: 1,
        }
    }
}

/// A scan and where each reference vertex lies on it.
#[derive(Clone, Debug)]
pub struct KnownScan {
    /// The scan.
    pub scan: Scan,
    /// True place of each fine reference vertex, scan's coordinates.
    pub truth: Vec<Point3>,
}

/// Scans a person. Deterministic. Cost O(cells).
pub fn scan_of(reference: &ReferenceHead, subject: &Subject, scanner: &Scanner) -> KnownScan {
    let mut random = RandomStream::new(scanner.seed, 0);
    let tilt = Vector3::from_fn(|_, _| random.uniform(-0.12, 0.12));
    let shift = Vector3::from_fn(|_, _| random.uniform(-6.0, 6.0));
    let scanner_from_head = Similarity3::from_parts(
        Translation3::from(shift),
        UnitQuaternion::from_scaled_axis(tilt),
        1.0,
    );
    let (solid, colors) = outer_surface(reference, subject, scanner.with_color);
    let positions: Vec<Point3> = (solid.positions.iter())
        .map(|p| scanner_from_head * p)
        .collect();
    let grid = CylinderGrid::new(1.9, -150.0, 130.0, scanner.cell_mm, 80.0);
    let map = RadialMap::cast(&positions, &solid.triangles, grid);
    let place = scanner.place * scanner_from_head.inverse();
    let mut mesh = sampled(&map, &solid, &colors, |h, phi, radius| {
        let noise = if scanner.noise_mm > 0.0 {
            scanner.noise_mm * random.normal()
        } else {
            0.0
        };
        place * facile_core::math::point_from_cylinder(h, phi, radius + noise)
    });
    let side = scanner.place.scaling();
    cut_holes(&mut mesh, scanner.holes, 8.0 * side, &mut random);
    KnownScan {
        scan: Scan {
            name: subject.id.clone(),
            path: format!("{}.obj", subject.id).into(),
            mesh,
            texture: None,
            groups: Vec::new(),
            triangle_groups: Vec::new(),
            notices: Vec::new(),
        },
        truth: subject
            .positions
            .iter()
            .map(|p| scanner.place * p)
            .collect(),
    }
}

/// Distance of each of `vertices` to its true place, mm.
pub fn errors(known: &KnownScan, found: &Registration, vertices: &[usize]) -> Vec<f64> {
    (vertices.iter())
        .map(|&v| {
            let truth = found.head_from_scan * known.truth[v];
            (found.subject.positions[v] - truth).norm()
        })
        .collect()
}

/// The vertices of the face: outer skin between the ears, forehead to chin, without the inner sides of lips and lids.
pub fn face_vertices(reference: &ReferenceHead) -> Vec<usize> {
    let beside = [
        Segment::Neck,
        Segment::Scalp,
        Segment::LeftEar,
        Segment::RightEar,
    ];
    let is_frontal = |v: &usize| reference.mesh.positions[*v].z > 30.0;
    let mut face = vertices_of(reference, |s| !beside.contains(&s));
    face.retain(is_frontal);
    face
}

/// The vertices of all outer skin: face, ears, scalp and neck, seen by scans or not.
pub fn skin_vertices(reference: &ReferenceHead) -> Vec<usize> {
    vertices_of(reference, |_| true)
}

/// Vertices with a triangle of an outer segment that `keep` keeps, and none inside mouth or sockets.
fn vertices_of(reference: &ReferenceHead, keep: impl Fn(Segment) -> bool) -> Vec<usize> {
    let mesh = &reference.mesh;
    let mut kept = vec![false; mesh.positions.len()];
    let mut hidden = vec![false; mesh.positions.len()];
    for (t, s) in mesh.triangles.iter().zip(&mesh.segments) {
        for &v in t {
            if matches!(s, Segment::InnerMouth | Segment::EyeSocket) {
                hidden[v as usize] = true;
            } else if keep(*s) {
                kept[v as usize] = true;
            }
        }
    }
    (0..kept.len()).filter(|&v| kept[v] && !hidden[v]).collect()
}

/// Skin, eyes and teeth of a subject as one mesh, with a colour for each triangle's corners.
fn outer_surface(
    reference: &ReferenceHead,
    subject: &Subject,
    with_color: bool,
) -> (Mesh, Vec<[[f32; 3]; 3]>) {
    let mut mesh = Mesh {
        positions: subject.positions.clone(),
        triangles: reference.mesh.triangles.clone(),
        ..Mesh::default()
    };
    let mut colors = Vec::new();
    if with_color {
        colors = (reference.mesh.texcoord_triangles.iter())
            .map(|t| t.map(|i| subject.texture.sample(reference.mesh.texcoords[i as usize])))
            .collect();
    }
    for (_, part) in subject.part_meshes(reference) {
        let offset = mesh.positions.len() as u32;
        mesh.positions.extend(&part.positions);
        mesh.triangles
            .extend(part.triangles.iter().map(|t| t.map(|v| v + offset)));
        if with_color {
            colors.resize(mesh.triangles.len(), [[0.6, 0.55, 0.5]; 3]);
        }
    }
    (mesh, colors)
}

/// One vertex for each covered cell, two triangles for each square of four without a jump.
fn sampled(
    map: &RadialMap,
    solid: &Mesh,
    colors: &[[[f32; 3]; 3]],
    mut at: impl FnMut(f64, f64, f64) -> Point3,
) -> Mesh {
    let grid = &map.grid;
    let mut mesh = Mesh::default();
    let mut vertex = facile_core::Plane::filled(grid.width, grid.height, u32::MAX);
    for y in 0..grid.height {
        for x in 0..grid.width {
            let t = map.triangle[(x, y)];
            if t == HOLE {
                continue;
            }
            let (h, phi) = grid.cylinder_from_cell([x as f64, y as f64]);
            vertex[(x, y)] = mesh.positions.len() as u32;
            mesh.positions.push(at(h, phi, map.radius[(x, y)]));
            if let Some(corners) = colors.get(t as usize) {
                let [v, w] = map.weights[(x, y)];
                let share = [1.0 - v - w, v, w];
                mesh.colors.push(std::array::from_fn(|c| {
                    (0..3).map(|k| share[k] * corners[k][c]).sum()
                }));
            }
        }
    }
    debug_assert!(solid.triangles.len() >= colors.len());
    let jump = (4.0 * grid.h_step).max(5.0);
    for y in 0..grid.height - 1 {
        for x in 0..grid.width - 1 {
            let cells = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)];
            let radii = cells.map(|c| map.radius[c]);
            let low = radii.iter().copied().fold(f64::INFINITY, f64::min);
            let high = radii.iter().copied().fold(0.0, f64::max);
            if low > 0.0 && high - low < jump {
                let [a, b, c, d] = cells.map(|c| vertex[c]);
                mesh.triangles.push([a, b, c]);
                mesh.triangles.push([a, c, d]);
            }
        }
    }
    mesh
}

/// Removes the triangles in round holes until `share` of them is gone.
fn cut_holes(mesh: &mut Mesh, share: f64, radius: f64, random: &mut RandomStream) {
    let wanted = (mesh.triangles.len() as f64 * (1.0 - share.clamp(0.0, 0.95))) as usize;
    while mesh.triangles.len() > wanted {
        let seed = mesh.triangles[random.index(mesh.triangles.len())];
        let center = mesh.positions[seed[0] as usize];
        let positions = &mesh.positions;
        mesh.triangles
            .retain(|t| (positions[t[0] as usize] - center).norm() > radius);
    }
}
