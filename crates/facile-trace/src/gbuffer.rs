//! Exact labels of a view, from the rays through the pixels' centres.

use facile_core::Plane;

use crate::camera::Camera;
use crate::edges::Edges;
use crate::interaction::{Interaction, albedo};
use crate::lanes::LANES;
use crate::layers::FurtherSurface;
use crate::math::{Rgb, Vec3};
use crate::object::Object;
use crate::primary::Behind;
use crate::ray::Hit;
use crate::scene::Scene;
use crate::surface::{self, SurfaceBlock};

/// Which labels are wanted. What is not asked for is not computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "one switch per channel is the plain form"
)]
pub struct Truth {
    /// [`GBuffer::depth_z`].
    pub depth_z: bool,
    /// [`GBuffer::normal_in_world`].
    pub normal_in_world: bool,
    /// [`GBuffer::normal_in_camera`].
    pub normal_in_camera: bool,
    /// [`GBuffer::segment`].
    pub segment: bool,
    /// [`GBuffer::hit`].
    pub hit: bool,
    /// [`GBuffer::occlusion`], [`GBuffer::amodal_segment`] and [`GBuffer::amodal_depth_z`].
    pub occlusion: bool,
    /// [`GBuffer::albedo`].
    pub albedo: bool,
    /// [`crate::Rendering::shadow`].
    pub shadow: bool,
    /// [`GBuffer::coverage`].
    pub coverage: bool,
    /// Number of [`GBuffer::layers`], at most [`crate::layers::MAX_LAYERS`].
    pub layers: u32,
}

impl Truth {
    /// Everything.
    pub const ALL: Self = Self {
        depth_z: true,
        normal_in_world: true,
        normal_in_camera: true,
        segment: true,
        hit: true,
        occlusion: true,
        albedo: true,
        shadow: true,
        coverage: true,
        layers: 4,
    };
}

/// What the occlusion map says of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Occlusion {
    /// No face here, with or without occluders.
    NoFace = 0,
    /// The face, nothing in front of it.
    Visible = 1,
    /// The face would be here, an opaque occluder covers it.
    Covered = 2,
    /// The face, seen through a transparent occluder.
    Through = 3,
}

/// Label maps. Row 0 is the top of the image. The first surface of a pixel counts, transparent or not: a lens is labelled
/// as a lens, and the amodal maps say what lies behind it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GBuffer {
    /// Depth along the optical axis, mm; infinite where nothing is hit.
    pub depth_z: Option<Plane<f32>>,
    /// Unit shading normal, world axes; zero where nothing is hit.
    pub normal_in_world: Option<Plane<[f32; 3]>>,
    /// Unit shading normal, camera axes (`x` right, `y` down, `z` forward); zero where nothing is hit.
    pub normal_in_camera: Option<Plane<[f32; 3]>>,
    /// [`facile_core::Segment`] ids; 0 where nothing is hit.
    pub segment: Option<Plane<u8>>,
    /// Object, triangle and barycentric coordinates; [`Hit::MISS`] where nothing is hit.
    pub hit: Option<Plane<Hit>>,
    /// [`Occlusion`] codes.
    pub occlusion: Option<Plane<u8>>,
    /// Segment ids as if there were no occluders.
    pub amodal_segment: Option<Plane<u8>>,
    /// Depth as if there were no occluders, mm.
    pub amodal_depth_z: Option<Plane<f32>>,
    /// Diffuse linear RGB of the surface, before any light.
    pub albedo: Option<Plane<[f32; 3]>>,
    /// Share of each pixel that shows any surface, in `[0, 1]`, in steps of one over [`crate::edges::VISIBLE_SAMPLES`].
    pub coverage: Option<Plane<f32>>,
    /// The first surfaces of each pixel, nearest first; empty unless asked for.
    pub layers: Vec<LayerMaps>,
}

/// Labels of one surface of each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerMaps {
    /// [`facile_core::Segment`] ids; 0 where there is no such surface.
    pub segment: Plane<u8>,
    /// Depth along the optical axis, mm; infinite where there is no such surface.
    pub depth_z: Plane<f32>,
}

/// The samples at the pixels' centres: one entry per pixel that may show anything.
pub(crate) struct CenterHits<'a> {
    pub(crate) pixels: &'a [[u32; 2]],
    pub(crate) hits: &'a [Hit],
    pub(crate) behind: &'a Behind,
    /// The surfaces at the hits; empty if there are too many to keep.
    pub(crate) surfaces: &'a [SurfaceBlock],
    /// Pixels on borders; only if the coverage is asked for.
    pub(crate) edges: &'a Edges,
}

