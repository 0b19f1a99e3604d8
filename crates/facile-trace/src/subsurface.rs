//! Light that spreads under the skin: shadow borders soften and redden.
//!
//! What the diffuse layer of a pixel gets is mixed with what its neighbours get, over a distance on the surface of its own
//! for each channel ([`crate::Material::scatter_mm`]), in two passes along the image's rows and columns. The weights are
//! positive and sum to 1, so no pixel gets more than the brightest around it. A neighbour's distance counts in depth too,
//! which keeps the light of the nose off the cheek behind it. The kernel is Tukey's biweight of the wanted variance: a
//! Gaussian to the eye, without its exponential. Source: Jimenez, Sundstedt, Gutierrez, Screen-Space Perceptual Rendering
//! of Human Skin, ACM TAP 6(4), 2009.
//!
//! Works on pixel centres: what further samples of a pixel add is kept, and the difference that spreading makes at its
//! centre is added to their mean.

use std::cell::Cell;

use crate::camera::Camera;
use crate::direct::ColorBlock;
use crate::lanes::{Kernel, LANES, Lanes, run};
use crate::math::Rgb;
use crate::scratch;

/// Support of the biweight kernel over its standard deviation, the square root of 7.
const SUPPORT: f32 = 2.645_751_3;

/// Share of each channel's light that spreads; the rest comes out closer to where it went in than pixels are apart. Of the
/// sum of Gaussians that [`crate::Material::skin`] names: all but the two narrowest of red, all but the narrowest of others.
pub(crate) const SPREAD_SHARE: Rgb = Rgb::new(0.667, 0.545, 0.351);

/// Neighbours on either side at most: bounds the cost of close-ups.
const MAX_RADIUS: usize = 40;

/// Red, green and blue.
type Planes = [Vec<f32>; 3];

thread_local! {
    static SCRATCH: Cell<Option<Box<[Planes; 2]>>> = const { Cell::new(None) };
}

/// A pixel whose light spreads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SkinPixel {
    /// Number of the sample at its centre.
    pub(crate) sample: u32,
    pub(crate) at: [u32; 2],
    /// Depth along the axis, mm.
    pub(crate) depth_z: f32,
    /// Standard deviations, mm.
    pub(crate) scatter_mm: Rgb,
}

/// The skin of a view as planes around it, with a margin of nothing that no kernel reaches over. Nothing here depends on
/// light.
#[derive(Clone, Debug)]
pub(crate) struct Skin {
    pixels: Vec<SkinPixel>,
    /// Place of each pixel in the planes.
    places: Vec<u32>,
    /// Numbers from a row to the next, a multiple of eight.
    stride: usize,
    /// First place of each run of eight with skin, and the steps that its kernels reach along rows and columns.
    runs: Vec<Run>,
    /// Depth, mm; infinite where there is no skin.
    depth_z: Vec<f32>,
    /// One over the square of each kernel's support, 1/mm^2.
    inverse: [Vec<f32>; 3],
    focal: [f32; 2],
    /// Depth whose scale all depths have, mm, of an orthographic camera.
    parallel_at: Option<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Run {
    first: u32,
    radius: [u32; 2],
}

impl Skin {
    /// Lays the skin out; `None` if there is none.
    pub(crate) fn new(camera: &Camera, pixels: Vec<SkinPixel>) -> Option<Self> {
        let (mut low, mut high) = (pixels.first()?.at, pixels.first()?.at);
        let k = camera.intrinsics();
        let focal = [k[(0, 0)] as f32, k[(1, 1)] as f32];
        let parallel_at = camera
            .is_orthographic()
            .then(|| camera.scale_depth(0.0) as f32);
        let mut reach = Vec::with_capacity(pixels.len());
        let mut margin = 0;
        for pixel in &pixels {
            let [red, green, blue] = pixel.scatter_mm.into();
            let support = red.max(green).max(blue) * SUPPORT;
            let scale = parallel_at.unwrap_or(pixel.depth_z);
            let own = focal.map(|f| ((support * f / scale) as usize).min(MAX_RADIUS));
            for axis in 0..2 {
                low[axis] = low[axis].min(pixel.at[axis]);
                high[axis] = high[axis].max(pixel.at[axis]);
                margin = margin.max(own[axis]);
            }
            reach.push(own.map(|r| r as u32));
        }
        let left = margin.next_multiple_of(LANES);
        let columns = (high[0] - low[0] + 1) as usize;
        let stride = (left + columns + margin).next_multiple_of(LANES);
        let rows = (high[1] - low[1] + 1) as usize + 2 * margin;
        let count = stride * rows;
        let place = |at: [u32; 2]| {
            let (x, y) = ((at[0] - low[0]) as usize, (at[1] - low[1]) as usize);
            ((y + margin) * stride + left + x) as u32
        };
        let mut skin = Self {
            places: pixels.iter().map(|p| place(p.at)).collect(),
            stride,
            runs: Vec::new(),
            depth_z: vec![f32::INFINITY; count],
            inverse: [0; 3].map(|_| vec![f32::INFINITY; count]),
            focal,
            parallel_at,
            pixels,
        };
        let mut runs = vec![None; count / LANES];
        for ((pixel, place), reach) in skin.pixels.iter().zip(&skin.places).zip(reach) {
            let place = *place as usize;
            skin.depth_z[place] = pixel.depth_z;
            for k in 0..3 {
                let support = pixel.scatter_mm[k] * SUPPORT;
                skin.inverse[k][place] = 1.0 / (support * support);
            }
            let radius: &mut [u32; 2] = runs[place / LANES].get_or_insert_default();
            *radius = [radius[0].max(reach[0]), radius[1].max(reach[1])];
        }
        let runs = runs.into_iter().enumerate();
        skin.runs.extend(
            runs.filter_map(|(i, radius)| Some(((i * LANES) as u32, radius?)))
                .map(|(first, radius)| Run { first, radius }),
        );
        Some(skin)
    }

