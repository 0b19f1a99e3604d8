//! From a scene and a camera to labels and images.
//!
//! [`trace_view`] shoots the primary rays and fills the labels; [`View::shade`] lights what they hit. One view serves any
//! number of light settings. Only pixels inside the projected bounds of the scene are traced.

mod further;
mod shade;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use facile_core::Plane;

pub use shade::{Rendering, ShadeTimes};

use further::Further;

use crate::TraceError;
use crate::bounces::{BounceParams, MIN_SHARE, ShadingPoints, Spacing};
use crate::camera::Camera;
use crate::edges::{self, Edges};
use crate::gbuffer::{CenterHits, GBuffer, Truth};
use crate::lanes::LANES;
use crate::layers;
use crate::lens::LensRays;
use crate::object::Object;
use crate::primary::{self, Method, PixelHits, find_samples, pixels_in_blocks};
use crate::raster::Wanted;
use crate::ray::{Hit, NO_OBJECT};
use crate::sampling::{Samples, sample_offsets};
use crate::scene::{Layer, Scene};
use crate::skips::Skips;
use crate::subsurface::{Skin, SkinPixel};

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Samples per pixel.
    pub samples: Samples,
    /// Labels to compute.
    pub truth: Truth,
    /// Mirror and refraction rays in a chain at most, 5 by default.
    pub max_depth: u32,
    /// Least share of a pixel's light for which a mirrored or refracted ray is followed, in `[0, 1]`; a thousandth by default,
    /// a tenth of a step of 8 bits at the brightness of skin.
    pub min_share: f32,
    /// Distance from a surface at which shadow and mirror rays start, mm; 0.05 by default. Larger hides contact
    /// shadows, smaller lets rounding darken surfaces.
    pub offset_mm: f32,
    /// Whether shadow rays start on the smooth surface that vertex normals stand for, so that shadows do not end in the
    /// staircase of the triangles; true by default. Otherwise they start above the triangle, along the shading normal, as in
    /// most ray tracers.
    pub smooth_shadows: bool,
    /// What is left out because it changes no pixel.
    pub skips: Skips,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            samples: Samples::default(),
            truth: Truth::default(),
            max_depth: 5,
            min_share: MIN_SHARE,
            offset_mm: 0.05,
            smooth_shadows: true,
            skips: Skips::default(),
        }
    }
}

/// Offset of a pixel's centre.
const CENTER: [f64; 2] = [0.5; 2];

/// Distance of the shaded rays of a pixel on a border, px.
const EDGE_SPACING: f32 = 0.25;

/// Surfaces that a view keeps for its next lights: 80 MB.
const MAX_KEPT_SURFACES: usize = 1 << 20;

/// What the primary rays of a camera found in a scene.
#[derive(Clone, Debug)]
pub struct View {
    camera: Camera,
    settings: RenderSettings,
    /// Pixels `[x0, y0, x1, y1)` that can show anything.
    bounds: Option<[usize; 4]>,
    /// What the pixels' centres see.
    centers: PixelHits,
    /// Pixels on the borders of objects, if sampling is adaptive.
    edges: Edges,
    /// The surfaces of centres and edges, and in their mirrors; none if there are more than [`MAX_KEPT_SURFACES`].
    points: Option<ShadingPoints>,
    /// Skin under which light spreads.
    skin: Option<Skin>,
    /// Pixels with a fixed number of samples above 1.
    dense_pixels: Vec<[u32; 2]>,
    dense_hits: Vec<Hit>,
    /// What samples see that some light asked for.
    further: Further,
    /// Labels.
    pub gbuffer: GBuffer,
    /// What primary rays and labels took, wall clock.
    pub primary_time: Duration,
}

