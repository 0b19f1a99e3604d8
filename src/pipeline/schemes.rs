//! Landmark schemes: those the reference head carries, and those that follow from them.
//!
//! | scheme | points |
//! |---|---|
//! | `five`, `ibug68` | carried by the reference head |
//! | `ibug51` | `ibug68` without the jaw |
//! | `wflw98` | the order of WFLW (W. Wu et al. 2018): contour, brows and lids by arc length along the curves through the points of `ibug68`, the lower edge of the brows from their class, pupils from the eyeballs |
//! | `mesh478` | the order of `MediaPipe`'s face mesh with irises: 468 points found on renders of the reference head (`assets/build/build_mesh478.py`), then the middle of each iris and four points on its edge |
//! | `dense` | every vertex of the reference mesh |
//!
//! `ibug68_contour` and `wflw98_contour` place the points of the jaw where annotators of photographs do: where a line
//! from the ear to the nose turns away from the camera, instead of at the projected jaw.

use std::collections::BTreeSet;

use facile_core::{
    LandmarkScheme, Mesh, Point3, ReferenceHead, Segment, Subject, SurfacePoint, UnitQuaternion,
    Vector3,
};
use facile_trace::Camera;
use facile_trace::head::{Gaze, IRIS_RADIUS_SHARE};

use super::Face;

/// What follows the name of a scheme whose jaw lies on the contour.
const CONTOUR: &str = "_contour";
/// Places of the first 468 points of `mesh478` on the reference head, mm, with the class of those on lips and lids.
const MESH478: &str = include_str!("../../assets/landmarks/mesh478.csv");
/// Points of the jaw in `ibug68`.
const JAW: usize = 17;
/// Places along each line from ear to nose, and how far towards the nose it goes, as a share of the angle.
const LINE_STEPS: usize = 16;
const LINE_END: f64 = 0.35;

/// A landmark of a scheme.
#[derive(Clone, Debug, PartialEq)]
enum Mark {
    /// A point fixed to the surface.
    Surface(SurfacePoint),
    /// Where the gaze of the left (0) or right (1) eye leaves the eyeball.
    Pupil(usize),
    /// On the edge of the iris of the left (0) or right (1) eye: quarters of a turn from the subject's left, over the top.
    Iris(usize, usize),
    /// Of these the one that lies furthest out in the image, on the left (1) or right (-1) side of the face.
    Contour(Vec<SurfacePoint>, f64),
}

/// A named, ordered list of landmarks.
#[derive(Clone, Debug, PartialEq)]
pub struct Scheme {
    /// Its name in recipes and records.
    pub name: String,
    marks: Vec<Mark>,
}

/// A landmark on a face.
pub(super) struct Placed {
    /// Place, mm, head frame.
    pub(super) point: Point3,
    /// Class of the surface it lies on.
    pub(super) segment: Segment,
}

impl Scheme {
    /// Names of all schemes.
    pub fn names() -> Vec<String> {
        let carried = ReferenceHead::embedded()
            .landmarks
            .iter()
            .map(|s| s.name.clone());
        let derived = [
            "ibug51",
            "ibug68_contour",
            "wflw98",
            "wflw98_contour",
            "mesh478",
            "dense",
        ];
        carried.chain(derived.map(str::to_owned)).collect()
    }

    /// The scheme of a name that [`Self::names`] has; `None` for any other.
    pub fn named(name: &str) -> Option<Self> {
        let reference = ReferenceHead::embedded();
        let base = name.strip_suffix(CONTOUR).unwrap_or(name);
        let ibug68 = reference.scheme("ibug68").ok()?;
        let surface = |scheme: &LandmarkScheme, from: usize| {
            scheme.points[from..]
                .iter()
                .map(|p| Mark::Surface(*p))
                .collect::<Vec<_>>()
        };
        let mut marks = match base {
            "ibug51" => surface(ibug68, JAW),
            "wflw98" => wflw98(reference, ibug68)?,
            "mesh478" => mesh478(&reference.mesh)?,
            "dense" => dense(&reference.mesh),
            _ => surface(reference.scheme(base).ok()?, 0),
        };
        if name != base {
            let jaw = match base {
                "ibug68" => JAW,
                "wflw98" => 2 * JAW - 1,
                _ => return None,
            };
            for (i, mark) in marks[..jaw].iter_mut().enumerate() {
                // The chin's point is on the contour from wherever it is seen.
                if let Mark::Surface(point) = mark
                    && i != jaw / 2
                {
                    *mark = contour(&reference.mesh, point)?;
                }
            }
        }
        let name = name.to_owned();
        Some(Self { name, marks })
    }

