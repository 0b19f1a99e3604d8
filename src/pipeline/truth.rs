//! From a traced view to ground truth: landmarks, boxes, maps, and the record of a sample.

use std::collections::BTreeMap;
use std::sync::Arc;

use facile_core::{Plane, Segment, Subject};
use facile_trace::{
    Camera, HeadScene, Layer, LayerMaps, Occlusion, Ray, Scene as TracedScene, View as TracedView,
};

use super::schemes::Placed;
use super::{Face, Person, Pipeline};
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
/// Finest depth of a 16-bit map, steps per mm; halved until the map reaches behind the head.
const FINEST_DEPTH_STEPS_PER_MM: f64 = 64.0;
/// Depth behind the head's origin that maps must reach, mm.
const DEPTH_BEHIND: f64 = 400.0;

/// The maps of a view. Row 0 is the top.
#[derive(Clone, Debug, Default)]
pub struct Maps {
    /// Ids of [`Segment`]; 0 where nothing is.
    pub segments: Option<Plane<u8>>,
    /// Depth along the optical axis, mm; infinite where nothing is.
    pub depth_z: Option<Plane<f32>>,
    /// Steps of the 16-bit depth in files for each mm, a power of two.
    pub depth_steps_per_mm: f64,
    /// Unit normals in the camera's frame; zero where nothing is.
    pub normals: Option<Plane<[f32; 3]>>,
    /// 255 where the head is seen, directly or through something transparent.
    pub visibility: Option<Plane<u8>>,
    /// 0 no head, 1 seen, 2 covered, 3 seen through something transparent.
    pub occlusion: Option<Plane<u8>>,
    /// Ids of [`Segment`] as if there were no occluders; 0 where nothing is.
    pub amodal: Option<Plane<u8>>,
    /// Ids of [`Segment`] of the first surfaces of each pixel: a plane for each, the nearest surface's first, one below the
    /// other; 0 where there is none.
    pub layers: Option<Plane<u8>>,
    /// Their depths, mm, likewise; infinite where there is none.
    pub layer_depth_z: Option<Plane<f32>>,
    /// 255 times the share of each pixel that shows any surface.
    pub coverage: Option<Plane<u8>>,
}

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
        let buffer = &traced.gbuffer;
        let asked = |truth| image.wants(truth).then_some(());
        let occlusion = buffer.occlusion.as_ref();
        let seen = [Occlusion::Visible as u8, Occlusion::Through as u8];
        let visible = |code: &u8| if seen.contains(code) { 255 } else { 0 };
        let maps = Maps {
            segments: asked(Truth::Segments).and(buffer.segment.clone()),
            depth_z: asked(Truth::Depth).and(buffer.depth_z.clone()),
            depth_steps_per_mm: depth_steps_per_mm(camera),
            normals: asked(Truth::Normals).and(buffer.normal_in_camera.clone()),
            visibility: occlusion
                .filter(|_| image.wants(Truth::Visibility))
                .map(|plane| plane.map(visible)),
            occlusion: occlusion.filter(|_| image.wants(Truth::Occlusion)).cloned(),
            amodal: asked(Truth::Amodal).and(buffer.amodal_segment.clone()),
            layers: asked(Truth::Layers).and_then(|()| stacked(&buffer.layers, |l| &l.segment)),
            layer_depth_z: asked(Truth::Layers)
                .and_then(|()| stacked(&buffer.layers, |l| &l.depth_z)),
            coverage: asked(Truth::Coverage)
                .and(buffer.coverage.as_ref())
                .map(|plane| plane.map(|share| (share * 255.0).round() as u8)),
        };
        ViewTruth {
            landmarks,
            face_box_px: self.face_box(face, camera),
            maps: Arc::new(maps),
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
    ) -> Record {
        let recipe = self.recipe();
        let lighting = &scene.lighting;
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
            },
            expression: self.expression_record(&scene.expression, face),
            light: LightRecord {
                name: lighting.name.clone(),
                sources: lighting.sources.clone(),
            },
            camera: CameraRecord::of(camera),
            head_pose: HeadPose::of(camera.camera_from_world()),
            occluder: Occluder::clone(&scene.occluder),
            face_box_px: truth.face_box_px,
            face_square_px: square(truth.face_box_px, 0.0),
            face_margin_px: square(truth.face_box_px, recipe.image.box_margin),
            landmarks: truth.landmarks.clone(),
            maps: map_records(first, &truth.maps),
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

/// The planes of all layers, one below the other; `None` without layers.
fn stacked<T: Clone>(
    layers: &[LayerMaps],
    plane: impl Fn(&LayerMaps) -> &Plane<T>,
) -> Option<Plane<T>> {
    let first = plane(layers.first()?);
    let values: Vec<T> = layers
        .iter()
        .flat_map(|layer| plane(layer).as_slice().iter().cloned())
        .collect();
    let rows = first.height() * layers.len();
    Some(Plane::from_vec(first.width(), rows, values))
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

/// For each landmark `visible`, or what hides it: `frame` (outside the image), `occluder`, `closed_mouth` (the other lip)
/// or `self` (the head).
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
        let Some(hit) = hit.ok() else {
            left.push(i);
            rays_left.push(ray);
            continue;
        };
        let own = placed[i].segment;
        let blocking = scene.objects()[hit.object as usize].segment_at(&hit);
        let is_other_lip = is_lip(own) && is_lip(blocking) && blocking != own;
        causes[i] = if is_other_lip { "closed_mouth" } else { "self" };
    }
    // A lens does not hide what is behind it, the frame does
    let mut shares = Vec::with_capacity(left.len());
    scene.transmittances(&rays_left, &mut shares);
    for (i, share) in left.into_iter().zip(shares) {
        let is_hidden = share.max() <= 0.0;
        causes[i] = if is_hidden { "occluder" } else { "visible" };
    }
    causes
}

/// The same for all views from one distance.
fn depth_steps_per_mm(camera: &Camera) -> f64 {
    let reach = camera.position().coords.norm() + DEPTH_BEHIND;
    let mut steps = FINEST_DEPTH_STEPS_PER_MM;
    while reach * steps > f64::from(u16::MAX) {
        steps /= 2.0;
    }
    steps
}

fn map_records(first: u64, maps: &Maps) -> BTreeMap<&'static str, MapRecord> {
    let kinds = [
        ("segments", maps.segments.is_some()),
        ("depth", maps.depth_z.is_some()),
        ("normals", maps.normals.is_some()),
        ("visibility", maps.visibility.is_some()),
        ("occlusion", maps.occlusion.is_some()),
        ("amodal", maps.amodal.is_some()),
        ("layers", maps.layers.is_some()),
        ("layer_depth", maps.layer_depth_z.is_some()),
        ("coverage", maps.coverage.is_some()),
    ];
    let present = kinds.into_iter().filter(|(_, is_there)| *is_there);
    present
        .map(|(kind, _)| {
            let record = MapRecord {
                file: map_name(kind, first),
                steps_per_mm: (kind == "depth" || kind == "layer_depth")
                    .then_some(maps.depth_steps_per_mm),
            };
            (kind, record)
        })
        .collect()
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
