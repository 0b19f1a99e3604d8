//! A whole image in 8-bit sRGB.

use facile_core::Plane;
use facile_core::color::Srgb8Codes;

use crate::math::Rgb;

/// The image in 8-bit sRGB.
pub(crate) fn srgb8(image: &Plane<Rgb>) -> Plane<[u8; 3]> {
    let codes = Srgb8Codes::default();
    // Backgrounds are long runs of one colour
    let (mut last, mut own) = (Rgb::zeros(), [0; 3]);
    image.map(|c| {
        if *c != last {
            (last, own) = (*c, [codes.of(c.x), codes.of(c.y), codes.of(c.z)]);
        }
        own
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::color::srgb8_from_linear;

    #[test]
    fn runs_of_a_colour_change_nothing() {
        let value = |x: usize| Rgb::new((x / 3) as f32 * 0.1, -0.2, 0.7);
        let image = Plane::from_fn(13, 1, |x, _| value(x));
        for (x, found) in srgb8(&image).as_slice().iter().enumerate() {
            let expected: [f32; 3] = value(x).into();
            assert_eq!(*found, expected.map(srgb8_from_linear), "{x}");
        }
    }
}
