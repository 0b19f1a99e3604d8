//! The highlight of a rough surface: mirrors of microscopic size in all directions about the normal.
//!
//! `pi D V F` of the GGX distribution with the height-correlated visibility of Smith and Schlick's Fresnel term, to be
//! multiplied by the light `E cos(theta)`; the `pi` follows from lights that light a white surface to 1. `alpha` is the
//! square of the roughness. Sources: Walter et al., Microfacet Models for Refraction through Rough Surfaces, EGSR 2007;
//! Heitz, Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs, JCGT 3(2), 2014.

use crate::lanes::Lanes;

/// Roughness below this would make points of light that no pixel can hold.
const MIN_ROUGHNESS: f32 = 0.05;

/// One highlight, the oracle of [`highlights`].
#[cfg(test)]
pub(crate) fn highlight(
    specular: f32,
    roughness: f32,
    [cos_nl, cos_nv, cos_nh, cos_vh]: [f32; 4],
) -> f32 {
    if cos_nl <= 0.0 || cos_nv <= 0.0 {
        return 0.0;
    }
    let rough = if roughness < MIN_ROUGHNESS {
        MIN_ROUGHNESS
    } else {
        roughness
    };
    let alpha = rough * rough;
    let squared = alpha * alpha;
    let spread = cos_nh * cos_nh * (squared - 1.0) + 1.0;
    let distribution = squared / (spread * spread);
    let hidden_light = cos_nl * (cos_nv * cos_nv * (1.0 - squared) + squared).sqrt();
    let hidden_view = cos_nv * (cos_nl * cos_nl * (1.0 - squared) + squared).sqrt();
    let visibility = 0.5 / (hidden_light + hidden_view);
    let x = 1.0 - cos_vh;
    let x2 = x * x;
    let fresnel = specular + (1.0 - specular) * (x2 * x2 * x);
    distribution * visibility * fresnel
}

/// The highlights; all cosines are with the normal but `cos_vh`, which is between the viewer and the half vector. 0 where
/// light or viewer is behind the surface.
#[inline(always)]
pub(crate) fn highlights<L: Lanes>(
    specular: L,
    roughness: L,
    [cos_nl, cos_nv, cos_nh, cos_vh]: [L; 4],
) -> L {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let least = L::splat(MIN_ROUGHNESS);
    let rough = L::select(roughness.lt(least), least, roughness);
    let alpha = rough * rough;
    let squared = alpha * alpha;
    let spread = cos_nh * cos_nh * (squared - one) + one;
    let distribution = squared / (spread * spread);
    let hidden_light = cos_nl * (cos_nv * cos_nv * (one - squared) + squared).sqrt();
    let hidden_view = cos_nv * (cos_nl * cos_nl * (one - squared) + squared).sqrt();
    let visibility = L::splat(0.5) / (hidden_light + hidden_view);
    let x = one - cos_vh;
    let x2 = x * x;
    let fresnel = specular + (one - specular) * (x2 * x2 * x);
    let found = distribution * visibility * fresnel;
    L::select(
        cos_nl.le(zero),
        zero,
        L::select(cos_nv.le(zero), zero, found),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec3;

    /// Share of light from the angle `view` that goes anywhere, for a reflectance of 1.
    fn albedo(roughness: f32, view: f32) -> f64 {
        let to_view = Vec3::new(view.sin(), 0.0, view.cos());
        let (n, mut sum) = (600, 0.0);
        for i in 0..n {
            let cosine = (i as f32 + 0.5) / n as f32;
            let sine = (1.0 - cosine * cosine).sqrt();
            for k in 0..n {
                let turn = (k as f32 + 0.5) / n as f32 * std::f32::consts::TAU;
                let to_light = Vec3::new(sine * turn.cos(), sine * turn.sin(), cosine);
                let half = crate::math::unit_or(to_view + to_light, Vec3::z());
                let cosines = [cosine, to_view.z, half.z, half.dot(&to_view)];
                sum += f64::from(highlight(1.0, roughness, cosines) * cosine);
            }
        }
        // Solid angle of a step is 2 pi / n^2; the highlight holds a factor pi
        sum * 2.0 / f64::from(n * n)
    }

    #[test]
    fn a_perfect_mirror_of_any_roughness_gives_back_at_most_what_it_gets() {
        for roughness in [0.3, 0.5, 0.8, 1.0] {
            for view in [0.0, 0.6, 1.2] {
                let share = albedo(roughness, view);
                assert!(share < 1.005, "{roughness} {view}: {share}");
            }
        }
        // The roughest keeps 1 - ln 2 of what falls straight on it, the rest is lost between its facets
        let kept = 1.0 - std::f64::consts::LN_2;
        assert!((albedo(1.0, 0.0) - kept).abs() < 1e-3);
        // A smooth one loses a hundredth
        assert!((albedo(0.3, 0.3) - 0.99).abs() < 0.005);
    }

    #[test]
    fn light_and_viewer_may_change_places() {
        let a = highlight(0.04, 0.4, [0.3, 0.8, 0.7, 0.6]);
        let b = highlight(0.04, 0.4, [0.8, 0.3, 0.7, 0.6]);
        assert!((a - b).abs() < 1e-6 * a);
    }
}