    /// Number of landmarks.
    pub fn len(&self) -> usize {
        self.marks.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.marks.is_empty()
    }

    /// The landmarks of a face as a camera sees it.
    pub(super) fn place(
        &self,
        reference: &ReferenceHead,
        subject: &Subject,
        face: &Face,
        camera: &Camera,
    ) -> Vec<Placed> {
        let mesh = &reference.mesh;
        let on_surface = |point: &SurfacePoint| Placed {
            point: point.position(&face.positions, &mesh.triangles),
            segment: mesh.segments[point.triangle as usize],
        };
        let right = rightwards(camera);
        let place = |mark: &Mark| match mark {
            Mark::Surface(point) => on_surface(point),
            Mark::Pupil(side) => Placed {
                point: on_eyeball(subject, *side, &face.gaze[*side], [0.0; 2]),
                segment: [Segment::LeftEye, Segment::RightEye][*side],
            },
            Mark::Iris(side, quarter) => {
                let edge = f64::from(IRIS_RADIUS_SHARE);
                let offset = [[edge, 0.0], [0.0, edge], [-edge, 0.0], [0.0, -edge]];
                Placed {
                    point: on_eyeball(subject, *side, &face.gaze[*side], offset[*quarter]),
                    segment: [Segment::LeftEye, Segment::RightEye][*side],
                }
            }
            Mark::Contour(line, side) => {
                // The subject's left is to the right in a frontal image.
                let outwards = |point: &SurfacePoint| {
                    let p = point.position(&face.positions, &mesh.triangles);
                    let projected = camera.project(&p);
                    let depth = projected.map_or(f64::MAX, |(_, z)| camera.scale_depth(z));
                    let away = (p - camera.position()).dot(&right) / depth;
                    away * side
                };
                let mut best = (&line[0], outwards(&line[0]));
                for point in &line[1..] {
                    let out = outwards(point);
                    // A hair's breadth further does not count: lines run along the contour for a while.
                    if out > best.1 + 1e-9 {
                        best = (point, out);
                    }
                }
                on_surface(best.0)
            }
        };
        self.marks.iter().map(place).collect()
    }
}

/// To the right in the image of an upright head, in the head's frame: as if the camera were not rolled.
fn rightwards(camera: &Camera) -> Vector3 {
    let rotation = camera.camera_from_world();
    let backward = -rotation.row(2).transpose();
    let right = Vector3::y().cross(&backward).try_normalize(1e-9);
    // From straight above or below nothing is upright
    right.unwrap_or_else(|| rotation.row(0).transpose())
}

/// A point of an eyeball at `offset` from where the gaze leaves it, to the subject's left and up as the eye sees them, in
/// radii.
fn on_eyeball(subject: &Subject, side: usize, gaze: &Gaze, [left, up]: [f64; 2]) -> Point3 {
    let eye = &subject.eyes[side];
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), gaze.yaw)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -gaze.pitch);
    let forward = (1.0 - left * left - up * up).sqrt();
    eye.center + turn * Vector3::new(left, up, forward) * eye.radius
}

/// The points of the face mesh, see the [module](self).
fn mesh478(mesh: &Mesh) -> Option<Vec<Mark>> {
    let on_skin = |s: Segment| !matches!(s, Segment::InnerMouth | Segment::EyeSocket);
    let point = |line: &str| {
        let mut cells = line.split(',');
        let mut number = || cells.next()?.parse().ok();
        let target = Point3::new(number()?, number()?, number()?);
        let class = cells.next().and_then(|name| Segment::from_name(name).ok());
        let found = nearest(mesh, &target, |s| class.map_or(on_skin(s), |c| s == c))?;
        Some(Mark::Surface(found))
    };
    let mut marks: Vec<Mark> = MESH478.lines().skip(1).map(point).collect::<Option<_>>()?;
    for side in [1, 0] {
        marks.push(Mark::Pupil(side));
        marks.extend((0..4).map(|quarter| Mark::Iris(side, quarter)));
    }
    Some(marks)
}

/// One mark for each vertex, as a corner of the first triangle that has it.
fn dense(mesh: &Mesh) -> Vec<Mark> {
    let mut corner = vec![None; mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for (k, v) in triangle.iter().enumerate() {
            corner[*v as usize].get_or_insert((t, k));
        }
    }
    let mark = |(t, k): (usize, usize)| {
        let mut barycentric = [0.0; 3];
        barycentric[k] = 1.0;
        Mark::Surface(SurfacePoint {
            triangle: t as u32,
            barycentric,
        })
    };
    corner.into_iter().flatten().map(mark).collect()
}

