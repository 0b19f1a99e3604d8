//! An object of a scene: a mesh with its tree, pose and materials.

use facile_core::{Mesh, Point3, Segment};

use crate::TraceError;
use crate::bvh::Bvh;
use crate::geometry::{Geometry, Normals};
use crate::material::Material;
use crate::math::{Pose, Rgb, Vec3};
use crate::ray::{Hit, Ray};

/// Gives the part of a surface around an axis a class of its own, such as the iris of an eyeball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentCap {
    /// Where the cap is measured from, object frame, mm.
    pub center: Vec3,
    /// Unit direction to the cap's middle, object frame.
    pub axis: Vec3,
    /// Cosine of the angle at the cap's rim.
    pub cos_angle: f32,
    /// Class of the cap.
    pub segment: Segment,
}

/// A mesh in a scene. Moving it as a whole ([`Object::set_pose`]) costs nothing; moving its vertices
/// ([`Object::set_positions`]) refits its tree.
#[derive(Clone, Debug)]
pub struct Object {
    pub(crate) geometry: Geometry,
    pub(crate) bvh: Bvh,
    pub(crate) materials: Vec<Material>,
    /// Material of each triangle; empty when all have the first.
    pub(crate) material_of_triangle: Vec<u16>,
    pub(crate) caps: Vec<SegmentCap>,
    /// `None` is the identity, which keeps coordinates bit for bit.
    pub(crate) world_from_object: Option<Pose>,
    pub(crate) is_occluder: bool,
    pub(crate) is_visible: bool,
}

impl Object {
    /// A visible object at its mesh's place.
    ///
    /// # Errors
    /// As [`Geometry::new`] and [`Bvh::build`].
    pub fn new(mesh: &Mesh, shading: Normals, material: Material) -> Result<Self, TraceError> {
        Self::like(None, mesh, shading, material)
    }

