//! The surfaces that primary rays hit, eight at a time: what shading and labels need to know, light left out.
//!
//! The same operations as the scalar [`crate::interaction`], which secondary rays use: each lane gives its bits.

use facile_core::color::LINEAR_FROM_SRGB8;

use crate::interaction::{Interaction, diffuse_weight, strand_at};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, V3, run};
use crate::material::{Albedo, Material};
use crate::math::{Rgb, Vec3};
use crate::ray::{Hit, Ray};
use crate::scene::Scene;

/// Eight surface points. Lanes without a hit hold nothing of use.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceBlock {
    /// The point lifted onto the smooth surface, world, mm.
    pub(crate) lifted: [Eight; 3],
    /// Unit normal of the triangle on the ray's side.
    pub(crate) flat_normal: [Eight; 3],
    /// Unit shading normal on the ray's side.
    pub(crate) normal: [Eight; 3],
    /// Unit direction back along the ray.
    pub(crate) view: [Eight; 3],
    /// Linear RGB.
    pub(crate) albedo: [Eight; 3],
    /// Share of light that the diffuse layer gets.
    pub(crate) weight: Eight,
    /// [`crate::Material::exposure`].
    pub(crate) exposure: Eight,
    /// [`crate::Material::specular`].
    pub(crate) specular: Eight,
    /// [`crate::Material::shininess`].
    pub(crate) shininess: Eight,
    /// [`crate::Material::roughness`].
    pub(crate) roughness: Eight,
    /// Lanes with a hit.
    pub(crate) hit: u32,
    /// Lanes whose material sends out rays of its own.
    pub(crate) spawns: u32,
    /// Hair among the lanes.
    pub(crate) strands: Option<Box<StrandBlock>>,
}

/// The lanes of eight surface points that are hair.
#[derive(Clone, Debug)]
pub(crate) struct StrandBlock {
    pub(crate) lanes: u32,
    /// Unit direction of the strands; any in other lanes.
    pub(crate) direction: [Eight; 3],
}

/// The surfaces at hits; `directions` are those of the rays that hit, of any length.
pub(crate) fn surfaces(
    scene: &Scene,
    hits: &[Hit],
    directions: &[[f32; 3]],
    out: &mut Vec<SurfaceBlock>,
) {
    out.clear();
    run(Surfaces {
        scene,
        hits,
        directions,
        out,
    });
}

struct Surfaces<'a> {
    scene: &'a Scene,
    hits: &'a [Hit],
    directions: &'a [[f32; 3]],
    out: &'a mut Vec<SurfaceBlock>,
}

impl Kernel for Surfaces<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        self.out.reserve(self.hits.len().div_ceil(LANES));
        let table: &[f32; 256] = &LINEAR_FROM_SRGB8;
        let mut gathered = Gathered::default();
        for (hits, directions) in self.hits.chunks(LANES).zip(self.directions.chunks(LANES)) {
            let materials = gathered.fill(self.scene, hits, directions);
            let texels = gathered.fetch_texels::<L>(&materials, hits, self.scene, table);
            self.out.push(gathered.surface::<L>(&texels));
        }
    }
}

/// What eight colours are mixed from: four texels, or one value four times.
#[derive(Default)]
struct Texels {
    corners: [[Eight; 3]; 4],
    fraction: [Eight; 2],
    tint: [Eight; 3],
}

/// What is fetched for eight hits. Idle lanes keep what they held.
struct Gathered {
    corners: [[Eight; 3]; 3],
    normals: [[Eight; 3]; 3],
    direction: [Eight; 3],
    u: Eight,
    v: Eight,
    /// Texture coordinates of the corners.
    texcoords: [[Eight; 2]; 3],
    weight: Eight,
    exposure: Eight,
    specular: Eight,
    shininess: Eight,
    roughness: Eight,
    hit: u32,
    /// Lanes with vertex normals.
    smooth: u32,
    spawns: u32,
    /// Lanes of hair, and the directions of its strands, world.
    hair: u32,
    strands: [Eight; 3],
}

impl Default for Gathered {
    fn default() -> Self {
        let zero = Eight::default();
        Self {
            corners: [[zero; 3]; 3],
            normals: [[zero; 3]; 3],
            direction: [zero; 3],
            u: zero,
            v: zero,
            texcoords: [[zero; 2]; 3],
            weight: zero,
            exposure: zero,
            specular: zero,
            shininess: zero,
            roughness: zero,
            hit: 0,
            smooth: 0,
            spawns: 0,
            hair: 0,
            strands: [zero; 3],
        }
    }
}

