//! What surfaces are made of.

use std::sync::Arc;

use facile_core::Texture;

use crate::aperture::Aperture;
use crate::math::{Rgb, Vec3};

/// Diffuse colour of a surface.
#[derive(Clone, Debug)]
pub enum Albedo {
    /// One linear RGB value.
    Constant(Rgb),
    /// Bilinear look-up by texture coordinate, times a linear RGB tint.
    Texture {
        /// The image.
        texture: Arc<Texture>,
        /// Factor on every texel.
        tint: Rgb,
    },
    /// Linear RGB of the vertices, interpolated.
    VertexColor,
}

impl Albedo {
    /// A texture as it is.
    pub fn texture(texture: Arc<Texture>) -> Self {
        Self::Texture {
            texture,
            tint: Rgb::repeat(1.0),
        }
    }
}

/// How light goes through a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transmission {
    /// A sheet so thin that light keeps its direction: a lens of glasses, a foil.
    Thin {
        /// Linear RGB share that passes, per surface.
        tint: Rgb,
    },
    /// A closed solid that refracts: a thick lens, a cornea.
    Solid {
        /// Refractive index inside over outside, above 0.
        ior: f32,
        /// Linear RGB share that passes, per surface.
        tint: Rgb,
    },
}

impl Transmission {
    /// Linear RGB share that passes one surface.
    pub fn tint(&self) -> Rgb {
        match self {
            Self::Thin { tint } | Self::Solid { tint, .. } => *tint,
        }
    }
}

/// A material: a diffuse layer, a highlight, a mirror, and what passes through.
#[derive(Clone, Debug)]
pub struct Material {
    /// Diffuse colour.
    pub albedo: Albedo,
    /// Strength of the highlight, at least 0. Without a roughness the highlight of light `E` is
    /// `specular (shininess + 2) / 2 cos^shininess(alpha) E cos(theta)`, `alpha` between the mirrored light and the viewer:
    /// Phong's, normalised so that its energy does not depend on the shininess. With one it is that of
    /// [`crate::microfacets`], of reflectance `specular` at normal incidence: 0.028 skin, 0.02 water.
    pub specular: f32,
    /// Sharpness of Phong's highlight, at least 0: 10 skin, 400 water.
    pub shininess: f32,
    /// Roughness of the surface in `[0, 1]`: 0.2 wet lips, 0.35 an oily nose, 0.5 a dry cheek; 0 for Phong's highlight.
    pub roughness: f32,
    /// How far light spreads under the surface, as far as it does, standard deviation of each linear RGB channel, mm; 0 for
    /// not at all. See
    /// [`crate::subsurface`].
    pub scatter_mm: Rgb,
    /// Mirror reflection at normal incidence, in `[0, 1]`; grows towards 1 at grazing angles by Schlick's rule. 0 spawns
    /// no rays. 0.02 water, 0.04 glass, 1 a perfect mirror.
    pub reflectivity: f32,
    /// What passes through; `None` is opaque. A transparent surface has no diffuse layer.
    pub transmission: Option<Transmission>,
    /// Strength of pores and fine wrinkles in `[0, 1]`: tilts of the normal that texture coordinates carry; 0 for none.
    pub detail: f32,
    /// Share of ambient light that arrives, in `[0, 1]`: below 1 for cavities, which ambient light without shadows would
    /// light too much.
    pub exposure: f32,
    /// The opening of the cavity that the surface is in, through which ambient light has to come; `None` for what is outside.
    pub aperture: Option<Aperture>,
}

impl Default for Material {
    /// Matt, half grey.
    fn default() -> Self {
        Self {
            albedo: Albedo::Constant(Rgb::repeat(0.5)),
            specular: 0.0,
            shininess: 1.0,
            roughness: 0.0,
            scatter_mm: Rgb::zeros(),
            reflectivity: 0.0,
            transmission: None,
            detail: 0.0,
            exposure: 1.0,
            aperture: None,
        }
    }
}

impl Material {
    /// A matt surface of one linear colour.
    pub fn matt(color: Rgb) -> Self {
        Self {
            albedo: Albedo::Constant(color),
            ..Self::default()
        }
    }

    /// How far the light that spreads under skin goes, see [`Material::skin`].
    pub(crate) const SKIN_SCATTER_MM: Rgb = Rgb::new(1.43, 0.35, 0.245);

    /// Skin with a texture: a rough, oily surface, and red light that spreads under it.
    ///
    /// Distances: of what spreads ([`crate::subsurface`]), the variances of d'Eon and Luebke, Advanced Techniques for Realistic
    /// Real-Time Skin Rendering, GPU Gems 3, 2007, of each channel's sum of Gaussians.
    pub fn skin(texture: Arc<Texture>) -> Self {
        Self {
            albedo: Albedo::texture(texture),
            specular: 0.028,
            roughness: 0.45,
            scatter_mm: Self::SKIN_SCATTER_MM,
            ..Self::default()
        }
    }

    /// A wet surface with a texture, such as an eye: a small bright highlight and a faint mirror image.
    pub fn wet(texture: Arc<Texture>) -> Self {
        Self {
            albedo: Albedo::texture(texture),
            specular: 0.02,
            shininess: 500.0,
            reflectivity: 0.02,
            ..Self::default()
        }
    }

    /// A coated lens of glasses that lets a linear RGB share pass.
    pub fn thin_glass(tint: Rgb) -> Self {
        Self {
            albedo: Albedo::Constant(Rgb::zeros()),
            specular: 0.02,
            shininess: 800.0,
            reflectivity: 0.02,
            transmission: Some(Transmission::Thin { tint }),
            ..Self::default()
        }
    }

    /// A perfect mirror.
    pub fn mirror() -> Self {
        Self {
            albedo: Albedo::Constant(Rgb::zeros()),
            reflectivity: 1.0,
            ..Self::default()
        }
    }

    /// Whether light passes through.
    pub fn is_transparent(&self) -> bool {
        self.transmission.is_some()
    }

    /// Share of ambient light that arrives at a point.
    pub(crate) fn exposure_at(&self, point: Vec3) -> f32 {
        self.exposure * self.aperture.map_or(1.0, |a| a.share(point))
    }

    /// Whether shading it needs more rays than the light's.
    pub(crate) fn spawns_rays(&self) -> bool {
        self.reflectivity > 0.0 || self.transmission.is_some()
    }
}
