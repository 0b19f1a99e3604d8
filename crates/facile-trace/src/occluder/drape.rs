//! Cloth over a head: surgical mask, scarf, cap, hat, head band.
//!
//! A sheet of rays from inside the head meets its surface; the cloth is the tightest membrane outside those points: relaxed
//! towards the threads between its neighbours, never under the surface plus its clearance.

use facile_core::{Mesh, Point3, Segment, Vector3};

use super::Prop;
use super::fit::FaceFit;
use super::sweep::add_tube;

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

/// Where threads pull a point: a length, and shares of its neighbours' radii.
#[derive(Clone, Copy, Default)]
struct Pull {
    rest: f64,
    left: f64,
    right: f64,
    above: f64,
    below: f64,
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
                // Where there is no skin below, cloth hangs down
                let above = sheet.radii.len().checked_sub(columns);
                let hanging = above.map_or(0.0, |i| sheet.radii[i]);
                let reach = fit.reach(center, direction);
                sheet.radii.push(reach.map_or(hanging, |r| r + clearance));
            }
        }
        sheet.relax();
        sheet
    }

    /// Moves each point, never under its floor, to where the threads between its opposite neighbours pass. Points whose row
    /// and column add up to an even number go first, so that both sides of a face are treated alike.
    fn relax(&mut self) {
        let floor = self.radii.clone();
        let pulls = self.pulls();
        let (n, rows) = (self.columns, self.rows);
        for round in 0..2 * RELAXATIONS {
            for row in 0..rows {
                for column in ((row + round) % 2..n).step_by(2) {
                    let i = row * n + column;
                    let left = if column > 0 { i - 1 } else { i + n - 1 };
                    let right = if column + 1 < n { i + 1 } else { i + 1 - n };
                    // Past the first and last row there is no pull
                    let above = i.saturating_sub(n);
                    let below = if row + 1 < rows { i + n } else { i };
                    let pull = &pulls[i];
                    let at = |k: usize| self.radii[k];
                    let across = pull.left * at(left) + pull.right * at(right);
                    let along = pull.above * at(above) + pull.below * at(below);
                    self.radii[i] = floor[i].max(pull.rest + across + along);
                }
            }
        }
    }

    /// How far out the threads between the neighbours of each point pass.
    fn pulls(&self) -> Vec<Pull> {
        let n = self.columns;
        let of = |i: usize| {
            let (row, column) = (i / n, i % n);
            let (center, out) = (self.centers[i], self.directions[i]);
            // Only pairs of opposite neighbours pull: the rim of a sheet keeps its shape along itself
            let is_across = self.is_ring || (column > 0 && column + 1 < n);
            let is_along = row > 0 && row + 1 < self.rows;
            let pairs = u8::from(is_across) + u8::from(is_along);
            if pairs == 0 {
                return Pull {
                    rest: f64::NEG_INFINITY,
                    ..Pull::default()
                };
            }
            let share = 0.5 / f64::from(pairs);
            let mut pull = Pull::default();
            let mut take = |k: usize| {
                pull.rest += (self.centers[k] - center).dot(&out) * share;
                self.directions[k].dot(&out) * share
            };
            let (left, right) = (row * n + (column + n - 1) % n, row * n + (column + 1) % n);
            let [left, right] = [left, right].map(|k| if is_across { take(k) } else { 0.0 });
            let [above, below] = if is_along {
                [i - n, i + n].map(take)
            } else {
                [0.0; 2]
            };
            Pull {
                left,
                right,
                above,
                below,
                ..pull
            }
        };
        (0..self.radii.len()).map(of).collect()
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

pub(super) fn mask(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    let scale = fit.half_eye_distance() / 29.0;
    let (bridge, tip, chin) = (fit.landmark(28).y, fit.landmark(30).y, fit.landmark(8).y);
    let corners = fit.landmark(48).y.midpoint(fit.landmark(54).y);
    let half_angle = 1.15 * (0.5 + 0.5 * style.size);
    let (middle, half) = (f64::midpoint(bridge, chin), style.size);
    let stretched = |y: f64| middle + (y - middle) * half + style.y_mm;
    let mut sheet = Membrane::over(fit, [49, 61], false, 2.0, |s, t| {
        let side = s * s;
        let top = stretched(blend(bridge, tip + 4.0 * scale, side));
        let bottom = stretched(blend(chin - 7.0 * scale, corners - 4.0 * scale, side));
        around(blend(top, bottom, t), s * half_angle)
    });
    // Three pleats, open in the middle and shut at the loops
    for row in 0..sheet.rows {
        let t = row as f64 / (sheet.rows - 1) as f64;
        for column in 0..sheet.columns {
            let s = 2.0 * column as f64 / (sheet.columns - 1) as f64 - 1.0;
            let along = (t - 0.18) / 0.64;
            if (0.0..1.0).contains(&along) {
                let fold = (along * 3.0).fract();
                let depth = 1.3 * scale * (1.0 - s * s).max(0.0);
                sheet.radii[row * sheet.columns + column] +=
                    depth * (1.0 - fold) * smooth(8.0 * fold);
            }
        }
    }
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

pub(super) fn scarf(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    let scale = fit.half_eye_distance() / 29.0;
    let (lip, chin) = (fit.landmark(51).y, fit.landmark(8).y);
    let (lip, chin) = (lip + style.y_mm, chin + style.y_mm.min(0.0));
    let nape = chin + 10.0 * scale;
    let mut sheet = Membrane::over(fit, [96, 57], true, 6.0 * scale, |s, t| {
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
            let thick = (2.6 * fold + 16.0 * t * t) * style.size;
            sheet.radii[row * sheet.columns + column] += thick * scale;
        }
    }
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    mesh
}

/// 0 at 0, 1 from 1 on, smooth.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Columns of a crown: the subject's back is the first, the front the middle one.
const COLUMNS: usize = 72;

/// The tight part of a cap or hat over the skull, from the crown down to a band that is `rise` higher in front than behind,
/// rad. Its band is the last row.
fn crown(
    fit: &FaceFit<'_>,
    y_mm: f64,
    [front_angle, back_angle]: [f64; 2],
    clearance: f64,
) -> Membrane {
    let scale = fit.half_eye_distance() / 29.0;
    let brow = fit.landmark(19).y.midpoint(fit.landmark(24).y);
    let center = Point3::new(0.0, brow + 2.0 * scale + y_mm, -6.0 * scale);
    Membrane::over(fit, [COLUMNS, 20], true, clearance, |s, t| {
        let phi = s * std::f64::consts::PI;
        let front = 0.5 + 0.5 * libm::cos(phi);
        let lowest = std::f64::consts::FRAC_PI_2 - blend(back_angle, front_angle, front);
        let theta = blend(0.03, lowest, t);
        let out = Vector3::new(
            libm::sin(theta) * libm::sin(phi),
            libm::cos(theta),
            libm::sin(theta) * libm::cos(phi),
        );
        (center, out)
    })
}

/// Closes the hole at a crown's top.
fn add_top(sheet: &Membrane, mesh: &mut Mesh) {
    let top = mesh.positions.len() as u32;
    let ring: Vec<Point3> = (0..COLUMNS).map(|c| sheet.point(c, 0)).collect();
    let sum = ring.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords);
    mesh.positions.push(Point3::from(sum / COLUMNS as f64));
    for c in 0..COLUMNS as u32 {
        mesh.triangles.push([top, c, (c + 1) % COLUMNS as u32]);
    }
    mesh.segments.resize(mesh.triangles.len(), Segment::Other);
}

/// A point of the band, at a column between whole ones.
fn band_at(sheet: &Membrane, column: f64) -> Vector3 {
    let (low, share) = (column.floor(), column - column.floor());
    let at = |c: f64| {
        let c = c.rem_euclid(COLUMNS as f64) as usize;
        sheet.point(c, sheet.rows - 1).coords
    };
    at(low).lerp(&at(low + 1.0), share)
}

pub(super) fn cap(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    const BRIM: usize = 33;
    const STEPS: usize = 8;
    let scale = fit.half_eye_distance() / 29.0;
    let sheet = crown(fit, style.y_mm, [0.2, -0.12], 3.0);
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    add_top(&sheet, &mut mesh);
    // The brim: outwards from the band, longest in the middle, drooping to its sides
    let half = 0.3 * COLUMNS as f64 / 2.0;
    let turn = style.turn_deg.to_radians();
    let forward = Vector3::new(libm::sin(turn), 0.0, libm::cos(turn));
    let middle = COLUMNS as f64 * (0.5 + turn / std::f64::consts::TAU);
    let mut points = Vec::new();
    for step in 0..=STEPS {
        let out = step as f64 / STEPS as f64;
        for k in 0..BRIM {
            let s = 2.0 * k as f64 / (BRIM - 1) as f64 - 1.0;
            let band = band_at(&sheet, middle + s * half);
            let shape = libm::sqrt((1.0 - s * s).max(0.0));
            let length = 62.0 * scale * style.size * shape;
            let droop = -0.18 * out * length - 9.0 * scale * s * s * out * shape;
            let down = Vector3::y() * droop;
            points.push(Point3::from(band + forward * (out * length) + down));
        }
    }
    add_grid(&mut mesh, &points, BRIM, false);
    mesh
}

pub(super) fn hat(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    const STEPS: usize = 8;
    let scale = fit.half_eye_distance() / 29.0;
    let mut sheet = crown(fit, style.y_mm, [0.26, 0.0], 5.0);
    // A crown with a flat top and straight sides, as felt keeps them
    let rows = sheet.rows;
    let tall = (0..COLUMNS)
        .map(|c| sheet.point(c, 0).y)
        .fold(f64::MIN, f64::max)
        + 12.0 * scale;
    for row in 0..rows {
        for column in 0..COLUMNS {
            let i = row * COLUMNS + column;
            let (center, out) = (sheet.centers[i], sheet.directions[i]);
            let band = sheet.point(column, rows - 1);
            let side = libm::hypot(band.x - center.x, band.z - center.z);
            let across = libm::hypot(out.x, out.z).max(1e-6);
            let to_side = side * 0.97 / across;
            let to_top = (tall - center.y) / out.y.max(1e-6);
            // The corner between them is round
            let power = 7.0;
            let sum = libm::pow(to_side, -power) + libm::pow(to_top.max(1.0), -power);
            let felt = libm::pow(sum, -1.0 / power);
            if row + 1 < rows {
                sheet.radii[i] = sheet.radii[i].max(felt);
            }
        }
    }
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    add_top(&sheet, &mut mesh);
    // A brim all around that rises at the sides
    let mut points = Vec::new();
    for step in 0..=STEPS {
        let out = step as f64 / STEPS as f64;
        for column in 0..COLUMNS {
            let phi = (2.0 * column as f64 / COLUMNS as f64 - 1.0) * std::f64::consts::PI;
            let away = Vector3::new(libm::sin(phi), 0.0, libm::cos(phi));
            let length = 58.0 * scale * style.size;
            let rise = 10.0 * scale * libm::sin(phi).abs() * out * out - 0.16 * out * length;
            let band = band_at(&sheet, column as f64);
            let up = Vector3::y() * rise;
            points.push(Point3::from(band + away * (out * length) + up));
        }
    }
    add_grid(&mut mesh, &points, COLUMNS, true);
    mesh
}

pub(super) fn head_band(style: &Prop, fit: &FaceFit<'_>) -> Mesh {
    let scale = fit.half_eye_distance() / 29.0;
    let brow = fit.landmark(19).y.midpoint(fit.landmark(24).y);
    let (front, back) = (
        brow + 34.0 * scale + style.y_mm,
        brow - 8.0 * scale + style.y_mm,
    );
    let half = 15.0 * scale * style.size;
    let mut sheet = Membrane::over(fit, [96, 9], true, 1.6, |s, t| {
        let phi = s * std::f64::consts::PI;
        let middle = blend(back, front, 0.5 + 0.5 * libm::cos(phi));
        around(middle + half * (1.0 - 2.0 * t), phi)
    });
    // Rounded edges
    for row in 0..sheet.rows {
        let t = 2.0 * row as f64 / (sheet.rows - 1) as f64 - 1.0;
        for column in 0..sheet.columns {
            sheet.radii[row * sheet.columns + column] += 1.4 * (1.0 - t * t);
        }
    }
    let mut mesh = Mesh::default();
    sheet.add_to(&mut mesh);
    mesh
}
