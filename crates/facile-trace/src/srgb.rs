//! A whole image in 8-bit sRGB: [`facile_core::color::srgb8_from_linear`] with its tables at hand.

use facile_core::Plane;
use facile_core::color::{linear_from_srgb, srgb8_from_linear};
use std::sync::LazyLock;

use crate::math::Rgb;

/// Steps of linear light, so small that at most one border between two codes lies in each.
const STEPS: usize = 4096;

/// Code at the start of each step, and the linear value from which the next code holds.
static STEP_CODES: LazyLock<Vec<(f32, u8)>> = LazyLock::new(|| {
    let code_at = |i: usize| srgb8_from_linear(i as f32 / STEPS as f32);
    let border = |code: u8| match code {
        255 => f32::INFINITY,
        _ => linear_from_srgb((f64::from(code) + 0.5) / 255.0) as f32,
    };
    (0..=STEPS)
        .map(|i| (border(code_at(i)), code_at(i)))
        .collect()
});

/// The image in 8-bit sRGB.
pub(crate) fn srgb8(image: &Plane<Rgb>) -> Plane<[u8; 3]> {
    let steps: &[(f32, u8)] = &STEP_CODES;
    let code = |v: f32| {
        // NaN and what is below 0 become 0
        let v = if v > 0.0 { v } else { 0.0 };
        let v = if v < 1.0 { v } else { 1.0 };
        let (border, code) = steps[(v * STEPS as f32) as usize];
        code + u8::from(border <= v)
    };
    // Backgrounds are long runs of one colour
    let (mut last, mut codes) = (Rgb::zeros(), [0; 3]);
    image.map(|c| {
        if *c != last {
            (last, codes) = (*c, [code(c.x), code(c.y), code(c.z)]);
        }
        codes
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_has_the_code_of_the_plain_function() {
        let special = [f32::NAN, -1.0, -0.0, 0.0, 1.0, 7.0, f32::INFINITY, 1e-40];
        let values = (0..300_000).map(|i| i as f32 / 299_000.0).chain(special);
        let near = (0..255_u8).flat_map(|c| {
            let border = linear_from_srgb((f64::from(c) + 0.5) / 255.0) as f32;
            [border.next_down(), border, border.next_up()]
        });
        let values: Vec<f32> = values.chain(near).collect();
        let image = Plane::from_fn(values.len(), 1, |x, _| Rgb::repeat(values[x]));
        for (found, v) in srgb8(&image).as_slice().iter().zip(&values) {
            assert_eq!(*found, [srgb8_from_linear(*v); 3], "{v}");
        }
    }
}
