//! From a traced view to ground truth: landmarks, boxes, maps, and the record of a sample.

use std::collections::BTreeMap;
use std::sync::Arc;

use facile_core::{Segment, Subject};
use facile_trace::{Camera, HeadScene, Hit, Layer, Ray, Scene as TracedScene, View as TracedView};

use super::maps::Maps;
use super::schemes::Placed;
use super::{BackgroundRecord, Face, Person, Pipeline};
use crate::recipe::file::Truth;
use crate::recipe::{Expression, Occluder};
use crate::record::{
    CameraRecord, ExpressionRecord, HeadPose, JawRecord, LandmarkRecord, LightRecord, MapRecord,
    Record, SubjectRecord, rounded, rounded_point,
};
use crate::sampling::Scene;
use crate::write::{image_name, map_name};

/// A landmark is seen if nothing lies in front of it by more than this, mm: it sits on the surface itself, and the lips'
/// and lids' rims curve away under it.
const LANDMARK_TOLERANCE: f64 = 1.0;
/// The ground truth of a view, whatever the light.
#[derive(Clone, Debug)]
pub struct ViewTruth {
    /// Landmarks by scheme.
    pub landmarks: BTreeMap<String, LandmarkRecord>,
    /// Box around the face, px: left, top, right, bottom.
    pub face_box_px: [f64; 4],
    /// Maps.
    pub maps: Arc<Maps>,
}

/// The classes that make up the face.
pub(super) fn is_face(segment: Segment) -> bool {
    matches!(
        segment,
        Segment::Skin
            | Segment::LeftBrow
            | Segment::RightBrow
            | Segment::LeftEyelid
            | Segment::RightEyelid
            | Segment::Nose
            | Segment::UpperLip
            | Segment::LowerLip
    )
}

impl Pipeline {
    /// The truth of a view.
    pub fn truth(
        &self,
        subject: &Subject,
        scene: &HeadScene,
        face: &Face,
        traced: &TracedView,
    ) -> ViewTruth {
        let camera = traced.camera();
        let image = &self.recipe().image;
        let mut landmarks = BTreeMap::new();
        if image.wants(Truth::Landmarks) {
            for scheme in self.schemes() {
                let placed = scheme.place(self.reference(), subject, face, camera);
                let record = landmark_record(&placed, scene, camera);
                landmarks.insert(scheme.name.clone(), record);
            }
        }
        ViewTruth {
            landmarks,
            face_box_px: self.face_box(face, camera),
            maps: Arc::new(Maps::of(image, self.reference(), scene, traced)),
        }
    }

    /// The box around the face's vertices in the image, px.
    fn face_box(&self, face: &Face, camera: &Camera) -> [f64; 4] {
        let start = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        self.face_vertices()
            .iter()
            .filter_map(|&v| camera.project(&face.positions[v as usize]))
            .fold(start, |[x0, y0, x1, y1], ([x, y], _)| {
                [x0.min(x), y0.min(y), x1.max(x), y1.max(y)]
            })
            .map(rounded)
    }

    /// The record of a sample. `first` is the sample whose number the maps' files carry.
    #[expect(
        clippy::too_many_arguments,
        reason = "one argument for each stage that a record tells of"
    )]
    pub(super) fn record(
        &self,
        index: u64,
        first: u64,
        scene: &Scene<'_>,
        person: &Person,
        face: &Face,
        camera: &Camera,
        truth: &ViewTruth,
        background: BackgroundRecord,
    ) -> Record {
        let recipe = self.recipe();
        let lighting = &scene.lighting;
        let mut maps = truth.maps.records(first);
        if recipe.image.wants(Truth::Shadow) {
            let record = MapRecord {
                file: map_name("shadow", index),
                steps_per_mm: None,
            };
            maps.insert("shadow", record);
        }
        Record {
            index,
            image: image_name(index, recipe.image.encoding),
            size: [recipe.image.width, recipe.image.height],
            recipe: self.recipe_hash().to_owned(),
            subject: SubjectRecord {
                id: person.subject.id.clone(),
                kind: person.kind,
                attributes: person.subject.attributes.clone(),
                registration: person.registration.clone(),
                hair: person.hair.clone(),
                clothes: person.clothes,
            },
            expression: self.expression_record(&scene.expression, face),
            light: LightRecord {
                name: lighting.name.clone(),
                sources: lighting.sources.clone(),
            },
            camera: CameraRecord::of(camera),
            head_pose: HeadPose::of(camera.camera_from_world()),
            occluder: Occluder::clone(&scene.occluder),
            background,
            face_box_px: truth.face_box_px,
            face_square_px: square(truth.face_box_px, 0.0),
            face_margin_px: square(truth.face_box_px, recipe.image.box_margin),
            landmarks: truth.landmarks.clone(),
            maps,
        }
    }

    fn expression_record(&self, expression: &Expression, face: &Face) -> ExpressionRecord {
        let pose = &expression.pose;
        let mut contractions: BTreeMap<_, _> = self
            .muscles()
            .muscles()
            .iter()
            .map(|m| (m.name.clone(), facile_sim::Sides::default()))
            .collect();
        contractions.extend(pose.contractions.clone());
        ExpressionRecord {
            name: expression.name.clone(),
            intensity: expression.intensity,
            contractions,
            action_units: expression.action_units.clone(),
            jaw: JawRecord {
                open_deg: rounded(pose.jaw.open_rad.to_degrees()),
                protrusion_mm: pose.jaw.protrusion_mm,
                lateral_mm: pose.jaw.lateral_mm,
            },
            gaze_deg: [pose.gaze.yaw_rad, pose.gaze.pitch_rad].map(|v| rounded(v.to_degrees())),
            equilibrium: face.certificate.clone(),
        }
    }
}