impl Gathered {
    /// Fetches vertices and materials, and returns the materials.
    #[inline(always)]
    fn fill<'a>(
        &mut self,
        scene: &'a Scene,
        hits: &[Hit],
        directions: &[[f32; 3]],
    ) -> [Option<&'a Material>; LANES] {
        let mut materials = [None; LANES];
        (self.hit, self.smooth, self.spawns, self.hair) = (0, 0, 0, 0);
        for (lane, (hit, direction)) in hits.iter().zip(directions).enumerate() {
            if !hit.is_some() {
                continue;
            }
            self.hit |= 1 << lane;
            let object = &scene.objects()[hit.object as usize];
            let geometry = &object.geometry;
            let triangle = geometry.triangles[hit.triangle as usize];
            let has_normals = !geometry.normals.is_empty();
            self.smooth |= u32::from(has_normals) << lane;
            for k in 0..3 {
                let v = triangle[k] as usize;
                let mut corner = geometry.positions[v];
                let mut normal = geometry.normals.get(v).copied().unwrap_or_default();
                if object.world_from_object.is_some() {
                    corner = object.point_in_world(corner);
                    normal = object.vector_in_world(normal);
                }
                for axis in 0..3 {
                    self.corners[k][axis].0[lane] = corner[axis];
                    self.normals[k][axis].0[lane] = normal[axis];
                }
            }
            if let Some(texcoords) = geometry.texcoords.get(hit.triangle as usize) {
                for k in 0..3 {
                    self.texcoords[k][0].0[lane] = texcoords[k][0];
                    self.texcoords[k][1].0[lane] = texcoords[k][1];
                }
            } else {
                for k in 0..3 {
                    self.texcoords[k][0].0[lane] = 0.5;
                    self.texcoords[k][1].0[lane] = 0.5;
                }
            }
            for axis in 0..3 {
                self.direction[axis].0[lane] = direction[axis];
            }
            (self.u.0[lane], self.v.0[lane]) = (hit.u, hit.v);
            if !geometry.strands.is_empty() {
                self.hair |= 1 << lane;
                let strand = strand_at(object, hit);
                for axis in 0..3 {
                    self.strands[axis].0[lane] = strand[axis];
                }
            }
            let material = object.material(hit.triangle);
            materials[lane] = Some(material);
            self.exposure.0[lane] = material.exposure;
            self.specular.0[lane] = material.specular;
            self.shininess.0[lane] = material.shininess;
            self.roughness.0[lane] = material.roughness;
            self.weight.0[lane] = 1.0;
            if material.spawns_rays() {
                self.spawns |= 1 << lane;
                // Rare, so not worth lanes of its own
                let ray = Ray::new(Vec3::zeros(), Vec3::from(*direction));
                let point = Interaction::new(scene, &ray, hit);
                self.weight.0[lane] = diffuse_weight(&point, material);
            }
        }
        materials
    }

    /// Fetches what the colours are mixed from, as [`facile_core::Texture::sample`] does.
    #[inline(always)]
    fn fetch_texels<L: Lanes>(
        &self,
        materials: &[Option<&Material>; LANES],
        hits: &[Hit],
        scene: &Scene,
        table: &[f32; 256],
    ) -> Texels {
        let mut texels = Texels::default();
        let mut size = [Eight([1.0; LANES]); 2];
        let texture_of = |material: Option<&Material>| match material {
            Some(Material {
                albedo: Albedo::Texture { texture, .. },
                ..
            }) => Some((texture.width(), texture.height())),
            _ => None,
        };
        for (lane, material) in materials.iter().enumerate() {
            if let Some((width, height)) = texture_of(*material) {
                (size[0].0[lane], size[1].0[lane]) = (width as f32, height as f32);
            }
        }
        // Find the texels around each point
        let (u, v) = (L::load(&self.u), L::load(&self.v));
        let weights = [L::splat(1.0) - u - v, u, v];
        let one = L::splat(1.0);
        let half = L::splat(0.5);
        let (width, height) = (L::load(&size[0]), L::load(&size[1]));
        let x = self.texcoord(0, &weights) * width - half;
        let y = (one - self.texcoord(1, &weights)) * height - half;
        let (x0, x1, fx) = neighbours(x, width);
        let (y0, y1, fy) = neighbours(y, height);
        texels.fraction = [fx.store(), fy.store()];
        // Fetch them
        for (lane, material) in materials.iter().enumerate() {
            let Some(material) = material else { continue };
            let (found, tint) = match &material.albedo {
                Albedo::Texture { texture, tint } => {
                    let (all, width) = (texture.texels(), texture.width());
                    let (top, bottom) = (y0[lane] as usize * width, y1[lane] as usize * width);
                    let (left, right) = (x0[lane] as usize, x1[lane] as usize);
                    let found = [
                        linear(all[top + left], table),
                        linear(all[top + right], table),
                        linear(all[bottom + left], table),
                        linear(all[bottom + right], table),
                    ];
                    (found, *tint)
                }
                Albedo::Constant(color) => ([(*color).into(); 4], Rgb::repeat(1.0)),
                Albedo::VertexColor => {
                    let object = &scene.objects()[hits[lane].object as usize];
                    let color = crate::interaction::albedo(object, &hits[lane]);
                    ([color.into(); 4], Rgb::repeat(1.0))
                }
            };
            for k in 0..3 {
                texels.corners[0][k].0[lane] = found[0][k];
                texels.corners[1][k].0[lane] = found[1][k];
                texels.corners[2][k].0[lane] = found[2][k];
                texels.corners[3][k].0[lane] = found[3][k];
                texels.tint[k].0[lane] = tint[k];
            }
        }
        texels
    }

    #[inline(always)]
    fn texcoord<L: Lanes>(&self, axis: usize, weights: &[L; 3]) -> L {
        let [p, q, r] = &self.texcoords;
        L::load(&p[axis]) * weights[0]
            + L::load(&q[axis]) * weights[1]
            + L::load(&r[axis]) * weights[2]
    }

    #[inline(always)]
    fn surface<L: Lanes>(&self, texels: &Texels) -> SurfaceBlock {
        let corners = [
            V3::<L>::load(&self.corners[0]),
            V3::load(&self.corners[1]),
            V3::load(&self.corners[2]),
        ];
        let (u, v) = (L::load(&self.u), L::load(&self.v));
        let weights = [L::splat(1.0) - u - v, u, v];
        let position = blend(&corners, &weights);
        // Orient the triangle's normal to the ray's side
        let direction = V3::<L>::load(&self.direction);
        let area_vector = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let flat = area_vector.unit_or(V3::splat([0.0, 1.0, 0.0]));
        let is_outside = flat.dot(direction).le(L::splat(0.0));
        let side = L::select(is_outside, L::splat(1.0), L::splat(-1.0));
        let flat = flat.scale(side);
        // Mix the vertices' normals
        let normals = [
            V3::load(&self.normals[0]).scale(side),
            V3::load(&self.normals[1]).scale(side),
            V3::load(&self.normals[2]).scale(side),
        ];
        let smooth = L::Mask::from_bits(self.smooth);
        let normal = V3::select(smooth, blend(&normals, &weights).unit_or(flat), flat);
        let lifted = lift(position, &corners, &normals, &weights);
        let albedo = V3([texels.mix::<L>(0), texels.mix::<L>(1), texels.mix::<L>(2)]);
        SurfaceBlock {
            lifted: V3::select(smooth, lifted, position).store(),
            flat_normal: flat.store(),
            normal: normal.store(),
            view: direction.negate().unit_or(flat).store(),
            albedo: albedo.store(),
            weight: self.weight,
            exposure: self.exposure,
            specular: self.specular,
            shininess: self.shininess,
            roughness: self.roughness,
            hit: self.hit,
            spawns: self.spawns,
            strands: (self.hair != 0).then(|| {
                Box::new(StrandBlock {
                    lanes: self.hair,
                    direction: self.strands,
                })
            }),
        }
    }
}

