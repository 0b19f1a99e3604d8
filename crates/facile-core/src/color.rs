//! The sRGB transfer function (IEC 61966-2-1), exact and by table.

use std::sync::LazyLock;

/// Linear light in `[0, 1]` from an sRGB value in `[0, 1]`.
pub fn linear_from_srgb(v: f64) -> f64 {
    if v <= 0.040_45 {
        v / 12.92
    } else {
        libm::pow((v + 0.055) / 1.055, 2.4)
    }
}

/// sRGB value in `[0, 1]` from linear light in `[0, 1]`.
pub fn srgb_from_linear(v: f64) -> f64 {
    if v <= 0.003_130_8 {
        v * 12.92
    } else {
        1.055 * libm::pow(v, 1.0 / 2.4) - 0.055
    }
}

/// Linear light of each of the 256 sRGB codes.
pub static LINEAR_FROM_SRGB8: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| linear_from_srgb(i as f64 / 255.0) as f32));

/// Smallest linear value that rounds to each 8-bit code: the borders between codes.
static SRGB8_BORDERS: LazyLock<[f32; 255]> =
    LazyLock::new(|| std::array::from_fn(|i| linear_from_srgb((i as f64 + 0.5) / 255.0) as f32));

/// Start of the search in [`SRGB8_BORDERS`] for each of 4,096 equal steps of linear light.
static SRGB8_START: LazyLock<[u8; 4097]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let v = i as f32 / 4096.0;
        SRGB8_BORDERS.partition_point(|b| *b <= v) as u8
    })
});

/// Nearest 8-bit sRGB code of linear light; values outside `[0, 1]` and NaN are clamped (NaN to 0).
///
/// Exact: equals rounding of [`srgb_from_linear`] for every `f32` up to ties. Cost: one table look-up and at most a
/// few comparisons.
pub fn srgb8_from_linear(v: f32) -> u8 {
    if v >= 1.0 {
        return 255;
    }
    if v > 0.0 {
        let mut code = usize::from(SRGB8_START[(v * 4096.0) as usize]);
        while code < 255 && SRGB8_BORDERS[code] <= v {
            code += 1;
        }
        return code as u8;
    }
    0
}

/// Steps of linear light, so small that at most one border between two codes lies in each.
const STEPS: usize = 4096;

/// The linear value from which the next code holds, and the code at the start of each step.
static STEP_CODES: LazyLock<Vec<(f32, u8)>> = LazyLock::new(|| {
    let border = |code: u8| SRGB8_BORDERS.get(usize::from(code)).copied();
    (0..=STEPS)
        .map(|i| {
            let code = srgb8_from_linear(i as f32 / STEPS as f32);
            (border(code).unwrap_or(f32::INFINITY), code)
        })
        .collect()
});

/// [`srgb8_from_linear`] for many values: its table at hand, one comparison each.
#[derive(Clone, Copy, Debug)]
pub struct Srgb8Codes {
    steps: &'static [(f32, u8)],
}

impl Default for Srgb8Codes {
    fn default() -> Self {
        Self { steps: &STEP_CODES }
    }
}

impl Srgb8Codes {
    /// As [`srgb8_from_linear`].
    #[inline]
    pub fn of(self, v: f32) -> u8 {
        // NaN and what is below 0 become 0
        let v = if v > 0.0 { v } else { 0.0 };
        let v = if v < 1.0 { v } else { 1.0 };
        let (border, code) = self.steps[(v * STEPS as f32) as usize];
        code + u8::from(border <= v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_round_trips() {
        for code in 0..=255_u8 {
            assert_eq!(
                srgb8_from_linear(LINEAR_FROM_SRGB8[usize::from(code)]),
                code
            );
        }
    }

    #[test]
    fn the_table_equals_the_formula() {
        for i in 0..200_000 {
            let v = f64::from(i) / 199_999.0;
            let exact = srgb_from_linear(v) * 255.0;
            let code = f64::from(srgb8_from_linear(v as f32));
            assert!(
                (code - exact).abs() <= 0.5 + 1e-4,
                "{v}: {code} against {exact}"
            );
        }
        assert_eq!(srgb8_from_linear(f32::NAN), 0);
        assert_eq!(srgb8_from_linear(7.0), 255);
    }

    #[test]
    fn the_table_of_steps_has_the_codes_of_the_plain_function() {
        let special = [f32::NAN, -1.0, -0.0, 0.0, 1.0, 7.0, f32::INFINITY, 1e-40];
        let values = (0..300_000).map(|i| i as f32 / 299_000.0).chain(special);
        let borders = SRGB8_BORDERS.iter();
        let near = borders.flat_map(|b| [b.next_down(), *b, b.next_up()]);
        let codes = Srgb8Codes::default();
        for v in values.chain(near) {
            assert_eq!(codes.of(v), srgb8_from_linear(v), "{v}");
        }
    }
}
