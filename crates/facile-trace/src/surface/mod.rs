//! The surfaces that rays hit, eight at a time: what shading and labels need to know, light left out.
//!
//! Vertices are fetched as rows of eight numbers and turned into lanes. The same operations as the scalar
//! [`crate::interaction`]: each lane gives its bits.

mod look;

use facile_core::color::LINEAR_FROM_SRGB8;

use crate::bounces::BounceParams;
use crate::detail;
use crate::interaction::{albedo, strand_at};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, V3, lanes_of, run};
use crate::material::{Albedo, Material};
use crate::math::Vec3;
use crate::object::Object;
use crate::ray::Hit;
use crate::scene::Scene;
use look::{Look, texture_of};

/// Texels for each ray from which the next level of a texture is taken, as a share of four: at 2 the texels of the level
/// that is taken are between 0.7 and 1.4 times as far apart as rays.
const LEVEL_BIAS: f32 = 2.0;

/// Hits ahead of the one at work whose triangles are asked for: they come from a cache far away.
const AHEAD: usize = 6 * LANES;

/// The smallest level of any texture.
const MAX_LEVEL: u32 = 15;

/// Eight surface points. Lanes without a hit hold nothing of use.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceBlock {
    /// Where rays to lights start, without their offset: the point lifted onto the smooth surface, world, mm.
    pub(crate) lifted: [Eight; 3],
    /// Unit normal of the triangle on the ray's side.
    pub(crate) flat_normal: [Eight; 3],
    /// Unit shading normal on the ray's side.
    pub(crate) normal: [Eight; 3],
    /// Unit direction back along the ray, in lanes without a hit too.
    pub(crate) view: [Eight; 3],
    /// Linear RGB.
    pub(crate) albedo: [Eight; 3],
    /// Share of light that the diffuse layer gets.
    pub(crate) weight: Eight,
    /// Share of ambient light that arrives.
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

/// Appends the surfaces at hits; `directions` are those of the rays that hit, of any length. Rays are `spacing` mm apart at
/// a parameter of 1, 0 for rays of no extent: texture that is finer than that is taken from a smaller level.
pub(crate) fn surfaces(
    scene: &Scene,
    hits: &[Hit],
    directions: &[[f32; 3]],
    (spacing, params): (f32, BounceParams),
    out: &mut Vec<SurfaceBlock>,
) {
    run(Surfaces {
        scene,
        hits,
        directions,
        spacing,
        raised: (!params.smooth_shadows).then_some(params.offset),
        out,
    });
}

struct Surfaces<'a> {
    scene: &'a Scene,
    hits: &'a [Hit],
    directions: &'a [[f32; 3]],
    spacing: f32,
    /// Distance along the shading normal at which shadow rays start, if not from the smooth surface.
    raised: Option<f32>,
    out: &'a mut Vec<SurfaceBlock>,
}

impl Kernel for Surfaces<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let table: &[f32; 256] = &LINEAR_FROM_SRGB8;
        let mut look = Look::default();
        for hit in &self.hits[..self.hits.len().min(AHEAD)] {
            ask_for::<L>(self.scene, hit);
        }
        let mut ahead = self.hits.chunks(LANES).skip(AHEAD / LANES);
        for (hits, directions) in self.hits.chunks(LANES).zip(self.directions.chunks(LANES)) {
            for hit in ahead.next().unwrap_or_default() {
                ask_for::<L>(self.scene, hit);
            }
            let found = Found::new(self.scene, hits, directions);
            look.take(&found.materials);
            let corners = found.corners::<L>(self.scene, hits);
            let levels = found.levels::<L>(&corners, &look, hits, self.spacing);
            let albedo = found.albedo::<L>(&corners, &look, levels, self.scene, hits, table);
            let mut block = found.surface::<L>(&corners, &look, albedo, self.raised);
            for lane in lanes_of(found.inside) {
                if let Some(material) = found.materials[lane] {
                    block.exposure.0[lane] = material.exposure_at(self::lane(&block.lifted, lane));
                }
            }
            if found.detail != 0 {
                detail::add(self.scene, hits, found.detail, &mut block);
            }
            if found.hair != 0 {
                block.strands = Some(Box::new(strands(self.scene, hits, found.hair)));
            }
            self.out.push(block);
        }
    }
}

/// Asks for what [`Found::corners`] fetches of a hit.
#[inline(always)]
fn ask_for<L: Lanes>(scene: &Scene, hit: &Hit) {
    if !hit.is_some() {
        return;
    }
    let geometry = &scene.objects()[hit.object as usize].geometry;
    for v in geometry.triangles[hit.triangle as usize] {
        L::prefetch(&geometry.vertex_rows[v as usize]);
    }
    if let Some(row) = geometry.texcoord_rows.get(hit.triangle as usize) {
        L::prefetch(row);
    }
}

