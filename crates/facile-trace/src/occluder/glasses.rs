//! Glasses: two rims, a bridge, temples that rest on the ears, and two thin lenses.
//!
//! The front is a curved sheet `z = z0 - x^2 / (2 wrap) + tilt (y - y0)` as close to the face as its clearance allows; the
//! bridge arches over the nose, the temples run along the head to the root of the ears and bend down behind them. Every
//! measure scales with the distance of the eyes.

use facile_core::{Mesh, Point3, Segment, Vector3};
use serde::{Deserialize, Serialize};

use super::fit::FaceFit;
use super::sweep::add_tube;
use crate::TraceError;
use crate::geometry::Normals;
use crate::material::{Albedo, Material, Transmission};
use crate::math::Rgb;
use crate::object::Object;

/// Half the distance of the eyes' centres that measures are given for, mm.
const REFERENCE_HALF_EYE_DISTANCE: f64 = 29.0;
/// Points of a rim.
const RIM_POINTS: usize = 72;
/// Refractive index of lenses, and their least thickness, mm.
const LENS_INDEX: f64 = 1.5;
const LEAST_THICKNESS: f64 = 1.2;
/// Rings of a lens from its middle to its rim.
const LENS_RINGS: usize = 8;

/// Outline of a lens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RimShape {
    /// A circle, nearly.
    Round,
    /// A rectangle with round corners.
    #[default]
    Rectangular,
}

/// A style of glasses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Glasses {
    /// Outline of the lenses.
    pub shape: RimShape,
    /// 8-bit sRGB colour of the frame.
    pub color: [u8; 3],
    /// Linear RGB share of light that passes a lens, each in `[0, 1]`: 0.95 clear, 0.1 sunglasses.
    pub tint: [f32; 3],
    /// Refracting power of the lenses, dioptres, in `[-8, 8]`: 0 for flat ones, which do not bend light.
    pub diopters: f64,
    /// Thickness of the rims, mm, in `[0.5, 8]`.
    pub rim_mm: f64,
    /// Size of the lenses relative to usual ones, in `[0.7, 1.3]`.
    pub size: f64,
}

impl Default for Glasses {
    /// Clear lenses in a dark rectangular frame.
    fn default() -> Self {
        Self {
            shape: RimShape::Rectangular,
            color: [28, 24, 22],
            tint: [0.93, 0.95, 0.94],
            diopters: 0.0,
            rim_mm: 2.6,
            size: 1.0,
        }
    }
}

impl Glasses {
    /// Dark lenses in a larger frame.
    pub fn sunglasses() -> Self {
        Self {
            shape: RimShape::Rectangular,
            color: [12, 12, 13],
            tint: [0.09, 0.085, 0.08],
            diopters: 0.0,
            rim_mm: 3.4,
            size: 1.12,
        }
    }

    /// The frame and the lenses for a head, ready to be added to its scene.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for a style out of range.
    pub fn objects(&self, fit: &FaceFit<'_>) -> Result<[Object; 2], TraceError> {
        let [frame, lenses] = self.meshes(fit)?;
        let color = self
            .color
            .map(|v| facile_core::color::LINEAR_FROM_SRGB8[usize::from(v)]);
        let plastic = Material {
            albedo: Albedo::Constant(Rgb::from(color)),
            specular: 0.04,
            shininess: 90.0,
            reflectivity: 0.03,
            ..Material::default()
        };
        let tint = Rgb::from(self.tint);
        let mut glass = Material::thin_glass(tint);
        if self.diopters != 0.0 {
            // Light passes two surfaces
            glass.transmission = Some(Transmission::Solid {
                ior: LENS_INDEX as f32,
                tint: tint.map(f32::sqrt),
            });
        }
        Ok([
            Object::new(&frame, Normals::Smooth, plastic)?.as_occluder(),
            Object::new(&lenses, Normals::Smooth, glass)?.as_occluder(),
        ])
    }

