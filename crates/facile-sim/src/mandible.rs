//! The lower jaw: it turns about its condyles, which slide forwards and down along the articular eminences.
//!
//! The condyles leave their sockets as soon as the mouth opens, first slowly, then in proportion to the turn: about 12 mm
//! at the widest opening, 33 degrees (Travers et al. 2000: 11.9 mm at an opening of 46.6 mm; Ferrario et al. 2005: 32 to
//! 34 degrees). The eminence is 6.4 mm high and inclined by 35 degrees (Kranjčić et al. 2021: 5.8 to 6.9 mm, 32 to 39
//! degrees); beyond its crest the path is level. A sideways jaw turns about the condyle it moves to: the other one goes
//! forwards, down and inwards. The place of the incisors is that of Bonwill's triangle, inclined by Balkwill's angle.
//! All of it is continuously differentiable in opening, protrusion and sideways motion: at the middle, where a jaw goes
//! over from one condyle to the other, the tip of the gothic arch that incisors draw is rounded by a tenth of a millimetre.

use facile_core::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::kinematics::Rigid;
use crate::pose::JawPose;
use crate::vector::{V3, ZERO, add, cross, dot, scale, sub};

/// Forward motion of the condyles for a turn of one radian, once they slide, mm.
const GLIDE_MM: f64 = 21.3;
/// Turn over which they start to slide, rad (6 degrees).
const GLIDE_STARTS: f64 = 0.105;
/// Height of the articular eminence, mm.
const EMINENCE_HEIGHT_MM: f64 = 6.4;
/// Way forward from the bottom of the socket to the crest of the eminence, mm: 35 degrees.
const EMINENCE_LENGTH_MM: f64 = 9.1;
/// Distance of the incisors from the hinge over that between the condyles: Bonwill's triangle has equal sides.
const BONWILL: f64 = 0.866;
/// Inclination of that triangle to the level, rad (Balkwill's angle, 26 degrees).
const BALKWILL: f64 = 0.454;
/// How far the condyle that a sideways jaw turns about goes back, twice, mm: what rounds the tip of the gothic arch.
const ARCH_MM: f64 = 0.2;
/// Largest turn of the jaw to a side, rad.
const MAX_YAW: f64 = 0.6;

/// The jaw's place in a skull.
#[derive(Clone, Debug)]
pub(crate) struct Mandible {
    /// Middle between the condyles at rest, mm.
    center: V3,
    /// Unit vectors towards the left condyle, up and forwards.
    axis: V3,
    up: V3,
    forward: V3,
    /// Distance between the condyles, mm.
    width: f64,
    /// Size of the skull; that of the reference is 1.
    size: f64,
}

/// The motion of the jaw in a pose, in full and in part.
#[derive(Clone, Debug)]
pub(crate) struct JawMotion<'a> {
    mandible: &'a Mandible,
    open: f64,
    yaw: f64,
    roll: f64,
    shift: V3,
}

impl Mandible {
    /// A jaw between these condyles in a skull that looks along `+z`, or `None` if both are at the same place.
    pub(crate) fn new(left: &Point3, right: &Point3, size: f64) -> Option<Self> {
        let (l, r) = ([left.x, left.y, left.z], [right.x, right.y, right.z]);
        let along = sub(l, r);
        let width = dot(along, along).sqrt();
        let forward = [0.0, 0.0, 1.0];
        (width > 1e-6).then(|| {
            let axis = scale(along, 1.0 / width);
            Self {
                center: scale(add(l, r), 0.5),
                axis,
                up: cross(forward, axis),
                forward,
                width,
                size,
            }
        })
    }

    /// Forward motion of both condyles in a jaw that is turned open by `open` rad.
    fn glide(&self, open: f64) -> f64 {
        let turn = open.max(0.0);
        let start = GLIDE_STARTS;
        self.size * GLIDE_MM * (libm::sqrt(turn * turn + start * start) - start)
    }

    /// How far down the eminence takes a condyle that has gone forward.
    fn drop(&self, forward: f64) -> f64 {
        let share = (forward / (self.size * EMINENCE_LENGTH_MM)).clamp(0.0, 1.0);
        let height = self.size * EMINENCE_HEIGHT_MM;
        0.5 * height * (1.0 - libm::cos(std::f64::consts::PI * share))
    }

    /// Forward motion of the condyle that the jaw turns to a side about, and of the other one.
    fn aside(&self, turn: f64) -> [f64; 2] {
        let half = 0.5 * self.width * libm::sin(turn);
        let round = 0.5 * self.size * ARCH_MM;
        let both = libm::sqrt(half * half + round * round) - round;
        [both - half, both + half]
    }

