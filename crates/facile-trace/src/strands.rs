//! Light on hair: every point of an object with strands is a bundle of cylinders along the strands' direction.
//!
//! Four ways of light, each with a share of what falls in, so that no hair gives back more than it gets: mirrored at the
//! surface towards the root (white), through the fibre and mirrored at its back towards the tip (coloured), straight
//! through (coloured, seen against the light), and scattered among fibres (coloured, wide). Lobes along the strand are
//! rational instead of Gaussian: `2 / (pi beta) / (1 + (x / beta)^2)^2`, of integral 1 over the sine `x`. The result
//! is to be multiplied by the light on a facing surface, and holds a factor `pi` since such light lights white to 1.
//!
//! Sources: Marschner et al., Light Scattering from Human Hair Fibers, SIGGRAPH 2003; Kajiya and Kay, Rendering Fur with
//! Three Dimensional Textures, SIGGRAPH 1989, for what is scattered among fibres.

use crate::lanes::{Lanes, V3};

/// Reflectance at normal incidence of an index of 1.55.
const REFLECTANCE: f32 = 0.046;
/// The same at grazing angles: below 1, since other fibres hide such light.
const GRAZING: f32 = 0.25;
/// Width of the white lobe and its shift towards the root, sines.
const WHITE_WIDTH: f32 = 0.19;
const WHITE_SHIFT: f32 = -0.09;
/// The same of the coloured lobe, towards the tip.
const COLOR_WIDTH: f32 = 0.28;
const COLOR_SHIFT: f32 = 0.13;
const THROUGH_WIDTH: f32 = 0.4;
/// Shares of the light that enters the fibre; the sum is 1.
const COLOR_SHARE: f32 = 0.14;
const THROUGH_SHARE: f32 = 0.1;
const SCATTERED_SHARE: f32 = 0.76;
/// Steps into the hair that light passes before it casts a shadow: among fibres shadows are soft, mm.
pub(crate) const SOFT_DEPTH_MM: f32 = 5.0;

/// `2 / (pi beta)` times `pi`.
fn peak(width: f32) -> f32 {
    2.0 / width
}

/// What comes back from eight points with unit strands `t`, light from `l`, seen from `v` (unit), of colour `albedo`.
#[inline(always)]
pub(crate) fn scatter<L: Lanes>(t: V3<L>, l: V3<L>, v: V3<L>, albedo: V3<L>) -> V3<L> {
    let (zero, one, half) = (L::splat(0.0), L::splat(1.0), L::splat(0.5));
    let (sin_l, sin_v) = (t.dot(l), t.dot(v));
    let square = |x: L| x * x;
    let cos_l = (one - square(sin_l)).max(zero).sqrt();
    let cos_v = (one - square(sin_v)).max(zero).sqrt();
    let between = l.dot(v);
    // Turn between light and viewer about the strand
    let turn = (between - sin_l * sin_v) / (cos_l * cos_v).max(L::splat(1e-4));
    let turn = turn.max(L::splat(-1.0)).min(one);
    let facing = (half + half * turn).max(zero);
    let lobe = |width: f32, shift: f32| {
        let x = (sin_l + sin_v - L::splat(shift)) / L::splat(width);
        L::splat(peak(width)) / square(one + square(x))
    };
    // Schlick's rule at the half vector, less at grazing angles
    let x = one - (half + half * between).max(zero).sqrt();
    let f0 = L::splat(REFLECTANCE);
    let fresnel = f0 + L::splat(GRAZING - REFLECTANCE) * square(square(x)) * x;
    let white = lobe(WHITE_WIDTH, WHITE_SHIFT) * facing.sqrt() * L::splat(0.25) * fresnel;
    // Azimuthal lobes of integral 1: cos^8 of half the turn over 35 pi / 64
    let eighth = square(square(facing));
    let behind = square(square(one - facing));
    let narrow = L::splat(64.0 / (35.0 * std::f32::consts::PI));
    let colored = lobe(COLOR_WIDTH, COLOR_SHIFT) * eighth * narrow * L::splat(COLOR_SHARE);
    let through = lobe(THROUGH_WIDTH, 0.0) * behind * narrow * L::splat(THROUGH_SHARE);
    // cos(theta) (1 + cos(turn)) / 2 has the integral pi^2 / 2 over directions
    let wide = cos_l * facing * L::splat(2.0 / std::f32::consts::PI * SCATTERED_SHARE);
    let inside = albedo.scale((one - fresnel) * (colored + through + wide));
    inside + V3([white, white, white])
}

