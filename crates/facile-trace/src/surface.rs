//! The surfaces that primary rays hit, eight at a time: what shading and labels need to know, light left out.
//!
//! The same operations as the scalar [`crate::interaction`], which secondary rays use: each lane gives its bits.

use facile_core::Texture;
use facile_core::color::LINEAR_FROM_SRGB8;

use crate::interaction::{Interaction, diffuse_weight};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, V3, run};
use crate::material::Albedo;
use crate::math::{Rgb, Vec3};
use crate::object::Object;
use crate::ray::{Hit, Ray};
use crate::scene::Scene;

/// Eight surface points. Lanes without a hit hold nothing of use.
#[derive(Clone, Copy, Debug)]
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
    /// Lanes with a hit.
    pub(crate) hit: u32,
    /// Lanes whose material sends out rays of its own.
    pub(crate) spawns: u32,
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
            gathered.fill(self.scene, hits, directions, table);
            self.out.push(gathered.surface::<L>());
        }
    }
}

/// What is fetched for eight hits. Idle lanes keep what they held.
struct Gathered {
    corners: [[Eight; 3]; 3],
    normals: [[Eight; 3]; 3],
    direction: [Eight; 3],
    u: Eight,
    v: Eight,
    texels: [[Eight; 3]; 4],
    fraction: [Eight; 2],
    tint: [Eight; 3],
    weight: Eight,
    exposure: Eight,
    specular: Eight,
    shininess: Eight,
    hit: u32,
    smooth: u32,
    spawns: u32,
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
            texels: [[zero; 3]; 4],
            fraction: [zero; 2],
            tint: [zero; 3],
            weight: zero,
            exposure: zero,
            specular: zero,
            shininess: zero,
            hit: 0,
            smooth: 0,
            spawns: 0,
        }
    }
}

impl Gathered {
    #[inline(always)]
    fn fill(
        &mut self,
        scene: &Scene,
        hits: &[Hit],
        directions: &[[f32; 3]],
        table: &[f32; 256],
    ) {
        (self.hit, self.smooth, self.spawns) = (0, 0, 0);
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
            for (k, v) in triangle.into_iter().enumerate() {
                let mut corner = geometry.positions[v as usize];
                let mut normal = Vec3::zeros();
                if has_normals {
                    normal = geometry.normals[v as usize];
                }
                if object.world_from_object.is_some() {
                    corner = object.point_in_world(corner);
                    normal = object.vector_in_world(normal);
                }
                for axis in 0..3 {
                    self.corners[k][axis].0[lane] = corner[axis];
                    self.normals[k][axis].0[lane] = normal[axis];
                }
            }
            for axis in 0..3 {
                self.direction[axis].0[lane] = direction[axis];
            }
            (self.u.0[lane], self.v.0[lane]) = (hit.u, hit.v);
            self.fill_color(lane, object, hit, table);
            let material = object.material(hit.triangle);
            self.exposure.0[lane] = material.exposure;
            self.specular.0[lane] = material.specular;
            self.shininess.0[lane] = material.shininess;
            self.weight.0[lane] = 1.0;
            if material.spawns_rays() {
                self.spawns |= 1 << lane;
                // Rare, so not worth lanes of its own
                let ray = Ray::new(Vec3::zeros(), Vec3::from(*direction));
                let point = Interaction::new(scene, &ray, hit);
                self.weight.0[lane] = diffuse_weight(&point, material);
            }
        }
    }

    /// Fetches what the colour is mixed from: four texels, or one value four times.
    #[inline(always)]
    fn fill_color(&mut self, lane: usize, object: &Object, hit: &Hit, table: &[f32; 256]) {
        let geometry = &object.geometry;
        let (texels, fraction, tint) = match &object.material(hit.triangle).albedo {
            Albedo::Texture { texture, tint } => {
                let [a, b, c] = hit.barycentric();
                let uv = match geometry.texcoords.get(hit.triangle as usize) {
                    Some([p, q, r]) => [
                        p[0] * a + q[0] * b + r[0] * c,
                        p[1] * a + q[1] * b + r[1] * c,
                    ],
                    None => [0.5; 2],
                };
                let (texels, fraction) = four_texels(texture, uv, table);
                (texels, fraction, *tint)
            }
            Albedo::Constant(color) => ([(*color).into(); 4], [0.0; 2], Rgb::repeat(1.0)),
            Albedo::VertexColor => {
                let color = crate::interaction::albedo(object, hit);
                ([color.into(); 4], [0.0; 2], Rgb::repeat(1.0))
            }
        };
        for (own, texel) in self.texels.iter_mut().zip(&texels) {
            for k in 0..3 {
                own[k].0[lane] = texel[k];
            }
        }
        for k in 0..3 {
            self.tint[k].0[lane] = tint[k];
        }
        self.fraction[0].0[lane] = fraction[0];
        self.fraction[1].0[lane] = fraction[1];
    }

    #[inline(always)]
    fn surface<L: Lanes>(&self) -> SurfaceBlock {
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
        let albedo = V3([self.mix::<L>(0), self.mix::<L>(1), self.mix::<L>(2)]);
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
            hit: self.hit,
            spawns: self.spawns,
        }
    }

    /// One channel of the colour, bilinear.
    #[inline(always)]
    fn mix<L: Lanes>(&self, channel: usize) -> L {
        let (fx, fy) = (L::load(&self.fraction[0]), L::load(&self.fraction[1]));
        let a = L::load(&self.texels[0][channel]);
        let b = L::load(&self.texels[1][channel]);
        let c = L::load(&self.texels[2][channel]);
        let d = L::load(&self.texels[3][channel]);
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

/// The texels around a texture coordinate, linear RGB, and the position between them: [`Texture::sample`] without its
/// mixing.
#[inline(always)]
fn four_texels(
    texture: &Texture,
    uv: [f32; 2],
    table: &[f32; 256],
) -> ([[f32; 3]; 4], [f32; 2]) {
    let [x, y] = texture.texel_from_texcoord(uv);
    let (x_floor, y_floor) = (x.floor(), y.floor());
    let clamp = |v: f32, n: usize| (v.max(0.0) as usize).min(n - 1);
    let (width, height) = (texture.width(), texture.height());
    let (x0, x1) = (clamp(x_floor, width), clamp(x_floor + 1.0, width));
    let (y0, y1) = (clamp(y_floor, height), clamp(y_floor + 1.0, height));
    let texels = texture.texels();
    let linear = |texel: [u8; 3]| {
        [
            table[usize::from(texel[0])],
            table[usize::from(texel[1])],
            table[usize::from(texel[2])],
        ]
    };
    let (top, bottom) = (y0 * width, y1 * width);
    let found = [
        linear(texels[top + x0]),
        linear(texels[top + x1]),
        linear(texels[bottom + x0]),
        linear(texels[bottom + x1]),
    ];
    (found, [x - x_floor, y - y_floor])
}

/// One lane of three coordinates.
pub(crate) fn lane(v: &[Eight; 3], k: usize) -> Vec3 {
    Vec3::new(v[0].0[k], v[1].0[k], v[2].0[k])
}
