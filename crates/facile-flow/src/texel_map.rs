//! Where the texels of a subject's texture lie on the head, and how many there should be.

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
    /// Rasterises the texture coordinates of the template at `size` x `size`; texels up to 2 outside a triangle take
    /// the nearest, so that bilinear sampling finds colour across the charts' borders.
    pub(crate) fn new(template: &Template<'_>, size: usize) -> Self {
        let mesh = &template.reference.mesh;
        let mut map = Self {
            triangle: Plane::filled(size, size, u32::MAX),
            weights: Plane::filled(size, size, [0.0; 2]),
        };
        let n = size as f64;
        let mut gap = Plane::filled(size, size, f64::INFINITY);
        for (t, corners) in mesh.texcoord_triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|i| {
                let [u, v] = mesh.texcoords[i as usize].map(f64::from);
                [u * n - 0.5, (1.0 - v) * n - 0.5]
            });
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            if area.abs() < 1e-12 {
                continue;
            }
            let range = |k: usize| {
                let low = a[k].min(b[k]).min(c[k]) - 2.0;
                let high = a[k].max(b[k]).max(c[k]) + 2.0;
                low.ceil().max(0.0) as usize..=(high.floor().min(n - 1.0)).max(0.0) as usize
            };
            for y in range(1) {
                for x in range(0) {
                    let (px, py) = (x as f64 - a[0], y as f64 - a[1]);
                    let v = (px * (c[1] - a[1]) - py * (c[0] - a[0])) / area;
                    let w = ((b[0] - a[0]) * py - (b[1] - a[1]) * px) / area;
                    let (v, w, outside) = clamp_to_triangle(v, w, [a, b, c], [x as f64, y as f64]);
                    if outside <= 2.0 && outside < gap[(x, y)] {
                        gap[(x, y)] = outside;
                        map.triangle[(x, y)] = t as u32;
                        map.weights[(x, y)] = [v as f32, w as f32];
                    }
                }
            }
        }
        map
    }
}

/// Weights moved into the triangle, and by how many texels.
fn clamp_to_triangle(v: f64, w: f64, [a, b, c]: [[f64; 2]; 3], at: [f64; 2]) -> (f64, f64, f64) {
    if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
        return (v, w, 0.0);
    }
    let lift = |p: [f64; 2]| Point3::new(p[0], p[1], 0.0);
    let corners = [lift(a), lift(b), lift(c)];
    let [u, v, w] = facile_core::mesh::closest_barycentric(&lift(at), &corners);
    let near = corners[0].coords * u + corners[1].coords * v + corners[2].coords * w;
    (v, w, (near - lift(at).coords).norm())
}
