//! Cloth over a head: surgical mask, scarf, cap.
//!
//! A sheet of rays from inside the head meets its surface; the cloth is the tightest membrane outside those points: relaxed
//! towards the mean of its neighbours, never under the surface plus its clearance.

use facile_core::{Mesh, Point3, Segment, Vector3};
use serde::{Deserialize, Serialize};

use super::fit::FaceFit;
use super::sweep::add_tube;
use crate::TraceError;
use crate::geometry::Normals;
use crate::material::{Albedo, Material};
use crate::math::Rgb;
use crate::object::Object;

/// What the cloth is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DrapeKind {
    /// Over nose, mouth and chin, with loops around the ears.
    SurgicalMask,
    /// Around neck, chin and mouth.
    Scarf,
    /// Over the skull, with a brim over the forehead.
    Cap,
}

/// A piece of cloth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drape {
    /// What it is.
    pub kind: DrapeKind,
    /// 8-bit sRGB colour.
    pub color: [u8; 3],
}

/// Rounds of relaxation; the membrane's waves are then below 0.1 mm.
const RELAXATIONS: usize = 400;

/// A sheet of `columns x rows` rays and how far out the cloth is on each.
struct Membrane {
    columns: usize,
    rows: usize,
    /// Whether the last column meets the first.
    is_ring: bool,
    centers: Vec<Point3>,
    directions: Vec<Vector3>,
    radii: Vec<f64>,
}

impl Membrane {
    /// Lays cloth at least `clearance` mm over the head. `ray(s, t)` gives a centre in the head and a unit direction for
    /// `s` in `[-1, 1]` along the rows and `t` in `[0, 1]` from the top row to the bottom row.
    fn over(
        fit: &FaceFit<'_>,
        [columns, rows]: [usize; 2],
        is_ring: bool,
        clearance: f64,
        ray: impl Fn(f64, f64) -> (Point3, Vector3),
    ) -> Self {
        let mut sheet = Self {
            columns,
            rows,
            is_ring,
            centers: Vec::new(),
            directions: Vec::new(),
            radii: Vec::new(),
        };
        let spans = if is_ring { columns } else { columns - 1 } as f64;
        for row in 0..rows {
            for column in 0..columns {
                let s = 2.0 * column as f64 / spans - 1.0;
                let (center, direction) = ray(s, row as f64 / (rows - 1) as f64);
                sheet.centers.push(center);
                sheet.directions.push(direction);
                let reach = fit.reach(center, direction);
                sheet.radii.push(reach.map_or(0.0, |r| r + clearance));
            }
        }
        sheet.relax();
        sheet
    }

    fn relax(&mut self) {
        let floor = self.radii.clone();
        let (n, rows) = (self.columns, self.rows);
        for _ in 0..RELAXATIONS {
            for row in 0..rows {
                for column in 0..n {
                    let at = |c: usize, r: usize| self.radii[r * n + c];
                    let (mut sum, mut count) = (0.0, 0.0);
                    let mut take = |pair: [Option<f64>; 2]| {
                        // Only pairs of opposite neighbours pull: the rim of a sheet keeps its shape along itself
                        if let [Some(a), Some(b)] = pair {
                            sum += a + b;
                            count += 2.0;
                        }
                    };
                    let left = (column > 0 || self.is_ring).then(|| at((column + n - 1) % n, row));
                    let right = (column + 1 < n || self.is_ring).then(|| at((column + 1) % n, row));
                    take([left, right]);
                    let above = (row > 0).then(|| at(column, row - 1));
                    let below = (row + 1 < rows).then(|| at(column, row + 1));
                    take([above, below]);
                    let i = row * n + column;
                    if count > 0.0 {
                        self.radii[i] = floor[i].max(sum / count);
                    }
                }
            }
        }
    }

    fn point(&self, column: usize, row: usize) -> Point3 {
        let i = row * self.columns + column % self.columns;
        self.centers[i] + self.directions[i] * self.radii[i]
    }

