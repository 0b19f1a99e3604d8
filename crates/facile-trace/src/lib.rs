//! A Whitted ray tracer for faces, with exact labels.
//!
//! A [`Scene`] holds [`Object`]s: meshes with [`Material`]s, poses and trees that refit when vertices move. A [`Camera`]
//! and the scene make a [`View`] ([`trace_view`]): the primary hits and the labels ([`GBuffer`]). Lights turn a view into
//! a [`Rendering`] ([`View::shade`]); one view serves any number of lights. Geometry is `f32` here, mm, `y` up. The
//! result depends on the input alone: not on threads, nor on the processor's vector width.
//!
//! Read [`view`] first, then [`material`], [`bvh`] and [`triangle`].

pub mod aperture;
pub mod backdrop;
pub mod bvh;
pub mod camera;
pub mod clothes;
pub mod cutout;
pub mod environment;
pub mod geometry;
pub mod hair;
pub mod head;
pub mod light;
pub mod material;
pub mod math;
pub mod object;
pub mod occluder;
pub mod png_file;
pub mod ray;
pub mod sampling;
pub mod scene;
pub mod scene_file;
pub mod triangle;
pub mod view;
pub mod visibility;

mod bends;
mod bounces;
mod cornea;
mod detail;
mod direct;
pub mod edges;
mod error;
mod footprint;
mod gbuffer;
pub mod instructions;
mod interaction;
mod lanes;
pub mod layers;
pub mod lens;
pub mod microfacets;
mod packet;
mod primary;
mod query;
mod raster;
#[cfg(test)]
mod scalar;
mod scratch;
pub mod sensor;
mod shadow_cells;
mod sight;
mod skips;
mod slopes;
mod srgb;
mod strands;
pub mod subsurface;
mod surface;
mod whitted;

pub use backdrop::Backdrop;
pub use camera::Camera;
pub use cutout::Cutout;
pub use environment::EnvironmentMap;
pub use error::TraceError;
pub use gbuffer::{GBuffer, LayerMaps, Occlusion, Truth};
pub use geometry::{Geometry, Normals};
pub use head::HeadScene;
pub use instructions::InstructionSet;
pub use lens::Lens;
pub use light::{Attach, LightSource};
pub use material::{Albedo, Material, Transmission};
pub use object::{Object, SegmentCap};
pub use ray::{Hit, Ray};
pub use sampling::Samples;
pub use scene::{Layer, Scene};
pub use scene_file::{
    BenchRow, CostRow, SceneFile, bench_scene_cost, bench_scene_file, render_scene_file,
};
pub use sensor::Sensor;
pub use skips::Skips;
pub use view::{RenderSettings, Rendering, View, trace_view};
pub use visibility::{Visibility, VisibilityParams, point_visibility};