/// Traces the primary rays of a view.
///
/// # Errors
/// [`TraceError::Setting`] for a sample count outside `1..=1024`, a negative offset or a share above 1.
pub fn trace_view(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
) -> Result<View, TraceError> {
    check(settings)?;
    check_lens(camera, settings.samples)?;
    let start = Instant::now();
    let everything = [0, 0, camera.width(), camera.height()];
    let bounds = if settings.skips.screen_bounds {
        camera.pixel_bounds(scene.bounds_in_world(Layer::All))
    } else {
        Some(everything)
    };
    let wanted = Wanted {
        behind_occluders: settings.truth.occlusion,
        further: settings.truth.layers.saturating_sub(1) as usize,
    };
    let (centers, behind) = bounds
        .map(|bounds| {
            let method = Method::for_view(scene, camera, bounds);
            primary::centers(scene, camera, bounds, method, wanted)
        })
        .unwrap_or_default();
    let mut edges = Edges::default();
    let is_adaptive = matches!(settings.samples, Samples::Adaptive(_));
    if is_adaptive || settings.truth.coverage {
        let pixels = border_pixels(scene, camera, bounds, &centers);
        edges = Edges::find(scene, camera, pixels);
    }
    let covering = if is_adaptive {
        edges.clone()
    } else {
        // The image does without them
        std::mem::take(&mut edges)
    };
    let points = (centers.hits.len() + edges.hits.len() <= MAX_KEPT_SURFACES).then(|| {
        let mut directions = center_directions(camera, &centers.pixels);
        let mut hits = Cow::Borrowed(&centers.hits[..]);
        let from = first_edge(&centers);
        if !edges.hits.is_empty() {
            hits.to_mut().resize(from, Hit::MISS);
            hits.to_mut().extend_from_slice(&edges.hits);
            directions.resize(from, [1.0; 3]);
            let of_edges = edges.places.iter().zip(&edges.hits);
            directions.extend(of_edges.map(|(px, hit)| camera.sight(*px, hit.is_some())));
        }
        let mut points = ShadingPoints::default();
        let pixel = camera.pixel_spacing();
        let mm = [pixel, pixel * EDGE_SPACING];
        points.find(
            scene,
            &hits,
            &directions,
            Spacing { from, mm },
            settings.bounces(),
        );
        points
    });
    let found = CenterHits {
        pixels: &centers.pixels,
        hits: &centers.hits,
        behind: &behind,
        surfaces: points.as_ref().map_or(&[], |p| &p.surfaces[..]),
        edges: &covering,
    };
    let gbuffer = GBuffer::new(scene, camera, settings.truth, &found);
    let mut view = View {
        camera: camera.clone(),
        settings: *settings,
        bounds,
        skin: Skin::new(camera, skin_pixels(scene, &centers)),
        centers,
        edges,
        points,
        dense_pixels: Vec::new(),
        dense_hits: Vec::new(),
        further: Further::default(),
        gbuffer,
        primary_time: Duration::ZERO,
    };
    if let Samples::Count(count @ 2..) = settings.samples {
        view.dense_pixels = view.bounds.map_or_else(Vec::new, pixels_in_blocks);
        let (offsets, hits) = (sample_offsets(count), &mut view.dense_hits);
        match LensRays::of(camera, count as usize) {
            Some(lens) => lens.trace(scene, &view.dense_pixels, &offsets, hits),
            None => find_samples(scene, camera, &view.dense_pixels, &offsets, hits),
        }
    }
    view.primary_time = start.elapsed();
    Ok(view)
}

impl RenderSettings {
    fn bounces(&self) -> BounceParams {
        BounceParams {
            max_depth: self.max_depth,
            min_share: self.min_share,
            offset: self.offset_mm,
            smooth_shadows: self.smooth_shadows,
        }
    }
}

/// Number of the first sample of an edge among the shading points: those of centres fill whole blocks.
fn first_edge(centers: &PixelHits) -> usize {
    centers.hits.len().next_multiple_of(LANES)
}

/// The pixels under whose surface light spreads.
fn skin_pixels(scene: &Scene, centers: &PixelHits) -> Vec<SkinPixel> {
    let mut skin = Vec::new();
    if !scene.objects().iter().any(Object::scatters) {
        return skin;
    }
    for (sample, (hit, at)) in centers.hits.iter().zip(&centers.pixels).enumerate() {
        let object = &scene.objects()[hit.object as usize];
        let scatter_mm = object.material(hit.triangle).scatter_mm;
        if scatter_mm.x > 0.0 || scatter_mm.y > 0.0 || scatter_mm.z > 0.0 {
            skin.push(SkinPixel {
                sample: sample as u32,
                at: *at,
                depth_z: hit.t,
                scatter_mm,
            });
        }
    }
    skin
}

