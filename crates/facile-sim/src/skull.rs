//! The skull as a smooth height field on the cylinder: radius over height and angle, a bicubic B-spline.
//!
//! Section 4.3.2 projects the skull onto the cylinder and checks fascia against it. A B-spline is twice continuously
//! differentiable, so that contact has no steps for a solver to stumble over. Its second coordinate is `sin(phi / 2)`
//! rather than `phi`: nearly the same over the face, and two square roots instead of an arc tangent. One field holds
//! both pieces: each node meets it in the frame of the piece below it, skull or jaw or the blend of both, see
//! `kinematics`.

use crate::SimError;
use crate::layers::{Layers, area_vector};
use crate::sparse::BandMatrix;
use crate::vector::{V3, ZERO, add, norm, scale};

/// Distance of the knots in height on the reference head, mm.
const KNOT_H_MM: f64 = 5.0;
/// Distance of the knots in `sin(phi / 2)`; at the nose 0.065 rad.
const KNOT_SIDE: f64 = 0.0325;
/// Weight of the bending energy against the squared distances, per sample.
const SMOOTHING: f64 = 2e-3;
/// Surface that faces the axis at less than this cosine does not shape the field.
const MIN_FACING: f64 = 0.2;
/// Largest angle with knots, rad.
const MAX_PHI: f64 = 2.2;

/// The knots, the same for all subjects.
#[derive(Debug)]
pub(crate) struct SkullGrid {
    rows: usize,
    columns: usize,
}

/// Radius over height and side.
#[derive(Clone, Debug)]
pub(crate) struct HeightField {
    h0: f64,
    per_h: f64,
    side0: f64,
    columns: usize,
    rows: usize,
    coefficients: Vec<f64>,
}

/// Value and slopes of the field.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Height {
    /// Radius, mm.
    pub(crate) radius: f64,
    /// Slope over height.
    pub(crate) over_h: f64,
    /// Slope over `sin(phi / 2)`, mm.
    pub(crate) over_side: f64,
}

/// A point's radius, `sin(phi / 2)` and `cos(phi / 2)`.
#[inline(always)]
fn cylindrical(p: V3) -> (f64, f64, f64) {
    let radius = (p[0] * p[0] + p[2] * p[2]).sqrt().max(1.0);
    // Behind the head the angle has no sign; no knots are there.
    let cos = (0.5 * (1.0 + p[2] / radius)).max(1e-4).sqrt();
    (radius, (0.5 * p[0] / (radius * cos)).clamp(-1.0, 1.0), cos)
}

fn heights(fascia: &[V3]) -> (f64, f64) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for p in fascia {
        low = low.min(p[1]);
        high = high.max(p[1]);
    }
    (low - KNOT_H_MM, high + KNOT_H_MM)
}

impl SkullGrid {
    /// Knots that cover the fascia of the reference head.
    pub(crate) fn new(layers: &Layers) -> Self {
        let (low, high) = heights(&layers.fascia);
        let most = libm::sin(0.5 * MAX_PHI);
        let side = layers
            .fascia
            .iter()
            .map(|p| cylindrical(*p).1.abs())
            .fold(0.25, f64::max)
            .min(most)
            + KNOT_SIDE;
        let rows = ((high - low) / KNOT_H_MM).ceil() as usize + 3;
        let columns = (2.0 * side / KNOT_SIDE).ceil() as usize + 3;
        Self { rows, columns }
    }

    /// Place of a knot in the system: columns of knots one after the other, so that pairs of neighbours are near.
    fn place(&self, row: usize, column: usize) -> usize {
        column * self.rows + row
    }

    /// Fits the fascia at rest, by area-weighted least squares with a little bending energy.
    pub(crate) fn fit(
        &self,
        triangles: &[[u32; 3]],
        layers: &Layers,
    ) -> Result<HeightField, SimError> {
        let (low, high) = heights(&layers.fascia);
        let mut field = HeightField {
            h0: low,
            per_h: (self.rows - 3) as f64 / (high - low).max(1.0),
            // Centred, so that mirrored shapes have mirrored fields.
            side0: -0.5 * (self.columns - 3) as f64 * KNOT_SIDE,
            rows: self.rows,
            columns: self.columns,
            coefficients: Vec::new(),
        };
        let knots = self.rows * self.columns;
        let mut matrix = BandMatrix::new(knots, 3 * self.rows + 3);
        let mut right = vec![0.0; knots];
        let mut total = 0.0;
        for s in samples(triangles, layers) {
            let (row, column, wh, ws) = field.weights(s.h, s.side);
            for a in 0..16 {
                let at = self.place(row + a % 4, column + a / 4);
                let w = s.weight * wh[a % 4] * ws[a / 4];
                right[at] += w * s.radius;
                for b in 0..=a {
                    let other = self.place(row + b % 4, column + b / 4);
                    matrix.add(at, other, w * wh[b % 4] * ws[b / 4]);
                }
            }
            total += s.weight;
        }
        self.smooth(&mut matrix, total);
        matrix.solve("skull field", &mut right)?;
        field.coefficients = (0..knots)
            .map(|k| right[self.place(k / self.columns, k % self.columns)])
            .collect();
        Ok(field)
    }