/// Eight hits, and the materials there.
struct Found<'a> {
    direction: [Eight; 3],
    u: Eight,
    v: Eight,
    materials: [Option<&'a Material>; LANES],
    hit: u32,
    /// Lanes with vertex normals.
    smooth: u32,
    /// Lanes of hair.
    hair: u32,
    /// Lanes with pores.
    detail: u32,
    /// Lanes in a cavity.
    inside: u32,
}

/// The triangles of eight hits, in the world.
struct Corners<L> {
    positions: [V3<L>; 3],
    normals: [V3<L>; 3],
    texcoords: [[L; 2]; 3],
    /// Of the corners.
    weights: [L; 3],
}

impl<'a> Found<'a> {
    #[inline(always)]
    fn new(scene: &'a Scene, hits: &[Hit], directions: &[[f32; 3]]) -> Self {
        let mut found = Self {
            direction: [Eight::default(); 3],
            u: Eight::default(),
            v: Eight::default(),
            materials: [None; LANES],
            hit: 0,
            smooth: 0,
            hair: 0,
            detail: 0,
            inside: 0,
        };
        for (lane, (hit, direction)) in hits.iter().zip(directions).enumerate() {
            for axis in 0..3 {
                found.direction[axis].0[lane] = direction[axis];
            }
            if !hit.is_some() {
                continue;
            }
            found.hit |= 1 << lane;
            let object = &scene.objects()[hit.object as usize];
            found.smooth |= u32::from(!object.geometry.normals.is_empty()) << lane;
            let material = object.material(hit.triangle);
            found.detail |= u32::from(material.detail > 0.0) << lane;
            found.inside |= u32::from(material.aperture.is_some()) << lane;
            found.materials[lane] = Some(material);
            (found.u.0[lane], found.v.0[lane]) = (hit.u, hit.v);
            found.hair |= u32::from(!object.geometry.strands.is_empty()) << lane;
        }
        found
    }

    /// Fetches the triangles.
    #[inline(always)]
    fn corners<L: Lanes>(&self, scene: &'a Scene, hits: &[Hit]) -> Corners<L> {
        const NOWHERE: &Eight = &Eight([0.0; LANES]);
        const MIDDLE: &Eight = &Eight([0.5; LANES]);
        let mut corners = [[&NOWHERE.0; LANES]; 3];
        let mut texcoords = [&MIDDLE.0; LANES];
        let mut moved = [[Eight::default(); 3]; LANES];
        let mut posed = 0;
        for lane in lanes_of(self.hit) {
            let hit = &hits[lane];
            let object = &scene.objects()[hit.object as usize];
            let geometry = &object.geometry;
            let triangle = geometry.triangles[hit.triangle as usize];
            for k in 0..3 {
                corners[k][lane] = &geometry.vertex_rows[triangle[k] as usize].0;
            }
            if object.world_from_object.is_some() {
                posed |= 1 << lane;
                for k in 0..3 {
                    moved[lane][k] = row_in_world(object, corners[k][lane]);
                }
            }
            if let Some(row) = geometry.texcoord_rows.get(hit.triangle as usize) {
                texcoords[lane] = &row.0;
            }
        }
        for lane in lanes_of(posed) {
            for k in 0..3 {
                corners[k][lane] = &moved[lane][k].0;
            }
        }
        let [a, b, c] = [
            L::transpose(corners[0]),
            L::transpose(corners[1]),
            L::transpose(corners[2]),
        ];
        let t = L::transpose(texcoords);
        let (u, v) = (L::load(&self.u), L::load(&self.v));
        Corners {
            positions: [
                V3([a[0], a[1], a[2]]),
                V3([b[0], b[1], b[2]]),
                V3([c[0], c[1], c[2]]),
            ],
            normals: [
                V3([a[3], a[4], a[5]]),
                V3([b[3], b[4], b[5]]),
                V3([c[3], c[4], c[5]]),
            ],
            texcoords: [[t[0], t[1]], [t[2], t[3]], [t[4], t[5]]],
            weights: [L::splat(1.0) - u - v, u, v],
        }
    }