    /// The frame and the lenses for a head, mm, head frame.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for a style out of range.
    pub fn meshes(&self, fit: &FaceFit<'_>) -> Result<[Mesh; 2], TraceError> {
        self.check()?;
        let front = Front::new(self, fit);
        let mut frame = Mesh::default();
        let mut lenses = Mesh::default();
        for side in [1.0, -1.0] {
            let rim = front.rim(side);
            let outwards = |i: usize| {
                let from_middle = rim[i] - front.on_sheet(side * front.middle_x, front.middle_y);
                Vector3::new(from_middle.x, from_middle.y, 0.0)
            };
            let section = [front.rim_depth, self.rim_mm];
            add_tube(
                &mut frame,
                &rim,
                true,
                outwards,
                section,
                Segment::GlassesFrame,
            );
            let temple = front.temple(side, fit);
            let section = [0.7 * self.rim_mm.max(1.6), 1.4 * self.rim_mm.max(1.6)];
            add_tube(
                &mut frame,
                &temple,
                false,
                |_| Vector3::y(),
                section,
                Segment::GlassesFrame,
            );
            if self.diopters == 0.0 {
                front.add_lens(side, &mut lenses, |_| 0.0, true);
            } else {
                front.add_solid_lens(side, self.diopters, &mut lenses);
            }
        }
        let bridge = front.bridge(fit);
        let section = [front.rim_depth, self.rim_mm];
        add_tube(
            &mut frame,
            &bridge,
            false,
            |_| Vector3::y(),
            section,
            Segment::GlassesFrame,
        );
        Ok([frame, lenses])
    }

    fn check(&self) -> Result<(), TraceError> {
        let tint_is_valid = self.tint.iter().all(|t| (0.0..=1.0).contains(t));
        let is_valid = tint_is_valid
            && (-8.0..=8.0).contains(&self.diopters)
            && (0.5..=8.0).contains(&self.rim_mm)
            && (0.7..=1.3).contains(&self.size);
        if is_valid {
            return Ok(());
        }
        Err(TraceError::Setting {
            name: "glasses",
            expected: "tint in [0, 1], diopters in [-8, 8], rim_mm in [0.5, 8] and size in [0.7, 1.3]",
            got: format!(
                "tint {:?}, diopters {}, rim_mm {}, size {}",
                self.tint, self.diopters, self.rim_mm, self.size
            ),
        })
    }
}

/// The front of glasses on a face.
struct Front {
    /// Middle of the left lens.
    middle_x: f64,
    middle_y: f64,
    /// Half width and half height of a lens.
    half: [f64; 2],
    /// Exponent of the outline's superellipse.
    exponent: f64,
    /// Radius of the front's curve in the horizontal plane.
    wrap: f64,
    /// Forward lean per mm of height.
    tilt: f64,
    /// `z` of the sheet at `x = 0`, `y = middle_y`.
    z: f64,
    rim_depth: f64,
    clearance: f64,
    scale: f64,
}

impl Front {
    fn new(style: &Glasses, fit: &FaceFit<'_>) -> Self {
        let scale = fit.half_eye_distance() / REFERENCE_HALF_EYE_DISTANCE;
        let size = style.size * scale;
        let [left, right] = [fit.eyes[0].center, fit.eyes[1].center];
        let (exponent, aspect) = match style.shape {
            RimShape::Round => (2.2, 0.92),
            RimShape::Rectangular => (4.0, 0.72),
        };
        let half_width = 25.5 * size;
        let inner = 9.5 * scale;
        let mut front = Self {
            middle_x: inner + half_width,
            middle_y: left.y.midpoint(right.y) - 3.0 * scale,
            half: [half_width, half_width * aspect],
            exponent,
            wrap: 170.0 * scale,
            tilt: 0.12,
            z: 0.0,
            rim_depth: style.rim_mm.clamp(1.8, 3.6),
            clearance: 0.8,
            scale,
        };
        // Bring the sheet as close as the face and the eyes allow
        let cornea = left.z.max(right.z) + fit.eyes[0].radius.max(fit.eyes[1].radius);
        let mut z = cornea + 9.0 * scale + front.middle_x.powi(2) / (2.0 * front.wrap);
        let reach = style.rim_mm / 2.0;
        for side in [1.0, -1.0] {
            for ring in 0..=LENS_RINGS {
                for k in 0..RIM_POINTS {
                    let share = ring as f64 / LENS_RINGS as f64;
                    let [dx, dy] = front.outline(k, share, reach * share);
                    let (x, y) = (side * (front.middle_x + dx), front.middle_y + dy);
                    if let Some(face) = fit.front(x, y) {
                        let flat = face - front.on_sheet(x, y).z;
                        z = z.max(flat + front.rim_depth / 2.0 + front.clearance);
                    }
                }
            }
        }
        front.z = z;
        front
    }

