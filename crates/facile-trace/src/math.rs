//! `f32` names for rendering, and the way from the `f64` vocabulary of `facile-core`.

use nalgebra::{Isometry3, Vector3};

/// A position or a direction in `f32`; which of the two, and in which space, the name of the value says.
pub type Vec3 = Vector3<f32>;

/// Linear RGB, 1 is a white diffuse surface under a light of unit illumination.
pub type Rgb = Vector3<f32>;

/// A rotation followed by a translation in `f32`.
pub type Pose = Isometry3<f32>;

/// Rounds a point to `f32`.
pub fn vec3_from_point(p: &facile_core::Point3) -> Vec3 {
    Vec3::new(p.x as f32, p.y as f32, p.z as f32)
}

/// Rounds a vector to `f32`.
pub fn vec3_from_vector(v: &facile_core::Vector3) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

/// Rounds a rigid motion to `f32`, its rotation normalised again.
pub fn pose_from_isometry(pose: &facile_core::Isometry3) -> Pose {
    pose.cast::<f32>()
}

/// `v / |v|`, or `fallback` where `v` is too short to have a direction.
pub(crate) fn unit_or(v: Vec3, fallback: Vec3) -> Vec3 {
    let squared = v.norm_squared();
    if squared > 1e-30 {
        v / squared.sqrt()
    } else {
        fallback
    }
}

/// `x^n` by repeated squaring where `n` is whole, by `libm` elsewhere: the same bits on every machine.
pub(crate) fn power(x: f32, n: f32) -> f32 {
    if (0.0..=65_536.0).contains(&n) && n.fract() == 0.0 {
        let (mut result, mut square, mut rest) = (1.0, x, n as u32);
        while rest > 0 {
            if rest & 1 == 1 {
                result *= square;
            }
            square *= square;
            rest >>= 1;
        }
        result
    } else {
        libm::powf(x, n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_agree_with_libm() {
        for n in [0.0, 1.0, 7.0, 24.0, 400.0, 2.5] {
            for x in [0.0_f32, 0.3, 0.97, 1.0] {
                let exact = f64::from(x).powf(f64::from(n));
                assert!(
                    (f64::from(power(x, n)) - exact).abs() <= 1e-5 * exact + 1e-37,
                    "{x}^{n}"
                );
            }
        }
    }
}
