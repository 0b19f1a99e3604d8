//! The subject's skin in the reference UV, from the scan's colours.
//!
//! Every texel belongs to a point of the fine mesh; its colour is that of the nearest scan surface that looks the same
//! way. What the scan does not show (holes, behind the ears, hair in front of the scalp) keeps the detail of the mean
//! texture in the scan's tone: the ratio of scan to mean colour is smoothed over the mesh, spread into what is unseen,
//! and multiplied in, so that no seam shows and no colour is smeared. The slit between the lids, the sockets and the
//! inside of the mouth always come from the mean texture: scans have the eyes painted on the surface.

use std::sync::OnceLock;

use facile_core::color::srgb8_from_linear;
use facile_core::{Plane, Point3, Segment, Texture, Vector3};
use rayon::prelude::*;

use crate::scan::WorkingScan;
use crate::shading::Shading;
use crate::template::{Template, in_front};

/// Scan surface further from the registered skin than this lends no colour, mm.
const REACH: f64 = 3.0;
/// Cosine between the normals of skin and scan from which the colour is trusted.
const SAME_SIDE: f64 = 0.6;
/// Rings of fine vertices around the lids' slit that scans paint with eyeball.
const SLIT_RINGS: u32 = 2;
/// Sweeps that spread the tone over the mesh.
const TONE_SWEEPS: usize = 60;
/// Darkest linear value in ratios of colours.
const DARK: f64 = 0.004;

/// Sides of textures that may be chosen, in eighths of the largest, and the least of them in texels.
const SIZES: [usize; 5] = [8, 6, 4, 3, 2];
const LEAST_SIZE: usize = 512;
/// A texture may have this share of the scan's own texels along a line before a larger one is taken.
const ENOUGH: f64 = 0.95;

/// Where each texel lies on the fine mesh; the same for every scan.
pub(crate) struct TexelMap {
    /// Triangle of each texel's centre, or `u32::MAX`.
    triangle: Plane<u32>,
    /// Weights of the second and third corner.
    weights: Plane<[f32; 2]>,
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

/// A colour found on the scan, linear, with trust in `[0, 1]`.
#[derive(Clone, Copy, Default)]
struct Found {
    color: [f32; 3],
    trust: f32,
    /// The triangle of the scan.
    triangle: u32,
}

/// Bakes the subject's texture; without colour in the scan it is the mean texture. Cost O(texels).
pub(crate) fn bake(
    template: &Template<'_>,
    maps: &TexelMaps,
    scan: &WorkingScan<'_>,
    positions: &[Point3],
    delight: bool,
) -> Texture {
    if !scan.has_color() {
        return template.reference.texture.clone();
    }
    let map = maps.of(template, scan, positions);
    let size = map.triangle.width();
    let mean_at = |x: usize, y: usize| {
        let middle = [x, y].map(|v| (v as f32 + 0.5) / size as f32);
        template
            .reference
            .texture
            .sample([middle[0], 1.0 - middle[1]])
    };
    let allowed = allowed_vertices(template);
    let normals = facile_core::mesh::vertex_normals(positions, &template.reference.mesh.triangles);
    let lookup = Lookup {
        scan,
        near_border: scan.distance_from_border(),
    };
    // Colours at the vertices give the tone, and the texels around them a place to start from.
    let mut at_vertices: Vec<Found> = (0..positions.len())
        .into_par_iter()
        .map(|v| {
            if allowed[v] <= 0.0 {
                return Found::default();
            }
            lookup.find(&positions[v], &normals[v])
        })
        .collect();
    // Factors that even the light out, by vertex.
    let even = if delight {
        even_light(template, &normals, &at_vertices)
    } else {
        vec![1.0; positions.len()]
    };
    for (found, factor) in at_vertices.iter_mut().zip(&even) {
        found.color = found.color.map(|c| c * factor);
    }
    let (tone, trust) = tone(template, &at_vertices, &allowed);
    let tone: Vec<[f32; 3]> = tone.iter().map(|t| t.map(|v| v as f32).into()).collect();
    let trust: Vec<f32> = trust.iter().map(|t| *t as f32).collect();
    let mut texels = vec![[0_u8; 3]; size * size];
    texels
        .par_chunks_mut(size)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, texel) in row.iter_mut().enumerate() {
                let mean = mean_at(x, y);
                let t = map.triangle[(x, y)];
                if t == u32::MAX {
                    *texel = encode(mean);
                    continue;
                }
                let corners = template.reference.mesh.triangles[t as usize].map(|i| i as usize);
                let [v, w] = map.weights[(x, y)];
                let share = [1.0 - v - w, v, w];
                let own = (0..3).map(|k| share[k] * trust[corners[k]]).sum::<f32>();
                let filled: [f32; 3] = std::array::from_fn(|c| {
                    let gain: f32 = (0..3).map(|k| share[k] * tone[corners[k]][c]).sum();
                    mean[c] * gain
                });
                if own <= 0.0 {
                    *texel = encode(filled);
                    continue;
                }
                let share = share.map(f64::from);
                let at = mix(&corners, &share, |i| positions[i].coords);
                let normal = mix(&corners, &share, |i| normals[i]);
                let start = (0..3)
                    .filter(|k| at_vertices[corners[*k]].trust > 0.0)
                    .max_by(|a, b| share[*a].total_cmp(&share[*b]))
                    .map(|k| at_vertices[corners[k]].triangle);
                let found = start.map_or_else(Found::default, |start| {
                    lookup.follow(start, &Point3::from(at), &normal)
                });
                let own = own * found.trust;
                let factor = (0..3)
                    .map(|k| share[k] as f32 * even[corners[k]])
                    .sum::<f32>();
                *texel = encode(std::array::from_fn(|c| {
                    filled[c] * (1.0 - own) + found.color[c] * factor * own
                }));
            }
        });
    Texture::new(size, size, texels)
}

