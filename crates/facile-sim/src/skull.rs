//! The skull as a smooth height field on the cylinder: radius over `(h, phi)`, a bicubic B-spline.
//!
//! Section 4.3.2 projects the skull onto the cylinder and checks fascia against it. A B-spline is twice continuously
//! differentiable, so that contact has no steps for a solver to stumble over. One field holds both pieces: each node
//! meets it in the frame of the piece below it, skull or jaw or the blend of both, see `kinematics`.

use crate::SimError;
use crate::layers::{Layers, area_vector};
use crate::sparse::{Factor, Pattern};
use crate::vector::{V3, add, norm, scale};

/// Distance of the knots in height, mm.
const KNOT_H_MM: f64 = 5.0;
/// Distance of the knots in angle, rad.
const KNOT_PHI: f64 = 0.065;
/// Weight of the bending energy against the squared distances, per sample.
const SMOOTHING: f64 = 2e-3;
/// Surface that faces the axis at less than this cosine does not shape the field.
const MIN_FACING: f64 = 0.2;

/// Radius over height and angle.
#[derive(Clone, Debug)]
pub(crate) struct HeightField {
    h0: f64,
    phi0: f64,
    rows: usize,
    columns: usize,
    coefficients: Vec<f64>,
}

/// Value and slopes of the field.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Height {
    /// Radius, mm.
    pub(crate) radius: f64,
    /// Slope over height.
    pub(crate) over_h: f64,
    /// Slope over angle, mm per rad.
    pub(crate) over_phi: f64,
}

impl HeightField {
    /// Fits the fascia at rest, by area-weighted least squares with a little bending energy.
    pub(crate) fn fit(triangles: &[[u32; 3]], layers: &Layers) -> Result<Self, SimError> {
        let (mut low, mut high, mut side) = (f64::INFINITY, f64::NEG_INFINITY, 0.5f64);
        for p in &layers.fascia {
            low = low.min(p[1]);
            high = high.max(p[1]);
            side = side.max(libm::atan2(p[0], p[2]).abs());
        }
        let side = side.min(2.2) + KNOT_PHI;
        let (low, high) = (low - KNOT_H_MM, high + KNOT_H_MM);
        let mut field = Self {
            h0: low,
            phi0: -side,
            rows: ((high - low) / KNOT_H_MM).ceil() as usize + 3,
            columns: (2.0 * side / KNOT_PHI).ceil() as usize + 3,
            coefficients: Vec::new(),
        };
        // Centre the columns, so that mirrored shapes have mirrored fields.
        field.phi0 = -0.5 * (field.columns - 3) as f64 * KNOT_PHI;
        field.coefficients = field.solve(&samples(triangles, layers))?;
        Ok(field)
    }

    /// Radius and slopes at height `h` (mm) and angle `phi` (rad); constant beyond the fitted region.
    pub(crate) fn at(&self, h: f64, phi: f64) -> Height {
        let (row, u, clamped_h) = cell((h - self.h0) / KNOT_H_MM, self.rows);
        let (column, v, clamped_phi) = cell((phi - self.phi0) / KNOT_PHI, self.columns);
        let (wu, du, wv, dv) = (basis(u), slope(u), basis(v), slope(v));
        let (mut radius, mut over_u, mut over_v) = (0.0, 0.0, 0.0);
        for i in 0..4 {
            let line = &self.coefficients[(row + i) * self.columns + column..][..4];
            let value = line[0] * wv[0] + line[1] * wv[1] + line[2] * wv[2] + line[3] * wv[3];
            let along = line[0] * dv[0] + line[1] * dv[1] + line[2] * dv[2] + line[3] * dv[3];
            radius += wu[i] * value;
            over_u += du[i] * value;
            over_v += wu[i] * along;
        }
        Height {
            radius,
            over_h: if clamped_h { 0.0 } else { over_u / KNOT_H_MM },
            over_phi: if clamped_phi { 0.0 } else { over_v / KNOT_PHI },
        }
    }