fn check(settings: &RenderSettings) -> Result<(), TraceError> {
    if let Samples::Count(count) = settings.samples
        && !(1..=1024).contains(&count)
    {
        return Err(TraceError::Setting {
            name: "samples",
            expected: "1 to 1024, or \"adaptive\"",
            got: count.to_string(),
        });
    }
    if settings.truth.layers > layers::MAX_LAYERS {
        return Err(TraceError::Setting {
            name: "layers",
            expected: "at most 16",
            got: settings.truth.layers.to_string(),
        });
    }
    if !(0.0..=1.0).contains(&settings.min_share) {
        return Err(TraceError::Setting {
            name: "min_share",
            expected: "a share in 0..=1",
            got: settings.min_share.to_string(),
        });
    }
    if !(settings.offset_mm >= 0.0 && settings.offset_mm.is_finite()) {
        return Err(TraceError::Setting {
            name: "offset_mm",
            expected: "a finite distance of at least 0",
            got: settings.offset_mm.to_string(),
        });
    }
    Ok(())
}

fn check_lens(camera: &Camera, samples: Samples) -> Result<(), TraceError> {
    if camera.lens().is_none() || matches!(samples, Samples::Count(2..)) {
        return Ok(());
    }
    Err(TraceError::Setting {
        name: "samples",
        expected: "a number from 2 on with a lens",
        got: format!("{samples:?}"),
    })
}

/// A value for each pixel whose centre shows something.
fn plane_of<T: Clone>(
    camera: &Camera,
    centers: &PixelHits,
    empty: T,
    value: impl Fn(usize) -> T,
) -> Plane<T> {
    let mut plane = Plane::filled(camera.width(), camera.height(), empty);
    for (i, [x, y]) in centers.pixels.iter().enumerate() {
        plane[(*x as usize, *y as usize)] = value(i);
    }
    plane
}

/// Pixels next to another object or to nothing, including those just outside the bounds of what was hit, and pixels with
/// sharp highlights.
fn border_pixels(
    scene: &Scene,
    camera: &Camera,
    bounds: Option<[usize; 4]>,
    centers: &PixelHits,
) -> Vec<[u32; 2]> {
    // A number that is no object's makes its neighbours differ
    let glossy = NO_OBJECT - 1;
    let objects = plane_of(camera, centers, NO_OBJECT, |i| {
        let hit = &centers.hits[i];
        if edges::is_glossy(scene, hit) {
            glossy
        } else {
            hit.object
        }
    });
    let differs = |[x, y]: &[u32; 2]| {
        let (x, y) = (*x as usize, *y as usize);
        let own = objects[(x, y)];
        let columns = x.saturating_sub(1)..(x + 2).min(objects.width());
        let mut rows = y.saturating_sub(1)..(y + 2).min(objects.height());
        own == glossy || rows.any(|v| objects.row(v)[columns.clone()].iter().any(|o| *o != own))
    };
    let pixels = bounds.map_or_else(Vec::new, pixels_in_blocks);
    pixels.into_iter().filter(differs).collect()
}

impl View {
    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Memory that the view keeps for the next light since it was lit, bytes.
    pub fn bytes_for_lights(&self) -> usize {
        self.further.bytes()
    }

    /// Number of primary rays that were traced.
    pub fn primary_rays(&self) -> usize {
        self.centers.hits.len() + self.edges.rays + self.dense_hits.len()
    }

    fn plane_of<T: Clone>(&self, empty: T, value: impl Fn(usize) -> T) -> Plane<T> {
        plane_of(&self.camera, &self.centers, empty, value)
    }
}

/// Directions of the rays through pixels' centres, those of [`Camera::sight`].
fn center_directions(camera: &Camera, pixels: &[[u32; 2]]) -> Vec<[f32; 3]> {
    if camera.is_orthographic() {
        return vec![camera.sight(CENTER, true); pixels.len()];
    }
    let center = |i: usize| i as f64 + 0.5;
    let columns: Vec<[f64; 3]> = (0..camera.width())
        .map(|x| camera.direction_of_column(center(x)))
        .collect();
    let rows: Vec<[f64; 3]> = (0..camera.height())
        .map(|y| camera.direction_of_row(center(y)))
        .collect();
    let direction = |[x, y]: &[u32; 2]| {
        let (column, row) = (&columns[*x as usize], &rows[*y as usize]);
        [
            (column[0] + row[0]) as f32,
            (column[1] + row[1]) as f32,
            (column[2] + row[2]) as f32,
        ]
    };
    pixels.iter().map(direction).collect()
}
