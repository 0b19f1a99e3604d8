//! Puts the textures of a scan into one image and moves the texture coordinates along.
//!
//! Texture coordinates outside `[0, 1]` repeat the texture, as in OBJ and glTF: each triangle is moved by whole numbers
//! into the first tile, before its texture goes into the atlas.

use std::collections::HashMap;

use super::draft::{NO_COLOR, Paint};
use crate::color::{LINEAR_FROM_SRGB8, srgb8_from_linear};
use crate::{Mesh, Texture};

/// Most texels of an atlas; larger sets of textures are halved until they fit.
const MAX_ATLAS_TEXELS: usize = 8192 * 8192;

/// Width of the rim around each texture that repeats its border, so that bilinear samples do not mix neighbours.
const RIM: usize = 2;

/// Side of the tile of a material of one colour.
const COLOR_SIDE: usize = 4;

/// How far outside `[0, 1]` a texture coordinate is taken as rounding.
const SLACK: f32 = 1e-3;

/// The outcome of [`paint`].
pub(crate) struct Painted {
    pub(crate) texture: Option<Texture>,
    pub(crate) notices: Vec<String>,
}

/// What a triangle is painted with.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tile {
    Image { texture: usize, factor: [f32; 3] },
    Color([f32; 3]),
}

/// A tile's place in the atlas, texels from the top left, without its rim.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

/// Merges the textures that triangles use into at most one and rewrites `mesh`'s texture coordinates to match.
///
/// One texture used by every triangle stays as it is. `materials` are indexed by `triangle_materials`; triangles
/// without texture coordinates in a mesh that has some carry `u32::MAX` as coordinate index.
pub(crate) fn paint(
    mesh: &mut Mesh,
    triangle_materials: &[u32],
    materials: &[Paint],
    mut textures: Vec<Texture>,
) -> Painted {
    let mut notices = Vec::new();
    let (tiles, tile_of_triangle) = tiles_of(mesh, triangle_materials, materials, &mut notices);
    if tiles.is_empty() {
        return Painted {
            texture: None,
            notices,
        };
    }
    if let [Tile::Image { texture, factor }] = tiles[..] {
        let mut image = textures.swap_remove(texture);
        multiply(&mut image, factor);
        if !mesh.texcoords.iter().all(|uv| is_in_first_tile(*uv)) {
            remap(mesh, &tile_of_triangle, |_, uv| uv, &mut notices);
        }
        return Painted {
            texture: Some(image),
            notices,
        };
    }
    let mut images: Vec<Texture> = tiles.iter().map(|tile| image_of(tile, &textures)).collect();
    drop(textures);
    let mut halvings = 0;
    let (width, height, places) = loop {
        let layout = shelves(&images);
        if layout.0 * layout.1 <= MAX_ATLAS_TEXELS
            || images
                .iter()
                .all(|i| i.width().max(i.height()) <= COLOR_SIDE)
        {
            break layout;
        }
        images = images.iter().map(halved).collect();
        halvings += 1;
    };
    let factor = 1 << halvings;
    notices.push(if halvings == 0 {
        format!("{} textures and colours were merged into one texture of {width} x {height}", images.len())
    } else {
        format!(
            "{} textures and colours were merged into one texture of {width} x {height}, {factor} times smaller a side",
            images.len()
        )
    });
    let mut atlas = Texture::new(width, height, vec![[0; 3]; width * height]);
    for (image, place) in images.iter().zip(&places) {
        copy_with_rim(image, place, &mut atlas);
    }
    let move_into = |tile: usize, [u, v]: [f32; 2]| {
        let place = &places[tile];
        let x = place.x as f32 + u.clamp(0.0, 1.0) * place.width as f32;
        let y = place.y as f32 + (1.0 - v.clamp(0.0, 1.0)) * place.height as f32;
        [x / width as f32, 1.0 - y / height as f32]
    };
    remap(mesh, &tile_of_triangle, move_into, &mut notices);
    Painted {
        texture: Some(atlas),
        notices,
    }
}

