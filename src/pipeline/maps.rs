//! The maps of a view: what each pixel's centre shows, as the recipe asks.

use std::collections::BTreeMap;

use facile_core::{Plane, Point3, ReferenceHead};
use facile_trace::{Camera, HeadScene, Hit, LayerMaps, Occlusion, View as TracedView};

use crate::recipe::ImageSettings;
use crate::recipe::file::Truth;
use crate::record::MapRecord;
use crate::write::map_name;

/// Finest depth of a 16-bit map, steps per mm; halved until the map reaches behind the head.
const FINEST_DEPTH_STEPS_PER_MM: f64 = 64.0;
/// Depth behind the head's origin that maps must reach, mm.
const DEPTH_BEHIND: f64 = 400.0;

/// The maps of a view. Row 0 is the top.
#[derive(Clone, Debug, Default)]
pub struct Maps {
    /// Ids of [`facile_core::Segment`]; 0 where nothing is.
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
    /// Ids of [`facile_core::Segment`] as if there were no occluders; 0 where nothing is.
    pub amodal: Option<Plane<u8>>,
    /// Ids of [`facile_core::Segment`] of the first surfaces of each pixel: a plane for each, the nearest surface's first,
    /// one below the other; 0 where there is none.
    pub layers: Option<Plane<u8>>,
    /// Their depths, mm, likewise; infinite where there is none.
    pub layer_depth_z: Option<Plane<f32>>,
    /// 255 times the share of each pixel that shows any surface.
    pub coverage: Option<Plane<u8>>,
    /// Number of the occluder's body that is seen, from 1: glasses have a frame and then lenses; 0 elsewhere.
    pub instances: Option<Plane<u8>>,
    /// `h`, mm, and `phi`, rad, of the reference head's point that corresponds to the skin; not a number elsewhere.
    pub reference: Option<Plane<[f32; 2]>>,
    /// Diffuse linear RGB of the surface before any light; 0 where nothing is.
    pub albedo: Option<Plane<[f32; 3]>>,
}

impl Maps {
    /// What the recipe asks for of a traced view.
    pub(super) fn of(
        image: &ImageSettings,
        head: &ReferenceHead,
        scene: &HeadScene,
        traced: &TracedView,
    ) -> Self {
        let (buffer, camera) = (&traced.gbuffer, traced.camera());
        let asked = |truth| image.wants(truth).then_some(());
        let occlusion = buffer.occlusion.as_ref();
        let seen = [Occlusion::Visible as u8, Occlusion::Through as u8];
        let visible = |code: &u8| if seen.contains(code) { 255 } else { 0 };
        let hits = |truth| asked(truth).and(buffer.hit.as_ref());
        Self {
            segments: asked(Truth::Segments).and(buffer.segment.clone()),
            depth_z: asked(Truth::Depth).and(buffer.depth_z.clone()),
            depth_steps_per_mm: depth_steps_per_mm(camera),
            normals: asked(Truth::Normals).and(buffer.normal_in_camera.clone()),
            visibility: asked(Truth::Visibility)
                .and(occlusion)
                .map(|plane| plane.map(visible)),
            occlusion: asked(Truth::Occlusion).and(occlusion).cloned(),
            amodal: asked(Truth::Amodal).and(buffer.amodal_segment.clone()),
            layers: asked(Truth::Layers).and_then(|()| stacked(&buffer.layers, |l| &l.segment)),
            layer_depth_z: asked(Truth::Layers)
                .and_then(|()| stacked(&buffer.layers, |l| &l.depth_z)),
            coverage: asked(Truth::Coverage)
                .and(buffer.coverage.as_ref())
                .map(|plane| plane.map(|share| (share * 255.0).round() as u8)),
            instances: hits(Truth::Instances).map(|plane| {
                let objects = scene.scene.objects();
                let is_body = |hit: &Hit| objects[hit.object as usize].is_occluder();
                let first = scene.parts() as u32;
                plane.map(|hit| match hit.ok().filter(is_body) {
                    Some(hit) => (hit.object - first + 1).min(255) as u8,
                    None => 0,
                })
            }),
            reference: hits(Truth::Reference)
                .map(|plane| plane.map(|hit| reference_coordinates(head, hit))),
            albedo: asked(Truth::Albedo).and(buffer.albedo.clone()),
        }
    }

    /// What records say of the maps; `first` is the sample whose number their files carry.
    pub(super) fn records(&self, first: u64) -> BTreeMap<&'static str, MapRecord> {
        let kinds = [
            ("segments", self.segments.is_some()),
            ("depth", self.depth_z.is_some()),
            ("normals", self.normals.is_some()),
            ("visibility", self.visibility.is_some()),
            ("occlusion", self.occlusion.is_some()),
            ("amodal", self.amodal.is_some()),
            ("layers", self.layers.is_some()),
            ("layer_depth", self.layer_depth_z.is_some()),
            ("coverage", self.coverage.is_some()),
            ("instances", self.instances.is_some()),
            ("reference", self.reference.is_some()),
            ("albedo", self.albedo.is_some()),
        ];
        let present = kinds.into_iter().filter(|(_, is_there)| *is_there);
        present
            .map(|(kind, _)| {
                let record = MapRecord {
                    file: map_name(kind, first),
                    steps_per_mm: (kind == "depth" || kind == "layer_depth")
                        .then_some(self.depth_steps_per_mm),
                };
                (kind, record)
            })
            .collect()
    }
}

/// `h`, mm, and `phi`, rad, of the point of the reference head that a hit on skin corresponds to; not numbers for other
/// hits.
fn reference_coordinates(head: &ReferenceHead, hit: &Hit) -> [f32; 2] {
    if hit.object as usize != HeadScene::SKIN {
        return [f32::NAN; 2];
    }
    let corners = head.mesh.triangles[hit.triangle as usize];
    let weights = hit.barycentric().map(f64::from);
    let corners = corners.iter().zip(weights);
    // Mixed in space: angles do not mix across the back of the head
    let point = corners.fold(Point3::origin(), |sum, (v, weight)| {
        sum + head.mesh.positions[*v as usize].coords * weight
    });
    [point.y as f32, libm::atan2(point.x, point.z) as f32]
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

/// The same for all views from one distance.
fn depth_steps_per_mm(camera: &Camera) -> f64 {
    let reach = camera.position().coords.norm() + DEPTH_BEHIND;
    let mut steps = FINEST_DEPTH_STEPS_PER_MM;
    while reach * steps > f64::from(u16::MAX) {
        steps /= 2.0;
    }
    steps
}
