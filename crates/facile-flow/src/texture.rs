//! The subject's skin in the reference UV, from the scan's colours.
//!
//! Every texel belongs to a point of the fine mesh; its colour is that of the nearest scan surface that looks the same
//! way. What the scan does not show (holes, behind the ears, hair in front of the scalp) keeps the detail of the mean
//! texture in the scan's tone: the ratio of scan to mean colour is smoothed over the mesh, spread into what is unseen,
//! and multiplied in, so that no seam shows and no colour is smeared. The slit between the lids, the sockets and the
//! inside of the mouth always come from the mean texture: scans have the eyes painted on the surface.

use facile_core::color::srgb8_from_linear;
use facile_core::{Point3, Segment, Texture, Vector3};
use rayon::prelude::*;

use crate::scan::WorkingScan;
use crate::shading::Shading;
use crate::template::Template;
use crate::texel_map::{TexelMap, TexelMaps};

/// Scan surface further from the registered skin than this lends no colour, mm.
const REACH: f64 = 3.0;
/// Cosine between the normals of skin and scan from which the colour is trusted.
const SAME_SIDE: f64 = 0.6;
/// Rings of fine vertices around the lids' slit that scans paint with eyeball.
const SLIT_RINGS: u32 = 2;
/// Sweeps that spread the tone over the cage.
const TONE_SWEEPS: usize = 30;
/// Darkest linear value in ratios of colours.
const DARK: f64 = 0.004;

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
    let baker = Baker {
        template,
        map,
        lookup,
        positions,
        normals,
        at_vertices,
        even,
        tone,
        trust,
    };
    let mut texels = vec![[0_u8; 3]; size * size];
    texels
        .par_chunks_mut(size)
        .enumerate()
        .for_each(|(y, row)| {
            let mut last = (u32::MAX, 0);
            for (x, texel) in row.iter_mut().enumerate() {
                *texel = baker.texel(x, y, &mut last);
            }
        });
    Texture::new(size, size, texels)
}

/// What the colour of a texel depends on.
struct Baker<'a, 'b> {
    template: &'a Template<'a>,
    map: &'a TexelMap,
    lookup: Lookup<'a, 'b>,
    positions: &'a [Point3],
    normals: Vec<Vector3>,
    /// Colours at the vertices give the texels around them a place to start from.
    at_vertices: Vec<Found>,
    /// By vertex: factors that even the light out, ratio of the scan's to the mean colour, trust in the scan's.
    even: Vec<f32>,
    tone: Vec<[f32; 3]>,
    trust: Vec<f32>,
}

impl Baker<'_, '_> {
    /// The colour of a texel; `last` holds the triangles of head and scan under the one before it in its row.
    fn texel(&self, x: usize, y: usize, last: &mut (u32, u32)) -> [u8; 3] {
        let t = self.map.triangle[(x, y)];
        if t == u32::MAX {
            return encode(self.mean(x, y));
        }
        let corners = self.template.reference.mesh.triangles[t as usize].map(|i| i as usize);
        let [v, w] = self.map.weights[(x, y)];
        let share = [1.0 - v - w, v, w];
        let sum = |value: &dyn Fn(usize) -> f32| {
            share[0] * value(corners[0])
                + share[1] * value(corners[1])
                + share[2] * value(corners[2])
        };
        let trust = sum(&|i| self.trust[i]);
        let found = if trust > 0.0 {
            self.follow(t, corners, share.map(f64::from), last)
        } else {
            Found::default()
        };
        let own = trust * found.trust;
        let factor = own * sum(&|i| self.even[i]);
        let mut color = found.color.map(|c| c * factor);
        // What the scan does not show has the mean's detail in the scan's tone.
        if own < 1.0 {
            let mean = self.mean(x, y);
            for (c, value) in color.iter_mut().enumerate() {
                *value += mean[c] * sum(&|i| self.tone[i][c]) * (1.0 - own);
            }
        }
        encode(color)
    }

    /// Linear RGB of the mean texture at a texel.
    fn mean(&self, x: usize, y: usize) -> [f32; 3] {
        let size = self.map.triangle.width() as f32;
        let [u, v] = [x, y].map(|v| (v as f32 + 0.5) / size);
        self.template.reference.texture.sample([u, 1.0 - v])
    }

    /// The scan's colour at a point of triangle `t`.
    fn follow(&self, t: u32, corners: [usize; 3], share: [f64; 3], last: &mut (u32, u32)) -> Found {
        let start = if last.0 == t {
            last.1
        } else {
            let seen = (0..3).filter(|k| self.at_vertices[corners[*k]].trust > 0.0);
            let Some(nearest) = seen.max_by(|a, b| share[*a].total_cmp(&share[*b])) else {
                return Found::default();
            };
            self.at_vertices[corners[nearest]].triangle
        };
        let at = Point3::from(mix(&corners, &share, |i| self.positions[i].coords));
        let normal = mix(&corners, &share, |i| self.normals[i]);
        let found = self.lookup.follow(start, &at, &normal);
        *last = (t, found.triangle);
        found
    }
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
/// neighbours on the cage are averaged, and the fine vertices take their stencils'.
fn spread(template: &Template<'_>, values: &[Vector3], known: &[f64]) -> Vec<Vector3> {
    let stencils = &template.reference.subdivision.stencils;
    // Each cage vertex knows the mean of the fine ones that hang on it, weighted by area.
    let mut cage = vec![(Vector3::zeros(), 0.0, 0.0); template.cage_adjacency.len()];
    let (mut sum, mut total) = (Vector3::zeros(), 0.0);
    for (v, value) in values.iter().enumerate() {
        let weight = known[v] * template.areas[v];
        sum += value * weight;
        total += weight;
        for &(u, w) in stencils.row(v) {
            let (sum, seen, all) = &mut cage[u as usize];
            *sum += value * (w * weight);
            *seen += w * weight;
            *all += w * template.areas[v];
        }
    }
    let mean = if total > 1.0 {
        sum / total
    } else {
        Vector3::zeros()
    };
    let own: Vec<(Vector3, f64)> = (cage.into_iter())
        .map(|(sum, seen, all)| {
            let value = if seen > 0.0 { sum / seen } else { mean };
            (value, seen / f64::max(all, 1e-9))
        })
        .collect();
    let mut smooth: Vec<Vector3> = (own.iter())
        .map(|(value, known)| mean + (value - mean) * *known)
        .collect();
    for _ in 0..TONE_SWEEPS {
        for (v, (value, known)) in own.iter().enumerate() {
            let neighbors = template.cage_adjacency.of(v);
            let sum = neighbors
                .iter()
                .fold(Vector3::zeros(), |s, u| s + smooth[*u as usize]);
            let count = neighbors.len() as f64;
            // As far as three rings of fine vertices the own value counts as much as the neighbours'.
            let own = 0.4 * count * known;
            // A weak pull to the mean tone: what is far from all colour gets it.
            let rest = 0.008 * count;
            if count > 0.0 {
                smooth[v] = (sum + value * own + mean * rest) / (count + own + rest);
            }
        }
    }
    stencils.apply(&smooth, Vector3::zeros())
}