    /// Adds the bending energy, `total` being the weight of all samples.
    fn smooth(&self, matrix: &mut BandMatrix, total: f64) {
        const BEND: [f64; 3] = [1.0, -2.0, 1.0];
        let bend = SMOOTHING * total / (self.rows * self.columns) as f64;
        for i in 0..self.rows {
            for j in 0..self.columns {
                for a in 0..3 {
                    for b in a..3 {
                        let w = bend * BEND[a] * BEND[b];
                        if i + 2 < self.rows {
                            matrix.add(self.place(i + a, j), self.place(i + b, j), w);
                        }
                        if j + 2 < self.columns {
                            matrix.add(self.place(i, j + a), self.place(i, j + b), w);
                        }
                    }
                }
                let at = self.place(i, j);
                matrix.add(at, at, 1e-9 * total);
            }
        }
    }
}

impl HeightField {
    fn weights(&self, h: f64, side: f64) -> (usize, usize, [f64; 4], [f64; 4]) {
        let (row, u, _) = cell((h - self.h0) * self.per_h, self.rows);
        let (column, v, _) = cell((side - self.side0) / KNOT_SIDE, self.columns);
        (row, column, basis(u), basis(v))
    }

    /// Radius and slopes at height `h` (mm) and `side = sin(phi / 2)`; constant beyond the fitted region.
    #[inline]
    pub(crate) fn at(&self, h: f64, side: f64) -> Height {
        let (row, u, clamped_h) = cell((h - self.h0) * self.per_h, self.rows);
        let (column, v, clamped_side) = cell((side - self.side0) / KNOT_SIDE, self.columns);
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
            over_h: if clamped_h { 0.0 } else { over_u * self.per_h },
            over_side: if clamped_side {
                0.0
            } else {
                over_v / KNOT_SIDE
            },
        }
    }

    /// Distance of a point from the field along the radius, mm, and its gradient.
    #[inline]
    pub(crate) fn gap(&self, p: V3) -> (f64, V3) {
        let (radius, side, half) = cylindrical(p);
        let height = self.at(p[1], side);
        let (sin, cos) = (p[0] / radius, p[2] / radius);
        // d side = cos(phi / 2) / 2 d phi.
        let turn = 0.5 * half * height.over_side / radius;
        // Radial direction (sin, 0, cos), direction of growing phi (cos, 0, -sin).
        let gradient = [sin - turn * cos, -height.over_h, cos + turn * sin];
        (radius - height.radius, gradient)
    }

    /// Second derivatives of the gap at a point, 1/mm.
    pub(crate) fn curvature(&self, p: V3) -> [V3; 3] {
        let (radius, side, half) = cylindrical(p);
        let Bend {
            over_side,
            h_h,
            h_side,
            side_side,
        } = self.bend(p[1], side);
        let (sin, cos) = (p[0] / radius, p[2] / radius);
        let (out, around) = ([sin, 0.0, cos], [cos, 0.0, -sin]);
        // First and second derivative of the side by the angle, times those of the angle by place.
        let turn = 0.5 * half / radius;
        let outer = |a: V3, b: V3, k: f64| a.map(|a| b.map(|b| k * a * b));
        let up = [0.0, 1.0, 0.0];
        let twice = (1.0 + 0.25 * side * over_side / radius) / radius - side_side * turn * turn;
        let skew = over_side * turn / radius;
        let terms = [
            outer(around, around, twice),
            outer(around, out, skew),
            outer(out, around, skew),
            outer(up, up, -h_h),
            outer(up, around, -h_side * turn),
            outer(around, up, -h_side * turn),
        ];
        let mut sum = [ZERO; 3];
        for term in terms {
            for (row, t) in sum.iter_mut().zip(term) {
                *row = add(*row, t);
            }
        }
        sum
    }

    /// First derivative over the side and second derivatives of the radius; zero beyond the fitted region.
    fn bend(&self, h: f64, side: f64) -> Bend {
        let (row, u, clamped_h) = cell((h - self.h0) * self.per_h, self.rows);
        let (column, v, clamped_side) = cell((side - self.side0) / KNOT_SIDE, self.columns);
        let product = |a: [f64; 4], b: [f64; 4]| -> f64 {
            (0..4)
                .map(|i| {
                    let line = &self.coefficients[(row + i) * self.columns + column..][..4];
                    a[i] * (line[0] * b[0] + line[1] * b[1] + line[2] * b[2] + line[3] * b[3])
                })
                .sum()
        };
        let per_h = if clamped_h { 0.0 } else { self.per_h };
        let per_side = if clamped_side { 0.0 } else { 1.0 / KNOT_SIDE };
        Bend {
            over_side: per_side * product(basis(u), slope(v)),
            h_h: per_h * per_h * product(bending(u), basis(v)),
            h_side: per_h * per_side * product(slope(u), slope(v)),
            side_side: per_side * per_side * product(basis(u), bending(v)),
        }
    }
}