    fn add_to(&self, mesh: &mut Mesh) {
        let points = (0..self.rows).flat_map(|r| (0..self.columns).map(move |c| (c, r)));
        let points: Vec<Point3> = points.map(|(c, r)| self.point(c, r)).collect();
        add_grid(mesh, &points, self.columns, self.is_ring);
    }
}

/// Adds a sheet of points, row by row from the top, columns from the subject's right to the left.
fn add_grid(mesh: &mut Mesh, points: &[Point3], columns: usize, is_ring: bool) {
    let base = mesh.positions.len();
    mesh.positions.extend_from_slice(points);
    let spans = if is_ring { columns } else { columns - 1 };
    for row in 0..points.len() / columns - 1 {
        for column in 0..spans {
            let vertex = |c: usize, r: usize| (base + r * columns + c % columns) as u32;
            let [a, b] = [vertex(column, row), vertex(column + 1, row)];
            let [c, d] = [vertex(column + 1, row + 1), vertex(column, row + 1)];
            mesh.triangles.extend([[a, d, c], [a, c, b]]);
        }
    }
    mesh.segments.resize(mesh.triangles.len(), Segment::Other);
}

fn around(h: f64, phi: f64) -> (Point3, Vector3) {
    let out = Vector3::new(libm::sin(phi), 0.0, libm::cos(phi));
    (Point3::new(0.0, h, 0.0), out)
}

fn blend(a: f64, b: f64, share: f64) -> f64 {
    a + (b - a) * share
}

impl Drape {
    /// The cloth for a head, ready to be added to its scene.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub fn object(&self, fit: &FaceFit<'_>) -> Result<Object, TraceError> {
        let color = self
            .color
            .map(|v| facile_core::color::LINEAR_FROM_SRGB8[usize::from(v)]);
        let cloth = Material {
            albedo: Albedo::Constant(Rgb::from(color)),
            ..Material::default()
        };
        Ok(Object::new(&self.mesh(fit), Normals::Smooth, cloth)?.as_occluder())
    }

    /// The cloth for a head, mm, head frame.
    pub fn mesh(&self, fit: &FaceFit<'_>) -> Mesh {
        match self.kind {
            DrapeKind::SurgicalMask => mask(fit),
            DrapeKind::Scarf => scarf(fit),
            DrapeKind::Cap => cap(fit),
        }
    }
}

fn mask(fit: &FaceFit<'_>) -> Mesh {
    let scale = fit.half_eye_distance() / 29.0;
    let (bridge, tip, chin) = (fit.landmark(28).y, fit.landmark(30).y, fit.landmark(8).y);
    let corners = fit.landmark(48).y.midpoint(fit.landmark(54).y);
    let half_angle = 1.15;
    let sheet = Membrane::over(fit, [49, 33], false, 2.0, |s, t| {
        let side = s * s;
        let top = blend(bridge, tip + 4.0 * scale, side);
        let bottom = blend(chin - 7.0 * scale, corners - 4.0 * scale, side);
        around(blend(top, bottom, t), s * half_angle)
    });
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    for (side, column) in [(1.0, sheet.columns - 1), (-1.0, 0)] {
        let root = fit.ear_roots[usize::from(side < 0.0)];
        let behind = Point3::new(root.x, root.y.midpoint(tip), root.z - 9.0 * scale);
        let way = [
            sheet.point(column, 0),
            root + Vector3::new(0.0, 1.5, 0.0),
            behind,
            Point3::new(root.x, tip - 14.0 * scale, root.z - 2.0 * scale),
            sheet.point(column, sheet.rows - 1),
        ];
        let loop_points = strap(fit, &way, side);
        add_tube(
            &mut mesh,
            &loop_points,
            false,
            |_| Vector3::y() + Vector3::z() * 0.3,
            [1.6, 1.6],
            Segment::Other,
        );
    }
    mesh
}

/// A cord along the head's side through the given points.
fn strap(fit: &FaceFit<'_>, way: &[Point3], side: f64) -> Vec<Point3> {
    const STEPS: usize = 8;
    let mut points = vec![way[0]];
    for pair in way.windows(2) {
        for i in 1..=STEPS {
            let mut p = Point3::from(
                pair[0]
                    .coords
                    .lerp(&pair[1].coords, i as f64 / STEPS as f64),
            );
            if let Some(x) = fit.side(side, p.y, p.z) {
                p.x = side * (p.x * side).max(x * side + 1.0);
            }
            points.push(p);
        }
    }
    points
}