/// One point, the oracle of [`scatter`].
#[cfg(test)]
pub(crate) fn scatter_one(
    t: crate::math::Vec3,
    l: crate::math::Vec3,
    v: crate::math::Vec3,
    albedo: crate::math::Rgb,
) -> crate::math::Rgb {
    let (sin_l, sin_v) = (t.dot(&l), t.dot(&v));
    let cos_l = (1.0 - sin_l * sin_l).max(0.0).sqrt();
    let cos_v = (1.0 - sin_v * sin_v).max(0.0).sqrt();
    let between = l.dot(&v);
    let turn = ((between - sin_l * sin_v) / (cos_l * cos_v).max(1e-4)).clamp(-1.0, 1.0);
    let facing = (0.5 + 0.5 * turn).max(0.0);
    let lobe = |width: f32, shift: f32| {
        let x = (sin_l + sin_v - shift) / width;
        let y = 1.0 + x * x;
        peak(width) / (y * y)
    };
    let x = 1.0 - (0.5 + 0.5 * between).max(0.0).sqrt();
    let x2 = x * x;
    let fresnel = REFLECTANCE + (GRAZING - REFLECTANCE) * (x2 * x2) * x;
    let white = lobe(WHITE_WIDTH, WHITE_SHIFT) * facing.sqrt() * 0.25 * fresnel;
    let power4 = |x: f32| (x * x) * (x * x);
    let narrow = 64.0 / (35.0 * std::f32::consts::PI);
    let colored = lobe(COLOR_WIDTH, COLOR_SHIFT) * power4(facing) * narrow * COLOR_SHARE;
    let through = lobe(THROUGH_WIDTH, 0.0) * power4(1.0 - facing) * narrow * THROUGH_SHARE;
    let wide = cos_l * facing * (2.0 / std::f32::consts::PI * SCATTERED_SHARE);
    let inside = albedo * ((1.0 - fresnel) * (colored + through + wide));
    inside + crate::math::Rgb::repeat(white)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Rgb, Vec3};

    #[test]
    fn white_hair_gives_back_at_most_what_it_gets() {
        let t = Vec3::y();
        for view in [0.0_f32, 0.5, 1.0, 1.4] {
            let v = Vec3::new(view.cos(), view.sin(), 0.0);
            let (n, mut sum) = (400, 0.0);
            for i in 0..n {
                let y = 2.0 * (i as f32 + 0.5) / n as f32 - 1.0;
                let r = (1.0 - y * y).sqrt();
                for k in 0..n {
                    let turn = (k as f32 + 0.5) / n as f32 * std::f32::consts::TAU;
                    let l = Vec3::new(r * turn.cos(), y, r * turn.sin());
                    sum += f64::from(scatter_one(t, l, v, Rgb::repeat(1.0)).x);
                }
            }
            // Solid angle of a step is 4 pi / n^2, and the result holds a factor pi
            let share = sum * 4.0 / f64::from(n * n);
            assert!(share < 1.0 && share > 0.55, "{view}: {share}");
        }
    }

    #[test]
    fn the_highlight_is_where_the_strand_mirrors() {
        let (t, v) = (Vec3::y(), Vec3::new(0.8, 0.6, 0.0));
        let at = |y: f32| {
            let l = Vec3::new((1.0 - y * y).sqrt(), y, 0.0);
            scatter_one(t, l, v, Rgb::zeros()).x
        };
        // White: the sines of light and viewer sum to the shift
        let (peak, _) = (-99..100)
            .map(|i| i as f32 / 100.0)
            .map(|y| (y, at(y)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .expect("not empty");
        assert!((peak - (WHITE_SHIFT - 0.6)).abs() < 0.06, "{peak}");
    }
}