impl Texels {
    /// One channel of the colour, bilinear.
    #[inline(always)]
    fn mix<L: Lanes>(&self, channel: usize) -> L {
        let (fx, fy) = (L::load(&self.fraction[0]), L::load(&self.fraction[1]));
        let a = L::load(&self.corners[0][channel]);
        let b = L::load(&self.corners[1][channel]);
        let c = L::load(&self.corners[2][channel]);
        let d = L::load(&self.corners[3][channel]);
        let top = a + (b - a) * fx;
        let bottom = c + (d - c) * fx;
        (top + (bottom - top) * fy) * L::load(&self.tint[channel])
    }
}

#[inline(always)]
fn blend<L: Lanes>(v: &[V3<L>; 3], weights: &[L; 3]) -> V3<L> {
    v[0].scale(weights[0]) + v[1].scale(weights[1]) + v[2].scale(weights[2])
}

/// As the scalar one of [`crate::interaction`].
#[inline(always)]
fn lift<L: Lanes>(
    position: V3<L>,
    corners: &[V3<L>; 3],
    normals: &[V3<L>; 3],
    weights: &[L; 3],
) -> V3<L> {
    let mut lifted = position;
    for k in 0..3 {
        let depth = (position - corners[k]).dot(normals[k]);
        let moved = lifted - normals[k].scale(depth * weights[k]);
        lifted = V3::select(depth.lt(L::splat(0.0)), moved, lifted);
    }
    lifted
}