fn scarf(fit: &FaceFit<'_>) -> Mesh {
    let scale = fit.half_eye_distance() / 29.0;
    let (lip, chin) = (fit.landmark(51).y, fit.landmark(8).y);
    let nape = chin + 10.0 * scale;
    let mut sheet = Membrane::over(fit, [96, 29], true, 6.0 * scale, |s, t| {
        let phi = s * std::f64::consts::PI;
        let front = 0.5 + 0.5 * libm::cos(phi);
        let top = blend(nape, lip + 6.0 * scale, front * front);
        around(blend(top, chin - 95.0 * scale, t), phi)
    });
    // Folds that run around the neck, and a wider lower part
    for row in 0..sheet.rows {
        let t = row as f64 / (sheet.rows - 1) as f64;
        for column in 0..sheet.columns {
            let s = 2.0 * column as f64 / sheet.columns as f64 - 1.0;
            let phase = 15.0 * t + 1.3 * libm::sin(std::f64::consts::TAU * s);
            let fold = 1.0 - libm::cos(phase);
            sheet.radii[row * sheet.columns + column] += (2.6 * fold + 16.0 * t * t) * scale;
        }
    }
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    mesh
}

fn cap(fit: &FaceFit<'_>) -> Mesh {
    const COLUMNS: usize = 72;
    const BRIM: usize = 33;
    const STEPS: usize = 8;
    let scale = fit.half_eye_distance() / 29.0;
    let brow = fit.landmark(19).y.midpoint(fit.landmark(24).y);
    let center = Point3::new(0.0, brow + 2.0 * scale, -6.0 * scale);
    let sheet = Membrane::over(fit, [COLUMNS, 20], true, 3.0, |s, t| {
        let phi = s * std::f64::consts::PI;
        let front = 0.5 + 0.5 * libm::cos(phi);
        // From the crown down to a band that is higher in front
        let lowest = std::f64::consts::FRAC_PI_2 - blend(-0.12, 0.2, front);
        let theta = blend(0.03, lowest, t);
        let out = Vector3::new(
            libm::sin(theta) * libm::sin(phi),
            libm::cos(theta),
            libm::sin(theta) * libm::cos(phi),
        );
        (center, out)
    });
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    // The crown's hole
    let top = mesh.positions.len() as u32;
    let ring: Vec<Point3> = (0..COLUMNS).map(|c| sheet.point(c, 0)).collect();
    let sum = ring.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords);
    mesh.positions.push(Point3::from(sum / COLUMNS as f64));
    for c in 0..COLUMNS as u32 {
        mesh.triangles.push([top, c, (c + 1) % COLUMNS as u32]);
    }
    mesh.segments.resize(mesh.triangles.len(), Segment::Other);
    // The brim: from the band forward, longest in the middle, drooping to its sides
    let half = 0.3 * COLUMNS as f64 / 2.0;
    let mut points = Vec::new();
    for step in 0..=STEPS {
        let out = step as f64 / STEPS as f64;
        for k in 0..BRIM {
            let s = 2.0 * k as f64 / (BRIM - 1) as f64 - 1.0;
            let column = COLUMNS as f64 / 2.0 + s * half;
            let (low, share) = (column.floor() as usize, column.fract());
            let row = sheet.rows - 1;
            let band = sheet
                .point(low, row)
                .coords
                .lerp(&sheet.point(low + 1, row).coords, share);
            let shape = libm::sqrt((1.0 - s * s).max(0.0));
            let length = 62.0 * scale * shape;
            let droop = -0.18 * out * length - 9.0 * scale * s * s * out * shape;
            points.push(Point3::from(band + Vector3::new(0.0, droop, out * length)));
        }
    }
    add_grid(&mut mesh, &points, BRIM, false);
    mesh
}