    /// Distance of a point from the field along the radius, mm, and its gradient.
    pub(crate) fn gap(&self, p: V3) -> (f64, V3) {
        let radius = libm::sqrt(p[0] * p[0] + p[2] * p[2]).max(1.0);
        let (sin, cos) = (p[0] / radius, p[2] / radius);
        let height = self.at(p[1], libm::atan2(p[0], p[2]));
        let turn = height.over_phi / radius;
        // Radial direction (sin, 0, cos), direction of growing phi (cos, 0, -sin).
        let gradient = [sin - turn * cos, -height.over_h, cos + turn * sin];
        (radius - height.radius, gradient)
    }

    fn solve(&self, samples: &[Sample]) -> Result<Vec<f64>, SimError> {
        let n = self.rows * self.columns;
        let index = |i: usize, j: usize| (i * self.columns + j) as u32;
        let near = (0..self.rows).flat_map(|i| (0..self.columns).map(move |j| (i, j)));
        let pairs = near.flat_map(|(i, j)| {
            (0..4usize)
                .flat_map(move |di| (-3..=3i64).map(move |dj| (di, dj)))
                .filter_map(move |(di, dj)| {
                    let (k, l) = (i + di, j as i64 + dj);
                    let inside = k < self.rows && l >= 0 && l < self.columns as i64;
                    inside.then(|| (index(i, j), index(k, l as usize)))
                })
        });
        let pattern = Pattern::new(n, "skull field", pairs)?;
        let mut matrix = vec![0.0; pattern.entries()];
        let mut side = vec![0.0; n];
        let mut total = 0.0;
        for s in samples {
            let (row, u, _) = cell((s.h - self.h0) / KNOT_H_MM, self.rows);
            let (column, v, _) = cell((s.phi - self.phi0) / KNOT_PHI, self.columns);
            let (wu, wv) = (basis(u), basis(v));
            let terms: Vec<(u32, f64)> = (0..16)
                .map(|k| (index(row + k / 4, column + k % 4), wu[k / 4] * wv[k % 4]))
                .collect();
            add_square(&pattern, &mut matrix, &terms, s.weight);
            for (i, w) in &terms {
                side[*i as usize] += s.weight * w * s.radius;
            }
            total += s.weight;
        }
        let bend = SMOOTHING * total / n as f64;
        for i in 0..self.rows {
            for j in 0..self.columns {
                if i + 2 < self.rows {
                    let line = [0, 1, 2].map(|k| (index(i + k, j), [1.0, -2.0, 1.0][k]));
                    add_square(&pattern, &mut matrix, &line, bend);
                }
                if j + 2 < self.columns {
                    let line = [0, 1, 2].map(|k| (index(i, j + k), [1.0, -2.0, 1.0][k]));
                    add_square(&pattern, &mut matrix, &line, bend);
                }
                matrix[pattern.slot(index(i, j), index(i, j)) as usize] += 1e-9 * total;
            }
        }
        let mut factor = Factor::new(&pattern, 1);
        factor.refactor(&pattern, "skull field", &matrix)?;
        factor.solve(&pattern, &mut side);
        Ok(side)
    }
}

struct Sample {
    h: f64,
    phi: f64,
    radius: f64,
    weight: f64,
}

/// Points of the fascia, 10 per element, weighted by area and by how well they face outwards.
fn samples(triangles: &[[u32; 3]], layers: &Layers) -> Vec<Sample> {
    let mut out = Vec::with_capacity(triangles.len() * 10);
    for t in triangles {
        let corners = t.map(|i| layers.fascia[i as usize]);
        let area = area_vector(corners);
        let size = norm(area);
        for i in 0..4u8 {
            for j in 0..4 - i {
                let (a, b) = (f64::from(i) / 3.0, f64::from(j) / 3.0);
                let p = add(
                    add(scale(corners[0], a), scale(corners[1], b)),
                    scale(corners[2], 1.0 - a - b),
                );
                let radius = libm::sqrt(p[0] * p[0] + p[2] * p[2]);
                let facing = (area[0] * p[0] + area[2] * p[2]) / (radius * size).max(1e-12);
                if facing > MIN_FACING {
                    out.push(Sample {
                        h: p[1],
                        phi: libm::atan2(p[0], p[2]),
                        radius,
                        weight: size * facing,
                    });
                }
            }
        }
    }
    out
}

