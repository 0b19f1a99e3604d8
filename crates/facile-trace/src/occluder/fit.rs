//! Measures of a head that occluders are built to.

use facile_core::{Eye, Point3, ReferenceHead, Segment, Vector3};

use crate::TraceError;
use crate::head::HeadScene;
use crate::math::{vec3_from_point, vec3_from_vector};
use crate::object::Object;
use crate::ray::Ray;

/// How far outside the head probes start, mm.
const OUTSIDE: f64 = 600.0;

/// Where a head's features are, and where its surface is.
#[derive(Clone, Copy, Debug)]
pub struct FaceFit<'a> {
    skin: &'a Object,
    landmarks: [Point3; 68],
    /// Left and right eye.
    pub eyes: [Eye; 2],
    /// Where the top of the left and right ear meets the head, mm.
    pub ear_roots: [Point3; 2],
    /// Smallest and largest corner of a box around the left and right ear, mm.
    pub ears: [[Point3; 2]; 2],
}

impl<'a> FaceFit<'a> {
    /// Measures the head of a scene as it is now, expression included.
    ///
    /// # Errors
    /// [`TraceError::Core`] if the reference has no `ibug68` landmarks, [`TraceError::Setting`] if it has no ears.
    pub fn new(reference: &ReferenceHead, head: &'a HeadScene) -> Result<Self, TraceError> {
        let skin = &head.scene.objects()[HeadScene::SKIN];
        let geometry = skin.geometry();
        let positions: Vec<Point3> = geometry
            .positions()
            .iter()
            .map(|p| Point3::from(p.cast::<f64>()))
            .collect();
        let scheme = reference.scheme("ibug68")?;
        let points = scheme.positions(&positions, geometry.triangles());
        let got = points.len();
        let landmarks = points.try_into().map_err(|_| TraceError::SizeMismatch {
            what: "landmarks of ibug68",
            expected: 68,
            got,
        })?;
        let ear_root = |ear| ear_root(skin, &positions, ear);
        Ok(Self {
            skin,
            landmarks,
            eyes: *head.eyes(),
            ear_roots: [ear_root(Segment::LeftEar)?, ear_root(Segment::RightEar)?],
            ears: [Segment::LeftEar, Segment::RightEar].map(|ear| ear_box(skin, &positions, ear)),
        })
    }

    /// An ibug-68 landmark, counted from 0 as in files of that scheme.
    ///
    /// # Panics
    /// If `index` is 68 or more.
    pub fn landmark(&self, index: usize) -> Point3 {
        self.landmarks[index]
    }

    /// Half the distance between the eyes' centres, mm: the size that occluders scale with.
    pub fn half_eye_distance(&self) -> f64 {
        (self.eyes[0].center - self.eyes[1].center).norm() / 2.0
    }

    /// The first point of skin on the way from `from` along `direction`; ears do not count.
    pub fn probe(&self, from: Point3, direction: Vector3) -> Option<Point3> {
        let mut ray = Ray::new(vec3_from_point(&from), vec3_from_vector(&direction));
        loop {
            let hit = self.skin.closest_hit(&ray)?;
            let segment = self.skin.geometry().segment(hit.triangle);
            if matches!(segment, Segment::LeftEar | Segment::RightEar) {
                ray.t_min = hit.t;
                continue;
            }
            return Some(from + direction * f64::from(hit.t));
        }
    }

    /// `z` of the surface that one sees from the front at `(x, y)`, mm. `None` beside the head.
    pub fn front(&self, x: f64, y: f64) -> Option<f64> {
        self.probe(Point3::new(x, y, OUTSIDE), -Vector3::z())
            .map(|p| p.z)
    }

    /// `x` of the head's side at `(y, z)`, mm; `side` is 1 on the left and -1 on the right. `None` where only the far
    /// side of the head is met, such as through the root of an ear.
    pub fn side(&self, side: f64, y: f64, z: f64) -> Option<f64> {
        self.probe(Point3::new(side * OUTSIDE, y, z), Vector3::x() * -side)
            .map(|p| p.x)
            .filter(|x| x * side > 15.0)
    }

    /// Distance from `center`, inside the head, to the outer surface in the unit direction `out`, mm.
    pub fn reach(&self, center: Point3, out: Vector3) -> Option<f64> {
        self.probe(center + out * OUTSIDE, -out)
            .map(|p| (p - center).dot(&out))
            .filter(|r| *r > 0.0)
    }
}

/// A box around an ear.
fn ear_box(skin: &Object, positions: &[Point3], ear: Segment) -> [Point3; 2] {
    let geometry = skin.geometry();
    let triangles = geometry.triangles().iter().enumerate();
    let of_ear = triangles.filter(|(t, _)| geometry.segment(*t as u32) == ear);
    let vertices = of_ear.flat_map(|(_, triangle)| triangle.map(|v| positions[v as usize]));
    let start = [f64::INFINITY, f64::NEG_INFINITY].map(|v| Point3::new(v, v, v));
    vertices.fold(start, |[low, high], p| {
        [
            low.coords.inf(&p.coords).into(),
            high.coords.sup(&p.coords).into(),
        ]
    })
}

/// The highest vertex that an ear shares with something else.
fn ear_root(skin: &Object, positions: &[Point3], ear: Segment) -> Result<Point3, TraceError> {
    let geometry = skin.geometry();
    let mut of_ear = vec![false; positions.len()];
    let mut of_rest = vec![false; positions.len()];
    for (t, triangle) in geometry.triangles().iter().enumerate() {
        let list = if geometry.segment(t as u32) == ear {
            &mut of_ear
        } else {
            &mut of_rest
        };
        for &v in triangle {
            list[v as usize] = true;
        }
    }
    (0..positions.len())
        .filter(|&v| of_ear[v] && of_rest[v])
        .map(|v| positions[v])
        .max_by(|a, b| a.y.total_cmp(&b.y))
        .ok_or_else(|| TraceError::Setting {
            name: "reference head",
            expected: "a border between each ear and the head",
            got: format!("no {}", ear.name()),
        })
}
