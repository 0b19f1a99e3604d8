//! Cards with holes: triangles of which only what an image covers is there, such as strands of hair on a card.
//!
//! A hit counts where the cover at its texture coordinate is at least a half. Packets, drawing and single rays ask the same
//! scalar function with the same numbers, so they agree bit for bit. Kernels take an [`Admit`]: those of solid meshes are
//! compiled with [`Solid`], which asks nothing.

use facile_core::Mesh;

use crate::TraceError;
use crate::lanes::{LaneMask, Lanes, lanes_of};

/// Which hits on a mesh count.
pub(crate) trait Admit: Copy {
    /// Whether the hit on a triangle at the weights of its second and third corner counts.
    fn admits(self, triangle: u32, u: f32, v: f32) -> bool;

    /// The lanes of `met` whose hits count.
    fn admitted<L: Lanes>(self, met: L::Mask, triangle: u32, u: L, v: L) -> L::Mask;
}

/// Every hit counts.
#[derive(Clone, Copy)]
pub(crate) struct Solid;

impl Admit for Solid {
    #[inline(always)]
    fn admits(self, _: u32, _: f32, _: f32) -> bool {
        true
    }

    #[inline(always)]
    fn admitted<L: Lanes>(self, met: L::Mask, _: u32, _: L, _: L) -> L::Mask {
        met
    }
}

/// What of a mesh is there.
#[derive(Clone, Debug)]
pub struct Cutout {
    width: usize,
    height: usize,
    /// 0 to 255, top row first.
    cover: Vec<u8>,
    /// Position in the cover of the corners of each triangle: texel centres lie at whole numbers, y downwards.
    corners: Vec<[[f32; 2]; 3]>,
}

impl Cutout {
    /// The cover of a mesh's texture coordinates: `width x height` values, top row first, 255 is there and 0 is not. Texture
    /// coordinate `(0, 0)` is the lower left corner; the border goes on outside.
    ///
    /// # Errors
    /// [`TraceError::SizeMismatch`] if the cover does not fill its size, or the mesh has no texture coordinates.
    pub fn new(
        mesh: &Mesh,
        [width, height]: [usize; 2],
        cover: Vec<u8>,
    ) -> Result<Self, TraceError> {
        let counts = [
            ("texels of a cover", width * height, cover.len()),
            (
                "texture coordinates of a mesh with a cover",
                mesh.triangles.len(),
                mesh.texcoord_triangles.len(),
            ),
        ];
        for (what, expected, got) in counts {
            if expected != got || (expected == 0 && what.starts_with("texels")) {
                return Err(TraceError::SizeMismatch {
                    what,
                    expected,
                    got,
                });
            }
        }
        let place = |v: u32| {
            let [x, y] = mesh.texcoords[v as usize];
            [x * width as f32 - 0.5, (1.0 - y) * height as f32 - 0.5]
        };
        Ok(Self {
            width,
            height,
            cover,
            corners: mesh
                .texcoord_triangles
                .iter()
                .map(|t| t.map(place))
                .collect(),
        })
    }

    /// Number of triangles.
    pub(crate) fn triangles(&self) -> usize {
        self.corners.len()
    }

    /// Cover at a position, bilinear, 0 to 255.
    fn at(&self, x: f32, y: f32) -> f32 {
        let last = [self.width as f32 - 1.0, self.height as f32 - 1.0];
        // A coordinate that is not a number is at the border
        let (x, y) = (x.max(0.0).min(last[0]), y.max(0.0).min(last[1]));
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let texel = |x: usize, y: usize| f32::from(self.cover[y * self.width + x]);
        let top = texel(x0, y0) + (texel(x1, y0) - texel(x0, y0)) * fx;
        let bottom = texel(x0, y1) + (texel(x1, y1) - texel(x0, y1)) * fx;
        top + (bottom - top) * fy
    }
}

impl Admit for &Cutout {
    fn admits(self, triangle: u32, u: f32, v: f32) -> bool {
        let [a, b, c] = self.corners[triangle as usize];
        let w = 1.0 - u - v;
        let [x, y] = [0, 1].map(|k| a[k] * w + b[k] * u + c[k] * v);
        self.at(x, y) >= 127.5
    }

    #[inline(always)]
    fn admitted<L: Lanes>(self, met: L::Mask, triangle: u32, u: L, v: L) -> L::Mask {
        let bits = met.bits();
        if bits == 0 {
            return met;
        }
        let (u, v) = (u.store().0, v.store().0);
        let kept = lanes_of(bits)
            .filter(|&k| self.admits(triangle, u[k], v[k]))
            .fold(0, |kept, k| kept | 1 << k);
        L::Mask::from_bits(kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec3;
    use crate::{Cutout, Layer, Material, Normals, Object, Ray, Scene};
    use facile_core::Point3;

    /// A square card of 20 mm, its left half there.
    fn card() -> (Mesh, Cutout) {
        let mesh = Mesh {
            positions: [(-10.0, -10.0), (10.0, -10.0), (10.0, 10.0), (-10.0, 10.0)]
                .map(|(x, y)| Point3::new(x, y, 0.0))
                .to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            texcoords: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            texcoord_triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let cover = (0..64).map(|i| if i % 8 < 4 { 255 } else { 0 }).collect();
        let cutout = Cutout::new(&mesh, [8, 8], cover).expect("fits");
        (mesh, cutout)
    }

    #[test]
    fn rays_pass_where_nothing_is() {
        let (mesh, cutout) = card();
        let object = Object::new(&mesh, Normals::Flat, Material::default()).expect("valid");
        let object = object.with_cutout(cutout).expect("of this mesh");
        let mut scene = Scene::default();
        scene.add(object);
        let rays: Vec<Ray> = (0..400)
            .map(|i| {
                let at = Vec3::new((i % 20) as f32 - 9.5, (i / 20) as f32 - 9.5, 0.0);
                let eye = Vec3::new(3.0, -4.0, if i % 2 == 0 { 50.0 } else { -50.0 });
                Ray {
                    t_max: 2.0,
                    ..Ray::new(eye, at - eye)
                }
            })
            .collect();
        let mut hits = Vec::new();
        scene.closest_hits(&rays, Layer::All, &mut hits);
        let mut shares = Vec::new();
        scene.transmittances(&rays, &mut shares);
        for ((ray, hit), share) in rays.iter().zip(&hits).zip(&shares) {
            let is_left = ray.at(1.0).x < 0.0;
            assert_eq!(hit.is_some(), is_left, "{ray:?}");
            assert_eq!(hit.ok(), scene.closest_hit(ray, Layer::All));
            assert_eq!(scene.any_opaque_hit(ray), is_left);
            assert_eq!(share.max() > 0.5, !is_left);
        }
    }

    #[test]
    fn a_cover_must_fit() {
        let (mesh, _) = card();
        assert!(Cutout::new(&mesh, [8, 8], vec![0; 63]).is_err());
        assert!(Cutout::new(&mesh, [0, 0], Vec::new()).is_err());
        let bare = Mesh {
            texcoord_triangles: Vec::new(),
            ..mesh
        };
        assert!(Cutout::new(&bare, [1, 1], vec![0]).is_err());
    }
}
