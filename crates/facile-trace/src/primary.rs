//! The primary pass: what each pixel or sample sees, drawn or by rays, whichever is faster.

use crate::camera::Camera;
use crate::layers::{self, FurtherSurface};
use crate::object::Object;
use crate::raster::{self, Wanted};
use crate::ray::{Hit, Ray};
use crate::scene::{Layer, Scene};
use crate::triangle::{RayShear, intersect};

/// Rays that are traced together: bounds the buffers.
const BATCH: usize = 4096;

/// Pixels that show something, and what, in the order of blocks, so that eight in a row are close together.
#[derive(Clone, Debug, Default)]
pub(crate) struct PixelHits {
    pub(crate) pixels: Vec<[u32; 2]>,
    pub(crate) hits: Vec<Hit>,
}

/// How to find out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Method {
    /// Triangles over pixels.
    Draw,
    /// Packets through the trees.
    Rays,
}

impl Method {
    /// The method for the pixels `[x0, y0, x1, y1)`.
    pub(crate) fn for_view(scene: &Scene, camera: &Camera, bounds: [usize; 4]) -> Self {
        let pixels = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]);
        if raster::suits(scene, camera, pixels) {
            Self::Draw
        } else {
            Self::Rays
        }
    }
}

/// What lies behind the surfaces that pixels show.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Behind {
    /// The hits without occluders; `None` if there is no occluder, or they are not asked for.
    pub(crate) occluders: Option<Vec<Hit>>,
    /// The surfaces behind the first, layer by layer.
    pub(crate) layers: Vec<Vec<FurtherSurface>>,
}

/// What the centres of the pixels `[x0, y0, x1, y1)` see, and what of the rest is wanted. The method does not change the
/// result.
pub(crate) fn centers(
    scene: &Scene,
    camera: &Camera,
    bounds: [usize; 4],
    method: Method,
    mut wanted: Wanted,
) -> (PixelHits, Behind) {
    let has_occluders = scene
        .objects()
        .iter()
        .any(|o| o.is_visible && o.is_occluder);
    wanted.behind_occluders &= has_occluders;
    let mut seen = PixelHits::default();
    let mut behind = Behind::default();
    match method {
        Method::Draw => {
            let [x0, y0, x1, y1] = bounds;
            let pixels = (x1 - x0) * (y1 - y0);
            seen.pixels.reserve(pixels);
            seen.hits.reserve(pixels);
            let mut without = Vec::new();
            behind.layers.resize(wanted.further, Vec::new());
            let is_plain = wanted == Wanted::default();
            raster::draw(scene, camera, bounds, [0.5; 2], wanted, |own| {
                let pixel = seen.pixels.len() as u32;
                seen.pixels.push(own.pixel);
                seen.hits.push(own.hit);
                if is_plain {
                    return;
                }
                if wanted.behind_occluders {
                    without.push(own.behind_occluders());
                }
                for (layer, (depth_z, [object, triangle])) in
                    behind.layers.iter_mut().zip(own.further())
                {
                    let object = &scene.objects()[object as usize];
                    layer.push(FurtherSurface {
                        pixel,
                        depth_z,
                        segment: segment_seen(object, triangle, camera, own.pixel),
                    });
                }
            });
            behind.occluders = wanted.behind_occluders.then_some(without);
        }
        Method::Rays => {
            let pixels = pixels_in_blocks(bounds);
            let mut hits = Vec::new();
            trace_samples(scene, camera, &pixels, &[[0.5; 2]], Layer::All, &mut hits);
            for (pixel, hit) in pixels.into_iter().zip(hits).filter(|(_, h)| h.is_some()) {
                seen.pixels.push(pixel);
                seen.hits.push(hit);
            }
            behind.layers = layers::by_rays(scene, camera, &seen, wanted.further);
            behind.occluders = wanted
                .behind_occluders
                .then(|| layers::without_occluders(scene, camera, &seen));
        }
    }
    (seen, behind)
}