    /// The pixels.
    pub(crate) fn pixels(&self) -> &[SkinPixel] {
        &self.pixels
    }

    /// What spreading adds to the light of each pixel; sample `i` has the irradiance of lane `i % 8` of block `i / 8`.
    pub(crate) fn spread(&self, irradiance: &[ColorBlock]) -> Vec<Rgb> {
        scratch::with(&SCRATCH, |[light, mixed]| {
            for plane in light.iter_mut().chain(&mut *mixed) {
                plane.clear();
                plane.resize(self.depth_z.len(), 0.0);
            }
            self.spread_with(irradiance, light, mixed)
        })
    }

    fn spread_with(
        &self,
        irradiance: &[ColorBlock],
        light: &mut Planes,
        mixed: &mut Planes,
    ) -> Vec<Rgb> {
        let [red, green, blue] = &mut *light;
        for (pixel, place) in self.pixels.iter().zip(&self.places) {
            let own = &irradiance[pixel.sample as usize / LANES];
            let (k, place) = (pixel.sample as usize % LANES, *place as usize);
            red[place] = own[0].0[k];
            green[place] = own[1].0[k];
            blue[place] = own[2].0[k];
        }
        for axis in 0..2 {
            run(Pass {
                skin: self,
                light,
                mixed,
                axis,
            });
            std::mem::swap(light, mixed);
        }
        let mut added = Vec::with_capacity(self.pixels.len());
        let [red, green, blue] = &*light;
        for (pixel, place) in self.pixels.iter().zip(&self.places) {
            let (own, k) = (
                &irradiance[pixel.sample as usize / LANES],
                pixel.sample as usize % LANES,
            );
            let place = *place as usize;
            added.push(Rgb::new(
                red[place] - own[0].0[k],
                green[place] - own[1].0[k],
                blue[place] - own[2].0[k],
            ));
        }
        added
    }
}

/// One pass along an axis of the image.
struct Pass<'a> {
    skin: &'a Skin,
    light: &'a Planes,
    mixed: &'a mut Planes,
    axis: usize,
}

impl Kernel for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let skin = self.skin;
        let along = if self.axis == 0 { 1 } else { skin.stride };
        let focal = L::splat(skin.focal[self.axis]);
        for run in &skin.runs {
            let at = run.first as usize;
            let depth_z = L::load_from(&skin.depth_z[at..]);
            let mm_per_px = skin.parallel_at.map_or(depth_z, L::splat) / focal;
            let inverse = [
                L::load_from(&skin.inverse[0][at..]),
                L::load_from(&skin.inverse[1][at..]),
                L::load_from(&skin.inverse[2][at..]),
            ];
            let mut sum = [
                L::load_from(&self.light[0][at..]),
                L::load_from(&self.light[1][at..]),
                L::load_from(&self.light[2][at..]),
            ];
            let mut total = [L::splat(1.0); 3];
            for step in 1..=run.radius[self.axis] as usize {
                let across = L::splat(step as f32) * mm_per_px;
                for there in [at - step * along, at + step * along] {
                    let deeper = L::load_from(&skin.depth_z[there..]) - depth_z;
                    let squared = across * across + deeper * deeper;
                    for k in 0..3 {
                        let weight = weight(squared, inverse[k]);
                        let light = L::load_from(&self.light[k][there..]);
                        sum[k] = sum[k] + light * weight;
                        total[k] = total[k] + weight;
                    }
                }
            }
            for k in 0..3 {
                (sum[k] / total[k]).store_to(&mut self.mixed[k][at..]);
            }
        }
    }
}