/// The line from a point of the jaw towards the nose, at the same height.
fn contour(mesh: &Mesh, from: &SurfacePoint) -> Option<Mark> {
    let start = from.position(&mesh.positions, &mesh.triangles);
    let phi = libm::atan2(start.x, start.z);
    let mut line = vec![*from];
    for step in 1..=LINE_STEPS {
        let share = 1.0 - (1.0 - LINE_END) * step as f64 / LINE_STEPS as f64;
        let (sin, cos) = libm::sincos(phi * share);
        // From far outside straight to the axis: the outermost surface there is the nearest one.
        let reach = start.x.hypot(start.z);
        let guess = Point3::new(sin * reach, start.y, cos * reach);
        line.push(nearest(mesh, &guess, |s| {
            matches!(
                s,
                Segment::Skin | Segment::Nose | Segment::UpperLip | Segment::LowerLip
            )
        })?);
    }
    Some(Mark::Contour(line, start.x.signum()))
}

/// The 98 points of WFLW, see the [module](self).
fn wflw98(reference: &ReferenceHead, ibug68: &LandmarkScheme) -> Option<Vec<Mark>> {
    let mesh = &reference.mesh;
    let place = |i: usize| ibug68.points[i].position(&mesh.positions, &mesh.triangles);
    let segment = |i: usize| mesh.segments[ibug68.points[i].triangle as usize];
    let carried = |i: usize| Mark::Surface(ibug68.points[i]);
    // The point at a share of the length of the curve through some points, on the classes these lie on.
    let between = |curve: &[usize], share: f64| {
        let points: Vec<Point3> = curve.iter().map(|i| place(*i)).collect();
        let on: Vec<Segment> = curve.iter().map(|i| segment(*i)).collect();
        let target = along(&points, share);
        nearest(mesh, &target, |s| on.contains(&s)).map(Mark::Surface)
    };
    let mut marks = Vec::with_capacity(98);
    for i in 0..JAW - 1 {
        marks.push(carried(i));
        marks.push(between(&[i, i + 1], 0.5)?);
    }
    marks.push(carried(JAW - 1));
    // Brows: five points of the upper edge, then four of the lower one, back from the inner end on the subject's right
    // and from the outer one but one on the left.
    let lower = |i: usize, brow: Segment| lower_edge(mesh, &place(i), brow);
    marks.extend((17..22).map(carried));
    for i in (18..22).rev() {
        marks.push(lower(i, Segment::RightBrow)?);
    }
    marks.extend((22..27).map(carried));
    for i in (22..26).rev() {
        marks.push(lower(i, Segment::LeftBrow)?);
    }
    marks.extend((27..36).map(carried));
    // Eyes: corner, three points of the upper lid, corner, three of the lower one.
    for first in [36, 42] {
        let [a, b, c, d, e, f] = std::array::from_fn(|k| first + k);
        marks.push(carried(a));
        for quarter in 1..4 {
            marks.push(between(&[a, b, c, d], 0.25 * f64::from(quarter))?);
        }
        marks.push(carried(d));
        for quarter in 1..4 {
            marks.push(between(&[d, e, f, a], 0.25 * f64::from(quarter))?);
        }
    }
    marks.extend((48..68).map(carried));
    marks.extend([Mark::Pupil(1), Mark::Pupil(0)]);
    Some(marks)
}

/// The point of the mesh nearest to `target` on classes that pass `keep`. Looks at triangles near by first: a scheme asks
/// hundreds of times.
fn nearest(mesh: &Mesh, target: &Point3, keep: impl Fn(Segment) -> bool) -> Option<SurfacePoint> {
    /// Farther away than any place that is looked for lies from the surface, and than a triangle is long, mm.
    const NEAR: f64 = 30.0;
    let mut near = Mesh::default();
    let mut numbers = Vec::new();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let first = &mesh.positions[triangle[0] as usize];
        if (first - target).norm_squared() < NEAR * NEAR && keep(mesh.segments[t]) {
            let start = near.positions.len() as u32;
            near.positions.extend(mesh.corners(t));
            near.triangles.push([start, start + 1, start + 2]);
            numbers.push(t as u32);
        }
    }
    match SurfacePoint::nearest(&near, target, |_| true) {
        Some(found) => Some(SurfacePoint {
            triangle: numbers[found.triangle as usize],
            ..found
        }),
        None => SurfacePoint::nearest(mesh, target, keep),
    }
}