/// Factors that take out the shading the scan was lit with.
fn even_light(template: &Template<'_>, normals: &[Vector3], found: &[Found]) -> Vec<f32> {
    let brightness = |c: [f64; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2] + DARK;
    let samples: Vec<(Vector3, f64, f64)> = (0..found.len())
        .filter(|&v| found[v].trust > 0.0 && template.face[v])
        .map(|v| {
            let own = brightness(found[v].color.map(|c| f64::from(c.max(0.0))));
            let mean = brightness(template.colors[v].into());
            let weight = f64::from(found[v].trust) * template.areas[v];
            (normals[v], libm::log(own / mean), weight)
        })
        .collect();
    match Shading::fit(&samples) {
        Some(shading) => normals.iter().map(|n| shading.inverse(n) as f32).collect(),
        None => vec![1.0; found.len()],
    }
}

fn mix(corners: &[usize; 3], share: &[f64; 3], value: impl Fn(usize) -> Vector3) -> Vector3 {
    value(corners[0]) * share[0] + value(corners[1]) * share[1] + value(corners[2]) * share[2]
}

fn encode(linear: [f32; 3]) -> [u8; 3] {
    linear.map(srgb8_from_linear)
}

/// Finds colours on the scan.
struct Lookup<'a, 'b> {
    scan: &'a WorkingScan<'b>,
    /// `[0, 1]` per scan vertex: 0 on borders, whose texture is often background.
    near_border: Vec<f32>,
}

impl Lookup<'_, '_> {
    /// The colour nearest to a point, anywhere on the scan.
    fn find(&self, at: &Point3, normal: &Vector3) -> Found {
        let Some(hit) = self.scan.nearest(at, REACH) else {
            return Found::default();
        };
        let distance = (hit.point - at).norm();
        self.judge(hit.triangle, hit.barycentric, distance, normal)
    }

    /// The colour nearest to a point on the surface around triangle `start`.
    fn follow(&self, start: u32, at: &Point3, normal: &Vector3) -> Found {
        let (triangle, weights, square) = self.scan.neighbors.walk(&self.scan.mesh, start, at);
        self.judge(triangle, weights, square.sqrt(), normal)
    }