    /// Point `k` of the outline from the middle of a lens, scaled by `share`, then grown by `grow` mm.
    fn outline(&self, k: usize, share: f64, grow: f64) -> [f64; 2] {
        let angle = std::f64::consts::TAU * k as f64 / RIM_POINTS as f64;
        let [c, s] = [libm::cos(angle), libm::sin(angle)];
        // Polar form of the superellipse: evenly spread in angle, so that corners are not left out
        let norm = libm::pow(
            libm::pow(c.abs(), self.exponent) + libm::pow(s.abs(), self.exponent),
            1.0 / self.exponent,
        );
        [
            (self.half[0] * share + grow) * c / norm,
            (self.half[1] * share + grow) * s / norm,
        ]
    }

    fn on_sheet(&self, x: f64, y: f64) -> Point3 {
        let z = self.z - x * x / (2.0 * self.wrap) + self.tilt * (y - self.middle_y);
        Point3::new(x, y, z)
    }

    fn rim(&self, side: f64) -> Vec<Point3> {
        (0..RIM_POINTS)
            .map(|k| {
                let [dx, dy] = self.outline(k, 1.0, 0.0);
                self.on_sheet(side * (self.middle_x + dx), self.middle_y + dy)
            })
            .collect()
    }

    /// A lens of two surfaces whose distance bends light by `diopters`, with a wall around.
    fn add_solid_lens(&self, side: f64, diopters: f64, mesh: &mut Mesh) {
        // Source: the thin lens maker's equation; the sag of a sphere of radius R at r is r^2 / 2R
        let bend = diopters / 1000.0 / (2.0 * (LENS_INDEX - 1.0));
        let edge = self.half.map(|h| h * h).into_iter().sum::<f64>();
        let thickest = LEAST_THICKNESS + (edge * bend).max(0.0);
        let thickness = |squared: f64| thickest - squared * bend;
        let first = mesh.positions.len() as u32;
        self.add_lens(side, mesh, |squared| thickness(squared) / 2.0, true);
        let second = mesh.positions.len() as u32;
        self.add_lens(side, mesh, |squared| -thickness(squared) / 2.0, false);
        let n = RIM_POINTS as u32;
        let rim = 1 + (LENS_RINGS as u32 - 1) * n;
        for k in 0..n {
            let [a, b] = [k, (k + 1) % n].map(|k| first + rim + k);
            let [c, d] = [(k + 1) % n, k].map(|k| second + rim + k);
            let quads = [[a, d, c], [a, c, b]];
            mesh.triangles
                .extend(quads.map(|[a, b, c]| if side > 0.0 { [a, b, c] } else { [a, c, b] }));
        }
        mesh.segments
            .resize(mesh.triangles.len(), Segment::GlassesLens);
    }

    /// A surface of a lens, `depth` of the squared distance from its middle in front of the sheet, seen from its front or
    /// its back.
    fn add_lens(&self, side: f64, mesh: &mut Mesh, depth: impl Fn(f64) -> f64, is_front: bool) {
        let base = mesh.positions.len() as u32;
        let forward = |squared: f64| Vector3::z() * depth(squared);
        mesh.positions
            .push(self.on_sheet(side * self.middle_x, self.middle_y) + forward(0.0));
        for ring in 1..=LENS_RINGS {
            for k in 0..RIM_POINTS {
                let [dx, dy] = self.outline(k, ring as f64 / LENS_RINGS as f64, 0.0);
                let on_sheet = self.on_sheet(side * (self.middle_x + dx), self.middle_y + dy);
                mesh.positions.push(on_sheet + forward(dx * dx + dy * dy));
            }
        }
        let n = RIM_POINTS as u32;
        let vertex = |ring: u32, k: u32| base + 1 + (ring - 1) * n + k % n;
        let mut add = |[a, b, c]: [u32; 3]| {
            mesh.triangles.push(if (side > 0.0) == is_front {
                [a, b, c]
            } else {
                [a, c, b]
            });
        };
        for k in 0..n {
            add([base, vertex(1, k), vertex(1, k + 1)]);
            for ring in 1..LENS_RINGS as u32 {
                let [a, b] = [vertex(ring, k), vertex(ring, k + 1)];
                let [c, d] = [vertex(ring + 1, k + 1), vertex(ring + 1, k)];
                add([a, d, c]);
                add([a, c, b]);
            }
        }
        mesh.segments
            .resize(mesh.triangles.len(), Segment::GlassesLens);
    }