/// Class of the surface where the ray through a pixel's centre meets a triangle.
fn segment_seen(object: &Object, triangle: u32, camera: &Camera, pixel: [u32; 2]) -> u8 {
    if object.caps.is_empty() {
        return object.geometry.segment(triangle).id();
    }
    let ray = object.ray_in_object(&camera.ray(sample_px(pixel, [0.5; 2])));
    let shear = RayShear::new(ray.direction);
    let corners = object.geometry.corners(triangle);
    let (t, u, v) = intersect(&ray, &shear, &corners).unwrap_or_default();
    let hit = Hit {
        t,
        object: 0,
        triangle,
        u,
        v,
    };
    object.segment_at(&hit).id()
}

/// The pixels of a rectangle `[x0, y0, x1, y1)` in blocks of 4 x 2.
pub(crate) fn pixels_in_blocks([x0, y0, x1, y1]: [usize; 4]) -> Vec<[u32; 2]> {
    let mut pixels = Vec::with_capacity((x1 - x0) * (y1 - y0));
    for y in (y0..y1).step_by(2) {
        for x in (x0..x1).step_by(4) {
            for dy in 0..2.min(y1 - y) {
                for dx in 0..4.min(x1 - x) {
                    pixels.push([(x + dx) as u32, (y + dy) as u32]);
                }
            }
        }
    }
    pixels
}

/// Image position at an offset in a pixel.
pub(crate) fn sample_px([x, y]: [u32; 2], [dx, dy]: [f64; 2]) -> [f64; 2] {
    [f64::from(x) + dx, f64::from(y) + dy]
}

/// What samples at the same offsets in each pixel see, drawn or by rays; the hits of a pixel are adjacent.
pub(crate) fn find_samples(
    scene: &Scene,
    camera: &Camera,
    pixels: &[[u32; 2]],
    offsets: &[[f64; 2]],
    hits: &mut Vec<Hit>,
) {
    let samples = pixels.len() * offsets.len();
    if raster::suits(scene, camera, samples) {
        hits.clear();
        hits.reserve(samples);
        raster::samples::draw(scene, camera, pixels, offsets, Layer::All, hits);
    } else {
        trace_samples(scene, camera, pixels, offsets, Layer::All, hits);
    }
}