/// The kernel at the square of a distance; 0 beyond its support.
#[inline(always)]
fn weight<L: Lanes>(squared: L, inverse: L) -> L {
    let zero = L::splat(0.0);
    let left = L::splat(1.0) - squared * inverse;
    L::select(zero.lt(left), left * left, zero)
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::{Point3, Vector3};

    fn camera() -> Camera {
        let eye = Point3::new(0.0, 0.0, 500.0);
        // 0.5 mm per pixel at a depth of 500 mm
        let fov = 2.0 * (16.0_f64 / 500.0).atan();
        Camera::look_at(64, 64, eye, Point3::origin(), Vector3::y(), fov).expect("valid")
    }

    /// What spreading adds on a sheet of skin.
    fn spread(depth_z: impl Fn(u32) -> f32, light: impl Fn(u32) -> f32) -> Vec<Rgb> {
        let pixel = |i: u32| SkinPixel {
            sample: i,
            at: [i % 64, i / 64],
            depth_z: depth_z(i % 64),
            scatter_mm: Rgb::new(1.2, 0.4, 0.0),
        };
        let pixels: Vec<SkinPixel> = (0..64 * 64).map(pixel).collect();
        let mut irradiance = vec![ColorBlock::default(); 64 * 64 / LANES];
        for i in 0..64 * 64 {
            for k in 0..3 {
                irradiance[i / LANES][k].0[i % LANES] = light(i as u32 % 64);
            }
        }
        let added = Skin::new(&camera(), pixels.clone())
            .expect("skin")
            .spread(&irradiance);
        let expected = mixed(&camera(), &pixels, &irradiance);
        for (i, (a, b)) in added.iter().zip(&expected).enumerate() {
            assert_eq!(a.map(f32::to_bits), b.map(f32::to_bits), "{i}: {a:?} {b:?}");
        }
        added
    }

    /// The plain form: all pixels of a row or column, one by one.
    fn mixed(camera: &Camera, pixels: &[SkinPixel], irradiance: &[ColorBlock]) -> Vec<Rgb> {
        let first: Vec<Rgb> = (0..pixels.len())
            .map(|i| Rgb::from_fn(|k, _| irradiance[i / LANES][k].0[i % LANES]))
            .collect();
        let mut light = first.clone();
        for axis in 0..2 {
            let focal = camera.intrinsics()[(axis, axis)] as f32;
            let next = pixels.iter().zip(&light).map(|(pixel, own)| {
                let (mut sum, mut total) = (*own, Rgb::repeat(1.0));
                for step in 1..=MAX_RADIUS as i64 {
                    for side in [-1, 1] {
                        let mut there = pixel.at.map(i64::from);
                        there[axis] += side * step;
                        if !there.iter().all(|v| (0..64).contains(v)) {
                            continue;
                        }
                        let other = (there[1] * 64 + there[0]) as usize;
                        let across = step as f32 * (pixel.depth_z / focal);
                        let deeper = pixels[other].depth_z - pixel.depth_z;
                        let squared = across * across + deeper * deeper;
                        for k in 0..3 {
                            let support = pixel.scatter_mm[k] * SUPPORT;
                            let left = 1.0 - squared * (1.0 / (support * support));
                            if left > 0.0 {
                                sum[k] += light[other][k] * (left * left);
                                total[k] += left * left;
                            }
                        }
                    }
                }
                sum.component_div(&total)
            });
            light = next.collect();
        }
        light.iter().zip(&first).map(|(l, f)| l - f).collect()
    }

    #[test]
    fn even_light_stays_and_shadow_borders_redden() {
        let even = spread(|_| 500.0, |_| 0.7);
        assert!(even.iter().all(|d| d.abs().max() < 1e-6));
        let added = spread(|_| 500.0, |x| if x < 32 { 0.0 } else { 1.0 });
        let at = |x: usize| added[30 * 64 + x];
        // Dark side: red comes over, then green, never blue; the bright side loses as much
        assert!(at(31).x > 0.2 && at(31).x < 0.5 && at(30).x > at(30).y && at(31).y > 0.02);
        assert_eq!(at(31).z, 0.0);
        for k in 0..6 {
            assert!((at(31 - k) + at(32 + k)).abs().max() < 1e-5);
        }
        // The slope in the middle of red's border is the kernel's peak, 15 / (16 support)
        let slope = (1.0 + at(32).x - at(31).x) / 0.5;
        let expected = 15.0 / (16.0 * 1.2 * SUPPORT);
        assert!((slope / expected - 1.0).abs() < 0.02, "{slope} {expected}");
        let total = |light: &dyn Fn(usize) -> f32| (0..64).map(light).sum::<f32>();
        assert!(total(&|x| at(x).x).abs() < 1e-3);
    }

    #[test]
    fn light_stays_on_its_side_of_a_gap_in_depth() {
        let cliff = spread(
            |x| if x < 32 { 500.0 } else { 510.0 },
            |x| if x < 32 { 0.0 } else { 1.0 },
        );
        assert!(cliff.iter().all(|d| d.abs().max() < 1e-6));
        assert!(Skin::new(&camera(), Vec::new()).is_none());
    }
}