/// The distinct tiles that triangles use, by first use, and the tile of each triangle. No tiles if nothing is painted.
fn tiles_of(
    mesh: &Mesh,
    triangle_materials: &[u32],
    materials: &[Paint],
    notices: &mut Vec<String>,
) -> (Vec<Tile>, Vec<u32>) {
    let mut tiles: Vec<Tile> = Vec::new();
    let mut tile_of: HashMap<(u32, bool), u32> = HashMap::new();
    let mut uncovered = 0_usize;
    let mut is_painted = false;
    let mut of_triangle = Vec::with_capacity(mesh.triangles.len());
    for t in 0..mesh.triangles.len() {
        let material = triangle_materials.get(t).copied().unwrap_or(u32::MAX);
        let paint = materials.get(material as usize).copied();
        let paint = paint.unwrap_or(Paint::Unknown);
        let has_texcoord = mesh
            .texcoord_triangles
            .get(t)
            .is_some_and(|tc| !tc.contains(&u32::MAX));
        if matches!(paint, Paint::Image { .. }) && !has_texcoord {
            uncovered += 1;
        }
        let index = *tile_of.entry((material, has_texcoord)).or_insert_with(|| {
            let tile = match paint {
                Paint::Image { texture, factor } if has_texcoord => Tile::Image { texture, factor },
                Paint::Color(color) => Tile::Color(color),
                _ => Tile::Color(NO_COLOR),
            };
            is_painted |= !matches!(paint, Paint::Unknown);
            tiles.iter().position(|k| *k == tile).unwrap_or_else(|| {
                tiles.push(tile);
                tiles.len() - 1
            }) as u32
        });
        of_triangle.push(index);
    }
    if uncovered > 0 {
        notices.push(format!(
            "{uncovered} triangles of textured materials have no texture coordinates and are grey"
        ));
    }
    // One colour for everything, or colours beside vertex colours, say less than the vertices do.
    let only_colors = tiles.iter().all(|t| matches!(t, Tile::Color(_)));
    if !is_painted || (only_colors && (!mesh.colors.is_empty() || tiles.len() == 1)) {
        tiles.clear();
    }
    (tiles, of_triangle)
}

fn image_of(tile: &Tile, textures: &[Texture]) -> Texture {
    match *tile {
        Tile::Image { texture, factor } => {
            let mut image = textures[texture].clone();
            multiply(&mut image, factor);
            image
        }
        Tile::Color(color) => {
            let texels = vec![color.map(srgb8_from_linear); COLOR_SIDE * COLOR_SIDE];
            Texture::new(COLOR_SIDE, COLOR_SIDE, texels)
        }
    }
}

/// Multiplies a texture by a linear colour.
fn multiply(image: &mut Texture, factor: [f32; 3]) {
    for (channel, factor) in factor.into_iter().enumerate() {
        let is_one = (factor - 1.0).abs() < 1e-6;
        if is_one {
            continue;
        }
        let table: [u8; 256] =
            std::array::from_fn(|i| srgb8_from_linear(LINEAR_FROM_SRGB8[i] * factor));
        for texel in image.texels_mut() {
            texel[channel] = table[usize::from(texel[channel])];
        }
    }
}

/// A texture of half the size (rounded up), each texel the mean of four in linear light.
fn halved(image: &Texture) -> Texture {
    if image.width().max(image.height()) <= COLOR_SIDE {
        return image.clone();
    }
    let (width, height) = (image.width().div_ceil(2), image.height().div_ceil(2));
    let mut texels: Vec<[u8; 3]> = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let at = |dx: usize, dy: usize| {
                image.texel(
                    (2 * x + dx).min(image.width() - 1),
                    (2 * y + dy).min(image.height() - 1),
                )
            };
            let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
            texels.push(std::array::from_fn(|k: usize| {
                let sum: f32 = four
                    .iter()
                    .map(|t| LINEAR_FROM_SRGB8[usize::from(t[k])])
                    .sum();
                srgb8_from_linear(sum / 4.0)
            }));
        }
    }
    Texture::new(width, height, texels)
}

