//! Single strands on cards whose pictures show locks: streaks along the strands, finer than what was painted.
//!
//! White noise is smeared along the direction in which strands run on the picture. Sources: Cabral, Leedom, Imaging Vector
//! Fields Using Line Integral Convolution, SIGGRAPH 1993; Stalling, Hege, Fast and Resolution Independent Line Integral
//! Convolution, SIGGRAPH 1995: one line serves all texels that it passes.

use facile_core::color::{LINEAR_FROM_SRGB8, srgb8_from_linear};
use facile_core::{HairStyle, Mesh, Texture, Vector3};

/// Texels that a streak reaches to either side.
const REACH: usize = 48;
/// Texels to either side of the one a line begins at that it serves.
const SERVED: usize = 96;
/// Power of the painted brightness: above 1 for more contrast.
const CONTRAST: f32 = 1.5;
/// Standard deviation of a strand's brightness over the mean around it.
const DEVIATION: f32 = 0.26;
/// Least brightness.
const DARKEST: f32 = 0.03;

/// The brightness of a style's strands, each for itself.
pub(super) fn streaked(style: &HairStyle) -> Texture {
    let [width, height] = style.size();
    let along = directions(&style.mesh, &style.strands, [width, height]);
    let noise: Vec<f32> = (0..width * height).map(|i| noise(i as u32)).collect();
    let streaks = smeared(&noise, &along, [width, height], &style.cover);
    let painted: [f32; 256] = LINEAR_FROM_SRGB8.map(|light| libm::powf(light, CONTRAST));
    let mut texture = style.light.clone();
    let texels = texture.texels_mut().iter_mut().zip(streaks);
    for ((texel, streak), _) in texels.zip(&style.cover).filter(|(_, cover)| **cover > 0) {
        let light = painted[usize::from(texel[0])] * (1.0 + DEVIATION * streak);
        *texel = [srgb8_from_linear(light.clamp(DARKEST, 1.0)); 3];
    }
    texture
}

/// Unit direction of the strands at each texel of the picture, in texels with `y` downwards; zero where there are none.
fn directions(mesh: &Mesh, strands: &[Vector3], [width, height]: [usize; 2]) -> Vec<[f32; 2]> {
    let mut along = vec![[0.0_f32; 2]; width * height];
    let size = [width as f64, height as f64];
    for (corners, texcoords) in mesh.triangles.iter().zip(&mesh.texcoord_triangles) {
        let [a, b, c] = corners.map(|v| mesh.positions[v as usize]);
        let at = texcoords.map(|v| {
            let [x, y] = mesh.texcoords[v as usize].map(f64::from);
            [x * size[0] - 0.5, (1.0 - y) * size[1] - 0.5]
        });
        let sum = corners.map(|v| strands[v as usize]).iter().sum::<Vector3>();
        let Some(step) = in_plane(&[b - a, c - a], &sum) else {
            continue;
        };
        let way = |k: usize| step[0] * (at[1][k] - at[0][k]) + step[1] * (at[2][k] - at[0][k]);
        let (x, y) = (way(0), way(1));
        let length = libm::hypot(x, y);
        if length < 1e-9 {
            continue;
        }
        let unit = [(x / length) as f32, (y / length) as f32];
        for_each_texel(&at, [width, height], |i| along[i] = unit);
    }
    along
}

/// The factors of two edges whose sum is nearest to a vector; `None` if they are parallel.
fn in_plane([e, f]: &[Vector3; 2], v: &Vector3) -> Option<[f64; 2]> {
    let (ee, ef, ff) = (e.dot(e), e.dot(f), f.dot(f));
    let determinant = ee * ff - ef * ef;
    (determinant > 1e-12 * ee * ff).then(|| {
        let (ev, fv) = (e.dot(v), f.dot(v));
        [
            (ff * ev - ef * fv) / determinant,
            (ee * fv - ef * ev) / determinant,
        ]
    })
}

/// Calls `visit` with each texel in or next to a triangle of the picture.
fn for_each_texel(at: &[[f64; 2]; 3], [width, height]: [usize; 2], mut visit: impl FnMut(usize)) {
    let range = |k: usize, n: usize| {
        let values = at.map(|p| p[k]);
        let low = values.into_iter().fold(f64::MAX, f64::min).floor().max(0.0) as usize;
        let high = values.into_iter().fold(f64::MIN, f64::max).ceil().max(0.0) as usize;
        low..(high + 1).min(n)
    };
    let edge = |a: [f64; 2], b: [f64; 2], p: [f64; 2]| {
        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    };
    let area = edge(at[0], at[1], at[2]);
    if area == 0.0 {
        return;
    }
    for y in range(1, height) {
        for x in range(0, width) {
            let p = [x as f64, y as f64];
            let is_inside = (0..3).all(|k| {
                let (a, b) = (at[k], at[(k + 1) % 3]);
                // A texel beyond the border counts: texture is looked up between texels
                let margin = libm::hypot(b[0] - a[0], b[1] - a[1]);
                edge(a, b, p) * area.signum() >= -margin
            });
            if is_inside {
                visit(y * width + x);
            }
        }
    }
}

