//! A scene: objects and a background, and the ray queries over all of them.

use crate::backdrop::Backdrop;
use crate::math::{Rgb, Vec3};
use crate::object::Object;
use crate::ray::{Hit, Ray};

/// Which objects a query sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// All visible objects.
    All,
    /// Visible objects that are no occluders: the face as if nothing were in front of it.
    BehindOccluders,
}

impl Layer {
    pub(crate) fn sees(self, object: &Object) -> bool {
        object.is_visible && !(self == Self::BehindOccluders && object.is_occluder)
    }
}

/// Objects and a background. Hits name objects by the index that [`Scene::add`] gave.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    objects: Vec<Object>,
    /// Linear RGB where no ray hits.
    pub background: Rgb,
    /// What is seen there instead.
    pub backdrop: Option<Backdrop>,
}

impl Scene {
    /// An empty scene.
    pub fn new(background: Rgb) -> Self {
        Self {
            objects: Vec::new(),
            background,
            backdrop: None,
        }
    }

    /// Adds an object and returns its index.
    pub fn add(&mut self, object: Object) -> usize {
        self.objects.push(object);
        self.objects.len() - 1
    }

    /// All objects.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// All objects, to move or hide.
    pub fn objects_mut(&mut self) -> &mut [Object] {
        &mut self.objects
    }

    /// Drops all objects from index `len` on, such as the occluders added last.
    pub fn truncate(&mut self, len: usize) {
        self.objects.truncate(len);
    }

    /// Boxes in the world around the objects of a layer.
    pub fn bounds_in_world(&self, layer: Layer) -> impl Iterator<Item = (Vec3, Vec3)> {
        self.objects
            .iter()
            .filter(move |o| layer.sees(o))
            .filter_map(Object::bounds_in_world)
    }

    /// The nearest hit, one ray at a time. Of equal distances the lower object, then the lower triangle wins.
    pub fn closest_hit(&self, ray: &Ray, layer: Layer) -> Option<Hit> {
        let mut best = Hit {
            t: ray.t_max,
            ..Hit::MISS
        };
        for (index, object) in self.objects.iter().enumerate() {
            if !layer.sees(object) {
                continue;
            }
            let ray = Ray {
                t_max: best.t,
                ..object.ray_in_object(ray)
            };
            if let Some(hit) = object.closest_hit(&ray) {
                best = Hit {
                    t: hit.t,
                    object: index as u32,
                    triangle: hit.triangle,
                    u: hit.u,
                    v: hit.v,
                };
            }
        }
        best.ok()
    }

    /// Whether an opaque object lies between the ends of a ray.
    pub fn any_opaque_hit(&self, ray: &Ray) -> bool {
        self.objects
            .iter()
            .filter(|o| o.is_visible && !o.is_transparent())
            .any(|o| o.any_hit(&o.ray_in_object(ray)))
    }

    /// Linear RGB share of light that comes through between the ends of a ray: 0 behind anything opaque, the product
    /// of the tints behind transparent surfaces.
    pub fn transmittance(&self, ray: &Ray) -> Rgb {
        if self.any_opaque_hit(ray) {
            Rgb::zeros()
        } else {
            self.tint(ray)
        }
    }

    /// As [`Scene::transmittance`] of the occluders alone.
    pub fn transmittance_of_occluders(&self, ray: &Ray) -> Rgb {
        let occluders = self
            .objects
            .iter()
            .filter(|o| o.is_visible && o.is_occluder);
        occluders.fold(Rgb::repeat(1.0), |share, object| {
            share.component_mul(&object.transmittance(ray))
        })
    }

    /// As [`Scene::transmittance`], opaque objects left out.
    pub(crate) fn tint(&self, ray: &Ray) -> Rgb {
        let mut share = Rgb::repeat(1.0);
        for object in self
            .objects
            .iter()
            .filter(|o| o.is_visible && o.is_transparent())
        {
            share.component_mul_assign(&object.transmittance(ray));
        }
        share
    }

    /// Whether any visible object lets light through.
    pub(crate) fn has_transparency(&self) -> bool {
        self.objects
            .iter()
            .any(|o| o.is_visible && o.is_transparent())
    }
}
