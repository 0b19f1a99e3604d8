//! A room out of focus: wall, floor, a window or a lamp, furniture, as a lens behind the head would blur them.

use facile_core::color::srgb8_from_linear;
use facile_core::rng::RandomStream;
use facile_core::{Plane, Texture};

use crate::math::Rgb;

/// Side of the picture, texels: more than what is left after the blur.
const SIDE: usize = 160;
/// Passes of a box blur: three are close to a Gaussian.
const PASSES: usize = 3;

/// Draws a room from a stream: `blur` is its softness as a share of the picture's side, in `[0, 0.2]`.
pub fn room(stream: &mut RandomStream, blur: f64) -> Texture {
    let mut picture = Plane::filled(SIDE, SIDE, Rgb::zeros());
    let wall = wall_color(stream);
    let light = stream.uniform(0.25, 0.9) as f32;
    let slope = stream.uniform(-0.5, 0.5) as f32;
    let floor_at = stream.uniform(0.72, 1.3);
    let floor = tinted(stream, 0.5) * (0.35 * light);
    for y in 0..SIDE {
        for x in 0..SIDE {
            let (u, v) = (x as f32 / SIDE as f32 - 0.5, y as f64 / SIDE as f64);
            let shade = light * (1.0 + slope * u) * (1.1 - 0.35 * v as f32);
            picture[(x, y)] = if v > floor_at { floor } else { wall * shade };
        }
    }
    for _ in 0..3 + stream.index(6) {
        let shade = stream.uniform(0.05, 1.1) as f32 * light;
        let color = tinted(stream, 0.45) * shade;
        let (width, height) = (stream.uniform(0.06, 0.35), stream.uniform(0.1, 0.7));
        let (x, bottom) = (stream.uniform(-0.1, 1.0), stream.uniform(0.5, 1.1));
        fill(&mut picture, [x, bottom - height, x + width, bottom], color);
    }
    match stream.index(3) {
        0 => window(&mut picture, stream),
        1 => lamp(&mut picture, stream),
        _ => {}
    }
    let radius = (blur * SIDE as f64 / 2.0) as usize;
    for _ in 0..PASSES {
        picture = across(&picture, radius, [1, 0]);
        picture = across(&picture, radius, [0, 1]);
    }
    let texels = picture.as_slice().iter();
    let texels = texels
        .map(|c| [c.x, c.y, c.z].map(srgb8_from_linear))
        .collect();
    Texture::new(SIDE, SIDE, texels)
}

/// Pale, warm or cool.
fn wall_color(stream: &mut RandomStream) -> Rgb {
    let base = stream.uniform(0.25, 0.8) as f32;
    tinted(stream, 0.25) * base
}

/// White, warmer or cooler by at most `strength`, a little greener or less: rooms are seldom colourful.
fn tinted(stream: &mut RandomStream, strength: f64) -> Rgb {
    let warmth = stream.uniform(-0.6, 1.0) * strength;
    let green = stream.uniform(-0.15, 0.15) * strength;
    let (red, blue) = (1.0 + warmth.min(0.0), 1.0 - warmth.max(0.0));
    let green = red.midpoint(blue) + green;
    Rgb::new(red as f32, green as f32, blue as f32)
}

fn window(picture: &mut Plane<Rgb>, stream: &mut RandomStream) {
    let sky = Rgb::new(0.85, 0.95, 1.05) * stream.uniform(1.0, 2.2) as f32;
    let (width, height) = (stream.uniform(0.18, 0.4), stream.uniform(0.35, 0.6));
    let (x, y) = (stream.uniform(-0.1, 0.85), stream.uniform(-0.1, 0.25));
    fill(picture, [x, y, x + width, y + height], sky);
    // Bars
    let bar = Rgb::repeat(0.25);
    fill(
        picture,
        [x + 0.48 * width, y, x + 0.52 * width, y + height],
        bar,
    );
    fill(
        picture,
        [x, y + 0.48 * height, x + width, y + 0.52 * height],
        bar,
    );
}

fn lamp(picture: &mut Plane<Rgb>, stream: &mut RandomStream) {
    let warm = Rgb::new(1.0, 0.78, 0.5) * stream.uniform(1.2, 2.6) as f32;
    let (x, y) = (stream.uniform(0.0, 0.9), stream.uniform(0.05, 0.5));
    let size = stream.uniform(0.05, 0.12);
    fill(picture, [x, y, x + size, y + 1.2 * size], warm);
}

/// Fills a rectangle `[left, top, right, bottom]` in shares of the picture.
fn fill(picture: &mut Plane<Rgb>, rectangle: [f64; 4], color: Rgb) {
    let [x0, y0, x1, y1] = rectangle.map(|v| (v.clamp(0.0, 1.0) * SIDE as f64) as usize);
    for y in y0..y1 {
        picture.row_mut(y)[x0..x1.max(x0)].fill(color);
    }
}

/// A box blur of `2 radius + 1` texels along one axis; the border goes on outside.
fn across(picture: &Plane<Rgb>, radius: usize, [dx, dy]: [i64; 2]) -> Plane<Rgb> {
    let clamp = |v: i64| v.clamp(0, SIDE as i64 - 1) as usize;
    let reach = radius as i64;
    Plane::from_fn(SIDE, SIDE, |x, y| {
        let sum = (-reach..=reach).fold(Rgb::zeros(), |sum, k| {
            sum + picture[(clamp(x as i64 + k * dx), clamp(y as i64 + k * dy))]
        });
        sum / (2 * radius + 1) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_repeat_and_differ_and_blur() {
        let draw = |number, blur| room(&mut RandomStream::new(3, number), blur);
        assert_eq!(draw(1, 0.05), draw(1, 0.05));
        assert_ne!(draw(1, 0.05), draw(2, 0.05));
        let steps = |texture: &Texture| {
            let texels = texture.texels();
            let step = |i: usize| texels[i][1].abs_diff(texels[i + 1][1]);
            (0..texels.len() - 1)
                .filter(|i| i % SIDE != SIDE - 1)
                .map(step)
                .max()
                .unwrap_or(0)
        };
        for number in 0..6 {
            assert!(steps(&draw(number, 0.08)) < 16);
        }
        assert!((0..6).any(|n| steps(&draw(n, 0.0)) > 60));
    }
}