    /// The levels of the textures whose texels are about as far apart as rays `spacing` mm apart at a parameter of 1.
    #[inline(always)]
    fn levels<L: Lanes>(
        &self,
        corners: &Corners<L>,
        look: &Look<'_>,
        hits: &[Hit],
        spacing: f32,
    ) -> [u8; LANES] {
        let mut levels = [0; LANES];
        if spacing <= 0.0 || look.is_plain {
            return levels;
        }
        let mut depth = Eight::default();
        for lane in lanes_of(self.hit) {
            depth.0[lane] = hits[lane].t;
        }
        // Texels of the triangle over its area in the world, times that of a ray
        let [a, b, c] = &corners.texcoords;
        let in_texels = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let texels = in_texels * L::load(&look.size[0]) * L::load(&look.size[1]);
        let [a, b, c] = corners.positions;
        let area_vector = (b - a).cross(c - a);
        let area = area_vector.dot(area_vector).sqrt();
        let apart = L::load(&depth) * L::splat(spacing);
        let zero = L::splat(0.0);
        let share = texels.max(zero - texels) * apart * apart / area;
        let share = (share * L::splat(LEVEL_BIAS)).store();
        for lane in lanes_of(self.hit) {
            // Half of the binary logarithm, rounded down
            let exponent = (share.0[lane].to_bits() >> 23).saturating_sub(127);
            levels[lane] = (exponent / 2).min(MAX_LEVEL) as u8;
        }
        levels
    }

    /// The diffuse colours, as [`facile_core::Texture::sample`] gives them.
    #[inline(always)]
    fn albedo<L: Lanes>(
        &self,
        corners: &Corners<L>,
        look: &Look<'_>,
        levels: [u8; LANES],
        scene: &Scene,
        hits: &[Hit],
        table: &[f32; 256],
    ) -> V3<L> {
        let mut size = look.size;
        for lane in 0..LANES {
            if levels[lane] > 0
                && let Some(texture) = self.materials[lane].and_then(texture_of)
            {
                let texture = texture.level(usize::from(levels[lane]));
                size[0].0[lane] = texture.width() as f32;
                size[1].0[lane] = texture.height() as f32;
            }
        }
        // Find the texels around each point
        let (one, half) = (L::splat(1.0), L::splat(0.5));
        let (width, height) = (L::load(&size[0]), L::load(&size[1]));
        let x = corners.texcoord(0) * width - half;
        let y = (one - corners.texcoord(1)) * height - half;
        let (x0, x1, fx) = neighbours(x, width);
        let (y0, y1, fy) = neighbours(y, height);
        // Fetch them
        let mut texels = [[Eight::default(); 3]; 4];
        for (lane, material) in self.materials.iter().enumerate() {
            let Some(material) = material else { continue };
            let found = match &material.albedo {
                Albedo::Texture { texture, .. } => {
                    let texture = texture.level(usize::from(levels[lane]));
                    let (all, width) = (texture.texels(), texture.width());
                    let (top, bottom) = (y0[lane] as usize * width, y1[lane] as usize * width);
                    let (left, right) = (x0[lane] as usize, x1[lane] as usize);
                    [
                        linear(all[top + left], table),
                        linear(all[top + right], table),
                        linear(all[bottom + left], table),
                        linear(all[bottom + right], table),
                    ]
                }
                Albedo::Constant(color) => [(*color).into(); 4],
                Albedo::VertexColor => {
                    let object = &scene.objects()[hits[lane].object as usize];
                    [albedo(object, &hits[lane]).into(); 4]
                }
            };
            for corner in 0..4 {
                for k in 0..3 {
                    texels[corner][k].0[lane] = found[corner][k];
                }
            }
        }
        // Mix them
        V3([
            bilinear(&texels, 0, [fx, fy]) * L::load(&look.tint[0]),
            bilinear(&texels, 1, [fx, fy]) * L::load(&look.tint[1]),
            bilinear(&texels, 2, [fx, fy]) * L::load(&look.tint[2]),
        ])
    }