impl GBuffer {
    pub(crate) fn new(
        scene: &Scene,
        camera: &Camera,
        truth: Truth,
        centers: &CenterHits<'_>,
    ) -> Self {
        let (width, height) = (camera.width(), camera.height());
        let fill = Fill {
            width,
            height,
            pixels: centers.pixels,
        };
        let segment_id = |h: &Hit| scene.objects()[h.object as usize].segment_at(h).id();
        // Labels do not know of pores
        let is_smooth = !scene.objects().iter().any(Object::has_detail);
        let wants_normal = truth.normal_in_world || truth.normal_in_camera;
        let normal_in_world =
            fill.plane(wants_normal, centers.hits, [0.0; 3], |i, h| {
                match centers.surfaces.get(i / LANES).filter(|_| is_smooth) {
                    Some(block) => surface::lane(&block.normal, i % LANES).into(),
                    None => shading_normal(scene, camera, centers.pixels[i], h).into(),
                }
            });
        let rotation = camera.camera_from_world().cast::<f32>();
        let normal_in_camera = normal_in_world
            .as_ref()
            .filter(|_| truth.normal_in_camera)
            .map(|plane| plane.map(|n| (rotation * Vec3::from(*n)).into()));
        let depth_of = |_: usize, h: &Hit| h.t;
        let segment_of = |_: usize, h: &Hit| segment_id(h);
        let is_layered = truth.layers > 0;
        let needs_segment = truth.segment || truth.occlusion || is_layered;
        let needs_depth = truth.depth_z || truth.occlusion || is_layered;
        let segment = fill.plane(needs_segment, centers.hits, 0, segment_of);
        let depth_z = fill.plane(needs_depth, centers.hits, f32::INFINITY, depth_of);
        // Without occluders everything is as it is seen
        let (mut amodal_segment, mut amodal_depth_z) = (None, None);
        if truth.occlusion {
            (amodal_segment, amodal_depth_z) = match &centers.behind.occluders {
                None => (segment.clone(), depth_z.clone()),
                Some(hits) => (
                    fill.plane(true, hits, 0, segment_of),
                    fill.plane(true, hits, f32::INFINITY, depth_of),
                ),
            };
        }
        let faces = centers.behind.occluders.as_deref();
        let occlusion = fill.plane(truth.occlusion, faces.unwrap_or(centers.hits), 0, |i, _| {
            occlusion_at(scene, &centers.hits[i]) as u8
        });
        let mut layers = Vec::new();
        if let (true, Some(segment), Some(depth_z)) = (is_layered, &segment, &depth_z) {
            layers.push(LayerMaps {
                segment: segment.clone(),
                depth_z: depth_z.clone(),
            });
            layers.resize_with(truth.layers as usize, || LayerMaps {
                segment: Plane::filled(width, height, 0),
                depth_z: Plane::filled(width, height, f32::INFINITY),
            });
            for (maps, surfaces) in layers[1..].iter_mut().zip(&centers.behind.layers) {
                fill.layer(surfaces, maps);
            }
        }
        Self {
            depth_z: depth_z.filter(|_| truth.depth_z),
            normal_in_world: normal_in_world.filter(|_| truth.normal_in_world),
            normal_in_camera,
            segment: segment.filter(|_| truth.segment),
            hit: fill.plane(truth.hit, centers.hits, Hit::MISS, |_, h| *h),
            occlusion,
            amodal_segment,
            amodal_depth_z,
            albedo: fill.plane(truth.albedo, centers.hits, [0.0; 3], |i, h| {
                let color: Rgb = match centers.surfaces.get(i / LANES) {
                    Some(block) => surface::lane(&block.albedo, i % LANES),
                    None => albedo(&scene.objects()[h.object as usize], h),
                };
                color.into()
            }),
            coverage: fill
                .plane(truth.coverage, centers.hits, 0.0, |_, _| 1.0)
                .map(|mut plane| {
                    centers.edges.cover(&mut plane);
                    plane
                }),
            layers,
        }
    }
}

/// Writes one value per hit into a plane.
struct Fill<'a> {
    width: usize,
    height: usize,
    pixels: &'a [[u32; 2]],
}

impl Fill<'_> {
    fn plane<T: Clone>(
        &self,
        wanted: bool,
        hits: &[Hit],
        empty: T,
        value: impl Fn(usize, &Hit) -> T,
    ) -> Option<Plane<T>> {
        wanted.then(|| {
            let mut plane = Plane::filled(self.width, self.height, empty);
            for (i, (hit, [x, y])) in hits.iter().zip(self.pixels).enumerate() {
                if hit.is_some() {
                    plane[(*x as usize, *y as usize)] = value(i, hit);
                }
            }
            plane
        })
    }

    /// Writes the surfaces of a layer into its maps.
    fn layer(&self, surfaces: &[FurtherSurface], maps: &mut LayerMaps) {
        let segments = maps.segment.as_mut_slice();
        let depths = maps.depth_z.as_mut_slice();
        for surface in surfaces {
            let [x, y] = self.pixels[surface.pixel as usize];
            let at = y as usize * self.width + x as usize;
            segments[at] = surface.segment;
            depths[at] = surface.depth_z;
        }
    }
}

fn shading_normal(scene: &Scene, camera: &Camera, [x, y]: [u32; 2], hit: &Hit) -> Vec3 {
    let ray = camera.ray([f64::from(x) + 0.5, f64::from(y) + 0.5]);
    Interaction::new(scene, &ray, hit).normal
}

/// The occlusion code of a pixel behind which there is a face.
fn occlusion_at(scene: &Scene, front: &Hit) -> Occlusion {
    let Some(object) = scene.objects().get(front.object as usize) else {
        return Occlusion::Visible;
    };
    if !object.is_occluder() {
        Occlusion::Visible
    } else if object.material(front.triangle).is_transparent() {
        Occlusion::Through
    } else {
        Occlusion::Covered
    }
}
