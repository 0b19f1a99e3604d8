//! Where the texels of a subject's texture lie on the head, and how many there should be.

use std::ops::RangeInclusive;
use std::sync::OnceLock;

use facile_core::{Plane, Point3};

use crate::scan::WorkingScan;
use crate::template::{Template, in_front};

/// Sides of textures that may be chosen, in eighths of the largest, and the least of them in texels.
const SIZES: [usize; 5] = [8, 6, 4, 3, 2];
const LEAST_SIZE: usize = 512;
/// A texture may have this share of the scan's own texels along a line before a larger one is taken.
const ENOUGH: f64 = 0.95;

/// Where each texel lies on the fine mesh; the same for every scan.
pub(crate) struct TexelMap {
    /// Triangle of each texel's centre, or `u32::MAX`.
    pub(crate) triangle: Plane<u32>,
    /// Weights of the second and third corner.
    pub(crate) weights: Plane<[f32; 2]>,
}

/// The texel maps of the sizes that scans may ask for; each is made when first used.
pub(crate) struct TexelMaps {
    largest: usize,
    maps: [OnceLock<TexelMap>; SIZES.len()],
}

impl TexelMaps {
    /// `largest`: side of the largest texture, texels.
    pub(crate) fn new(largest: usize) -> Self {
        Self {
            largest,
            maps: [const { OnceLock::new() }; SIZES.len()],
        }
    }

    /// The map that holds what the scan's own texture shows of the face: the smallest that is about as fine.
    pub(crate) fn of(
        &self,
        template: &Template<'_>,
        scan: &WorkingScan<'_>,
        positions: &[Point3],
    ) -> &TexelMap {
        let wanted = ENOUGH * wanted_size(template, scan, positions);
        let side = |k: usize| self.largest * SIZES[k] / SIZES[0];
        let chosen = (1..SIZES.len())
            .take_while(|&k| side(k) >= LEAST_SIZE && side(k) as f64 >= wanted)
            .last()
            .unwrap_or(0);
        self.maps[chosen].get_or_init(|| TexelMap::new(template, side(chosen)))
    }
}

/// Side of the subject's texture, texels, that shows the face as finely as the scan does.
fn wanted_size(template: &Template<'_>, scan: &WorkingScan<'_>, positions: &[Point3]) -> f64 {
    let mesh = &template.reference.mesh;
    let own = (mesh.triangles.iter().zip(&mesh.texcoord_triangles))
        .filter(|(t, _)| t.iter().all(|v| template.face[*v as usize]))
        .map(|(t, uv)| {
            let area = triangle_area(&t.map(|v| positions[v as usize]));
            (texel_area(&mesh.texcoords, *uv, [1.0; 2]), area)
        });
    let texture = scan
        .texture
        .map_or([0.0; 2], |t| [t.width() as f64, t.height() as f64]);
    let shown = (scan
        .mesh
        .triangles
        .iter()
        .zip(&scan.mesh.texcoord_triangles))
    .map(|(t, uv)| (t.map(|v| scan.mesh.positions[v as usize]), uv))
    .filter(|(corners, _)| in_front(&corners[0]))
    .map(|(corners, uv)| {
        (
            texel_area(&scan.mesh.texcoords, *uv, texture),
            triangle_area(&corners),
        )
    });
    density(shown) / density(own).max(1e-12)
}

/// Texels along a line of 1 mm, over triangles with their areas in texels and in mm^2.
fn density(triangles: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (texels, area) = triangles.fold((0.0, 0.0), |s, t| (s.0 + t.0, s.1 + t.1));
    (texels / f64::max(area, 1e-9)).sqrt()
}

fn triangle_area([a, b, c]: &[Point3; 3]) -> f64 {
    0.5 * (b - a).cross(&(c - a)).norm()
}

/// Area of a triangle of texture coordinates on a texture of this size.
fn texel_area(texcoords: &[[f32; 2]], corners: [u32; 3], [width, height]: [f64; 2]) -> f64 {
    let [a, b, c] = corners.map(|i| texcoords[i as usize].map(f64::from));
    let double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    0.5 * double.abs() * width * height
}

impl TexelMap {
    /// Rasterises the texture coordinates of the template at `size` x `size`; texels up to 2 outside a chart take the
    /// nearest triangle, so that bilinear sampling finds colour across the charts' borders.
    pub(crate) fn new(template: &Template<'_>, size: usize) -> Self {
        let mesh = &template.reference.mesh;
        let mut map = Self {
            triangle: Plane::filled(size, size, u32::MAX),
            weights: Plane::filled(size, size, [0.0; 2]),
        };
        let triangles: Vec<Texels> = (mesh.texcoord_triangles.iter())
            .map(|corners| Texels::new(corners.map(|i| mesh.texcoords[i as usize]), size))
            .collect();
        for (t, triangle) in triangles.iter().enumerate() {
            map.fill(t as u32, triangle);
        }
        // What lies outside a chart is nearest to a triangle at the chart's border.
        let mut gap = Plane::filled(size, size, f64::INFINITY);
        for t in at_borders(&mesh.texcoord_triangles) {
            map.surround(t as u32, &triangles[t], &mut gap);
        }
        map
    }