    /// Tilt of a jaw whose condyles have gone forward by these ways: the one that has gone farther is lower.
    fn roll(&self, left: f64, right: f64) -> f64 {
        libm::asin(((self.drop(right) - self.drop(left)) / self.width).clamp(-0.5, 0.5))
    }

    /// Turn to a side that brings the incisors of a closed jaw there by `lateral` mm, without its sign.
    fn yaw(&self, lateral: f64) -> f64 {
        let reach = BONWILL * self.width;
        let (before, below) = (reach * libm::cos(BALKWILL), reach * libm::sin(BALKWILL));
        let sideways = |yaw: f64| {
            let (s, c) = (libm::sin(yaw), libm::cos(yaw));
            let [near, far] = self.aside(yaw);
            let roll = self.roll(near, far);
            before * s * libm::cos(roll) + below * libm::sin(roll) + 0.5 * self.width * (1.0 - c)
        };
        let (mut low, mut high) = (0.0, MAX_YAW);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if sideways(middle) < lateral {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// The motion of a pose.
    pub(crate) fn motion(&self, jaw: &JawPose) -> JawMotion<'_> {
        let ahead = self.glide(jaw.open_rad) + jaw.protrusion_mm;
        let turn = if jaw.lateral_mm == 0.0 {
            0.0
        } else {
            self.yaw(jaw.lateral_mm.abs())
        };
        let [near, far] = self.aside(turn).map(|way| ahead + way);
        let side = if jaw.lateral_mm < 0.0 { -1.0 } else { 1.0 };
        let (left, right) = if side > 0.0 { (near, far) } else { (far, near) };
        let inward = 0.5 * self.width * (1.0 - libm::cos(turn));
        let along = [
            side * inward,
            -0.5 * (self.drop(left) + self.drop(right)),
            0.5 * (near + far),
        ];
        let shift = [self.axis, self.up, self.forward]
            .into_iter()
            .zip(along)
            .fold(ZERO, |sum, (direction, way)| {
                add(sum, scale(direction, way))
            });
        JawMotion {
            mandible: self,
            open: jaw.open_rad,
            yaw: side * turn,
            roll: self.roll(left, right),
            shift,
        }
    }
}

impl JawMotion<'_> {
    /// The motion of what follows the jaw with this weight in `[0, 1]`: angles and shift times the weight.
    pub(crate) fn of(&self, weight: f64) -> Rigid {
        let jaw = self.mandible;
        let about = |axis: V3, angle: f64| Rigid::about(ZERO, axis, angle * weight, ZERO).rotation;
        let mut rotation = about(jaw.axis, self.open);
        for (axis, angle) in [(jaw.up, self.yaw), (jaw.forward, self.roll)] {
            if angle != 0.0 {
                rotation = crate::vector::product(&about(axis, angle), &rotation);
            }
        }
        Rigid::turning(jaw.center, rotation, scale(self.shift, weight))
    }

