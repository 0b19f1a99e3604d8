//! What the materials of eight surface points are, lane by lane.

use facile_core::Texture;

use crate::lanes::{Eight, LANES};
use crate::material::{Albedo, Material};
use crate::math::Rgb;

/// What eight materials are. Lanes without one hold any.
#[derive(Default)]
pub(super) struct Look<'a> {
    /// The material of all lanes, if they have the same.
    pub(super) of_all: Option<&'a Material>,
    pub(super) exposure: Eight,
    pub(super) specular: Eight,
    pub(super) shininess: Eight,
    pub(super) roughness: Eight,
    pub(super) reflectivity: Eight,
    pub(super) tint: [Eight; 3],
    /// Columns and rows of the texture, 1 without one.
    pub(super) size: [Eight; 2],
    /// Whether no lane has a texture of several texels.
    pub(super) is_plain: bool,
    /// Lanes that let light pass.
    pub(super) transparent: u32,
    /// Lanes that send out rays of their own.
    pub(super) spawns: u32,
}

impl<'a> Look<'a> {
    /// Takes over eight materials; neighbours mostly have the one of the eight before.
    #[inline(always)]
    pub(super) fn take(&mut self, materials: &[Option<&'a Material>; LANES]) {
        let mut present = materials.iter().flatten();
        let Some(first) = present.next() else {
            return;
        };
        if present.all(|m| std::ptr::eq(*m, *first)) {
            if !self.of_all.is_some_and(|m| std::ptr::eq(m, *first)) {
                (0..LANES).for_each(|lane| self.set(lane, first));
                self.of_all = Some(first);
                self.is_plain = texture_of(first).is_none();
            }
            return;
        }
        self.is_plain = false;
        self.of_all = None;
        for (lane, material) in materials.iter().enumerate() {
            if let Some(material) = material {
                self.set(lane, material);
            }
        }
    }

    fn set(&mut self, lane: usize, material: &Material) {
        self.exposure.0[lane] = material.exposure;
        self.specular.0[lane] = material.specular;
        self.shininess.0[lane] = material.shininess;
        self.roughness.0[lane] = material.roughness;
        self.reflectivity.0[lane] = material.reflectivity;
        let (size, tint) = match &material.albedo {
            Albedo::Texture { texture, tint } => {
                ([texture.width() as f32, texture.height() as f32], *tint)
            }
            Albedo::Constant(_) | Albedo::VertexColor => ([1.0; 2], Rgb::repeat(1.0)),
        };
        for k in 0..2 {
            self.size[k].0[lane] = size[k];
        }
        for k in 0..3 {
            self.tint[k].0[lane] = tint[k];
        }
        let bit = 1 << lane;
        self.transparent &= !bit;
        self.spawns &= !bit;
        self.transparent |= u32::from(material.is_transparent()) << lane;
        self.spawns |= u32::from(material.spawns_rays()) << lane;
    }
}

pub(super) fn texture_of(material: &Material) -> Option<&Texture> {
    match &material.albedo {
        Albedo::Texture { texture, .. } => Some(texture),
        Albedo::Constant(_) | Albedo::VertexColor => None,
    }
}