    /// From rim to rim, over the nose.
    fn bridge(&self, fit: &FaceFit<'_>) -> Vec<Point3> {
        const STEPS: i32 = 16;
        let y = self.middle_y + 0.45 * self.half[1];
        // The rims' inner edges at this height
        let rim_x = (0..RIM_POINTS)
            .map(|k| self.outline(k, 1.0, 0.0))
            .filter(|[dx, _]| *dx < 0.0)
            .min_by(|a, b| {
                let off = |p: &[f64; 2]| (self.middle_y + p[1] - y).abs();
                off(a).total_cmp(&off(b))
            })
            .map_or(self.middle_x - self.half[0], |[dx, _]| self.middle_x + dx);
        let over_nose = (-STEPS..=STEPS)
            .map(|i| {
                let s = f64::from(i) / f64::from(STEPS);
                let rise = 2.0 * self.scale * (1.0 - s * s);
                let sheet = self.on_sheet(s * rim_x, y + rise);
                let face = fit.front(sheet.x, sheet.y).unwrap_or(f64::NEG_INFINITY);
                (
                    s,
                    sheet,
                    face + self.rim_depth / 2.0 + self.clearance - sheet.z,
                )
            })
            .collect::<Vec<_>>();
        // One smooth arch that clears the nose everywhere
        let arch = over_nose
            .iter()
            .map(|(s, _, lack)| lack / (1.0 - s * s).max(0.05))
            .fold(0.0, f64::max);
        over_nose
            .into_iter()
            .map(|(s, sheet, _)| sheet + Vector3::z() * (arch * (1.0 - s * s)))
            .collect()
    }

    /// From the rim's outer upper edge along the head, over the ear's root, and down behind the ear.
    fn temple(&self, side: f64, fit: &FaceFit<'_>) -> Vec<Point3> {
        const STEPS: usize = 20;
        const HOOK: usize = 8;
        let root = fit.ear_roots[usize::from(side < 0.0)];
        let y_hinge = self.middle_y + 0.5 * self.half[1];
        let x_hinge = side * (self.middle_x + self.half[0] + 1.5 * self.scale);
        let hinge = self.on_sheet(x_hinge, y_hinge);
        let rest = Point3::new(root.x, root.y + 2.2, root.z);
        // Heights and depths of the way, then the head's side where it is wider than the straight line
        let mut way: Vec<Point3> = (0..=STEPS)
            .map(|i| {
                let s = i as f64 / STEPS as f64;
                Point3::from(hinge.coords.lerp(&rest.coords, s))
            })
            .collect();
        for i in 1..=HOOK {
            let s = i as f64 / HOOK as f64;
            let bend = s * s;
            way.push(Point3::new(
                rest.x,
                rest.y - 26.0 * bend * self.scale,
                rest.z - 20.0 * s * self.scale,
            ));
        }
        let half_width = 1.3 + self.clearance;
        let outside: Vec<f64> = way
            .iter()
            .map(|p| {
                let reach = [-2.0, 0.0, 2.0].map(|dy| fit.side(side, p.y + dy, p.z));
                let widest = reach
                    .into_iter()
                    .flatten()
                    .map(|x| x * side)
                    .fold(0.0, f64::max);
                (p.x * side).max(widest + half_width)
            })
            .collect();
        let hull = upper_hull(&way, &outside, STEPS);
        for (p, x) in way.iter_mut().zip(hull) {
            p.x = side * x;
        }
        // Start at the rim itself
        let start = self.on_sheet(side * (self.middle_x + self.half[0] * 0.97), y_hinge);
        way.insert(0, start);
        way
    }
}

/// The smallest curve over `outside` without dents from the hinge to the ear, following it behind the ear.
fn upper_hull(way: &[Point3], outside: &[f64], ear: usize) -> Vec<f64> {
    let mut hull: Vec<usize> = Vec::new();
    for i in 0..=ear {
        while let [.., a, b] = hull[..] {
            let line = |k: usize| {
                let share = (way[k].z - way[a].z) / (way[i].z - way[a].z);
                outside[a] + share * (outside[i] - outside[a])
            };
            if outside[b] > line(b) {
                break;
            }
            hull.pop();
        }
        hull.push(i);
    }
    let mut result = outside.to_vec();
    for pair in hull.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        for k in a..=b {
            let share = (way[k].z - way[a].z) / (way[b].z - way[a].z);
            result[k] = outside[a] + share * (outside[b] - outside[a]);
        }
    }
    result
}