    fn judge(&self, triangle: u32, weights: [f64; 3], distance: f64, normal: &Vector3) -> Found {
        let Some(color) = self.scan.color(triangle, weights) else {
            return Found::default();
        };
        let corners = self.scan.mesh.triangles[triangle as usize].map(|v| v as usize);
        let there = mix(&corners, &weights, |v| self.scan.normals[v]);
        let same = there.dot(normal) / (there.norm() * normal.norm()).max(1e-12);
        let inside: f64 = (0..3)
            .map(|k| weights[k] * f64::from(self.near_border[corners[k]]))
            .sum();
        let ramp = |v: f64| v.clamp(0.0, 1.0);
        let trust =
            ramp((same - SAME_SIDE) / 0.2) * ramp((REACH - distance) / (0.5 * REACH)) * inside;
        Found {
            color,
            trust: trust as f32,
            triangle,
        }
    }
}

/// Vertices that may take the scan's colour: not inside mouth and sockets, not at the lids' slit.
fn allowed_vertices(template: &Template<'_>) -> Vec<f64> {
    let mesh = &template.reference.mesh;
    let mut socket = vec![false; mesh.positions.len()];
    for (t, s) in mesh.triangles.iter().zip(&mesh.segments) {
        if *s == Segment::EyeSocket {
            for &v in t {
                socket[v as usize] = true;
            }
        }
    }
    let seeds = (0..socket.len()).filter(|&v| socket[v]);
    let rings = template.adjacency.rings_from(seeds, SLIT_RINGS + 1);
    (0..socket.len())
        .map(|v| {
            let slit = if rings[v] <= SLIT_RINGS { 0.0 } else { 1.0 };
            template.skin[v].min(slit)
        })
        .collect()
}

/// Ratio of the scan's to the mean colour at every vertex, smooth, and the trust in the scan's colour, smooth.
fn tone(template: &Template<'_>, found: &[Found], allowed: &[f64]) -> (Vec<Vector3>, Vec<f64>) {
    let n = found.len();
    let known: Vec<f64> = (0..n)
        .map(|v| f64::from(found[v].trust) * allowed[v])
        .collect();
    let log_ratio: Vec<Vector3> = (0..n)
        .map(|v| {
            let (own, mean) = (found[v].color, template.colors[v]);
            Vector3::from_fn(|k, _| {
                let own = f64::from(own[k].max(0.0));
                libm::log((own + DARK) / (mean[k].max(0.0) + DARK)).clamp(-2.5, 2.5)
            })
        })
        .collect();
    let ratio = spread(template, &log_ratio, &known)
        .into_iter()
        .map(|r| r.map(libm::exp))
        .collect();
    // A vertex counts as seen if its neighbours are, so that single holes do not speckle; fading into the unseen.
    let mut trust = known;
    for _ in 0..3 {
        trust = (0..n)
            .map(|v| {
                let neighbors = template.adjacency.of(v);
                let sum: f64 = neighbors.iter().map(|u| trust[*u as usize]).sum();
                let mean = sum / neighbors.len().max(1) as f64;
                mean.min(trust[v]).min(allowed[v])
            })
            .collect();
    }
    (ratio, trust)
}

/// Smooth values everywhere from values known at some vertices: the robust mean of the known ones is the start, then
/// neighbours are averaged.
fn spread(template: &Template<'_>, values: &[Vector3], known: &[f64]) -> Vec<Vector3> {
    let n = values.len();
    let weight = |v: usize| known[v] * template.areas[v];
    let total: f64 = (0..n).map(weight).sum();
    let mean = if total > 1.0 {
        (0..n).fold(Vector3::zeros(), |s, v| s + values[v] * weight(v)) / total
    } else {
        Vector3::zeros()
    };
    let mut smooth: Vec<Vector3> = (0..n)
        .map(|v| mean + (values[v] - mean) * known[v])
        .collect();
    for _ in 0..TONE_SWEEPS {
        for v in 0..n {
            let neighbors = template.adjacency.of(v);
            let sum = neighbors
                .iter()
                .fold(Vector3::zeros(), |s, u| s + smooth[*u as usize]);
            let count = neighbors.len() as f64;
            let own = 0.1 * count * known[v];
            // A weak pull to the mean tone: what is far from all colour gets it.
            let rest = 0.002 * count;
            if count > 0.0 {
                smooth[v] = (sum + values[v] * own + mean * rest) / (count + own + rest);
            }
        }
    }
    smooth
}