/// Texels on both sides of a position, clamped to `0..count`, and the position between them.
#[inline(always)]
fn neighbours<L: Lanes>(x: L, count: L) -> ([i32; LANES], [i32; LANES], L) {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    // Beyond the texture both sides are the same texel, whatever lies between
    let x = x.max(L::splat(-2.0)).min(count + one);
    let whole = x.trunc();
    let floor = L::select(x.lt(whole), whole - one, whole);
    let last = count - one;
    let low = floor.max(zero).min(last);
    let high = (floor + one).max(zero).min(last);
    (low.to_i32(), high.to_i32(), x - floor)
}

#[inline(always)]
fn linear(texel: [u8; 3], table: &[f32; 256]) -> [f32; 3] {
    [
        table[usize::from(texel[0])],
        table[usize::from(texel[1])],
        table[usize::from(texel[2])],
    ]
}

/// One lane of three coordinates.
pub(crate) fn lane(v: &[Eight; 3], k: usize) -> Vec3 {
    Vec3::new(v[0].0[k], v[1].0[k], v[2].0[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Pose;
    use crate::{Layer, Normals, Object};
    use facile_core::{Mesh, Point3, Texture};
    use std::sync::Arc;

    #[test]
    fn lanes_give_the_bits_of_the_scalar_form() {
        let mesh = Mesh {
            positions: vec![
                Point3::new(-30.0, -30.0, 4.0),
                Point3::new(30.0, -28.0, -3.0),
                Point3::new(28.0, 31.0, 6.0),
                Point3::new(-31.0, 30.0, 0.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            texcoords: vec![[-0.1, 0.0], [1.2, 0.1], [0.9, 1.1], [0.0, 0.7]],
            texcoord_triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let texels = (0..35)
            .map(|i| [i as u8 * 7, 255 - i as u8, i as u8])
            .collect();
        let texture = Arc::new(Texture::new(7, 5, texels));
        let mut scene = Scene::default();
        for (normals, material) in [
            (Normals::Smooth, Material::skin(texture.clone())),
            (Normals::Flat, Material::wet(texture.clone())),
        ] {
            let mut object = Object::new(&mesh, normals, material).expect("valid");
            let shift = 40.0 * scene.objects().len() as f32;
            let turn = Vec3::new(0.1, 0.2, 0.3) * shift * 0.02;
            let pose = Pose::new(Vec3::new(shift, shift, 0.0), turn);
            object.set_pose(&pose).expect("finite");
            scene.add(object);
        }
        let rays: Vec<Ray> = (0..900)
            .map(|i| {
                let target = Vec3::new(
                    (i % 30) as f32 * 4.0 - 40.0,
                    (i / 30) as f32 * 4.0 - 40.0,
                    0.0,
                );
                let side = if i % 2 == 0 { 1.0 } else { -1.0 };
                let eye = Vec3::new(5.0, 9.0, 300.0 * side);
                Ray::new(eye, target - eye)
            })
            .collect();
        let mut hits = Vec::new();
        scene.closest_hits(&rays, Layer::All, &mut hits);
        let directions: Vec<[f32; 3]> = rays.iter().map(|r| r.direction.into()).collect();
        let mut blocks = Vec::new();
        surfaces(&scene, &hits, &directions, &mut blocks);
        let mut compared = 0;
        for (i, (ray, hit)) in rays.iter().zip(&hits).enumerate() {
            let (block, k) = (&blocks[i / LANES], i % LANES);
            assert_eq!(block.hit >> k & 1 == 1, hit.is_some());
            if !hit.is_some() {
                continue;
            }
            let point = Interaction::new(&scene, ray, hit);
            let material = point.object.material(point.triangle);
            assert_eq!(lane(&block.normal, k), point.normal, "{i}");
            assert_eq!(lane(&block.flat_normal, k), point.flat_normal, "{i}");
            assert_eq!(lane(&block.lifted, k), point.lifted, "{i}");
            assert_eq!(lane(&block.view, k), point.view, "{i}");
            assert_eq!(lane(&block.albedo, k), point.albedo, "{i}");
            assert_eq!(block.weight.0[k], diffuse_weight(&point, material), "{i}");
            compared += 1;
        }
        assert!(compared > 300, "{compared}");
    }
}