/// Projects landmarks and finds what hides each.
fn landmark_record(placed: &[Placed], scene: &HeadScene, camera: &Camera) -> LandmarkRecord {
    let projected: Vec<Option<([f64; 2], f64)>> =
        placed.iter().map(|p| camera.project(&p.point)).collect();
    // At or behind the camera: nowhere in the image.
    let px = projected
        .iter()
        .map(|p| p.map_or([-1e6; 2], |(px, _)| px.map(rounded)));
    LandmarkRecord {
        px: px.collect(),
        mm: placed.iter().map(|p| rounded_point(&p.point)).collect(),
        visibility: hidden_by(placed, &projected, &scene.scene, camera),
    }
}

/// The smallest square around a box, with the same middle, larger by a share of its side on each side.
fn square([left, top, right, bottom]: [f64; 4], margin: f64) -> [f64; 4] {
    let half = (right - left).max(bottom - top) * (0.5 + margin);
    let (x, y) = (f64::midpoint(left, right), f64::midpoint(top, bottom));
    [x - half, y - half, x + half, y + half].map(rounded)
}

/// For each landmark `visible`, or what hides it: `frame` (outside the image), `occluder`, `closed_mouth` (the other lip),
/// `hair` or `self` (the head).
fn hidden_by(
    placed: &[Placed],
    projected: &[Option<([f64; 2], f64)>],
    scene: &TracedScene,
    camera: &Camera,
) -> Vec<&'static str> {
    let mut causes = vec!["frame"; placed.len()];
    // A ray to each landmark in the image, ending just in front of it
    let mut within = Vec::with_capacity(placed.len());
    let mut rays = Vec::with_capacity(placed.len());
    for (i, projected) in projected.iter().enumerate() {
        if let Some((px, depth)) = projected.filter(|(px, _)| camera.contains_px(*px)) {
            within.push(i);
            rays.push(Ray {
                t_max: (depth - LANDMARK_TOLERANCE) as f32,
                ..camera.ray(px)
            });
        }
    }
    // What the head hides, and by which of its parts
    let mut hits = Vec::with_capacity(rays.len());
    scene.closest_hits(&rays, Layer::BehindOccluders, &mut hits);
    let is_lip = |s| matches!(s, Segment::UpperLip | Segment::LowerLip);
    let mut left = Vec::with_capacity(rays.len());
    let mut rays_left = Vec::with_capacity(rays.len());
    for ((i, ray), hit) in within.into_iter().zip(rays).zip(hits) {
        let Some(hit) = behind_clear(scene, &ray, hit.ok()) else {
            left.push(i);
            rays_left.push(ray);
            continue;
        };
        let own = placed[i].segment;
        let blocking = scene.objects()[hit.object as usize].segment_at(&hit);
        let is_other_lip = is_lip(own) && is_lip(blocking) && blocking != own;
        causes[i] = match blocking {
            _ if is_other_lip => "closed_mouth",
            Segment::Hair => "hair",
            _ => "self",
        };
    }
    // A lens does not hide what is behind it, the frame does
    for (i, ray) in left.into_iter().zip(rays_left) {
        let is_hidden = scene.transmittance_of_occluders(&ray).max() <= 0.0;
        causes[i] = if is_hidden { "occluder" } else { "visible" };
    }
    causes
}

/// The first hit that is none of what one sees through: lashes and corneas.
fn behind_clear(scene: &TracedScene, ray: &Ray, mut hit: Option<Hit>) -> Option<Hit> {
    let mut rest = *ray;
    while let Some(found) = hit {
        let object = &scene.objects()[found.object as usize];
        if object.segment_at(&found) != Segment::Lashes && !object.is_transparent() {
            break;
        }
        rest.t_min = found.t;
        hit = scene.closest_hit(&rest, Layer::BehindOccluders);
    }
    hit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_keep_the_middle_of_their_box() {
        assert_eq!(
            square([10.0, 20.0, 30.0, 60.0], 0.0),
            [0.0, 20.0, 40.0, 60.0]
        );
        assert_eq!(
            square([10.0, 20.0, 30.0, 60.0], 0.25),
            [-10.0, 10.0, 50.0, 70.0]
        );
    }
}