    /// Gives a triangle the texels inside it that are free.
    fn fill(&mut self, t: u32, triangle: &Texels) {
        /// Weight outside the triangle at which a texel counts as inside: none slips between neighbours.
        const SLACK: f64 = -1e-9;
        let Some((xs, ys)) = triangle.range(self.triangle.width(), 0.0) else {
            return;
        };
        for y in ys {
            let (row, weights) = (self.triangle.row_mut(y), self.weights.row_mut(y));
            for x in xs.clone() {
                let [v, w] = triangle.weights([x as f64, y as f64]);
                if v >= SLACK && w >= SLACK && v + w <= 1.0 - SLACK && row[x] == u32::MAX {
                    row[x] = t;
                    weights[x] = [v as f32, w as f32];
                }
            }
        }
    }

    /// Gives a triangle the texels within 2 of it that no triangle holds and that are nearer to no other; `gap` is their
    /// distance so far.
    fn surround(&mut self, t: u32, triangle: &Texels, gap: &mut Plane<f64>) {
        const WIDTH: f64 = 2.0;
        let Some((xs, ys)) = triangle.range(self.triangle.width(), WIDTH) else {
            return;
        };
        for y in ys {
            for x in xs.clone() {
                let is_free = self.triangle[(x, y)] == u32::MAX || gap[(x, y)] < f64::INFINITY;
                if !is_free {
                    continue;
                }
                let (weights, outside) = triangle.nearest([x as f64, y as f64]);
                if outside <= WIDTH && outside < gap[(x, y)] {
                    gap[(x, y)] = outside;
                    self.triangle[(x, y)] = t;
                    self.weights[(x, y)] = weights.map(|w| w as f32);
                }
            }
        }
    }
}

/// A triangle of texture coordinates, in texels: centres lie at whole numbers.
struct Texels {
    corners: [[f64; 2]; 3],
    /// Twice the area, with sign.
    area: f64,
}

impl Texels {
    fn new(texcoords: [[f32; 2]; 3], size: usize) -> Self {
        let n = size as f64;
        let corners = texcoords.map(|uv| {
            let [u, v] = uv.map(f64::from);
            [u * n - 0.5, (1.0 - v) * n - 0.5]
        });
        let [a, b, c] = corners;
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        Self { corners, area }
    }

    /// Columns and rows of texels that may lie within `margin` of the triangle. `None` without area or outside.
    fn range(
        &self,
        size: usize,
        margin: f64,
    ) -> Option<(RangeInclusive<usize>, RangeInclusive<usize>)> {
        let [a, b, c] = self.corners;
        let side = |k: usize| {
            let low = (a[k].min(b[k]).min(c[k]) - margin - 1e-6).ceil().max(0.0);
            let high = (a[k].max(b[k]).max(c[k]) + margin + 1e-6).floor();
            let high = high.min(size as f64 - 1.0);
            (low <= high).then_some(low as usize..=high as usize)
        };
        (self.area.abs() >= 1e-12)
            .then(|| Some((side(0)?, side(1)?)))
            .flatten()
    }

    /// Weights of the second and third corner at a point.
    fn weights(&self, at: [f64; 2]) -> [f64; 2] {
        let [a, b, c] = self.corners;
        let (px, py) = (at[0] - a[0], at[1] - a[1]);
        [
            (px * (c[1] - a[1]) - py * (c[0] - a[0])) / self.area,
            ((b[0] - a[0]) * py - (b[1] - a[1]) * px) / self.area,
        ]
    }

    /// Weights of the second and third corner at the triangle's point nearest to `at`, and its distance.
    fn nearest(&self, at: [f64; 2]) -> ([f64; 2], f64) {
        let lift = |p: [f64; 2]| Point3::new(p[0], p[1], 0.0);
        let corners = self.corners.map(lift);
        let [u, v, w] = facile_core::mesh::closest_barycentric(&lift(at), &corners);
        let near = corners[0].coords * u + corners[1].coords * v + corners[2].coords * w;
        ([v, w], (near - lift(at).coords).norm())
    }
}

/// The triangles with an edge that no other one has, by index.
fn at_borders(triangles: &[[u32; 3]]) -> Vec<usize> {
    let mut edges: Vec<([u32; 2], u32)> = (triangles.iter().enumerate())
        .flat_map(|(t, &[a, b, c])| {
            [[a, b], [b, c], [c, a]].map(|[p, q]| ([p.min(q), p.max(q)], t as u32))
        })
        .collect();
    edges.sort_unstable();
    let mut alone: Vec<usize> = (edges.chunk_by(|a, b| a.0 == b.0))
        .filter(|run| run.len() == 1)
        .map(|run| run[0].1 as usize)
        .collect();
    alone.sort_unstable();
    alone.dedup();
    alone
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::ReferenceHead;

    #[test]
    fn every_texel_has_the_triangle_that_a_search_over_all_finds() {
        let template = Template::new(ReferenceHead::embedded()).expect("a surface");
        let mesh = &template.reference.mesh;
        let size = 128;
        let map = TexelMap::new(&template, size);
        let triangles: Vec<Texels> = (mesh.texcoord_triangles.iter())
            .map(|corners| Texels::new(corners.map(|i| mesh.texcoords[i as usize]), size))
            .collect();
        for y in (0..size).step_by(5) {
            for x in (0..size).step_by(3) {
                let at = [x as f64, y as f64];
                let gap = (triangles.iter())
                    .filter(|t| t.area.abs() >= 1e-12)
                    .map(|t| t.nearest(at).1)
                    .fold(f64::INFINITY, f64::min);
                let t = map.triangle[(x, y)];
                if t == u32::MAX {
                    assert!(gap > 2.0 - 1e-6, "{x} {y}: {gap}");
                } else {
                    let own = triangles[t as usize].nearest(at).1;
                    assert!(own <= gap + 1e-6, "{x} {y}: {own} against {gap}");
                }
            }
        }
    }
}