/// Traces samples at the same offsets in each pixel; the hits of a pixel are adjacent.
pub(crate) fn trace_samples(
    scene: &Scene,
    camera: &Camera,
    pixels: &[[u32; 2]],
    offsets: &[[f64; 2]],
    layer: Layer,
    hits: &mut Vec<Hit>,
) {
    hits.clear();
    hits.reserve(pixels.len() * offsets.len());
    let mut rays: Vec<Ray> = Vec::with_capacity(BATCH);
    for chunk in pixels.chunks(BATCH.div_ceil(offsets.len())) {
        rays.clear();
        for &pixel in chunk {
            rays.extend(offsets.iter().map(|o| camera.ray(sample_px(pixel, *o))));
        }
        scene.closest_hits(&rays, layer, hits);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;
    use crate::{Normals, SegmentCap};
    use facile_core::rng::RandomStream;
    use facile_core::{Mesh, Point3, Segment, Vector3};

    /// Triangles about the origin.
    fn soup(count: usize, seed: u64) -> Mesh {
        let mut random = RandomStream::new(seed, 0);
        let mut mesh = Mesh::default();
        for t in 0..count as u32 {
            let size = random.uniform(2.0, 50.0);
            let center = Vector3::from_fn(|_, _| random.uniform(-90.0, 90.0));
            for _ in 0..3 {
                let corner = center + Vector3::from_fn(|_, _| random.uniform(-size, size));
                mesh.positions.push(Point3::from(corner));
            }
            mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
            mesh.segments.push(Segment::ALL[t as usize % 7]);
        }
        mesh
    }

    #[test]
    fn drawing_and_rays_find_the_same_surfaces_behind_others() {
        let mut scene = Scene::default();
        let shared = soup(150, 3);
        // Some surfaces coincide, within an object and between a face and what covers it
        let mut twice = shared.clone();
        twice.triangles.extend_from_slice(&shared.triangles[..40]);
        twice.segments.extend_from_slice(&shared.segments[40..80]);
        for (mesh, is_occluder) in [(&soup(100, 5), true), (&shared, true), (&twice, false)] {
            let mut object = Object::new(mesh, Normals::Flat, Material::default()).expect("valid");
            if is_occluder {
                object = object.as_occluder();
            } else {
                object = object.with_cap(SegmentCap {
                    center: crate::math::Vec3::zeros(),
                    axis: crate::math::Vec3::z(),
                    cos_angle: 0.4,
                    segment: Segment::ALL[8],
                });
            }
            scene.add(object);
        }
        let pose = crate::math::Pose::new(crate::math::Vec3::x(), crate::math::Vec3::y() * 0.3);
        scene.objects_mut()[0].set_pose(&pose).expect("finite");
        let eye = Point3::new(30.0, 20.0, 600.0);
        let camera = Camera::look_at(61, 47, eye, Point3::origin(), Vector3::y(), 0.3);
        let camera = camera.expect("valid");
        for further in [0, 1, 3, 15] {
            let wanted = Wanted {
                behind_occluders: true,
                further,
            };
            let bounds = [0, 0, 61, 47];
            let [drawn, traced] = [Method::Draw, Method::Rays]
                .map(|method| centers(&scene, &camera, bounds, method, wanted));
            let mut order: Vec<usize> = (0..drawn.0.pixels.len()).collect();
            order.sort_by_key(|i| drawn.0.pixels[*i]);
            let mut other: Vec<usize> = (0..traced.0.pixels.len()).collect();
            other.sort_by_key(|i| traced.0.pixels[*i]);
            assert_eq!(order.len(), other.len());
            let behind = |b: &Behind| b.occluders.clone().expect("asked for");
            let (a, b) = (behind(&drawn.1), behind(&traced.1));
            let layers = |b: &Behind, pixel: usize| -> Vec<FurtherSurface> {
                let of =
                    |l: &Vec<FurtherSurface>| l.iter().find(|s| s.pixel as usize == pixel).copied();
                b.layers.iter().filter_map(of).collect()
            };
            let mut found = 0;
            for (i, j) in order.into_iter().zip(other) {
                assert_eq!(drawn.0.pixels[i], traced.0.pixels[j]);
                assert_eq!(drawn.0.hits[i], traced.0.hits[j]);
                assert_eq!(a[i], b[j], "{i}");
                let (own, expected) = (layers(&drawn.1, i), layers(&traced.1, j));
                assert_eq!(own.len(), expected.len(), "{i}");
                for (own, expected) in own.iter().zip(&expected) {
                    assert_eq!(
                        (own.depth_z, own.segment),
                        (expected.depth_z, expected.segment)
                    );
                }
                found += own.len();
            }
            assert!(further == 0 || found > 1_000, "{found}");
        }
    }

    #[test]
    fn drawn_samples_are_those_of_rays() {
        let mut scene = Scene::default();
        let mut twice = soup(120, 7);
        twice.triangles.extend_from_within(..30);
        twice.segments.extend_from_within(..30);
        for mesh in [&soup(80, 8), &twice, &soup(60, 9)] {
            scene.add(Object::new(mesh, Normals::Flat, Material::default()).expect("valid"));
        }
        let pose = crate::math::Pose::new(crate::math::Vec3::x(), crate::math::Vec3::y() * 0.3);
        scene.objects_mut()[1].set_pose(&pose).expect("finite");
        let eye = Point3::new(300.0, 20.0, 300.0);
        let camera = Camera::look_at(61, 47, eye, Point3::origin(), Vector3::y(), 0.5);
        let camera = camera.expect("valid");
        // Some pixels twice, many not at all
        let mut pixels: Vec<[u32; 2]> = (0..61 * 47)
            .filter(|i| i % 7 < 3)
            .map(|i| [i % 61, i / 61])
            .collect();
        pixels.extend_from_within(..50);
        for count in [1, 4, 13, 64] {
            let offsets = crate::sampling::lattice_offsets(count);
            let (mut drawn, mut traced) = (Vec::new(), Vec::new());
            for layer in [Layer::All, Layer::BehindOccluders] {
                drawn.clear();
                raster::samples::draw(&scene, &camera, &pixels, &offsets, layer, &mut drawn);
                trace_samples(&scene, &camera, &pixels, &offsets, layer, &mut traced);
                assert!(drawn == traced, "{count}");
                let found = drawn.iter().filter(|h| h.is_some()).count();
                assert!(found > drawn.len() / 8, "{found}");
            }
        }
    }
}