fn add_square(pattern: &Pattern, matrix: &mut [f64], terms: &[(u32, f64)], weight: f64) {
    for (k, (i, a)) in terms.iter().enumerate() {
        for (j, b) in &terms[..=k] {
            matrix[pattern.slot(*i, *j) as usize] += weight * a * b;
        }
    }
}

/// First of the four coefficients, place in the cell, and whether the coordinate lies outside.
fn cell(t: f64, count: usize) -> (usize, f64, bool) {
    let last = (count - 3) as f64;
    let inside = t.clamp(0.0, last);
    let first = (inside.floor() as usize).min(count - 4);
    let outside = t < 0.0 || t > last;
    (first, inside - first as f64, outside)
}

/// The four cubic B-splines that overlap a cell.
fn basis(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    let (t2, t3) = (t * t, t * t * t);
    [
        s * s * s / 6.0,
        (3.0 * t3 - 6.0 * t2 + 4.0) / 6.0,
        (-3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0) / 6.0,
        t3 / 6.0,
    ]
}

fn slope(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [
        -0.5 * s * s,
        1.5 * t * t - 2.0 * t,
        -1.5 * t * t + t + 0.5,
        0.5 * t * t,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A patch of a vertical ellipsoid around the axis.
    fn patch() -> (Vec<[u32; 3]>, Layers) {
        let (rows, columns) = (25u32, 41u32);
        let mut fascia = Vec::new();
        for i in 0..rows {
            for j in 0..columns {
                let (h, phi) = (f64::from(i) * 5.0 - 60.0, f64::from(j) * 0.07 - 1.4);
                let r = 80.0 * libm::sqrt(1.0 - (h / 130.0) * (h / 130.0));
                fascia.push([r * libm::sin(phi), h, r * libm::cos(phi)]);
            }
        }
        let mut triangles = Vec::new();
        for i in 0..rows - 1 {
            for j in 0..columns - 1 {
                let a = i * columns + j;
                triangles.extend([
                    [a, a + 1, a + columns + 1],
                    [a, a + columns + 1, a + columns],
                ]);
            }
        }
        let skin = fascia.clone();
        (triangles, Layers { skin, fascia })
    }

    #[test]
    fn the_field_meets_a_smooth_surface_and_its_gradient_is_right() {
        let (triangles, layers) = patch();
        let field = HeightField::fit(&triangles, &layers).expect("positive");
        let p = [30.0, 10.0, 72.0];
        let (gap, gradient) = field.gap(p);
        let truth = libm::sqrt(30.0f64 * 30.0 + 72.0 * 72.0)
            - 80.0 * libm::sqrt(1.0 - (10.0f64 / 130.0) * (10.0 / 130.0));
        assert!((gap - truth).abs() < 0.1, "{gap} {truth}");
        for k in 0..3 {
            let (mut q, mut r) = (p, p);
            q[k] += 1e-5;
            r[k] -= 1e-5;
            let slope = (field.gap(q).0 - field.gap(r).0) / 2e-5;
            assert!(
                (slope - gradient[k]).abs() < 1e-7,
                "{slope} {}",
                gradient[k]
            );
        }
    }

    #[test]
    fn beyond_its_border_the_field_is_constant() {
        let (triangles, layers) = patch();
        let field = HeightField::fit(&triangles, &layers).expect("positive");
        let (a, b) = (field.at(900.0, 0.0), field.at(1000.0, 0.0));
        assert!((a.radius - b.radius).abs() < 1e-12 && a.over_h == 0.0);
    }
}