    #[inline(always)]
    fn surface<L: Lanes>(
        &self,
        corners: &Corners<L>,
        look: &Look<'_>,
        albedo: V3<L>,
        raised: Option<f32>,
    ) -> SurfaceBlock {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let (places, weights) = (&corners.positions, &corners.weights);
        let position = blend(places, weights);
        // Orient the triangle's normal to the ray's side
        let direction = V3::<L>::load(&self.direction);
        let area_vector = (places[1] - places[0]).cross(places[2] - places[0]);
        let flat = area_vector.unit_or(V3::splat([0.0, 1.0, 0.0]));
        let is_outside = flat.dot(direction).le(zero);
        let side = L::select(is_outside, one, L::splat(-1.0));
        let flat = flat.scale(side);
        // Mix the vertices' normals
        let normals = [
            corners.normals[0].scale(side),
            corners.normals[1].scale(side),
            corners.normals[2].scale(side),
        ];
        let smooth = L::Mask::from_bits(self.smooth);
        let normal = V3::select(smooth, blend(&normals, weights).unit_or(flat), flat);
        let lifted = match raised {
            None => V3::select(smooth, lift(position, places, &normals, weights), position),
            // The offset along the triangle's normal comes later
            Some(offset) => position + (normal - flat).scale(L::splat(offset)),
        };
        let view = direction.negate().unit_or(flat);
        // Leave the diffuse layer what is not mirrored
        let spawns = look.spawns & self.hit;
        let mut weight = one;
        if spawns != 0 {
            let reflectivity = L::load(&look.reflectivity);
            let rest = one - fresnel(reflectivity, normal.dot(view));
            let opaque = L::select(zero.lt(reflectivity), rest, one);
            weight = L::select(L::Mask::from_bits(look.transparent), zero, opaque);
        }
        SurfaceBlock {
            lifted: lifted.store(),
            flat_normal: flat.store(),
            normal: normal.store(),
            view: view.store(),
            albedo: albedo.store(),
            weight: weight.store(),
            exposure: look.exposure,
            specular: look.specular,
            shininess: look.shininess,
            roughness: look.roughness,
            hit: self.hit,
            spawns,
            strands: None,
        }
    }
}

impl<L: Lanes> Corners<L> {
    #[inline(always)]
    fn texcoord(&self, axis: usize) -> L {
        let [p, q, r] = &self.texcoords;
        let weights = &self.weights;
        p[axis] * weights[0] + q[axis] * weights[1] + r[axis] * weights[2]
    }
}

/// A row of [`crate::geometry::Geometry::vertex_rows`], moved to the world.
fn row_in_world(object: &Object, row: &[f32; LANES]) -> Eight {
    let [x, y, z, nx, ny, nz, ..] = *row;
    let p = object.point_in_world(Vec3::new(x, y, z));
    let n = object.vector_in_world(Vec3::new(nx, ny, nz));
    Eight([p.x, p.y, p.z, n.x, n.y, n.z, 0.0, 0.0])
}

/// Four texels mixed, one channel.
#[inline(always)]
fn bilinear<L: Lanes>(texels: &[[Eight; 3]; 4], channel: usize, [fx, fy]: [L; 2]) -> L {
    let a = L::load(&texels[0][channel]);
    let b = L::load(&texels[1][channel]);
    let c = L::load(&texels[2][channel]);
    let d = L::load(&texels[3][channel]);
    let top = a + (b - a) * fx;
    let bottom = c + (d - c) * fx;
    top + (bottom - top) * fy
}

/// As [`crate::whitted::fresnel`] for surfaces that mirror.
#[inline(always)]
fn fresnel<L: Lanes>(at_normal: L, cosine: L) -> L {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let x = one - cosine.max(zero).min(one);
    let x2 = x * x;
    at_normal + (one - at_normal) * x2 * x2 * x
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

/// The strands of the lanes `hair`.
fn strands(scene: &Scene, hits: &[Hit], hair: u32) -> StrandBlock {
    let mut direction = [Eight::default(); 3];
    for lane in lanes_of(hair) {
        let hit = &hits[lane];
        let strand = strand_at(&scene.objects()[hit.object as usize], hit);
        for axis in 0..3 {
            direction[axis].0[lane] = strand[axis];
        }
    }
    StrandBlock {
        lanes: hair,
        direction,
    }
}

/// One lane of three coordinates.
pub(crate) fn lane(v: &[Eight; 3], k: usize) -> Vec3 {
    Vec3::new(v[0].0[k], v[1].0[k], v[2].0[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::aperture::Aperture;
    use crate::interaction::{Interaction, diffuse_weight};
    use crate::math::Pose;
    use crate::ray::Ray;
    use crate::{Layer, Normals};
    use facile_core::Texture;
    use facile_core::{Mesh, Point3};
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
            (
                Normals::Flat,
                Material {
                    aperture: Some(Aperture {
                        ends: [Vec3::new(40.0, 40.0, 20.0), Vec3::new(55.0, 40.0, 20.0)],
                        radius: 15.0,
                    }),
                    ..Material::wet(texture.clone())
                },
            ),
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
        let params = BounceParams {
            max_depth: 0,
            min_share: 0.0,
            offset: 0.05,
            smooth_shadows: true,
        };
        surfaces(&scene, &hits, &directions, (0.0, params), &mut blocks);
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
            let exposure = material.exposure_at(point.lifted);
            assert_eq!(block.exposure.0[k], exposure, "{i}");
            assert_eq!(block.weight.0[k], diffuse_weight(&point, material), "{i}");
            compared += 1;
        }
        assert!(compared > 300, "{compared}");
    }
}