/// The point at a share of a polyline's length.
fn along(points: &[Point3], share: f64) -> Point3 {
    let lengths: Vec<f64> = points.windows(2).map(|p| (p[1] - p[0]).norm()).collect();
    let mut left = share * lengths.iter().sum::<f64>();
    for (pair, length) in points.windows(2).zip(&lengths) {
        if left <= *length {
            return pair[0] + (pair[1] - pair[0]) * (left / length.max(f64::MIN_POSITIVE));
        }
        left -= length;
    }
    points[points.len() - 1]
}

/// The point of a brow's lower edge below a point of its upper one.
fn lower_edge(mesh: &Mesh, upper: &Point3, brow: Segment) -> Option<Mark> {
    /// Half of the width in which the edge is looked for, mm.
    const WIDTH: f64 = 4.0;
    let vertices: BTreeSet<u32> = mesh
        .triangles
        .iter()
        .zip(&mesh.segments)
        .filter(|(_, segment)| **segment == brow)
        .flat_map(|(triangle, _)| *triangle)
        .collect();
    let below = vertices
        .iter()
        .map(|v| mesh.positions[*v as usize])
        .filter(|p| (p.x - upper.x).abs() < WIDTH)
        .min_by(|a, b| a.y.total_cmp(&b.y))?;
    let target = Point3::new(upper.x, below.y.min(upper.y), below.z);
    let on = |s: Segment| s == brow || s == Segment::Skin;
    nearest(mesh, &target, on).map(Mark::Surface)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest(scheme: &Scheme) -> Vec<Point3> {
        let mesh = &ReferenceHead::embedded().mesh;
        let place = |mark: &Mark| match mark {
            Mark::Surface(point) => point.position(&mesh.positions, &mesh.triangles),
            Mark::Contour(line, _) => line[0].position(&mesh.positions, &mesh.triangles),
            Mark::Pupil(_) | Mark::Iris(..) => Point3::origin(),
        };
        scheme.marks.iter().map(place).collect()
    }

    #[test]
    fn every_scheme_has_its_number_of_points() {
        let vertices = ReferenceHead::embedded().mesh.positions.len();
        let expected = [
            ("ibug68", 68),
            ("five", 5),
            ("ibug51", 51),
            ("ibug68_contour", 68),
            ("wflw98", 98),
            ("wflw98_contour", 98),
            ("mesh478", 478),
            ("dense", vertices),
        ];
        for (name, number) in expected {
            assert!(Scheme::names().contains(&name.to_owned()), "{name}");
            assert_eq!(Scheme::named(name).map(|s| s.len()), Some(number), "{name}");
        }
        for name in ["ibug", "five_contour", "dense_contour", ""] {
            assert_eq!(Scheme::named(name), None, "{name}");
        }
        assert_eq!(Scheme::names().len(), expected.len());
    }

    #[test]
    fn rightwards_is_level_and_across_the_view_however_the_camera_is_rolled() {
        let (position, target) = (Point3::new(400.0, 250.0, 700.0), Point3::origin());
        for up in [Vector3::y(), Vector3::new(0.5, 1.0, 0.1)] {
            let camera = Camera::look_at(8, 8, position, target, up, 0.5).expect("possible");
            let right = rightwards(&camera);
            assert!(right.y.abs() < 1e-12 && right.x > 0.5, "{right}");
            assert!(right.dot(&(target - position)).abs() < 1e-9, "{right}");
            assert!((right.norm() - 1.0).abs() < 1e-12, "{right}");
        }
    }

    #[test]
    fn wflw_points_are_in_order_and_mirror_each_other() {
        let points = rest(&Scheme::named("wflw98").expect("there"));
        // The contour goes from the subject's right ear over the chin to the left one.
        assert!(points[..33].windows(2).all(|p| p[0].x < p[1].x + 2.0));
        assert!(points[16].x.abs() < 1.0 && points[16].y < points[0].y - 80.0);
        // Lower edges of the brows lie below the upper ones, above the eyes.
        for (upper, lower) in [
            (37, 38),
            (36, 39),
            (35, 40),
            (34, 41),
            (45, 47),
            (44, 48),
            (43, 49),
            (42, 50),
        ] {
            let (u, l) = (&points[upper], &points[lower]);
            assert!(
                (u.x - l.x).abs() < 6.0 && u.y > l.y && l.y > 0.0,
                "{upper} {u} {lower} {l}"
            );
        }
        // Lids: the upper three above the lower three.
        for eye in [60, 68] {
            for k in 1..4 {
                let (up, low) = (&points[eye + k], &points[eye + 8 - k]);
                assert!(up.y > low.y && (up.x - low.x).abs() < 4.0, "{up} {low}");
            }
        }
        // The head is symmetric: pairs that mirror each other.
        let pairs = (0..16).map(|i| (i, 32 - i)).chain([
            (60, 72),
            (62, 70),
            (64, 68),
            (66, 74),
            (33, 46),
            (37, 42),
            (76, 82),
            (88, 92),
        ]);
        for (a, b) in pairs {
            let (p, q) = (&points[a], &points[b]);
            let mirrored = Point3::new(-q.x, q.y, q.z);
            assert!((p - mirrored).norm() < 2.0, "{a} {p} {b} {q}");
        }
    }

    #[test]
    fn the_face_mesh_lies_where_ibug_has_the_same_points() {
        let (mesh, ibug) = (
            rest(&Scheme::named("mesh478").expect("there")),
            rest(&Scheme::named("ibug68").expect("there")),
        );
        // Chin, tip of the nose, corners of eyes and mouth, middle of the lips
        let pairs = [
            (152, 8),
            (4, 30),
            (33, 36),
            (133, 39),
            (362, 42),
            (263, 45),
            (61, 48),
            (291, 54),
            (0, 51),
            (17, 57),
            (13, 62),
        ];
        for (a, b) in pairs {
            let apart = (mesh[a] - ibug[b]).norm();
            assert!(apart < 7.0, "{a} and {b}: {apart} mm");
        }
        // Lips: the inner edge of the upper one lies on it, above that of the lower one.
        assert!(mesh[13].y > mesh[14].y && mesh[82].y > mesh[87].y);
        // The head is symmetric: so are points that mirror each other.
        for (a, b) in [
            (33, 263),
            (61, 291),
            (234, 454),
            (205, 425),
            (107, 336),
            (159, 386),
        ] {
            let mirrored = Point3::new(-mesh[b].x, mesh[b].y, mesh[b].z);
            assert!(
                (mesh[a] - mirrored).norm() < 0.5,
                "{a} {} {b} {}",
                mesh[a],
                mesh[b]
            );
        }
    }

    #[test]
    fn irises_turn_with_the_eyes() {
        let reference = ReferenceHead::embedded();
        let subject = facile_sim::mean_subject(reference);
        let gaze = Gaze {
            yaw: 0.3,
            pitch: -0.2,
        };
        let at = |offset| on_eyeball(&subject, 0, &gaze, offset);
        let eye = &subject.eyes[0];
        let edge = f64::from(IRIS_RADIUS_SHARE);
        let sight = (at([0.0; 2]) - eye.center) / eye.radius;
        let expected = Vector3::new(
            libm::cos(-0.2) * libm::sin(0.3),
            libm::sin(-0.2),
            libm::cos(-0.2) * libm::cos(0.3),
        );
        assert!((sight - expected).norm() < 1e-12);
        for offset in [[edge, 0.0], [0.0, edge], [-edge, 0.0], [0.0, -edge]] {
            let rim = (at(offset) - eye.center) / eye.radius;
            assert!((rim.norm() - 1.0).abs() < 1e-12);
            assert!((rim.dot(&sight) - (1.0 - edge * edge).sqrt()).abs() < 1e-12);
        }
        assert!(at([0.0, edge]).y > at([0.0, -edge]).y && at([edge, 0.0]).x > at([-edge, 0.0]).x);
    }

    #[test]
    fn lines_of_the_contour_run_from_the_jaw_towards_the_nose() {
        let mesh = &ReferenceHead::embedded().mesh;
        let scheme = Scheme::named("ibug68_contour").expect("there");
        for (i, mark) in scheme.marks[..JAW].iter().enumerate() {
            let Mark::Contour(line, side) = mark else {
                assert_eq!(i, 8, "the chin alone stays");
                continue;
            };
            assert_eq!(*side, if i < 8 { -1.0 } else { 1.0 });
            let points: Vec<Point3> = line
                .iter()
                .map(|p| p.position(&mesh.positions, &mesh.triangles))
                .collect();
            let (first, last) = (points[0], points[LINE_STEPS]);
            assert!(
                last.x.abs() < first.x.abs() && (last.y - first.y).abs() < 12.0,
                "{i} {first} {last}"
            );
        }
    }
}