/// Means of the noise along the strand through each covered texel, of unit variance; not a number in others.
fn smeared(noise: &[f32], along: &[[f32; 2]], size: [usize; 2], cover: &[u8]) -> Vec<f32> {
    let mut means = vec![f32::NAN; noise.len()];
    let (mut places, mut running) = (Vec::new(), Vec::new());
    for i in (0..noise.len()).filter(|i| cover[*i] > 0) {
        if !means[i].is_nan() {
            continue;
        }
        places.clear();
        walk(along, size, (i, -1.0), &mut places);
        places.reverse();
        let middle = places.len();
        places.push(i);
        walk(along, size, (i, 1.0), &mut places);
        // The noise up to each place
        running.clear();
        running.push(0.0);
        let mut sum = 0.0;
        running.extend(places.iter().map(|place| {
            sum += noise[*place];
            sum
        }));
        for k in middle.saturating_sub(SERVED)..places.len().min(middle + SERVED + 1) {
            let (from, to) = (k.saturating_sub(REACH), places.len().min(k + REACH + 1));
            let mean = &mut means[places[k]];
            // The first line counts: the mean of several would be duller
            if mean.is_nan() {
                *mean = (running[to] - running[from]) / ((to - from) as f32).sqrt();
            }
        }
    }
    means
}

/// Appends the texels that the strand through texel `i` passes, from the next on, to its positive or negative side.
fn walk(
    along: &[[f32; 2]],
    [width, height]: [usize; 2],
    (i, side): (usize, f32),
    places: &mut Vec<usize>,
) {
    let (mut x, mut y) = ((i % width) as f32, (i / width) as f32);
    let mut heading = along[i].map(|v| v * side);
    for _ in 0..SERVED + REACH {
        (x, y) = (x + heading[0], y + heading[1]);
        let inside = x >= 0.0 && y >= 0.0 && x < width as f32 - 0.5 && y < height as f32 - 0.5;
        if !inside || heading == [0.0; 2] {
            return;
        }
        let place = (y + 0.5) as usize * width + (x + 0.5) as usize;
        places.push(place);
        // Strands have no sign: go on the way one came
        let next = along[place];
        let turn = next[0] * heading[0] + next[1] * heading[1];
        heading = next.map(|v| if turn < 0.0 { -v } else { v });
    }
}

/// White noise of unit variance, uniform. Source of the hash: Wellons, Prospecting for Hash Functions, 2018.
fn noise(i: u32) -> f32 {
    let mut x = i.wrapping_add(0x9E37_79B9);
    x = (x ^ x >> 16).wrapping_mul(0x21F0_AAAD);
    x = (x ^ x >> 15).wrapping_mul(0x735A_2D97);
    x ^= x >> 15;
    (x as f32 / 4_294_967_296.0 - 0.5) * libm::sqrtf(12.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streaks_run_along_the_strands() {
        for name in ["long01", "short03"] {
            let style = HairStyle::embedded(name).expect("ships");
            let [width, height] = style.size();
            let along = directions(&style.mesh, &style.strands, [width, height]);
            let texture = streaked(style);
            let light = |i: usize| f32::from(texture.texels()[i][0]);
            // Brightness changes more across strands than along them
            let (mut changes, mut count) = ([0.0_f64; 2], 0);
            for y in 4..height - 4 {
                for x in 4..width - 4 {
                    let i = y * width + x;
                    let [dx, dy] = along[i];
                    if style.cover[i] < 200 || [dx, dy] == [0.0; 2] {
                        continue;
                    }
                    let to = |dx: f32, dy: f32| {
                        let (x, y) = (x as f32 + 3.0 * dx + 0.5, y as f32 + 3.0 * dy + 0.5);
                        y as usize * width + x as usize
                    };
                    changes[0] += f64::from((light(to(dx, dy)) - light(i)).abs());
                    changes[1] += f64::from((light(to(-dy, dx)) - light(i)).abs());
                    count += 1;
                }
            }
            assert!(
                count > 10_000 && changes[1] > 1.6 * changes[0],
                "{name}: {changes:?}"
            );
        }
    }
}