    /// As [`Self::new`]. If `other` has the same triangles its tree is refitted, which takes a twentieth of building one.
    /// The answers of queries do not depend on the tree.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn like(
        other: Option<&Self>,
        mesh: &Mesh,
        shading: Normals,
        material: Material,
    ) -> Result<Self, TraceError> {
        let geometry = Geometry::new(mesh, shading)?;
        let bvh = match other.filter(|o| o.geometry.triangles == geometry.triangles) {
            Some(other) => {
                let mut bvh = other.bvh.clone();
                bvh.refit(&geometry.positions, &geometry.triangles);
                bvh
            }
            None => Bvh::build(&geometry.positions, &geometry.triangles)?,
        };
        Ok(Self {
            geometry,
            bvh,
            materials: vec![material],
            material_of_triangle: Vec::new(),
            caps: Vec::new(),
            world_from_object: None,
            is_occluder: false,
            is_visible: true,
        })
    }

    /// The same object with another material where `of(segment)` is true; later calls win.
    pub fn with_material(mut self, material: Material, of: impl Fn(Segment) -> bool) -> Self {
        let index = self.materials.len() as u16;
        self.materials.push(material);
        self.material_of_triangle
            .resize(self.geometry.triangles.len(), 0);
        for (t, slot) in self.material_of_triangle.iter_mut().enumerate() {
            if of(self.geometry.segment(t as u32)) {
                *slot = index;
            }
        }
        self
    }

    /// The same object with a cap of another class, see [`SegmentCap`].
    pub fn with_cap(mut self, cap: SegmentCap) -> Self {
        self.caps.push(cap);
        self
    }

    /// The same object with given unit normals, one per vertex, instead of computed ones. When vertices move, normals
    /// are computed again.
    ///
    /// # Errors
    /// [`TraceError::SizeMismatch`] or [`TraceError::NotFinite`]; a zero normal counts as the computed one.
    pub fn with_vertex_normals(mut self, normals: Vec<Vec3>) -> Result<Self, TraceError> {
        self.geometry.set_normals(normals)?;
        Ok(self)
    }

    /// The same object marked as an occluder: something in front of the face that amodal truth looks through.
    pub fn as_occluder(mut self) -> Self {
        self.is_occluder = true;
        self
    }

    /// Places the object: `world_from_object` takes its mesh's coordinates to the world.
    ///
    /// # Errors
    /// [`TraceError::NotFinite`] for a pose that is not finite.
    pub fn set_pose(&mut self, world_from_object: &Pose) -> Result<(), TraceError> {
        let matrix = world_from_object.to_homogeneous();
        if !matrix.iter().all(|v| v.is_finite()) {
            return Err(TraceError::NotFinite {
                what: "object pose",
                index: 0,
                value: format!("{world_from_object:?}"),
            });
        }
        let is_identity = *world_from_object == Pose::identity();
        self.world_from_object = (!is_identity).then_some(*world_from_object);
        Ok(())
    }

    /// Moves the vertices, mm, object frame; refits the tree. Cost O(n).
    ///
    /// # Errors
    /// [`TraceError::SizeMismatch`] for another number of vertices, [`TraceError::NotFinite`] for a bad one; the object
    /// is then unchanged.
    pub fn set_positions(&mut self, positions: &[Point3]) -> Result<(), TraceError> {
        self.geometry.set_positions(positions)?;
        self.bvh
            .refit(&self.geometry.positions, &self.geometry.triangles);
        Ok(())
    }

    /// Shows or hides the object: a hidden one is in no image, shadow or label, and costs nothing.
    pub fn set_visible(&mut self, is_visible: bool) {
        self.is_visible = is_visible;
    }

    /// The mesh as the tracer keeps it.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// The tree.
    pub fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// The materials; the first is the default.
    pub fn materials_mut(&mut self) -> &mut [Material] {
        &mut self.materials
    }

    /// Whether the object is marked as an occluder.
    pub fn is_occluder(&self) -> bool {
        self.is_occluder
    }

    /// Whether light passes through any of its materials.
    pub fn is_transparent(&self) -> bool {
        self.materials.iter().any(Material::is_transparent)
    }

    /// Whether light spreads under any of its materials.
    pub(crate) fn scatters(&self) -> bool {
        self.is_visible && self.materials.iter().any(|m| m.scatter_mm.max() > 0.0)
    }

    /// Material of a triangle.
    pub fn material(&self, triangle: u32) -> &Material {
        let index = self.material_of_triangle.get(triangle as usize);
        &self.materials[index.map_or(0, |m| usize::from(*m))]
    }

    /// Class of the surface at a hit, caps included.
    pub fn segment_at(&self, hit: &Hit) -> Segment {
        let base = self.geometry.segment(hit.triangle);
        self.caps.iter().fold(base, |segment, cap| {
            let [a, b, c] = self.geometry.corners(hit.triangle);
            let [wa, wb, wc] = hit.barycentric();
            let offset = a * wa + b * wb + c * wc - cap.center;
            if offset.dot(&cap.axis) >= cap.cos_angle * offset.norm() {
                cap.segment
            } else {
                segment
            }
        })
    }

    /// Linear RGB share of light that comes through the object between the ends of a ray of the world.
    pub(crate) fn transmittance(&self, ray: &Ray) -> Rgb {
        let mut share = Rgb::repeat(1.0);
        let mut rest = self.ray_in_object(ray);
        while let Some(hit) = self.bvh.closest_hit(&rest) {
            match &self.material(hit.triangle).transmission {
                Some(transmission) => share.component_mul_assign(&transmission.tint()),
                None => return Rgb::zeros(),
            }
            if share.max() <= 0.0 {
                break;
            }
            rest.t_min = hit.t;
        }
        share
    }

    /// The ray in the object's frame; its parameter keeps its meaning.
    pub(crate) fn ray_in_object(&self, ray: &Ray) -> Ray {
        match &self.world_from_object {
            None => *ray,
            Some(pose) => Ray {
                origin: pose.rotation.inverse() * (ray.origin - pose.translation.vector),
                direction: pose.rotation.inverse() * ray.direction,
                ..*ray
            },
        }
    }

    pub(crate) fn vector_in_world(&self, v: Vec3) -> Vec3 {
        self.world_from_object
            .as_ref()
            .map_or(v, |pose| pose.rotation * v)
    }

    pub(crate) fn point_in_world(&self, p: Vec3) -> Vec3 {
        self.world_from_object
            .as_ref()
            .map_or(p, |pose| pose.rotation * p + pose.translation.vector)
    }

    /// Smallest and largest corner in the world of a box around the object. `None` without triangles.
    pub fn bounds_in_world(&self) -> Option<(Vec3, Vec3)> {
        let (min, max) = self.bvh.bounds()?;
        let Some(pose) = &self.world_from_object else {
            return Some((min, max));
        };
        let matrix = pose.rotation.to_rotation_matrix();
        let (center, half) = ((min + max) * 0.5, (max - min) * 0.5);
        let center = pose.rotation * center + pose.translation.vector;
        // A share more than the extent pays for rounding
        let half = matrix.matrix().abs() * half * 1.000_01 + center.abs() * 1e-6;
        Some((center - half, center + half))
    }
}
