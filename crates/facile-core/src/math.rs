//! Names for the `nalgebra` types that the project uses: `f64` for geometry and physics.

/// A position, mm.
pub type Point3 = nalgebra::Point3<f64>;
/// A displacement or direction.
pub type Vector3 = nalgebra::Vector3<f64>;
/// A pair, such as `(h, phi)` or a texture coordinate.
pub type Vector2 = nalgebra::Vector2<f64>;
/// A 3x3 matrix.
pub type Matrix3 = nalgebra::Matrix3<f64>;
/// A rotation followed by a translation.
pub type Isometry3 = nalgebra::Isometry3<f64>;
/// A uniform scale and a rotation followed by a translation.
pub type Similarity3 = nalgebra::Similarity3<f64>;
/// A rotation.
pub type UnitQuaternion = nalgebra::UnitQuaternion<f64>;

/// Cylindrical coordinates `(h, phi)` of a point: `h` is its height in mm, `phi` in `(-pi, pi]` is 0 at the nose and
/// grows towards the subject's left.
pub fn cylinder_from_point(p: &Point3) -> Vector2 {
    Vector2::new(p.y, libm::atan2(p.x, p.z))
}

/// Distance of a point from the cylinder's axis, mm.
pub fn radius_of_point(p: &Point3) -> f64 {
    libm::sqrt(p.x * p.x + p.z * p.z)
}

/// The point at height `h` (mm), angle `phi` (rad) and radius `r` (mm).
pub fn point_from_cylinder(h: f64, phi: f64, r: f64) -> Point3 {
    Point3::new(r * libm::sin(phi), h, r * libm::cos(phi))
}

/// The similarity that maps `source` onto `target` with the least sum of squared distances.
///
/// Both lists have the same length, at least 3 points not on one line. Weights are non-negative, one per pair.
/// Returns `None` if the points do not determine a similarity. Cost O(n).
///
/// Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991.
///
/// # Panics
/// If the lists have different lengths.
pub fn fit_similarity(
    source: &[Point3],
    target: &[Point3],
    weights: &[f64],
) -> Option<Similarity3> {
    assert_eq!(source.len(), target.len(), "one target per source point");
    assert_eq!(source.len(), weights.len(), "one weight per source point");
    let total: f64 = weights.iter().sum();
    if source.len() < 3 || total <= 0.0 {
        return None;
    }
    let mean = |points: &[Point3]| {
        let sum = points
            .iter()
            .zip(weights)
            .fold(Vector3::zeros(), |s, (p, w)| s + p.coords * *w);
        sum / total
    };
    let (source_mean, target_mean) = (mean(source), mean(target));
    let mut covariance = Matrix3::zeros();
    let mut source_variance = 0.0;
    for ((s, t), w) in source.iter().zip(target).zip(weights) {
        let (s, t) = (s.coords - source_mean, t.coords - target_mean);
        covariance += t * s.transpose() * *w;
        source_variance += w * s.norm_squared();
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Vector3::repeat(1.0);
    if (u * v_t).determinant() < 0.0 {
        sign.z = -1.0;
    }
    let scale = svd.singular_values.dot(&sign) / source_variance;
    if !(scale.is_finite() && scale > 0.0) {
        return None;
    }
    let rotation = UnitQuaternion::from_matrix(&(u * Matrix3::from_diagonal(&sign) * v_t));
    let translation = target_mean - rotation * source_mean * scale;
    Some(Similarity3::from_parts(translation.into(), rotation, scale))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn cylinder_coordinates_round_trip() {
        let p = Point3::new(30.0, -12.0, 80.0);
        let c = cylinder_from_point(&p);
        assert_relative_eq!(
            point_from_cylinder(c.x, c.y, radius_of_point(&p)),
            p,
            epsilon = 1e-12
        );
        assert!(c.y > 0.0, "the subject's left has positive phi");
    }

    #[test]
    fn a_known_similarity_is_recovered() {
        let truth = Similarity3::new(
            Vector3::new(3.0, -2.0, 9.0),
            Vector3::new(0.2, -0.4, 0.1),
            1.7,
        );
        let source: Vec<Point3> = (0..12)
            .map(|i| {
                let t = f64::from(i);
                Point3::new(t.sin() * 50.0, t * 7.0 - 40.0, (t * 1.7).cos() * 30.0)
            })
            .collect();
        let target: Vec<Point3> = source.iter().map(|p| truth * p).collect();
        let fit = fit_similarity(&source, &target, &[1.0; 12]).expect("determined");
        for (s, t) in source.iter().zip(&target) {
            assert_relative_eq!(fit * s, *t, epsilon = 1e-9);
        }
    }
}