/// Packs images on shelves, tallest first. Returns the atlas' width and height and each image's place.
fn shelves(images: &[Texture]) -> (usize, usize, Vec<Place>) {
    let padded = |i: usize| (images[i].width() + 2 * RIM, images[i].height() + 2 * RIM);
    let mut order: Vec<usize> = (0..images.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(padded(i).1), i));
    let area: usize = order.iter().map(|&i| padded(i).0 * padded(i).1).sum();
    let widest = order.iter().map(|&i| padded(i).0).max().unwrap_or(1);
    let limit = area.isqrt().max(widest);
    let mut places = vec![Place::default(); images.len()];
    let (mut x, mut y, mut shelf, mut width) = (0, 0, 0, 0);
    for i in order {
        let (w, h) = padded(i);
        if x > 0 && x + w > limit + limit / 8 {
            (x, y, shelf) = (0, y + shelf, 0);
        }
        places[i] = Place {
            x: x + RIM,
            y: y + RIM,
            width: images[i].width(),
            height: images[i].height(),
        };
        x += w;
        shelf = shelf.max(h);
        width = width.max(x);
    }
    (width, y + shelf, places)
}

fn copy_with_rim(image: &Texture, place: &Place, atlas: &mut Texture) {
    let stride = atlas.width();
    let clamp = |i: usize, n: usize| i.saturating_sub(RIM).min(n - 1);
    for row in 0..image.height() + 2 * RIM {
        let start = (place.y - RIM + row) * stride + place.x - RIM;
        let target = &mut atlas.texels_mut()[start..start + image.width() + 2 * RIM];
        for (column, texel) in target.iter_mut().enumerate() {
            *texel = image.texel(clamp(column, image.width()), clamp(row, image.height()));
        }
    }
}

/// Passes the texture coordinates of every triangle, moved into the first tile, through `move_into(tile, uv)`.
fn remap(
    mesh: &mut Mesh,
    tile_of_triangle: &[u32],
    move_into: impl Fn(usize, [f32; 2]) -> [f32; 2],
    notices: &mut Vec<String>,
) {
    let mut index_of: HashMap<(u32, u32, [i32; 2]), u32> =
        HashMap::with_capacity(mesh.texcoords.len());
    let mut texcoords = Vec::with_capacity(mesh.texcoords.len());
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    let mut crossing = 0_usize;
    for (t, &tile) in tile_of_triangle.iter().enumerate() {
        let corners = mesh.texcoord_triangles.get(t).copied();
        let corners = corners.unwrap_or([u32::MAX; 3]);
        let uv = corners.map(|c| mesh.texcoords.get(c as usize).copied().unwrap_or([0.5; 2]));
        let shift = [0, 1].map(|k| tile_shift(uv.map(|c| c[k])));
        crossing +=
            usize::from((0..2).any(|k| uv.iter().any(|c| c[k] - shift[k] as f32 > 1.0 + SLACK)));
        triangles.push(std::array::from_fn(|i| {
            *index_of
                .entry((corners[i], tile, shift))
                .or_insert_with(|| {
                    let moved = [0, 1].map(|k| {
                        if shift[k] == 0 {
                            uv[i][k]
                        } else {
                            uv[i][k] - shift[k] as f32
                        }
                    });
                    texcoords.push(move_into(tile as usize, moved));
                    texcoords.len() as u32 - 1
                })
        }));
    }
    if crossing > 0 {
        notices.push(format!(
            "{crossing} triangles cross the border of a repeating texture and are clamped to it"
        ));
    }
    mesh.texcoords = texcoords;
    mesh.texcoord_triangles = triangles;
}

fn is_in_first_tile(uv: [f32; 2]) -> bool {
    uv.iter().all(|v| (-SLACK..=1.0 + SLACK).contains(v))
}