    /// The jaw's own motion: what lower teeth and tongue follow.
    pub(crate) fn isometry(&self) -> Isometry3 {
        let jaw = self.mandible;
        let about = |axis: V3, angle: f64| {
            let (s, c) = (libm::sin(0.5 * angle), libm::cos(0.5 * angle));
            nalgebra::Quaternion::new(c, s * axis[0], s * axis[1], s * axis[2])
        };
        let turn =
            about(jaw.forward, self.roll) * about(jaw.up, self.yaw) * about(jaw.axis, self.open);
        let t = self.of(1.0).translation;
        Isometry3::from_parts(
            Vector3::new(t[0], t[1], t[2]).into(),
            UnitQuaternion::from_quaternion(turn),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const LEFT: Point3 = Point3::new(52.0, -22.0, 4.0);
    const RIGHT: Point3 = Point3::new(-52.0, -22.0, 4.0);

    fn mandible() -> Mandible {
        Mandible::new(&LEFT, &RIGHT, 1.0).expect("apart")
    }

    fn way(jaw: &JawPose, p: &Point3) -> Vector3 {
        mandible().motion(jaw).isometry() * p - p
    }

    fn opened(deg: f64) -> JawPose {
        JawPose {
            open_rad: deg.to_radians(),
            ..JawPose::default()
        }
    }

    #[test]
    fn an_opening_jaw_turns_first_and_slides_along_the_eminence_then() {
        assert!(way(&opened(2.0), &LEFT).norm() < 0.15);
        let wide = way(&opened(33.0), &LEFT);
        assert!((wide.norm() - 11.9).abs() < 0.5, "{wide}");
        let slope = libm::atan2(-wide.y, wide.z).to_degrees();
        assert!(slope > 25.0 && slope < 40.0, "{slope}");
        let farther = way(&opened(39.0), &LEFT);
        assert_relative_eq!(farther.y, wide.y, epsilon = 1e-9);
        // A jaw that is clenched stays in its socket.
        assert!(way(&opened(-2.0), &LEFT).norm() < 1e-12);
    }

    #[test]
    fn the_condyles_path_has_no_corner() {
        let jaw = mandible();
        let at = |open: f64| {
            let t = jaw.motion(&JawPose {
                open_rad: open,
                ..JawPose::default()
            });
            t.shift
        };
        let slope = |open: f64| scale(sub(at(open + 1e-5), at(open - 1e-5)), 5e4);
        for step in -20..320 {
            let open = 0.00217 * f64::from(step);
            let kink = sub(slope(open + 1e-4), slope(open));
            assert!(dot(kink, kink).sqrt() < 0.1, "at {open}: {kink:?}");
        }
    }

    #[test]
    fn a_jaw_that_crosses_the_middle_has_no_corner() {
        let jaw = mandible();
        // Motion of a point of the chin and of both condyles.
        let at = |lateral: f64, p: V3| {
            let pose = JawPose {
                open_rad: 0.1,
                lateral_mm: lateral,
                ..JawPose::default()
            };
            jaw.motion(&pose).of(1.0).apply(p)
        };
        for p in [[0.0, -110.0, 80.0], [52.0, -22.0, 4.0], [-52.0, -22.0, 4.0]] {
            let slope = |x: f64| scale(sub(at(x + 1e-4, p), at(x - 1e-4, p)), 5e3);
            for step in -400..400 {
                let x = 0.005 * f64::from(step);
                let kink = sub(slope(x + 1e-3), slope(x));
                assert!(dot(kink, kink).sqrt() < 0.02, "at {x}: {kink:?}");
            }
        }
    }

    #[test]
    fn the_incisors_of_a_sideways_jaw_go_where_they_are_told_and_one_condyle_stays() {
        let reach = 104.0 * BONWILL;
        let incisors = Point3::new(
            0.0,
            -22.0 - reach * libm::sin(BALKWILL),
            4.0 + reach * libm::cos(BALKWILL),
        );
        for (lateral, still, other) in [(8.0, LEFT, RIGHT), (-8.0, RIGHT, LEFT)] {
            let jaw = JawPose {
                lateral_mm: lateral,
                ..JawPose::default()
            };
            assert_relative_eq!(way(&jaw, &incisors).x, lateral, epsilon = 1e-9);
            let stays = way(&jaw, &still);
            assert!(stays.norm() < 0.2, "{stays}");
            let slides = way(&jaw, &other);
            assert!(slides.z > 4.0 && slides.y < -2.0, "{slides}");
            assert!(slides.x * lateral > 0.0, "{slides}");
        }
    }

    #[test]
    fn a_protruded_jaw_follows_the_eminence_without_turning() {
        let jaw = JawPose {
            protrusion_mm: 5.0,
            ..JawPose::default()
        };
        let (a, b) = (way(&jaw, &LEFT), way(&jaw, &Point3::new(0.0, -110.0, 80.0)));
        assert_relative_eq!(a, b, epsilon = 1e-12);
        assert_relative_eq!(a.z, 5.0, epsilon = 1e-12);
        assert!(a.y < -3.0 && a.y > -4.5, "{a}");
        let back = JawPose {
            protrusion_mm: -2.0,
            ..JawPose::default()
        };
        assert_relative_eq!(
            way(&back, &LEFT),
            Vector3::new(0.0, 0.0, -2.0),
            epsilon = 1e-12
        );
    }

    #[test]
    fn the_isometry_agrees_with_the_motion_of_full_weight() {
        let jaw = JawPose {
            open_rad: 0.3,
            protrusion_mm: 4.0,
            lateral_mm: -3.0,
        };
        let jaws = mandible();
        let a = jaws.motion(&jaw).of(1.0).apply([5.0, -90.0, 70.0]);
        let b = jaws.motion(&jaw).isometry() * Point3::new(5.0, -90.0, 70.0);
        for k in 0..3 {
            assert_relative_eq!(a[k], b[k], epsilon = 1e-12);
        }
    }
}