/// How the field bends.
struct Bend {
    over_side: f64,
    h_h: f64,
    h_side: f64,
    side_side: f64,
}

struct Sample {
    h: f64,
    side: f64,
    radius: f64,
    weight: f64,
}

/// Points of the fascia, 6 per element, weighted by area and by how well they face outwards.
fn samples(triangles: &[[u32; 3]], layers: &Layers) -> Vec<Sample> {
    let mut out = Vec::with_capacity(triangles.len() * 6);
    for t in triangles {
        let corners = t.map(|i| layers.fascia[i as usize]);
        let area = area_vector(corners);
        let size = norm(area);
        for i in 0..3u8 {
            for j in 0..3 - i {
                let (a, b) = (f64::from(i) / 2.0, f64::from(j) / 2.0);
                let p = add(
                    add(scale(corners[0], a), scale(corners[1], b)),
                    scale(corners[2], 1.0 - a - b),
                );
                let (radius, side, _) = cylindrical(p);
                let facing = (area[0] * p[0] + area[2] * p[2]) / (radius * size).max(1e-12);
                if facing > MIN_FACING {
                    out.push(Sample {
                        h: p[1],
                        side,
                        radius,
                        weight: size * facing,
                    });
                }
            }
        }
    }
    out
}

/// First of the four coefficients, place in the cell, and whether the coordinate lies outside.
fn cell(t: f64, count: usize) -> (usize, f64, bool) {
    let last = (count - 3) as f64;
    let inside = t.clamp(0.0, last);
    // Truncation is the floor of what is not negative.
    let first = (inside as usize).min(count - 4);
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

fn bending(t: f64) -> [f64; 4] {
    [1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t]
}

/// A field fitted to a patch of an ellipsoid.
#[cfg(test)]
pub(crate) fn test_patch() -> HeightField {
    let (triangles, layers) = tests::patch();
    let grid = SkullGrid::new(&layers);
    grid.fit(&triangles, &layers).expect("positive")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A patch of a vertical ellipsoid around the axis.
    pub(super) fn patch() -> (Vec<[u32; 3]>, Layers) {
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
        let field = test_patch();
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
    fn its_curvature_is_the_slope_of_its_gradient() {
        let field = test_patch();
        for p in [[30.0, 10.0, 72.0], [-51.0, -33.0, 40.0], [2.0, 41.0, 83.0]] {
            let curvature = field.curvature(p);
            for k in 0..3 {
                let (mut q, mut r) = (p, p);
                q[k] += 1e-5;
                r[k] -= 1e-5;
                let (q, r) = (field.gap(q).1, field.gap(r).1);
                for l in 0..3 {
                    let slope = (q[l] - r[l]) / 2e-5;
                    assert!(
                        (slope - curvature[k][l]).abs() < 1e-8,
                        "{k} {l}: {slope} {curvature:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn beyond_its_border_the_field_is_constant() {
        let field = test_patch();
        let (a, b) = (field.at(900.0, 0.0), field.at(1000.0, 0.0));
        assert!((a.radius - b.radius).abs() < 1e-12 && a.over_h == 0.0);
    }
}