/// The whole number to take from three coordinates so that they lie in `[0, 1]` as far as possible.
fn tile_shift(values: [f32; 3]) -> i32 {
    let low = values.into_iter().fold(f32::INFINITY, f32::min);
    let high = values.into_iter().fold(f32::NEG_INFINITY, f32::max);
    if low >= -SLACK && high <= 1.0 + SLACK {
        0
    } else {
        (low + SLACK).floor() as i32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Point3;

    const WHITE: [f32; 3] = [1.0; 3];

    fn square(texcoords: Vec<[f32; 2]>) -> Mesh {
        Mesh {
            positions: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
                .map(|[x, y]| Point3::new(x, y, 0.0))
                .to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            texcoords,
            texcoord_triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    fn unit() -> Vec<[f32; 2]> {
        vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    }

    /// The colour a mesh shows at the middle of a triangle.
    fn color_at(mesh: &Mesh, texture: &Texture, t: usize, weights: [f32; 3]) -> [f32; 3] {
        let uv = mesh.texcoord_triangles[t].map(|c| mesh.texcoords[c as usize]);
        texture.sample([0, 1].map(|k| (0..3).map(|i| uv[i][k] * weights[i]).sum()))
    }

    fn image(seed: u8, width: usize, height: usize) -> Texture {
        let texel = |i: usize| [seed, (i * 7 % 256) as u8, (i * 13 % 256) as u8];
        Texture::new(width, height, (0..width * height).map(texel).collect())
    }

    #[test]
    fn an_atlas_shows_what_the_textures_showed() {
        let textures = vec![image(10, 9, 4), image(200, 5, 30), image(90, 64, 64)];
        let paints = [2, 0].map(|texture| Paint::Image {
            texture,
            factor: WHITE,
        });
        let plain = square(unit());
        let mut mesh = plain.clone();
        let painted = paint(&mut mesh, &[0, 1], &paints, textures.clone());
        let atlas = painted.texture.expect("atlas");
        mesh.validate(std::path::Path::new("m")).expect("valid");
        for (t, original) in [(0, 2), (1, 0)] {
            for weights in [[0.2, 0.3, 0.5], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]] {
                let before = color_at(&plain, &textures[original], t, weights);
                let after = color_at(&mesh, &atlas, t, weights);
                for k in 0..3 {
                    assert!((before[k] - after[k]).abs() < 1e-3, "{before:?} {after:?}");
                }
            }
        }
        assert_eq!(painted.notices.len(), 1);
    }

    #[test]
    fn one_texture_stays_and_its_coordinates_too() {
        let mut mesh = square(unit());
        let before = mesh.clone();
        let paints = [Paint::Image {
            texture: 0,
            factor: WHITE,
        }];
        let painted = paint(&mut mesh, &[0, 0], &paints, vec![image(1, 8, 8)]);
        assert_eq!(mesh, before);
        assert_eq!(painted.texture, Some(image(1, 8, 8)));
        assert!(painted.notices.is_empty());
    }

    #[test]
    fn repeated_tiles_come_home() {
        let shifted = unit().iter().map(|[u, v]| [u + 3.0, v - 2.0]).collect();
        let mut mesh = square(shifted);
        let paints = [Paint::Image {
            texture: 0,
            factor: WHITE,
        }];
        let painted = paint(&mut mesh, &[0, 0], &paints, vec![image(1, 8, 8)]);
        assert_eq!(mesh.texcoords, unit());
        assert!(painted.notices.is_empty(), "{:?}", painted.notices);
    }

    #[test]
    fn colours_become_tiles_and_factors_darken() {
        let mut mesh = square(unit());
        let paints = [
            Paint::Color([1.0, 0.0, 0.0]),
            Paint::Image {
                texture: 0,
                factor: [0.5, 1.0, 1.0],
            },
        ];
        let white = Texture::new(2, 2, vec![[255; 3]; 4]);
        let painted = paint(&mut mesh, &[0, 1], &paints, vec![white]);
        let atlas = painted.texture.expect("atlas");
        let red = color_at(&mesh, &atlas, 0, [0.3; 3]);
        assert!(red[0] > 0.999 && red[1] + red[2] < 1e-6);
        let halved = color_at(&mesh, &atlas, 1, [0.3; 3]);
        assert!((halved[0] - 0.5).abs() < 0.01 && halved[1] > 0.999);
    }

    #[test]
    fn nothing_known_is_not_painted() {
        let mut mesh = square(unit());
        assert!(paint(&mut mesh, &[], &[], Vec::new()).texture.is_none());
    }

    #[test]
    fn halving_keeps_the_mean() {
        let half = halved(&Texture::new(8, 6, vec![[0, 128, 255]; 48]));
        assert_eq!((half.width(), half.height()), (4, 3));
        assert!(half.texels().iter().all(|t| *t == [0, 128, 255]));
    }
}
