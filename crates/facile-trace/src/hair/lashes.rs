//! Lashes: cards that move and turn with the lids.

use std::sync::Arc;

use facile_core::{HairStyle, Mesh, Point3, ReferenceHead, Segment, Texture, Vector3};

use crate::TraceError;
use crate::cutout::Cutout;
use crate::geometry::Normals;
use crate::material::{Albedo, Material};
use crate::math::{Rgb, vec3_from_vector};
use crate::object::Object;

/// Triangles of the lids that a vertex of the lashes follows.
const ANCHORS: usize = 6;
/// Linear RGB of lashes.
const COLOR: [f32; 3] = [0.012, 0.009, 0.008];

/// The lashes on the reference head, ready for any face.
#[derive(Clone, Debug)]
pub struct LashFit {
    mesh: Mesh,
    strands: Vec<Vector3>,
    cutout: Arc<Cutout>,
    light: Arc<Texture>,
    /// The skin's triangles.
    triangles: Vec<[u32; 3]>,
    /// Triangle, weight and place in the triangle's frame of each vertex.
    anchors: Vec<[(u32, f64, Vector3); ANCHORS]>,
}

/// A triangle's middle and frame: along its first edge, across it, and its normal.
fn frame(positions: &[Point3], triangle: [u32; 3]) -> (Point3, [Vector3; 3]) {
    let [a, b, c] = triangle.map(|v| positions[v as usize]);
    let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
    let along = (b - a).try_normalize(1e-12).unwrap_or_else(Vector3::x);
    let normal = (b - a).cross(&(c - a)).try_normalize(1e-12);
    let normal = normal.unwrap_or_else(Vector3::z);
    (middle, [along, normal.cross(&along), normal])
}

impl LashFit {
    /// The lashes of a reference head.
    ///
    /// # Errors
    /// [`TraceError::SizeMismatch`] for a reference without lids.
    pub fn new(reference: &ReferenceHead) -> Result<Self, TraceError> {
        let style = HairStyle::lashes();
        let skin = &reference.mesh;
        let is_lid = |s: &Segment| matches!(s, Segment::LeftEyelid | Segment::RightEyelid);
        let lids: Vec<(u32, Point3)> = (0..skin.triangles.len())
            .filter(|t| is_lid(&skin.segments[*t]))
            .map(|t| (t as u32, frame(&skin.positions, skin.triangles[t]).0))
            .collect();
        if lids.len() < ANCHORS {
            return Err(TraceError::SizeMismatch {
                what: "triangles of the lids",
                expected: ANCHORS,
                got: lids.len(),
            });
        }
        let anchors = style.mesh.positions.iter().map(|p| {
            let mut near: Vec<(f64, u32)> = lids
                .iter()
                .map(|(t, m)| ((p - m).norm_squared(), *t))
                .collect();
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let total: f64 = near[..ANCHORS].iter().map(|(d, _)| 1.0 / (d + 0.25)).sum();
            std::array::from_fn(|k| {
                let (squared, t) = near[k];
                let (middle, axes) = frame(&skin.positions, skin.triangles[t as usize]);
                let offset = p - middle;
                let local = Vector3::from_fn(|i, _| offset.dot(&axes[i]));
                (t, 1.0 / (squared + 0.25) / total, local)
            })
        });
        Ok(Self {
            anchors: anchors.collect(),
            mesh: style.mesh.clone(),
            strands: style.strands.clone(),
            cutout: Arc::new(Cutout::new(&style.mesh, style.size(), style.cover.clone())?),
            light: Arc::new(style.light.clone()),
            triangles: skin.triangles.clone(),
        })
    }

    /// The vertices on a face given by its fine vertices, mm.
    pub fn positions(&self, skin: &[Point3]) -> Vec<Point3> {
        let place = |anchors: &[(u32, f64, Vector3); ANCHORS]| {
            let sum = anchors
                .iter()
                .fold(Vector3::zeros(), |sum, (t, weight, local)| {
                    let (middle, axes) = frame(skin, self.triangles[*t as usize]);
                    let p = middle + axes[0] * local.x + axes[1] * local.y + axes[2] * local.z;
                    sum + p.coords * *weight
                });
            Point3::from(sum)
        };
        self.anchors.iter().map(place).collect()
    }

    /// The lashes of a face.
    ///
    /// # Errors
    /// As [`Object::new`].
    pub fn object(&self, skin: &[Point3]) -> Result<Object, TraceError> {
        let mesh = Mesh {
            positions: self.positions(skin),
            ..self.mesh.clone()
        };
        let material = Material {
            albedo: Albedo::Texture {
                texture: self.light.clone(),
                tint: Rgb::from(COLOR),
            },
            ..Material::default()
        };
        let strands = self.strands.iter().map(vec3_from_vector).collect();
        Object::new(&mesh, Normals::Smooth, material)?
            .with_strands(strands)?
            .with_cutout(self.cutout.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::UnitQuaternion;

    #[test]
    fn lashes_keep_their_place_and_turn_with_the_lids() {
        let reference = ReferenceHead::embedded();
        let fit = LashFit::new(reference).expect("has lids");
        let own = fit.positions(&reference.mesh.positions);
        for (p, from) in own.iter().zip(&fit.mesh.positions) {
            assert!((p - from).norm() < 1e-9);
        }
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.8, 0.2);
        let turned: Vec<Point3> = reference.mesh.positions.iter().map(|p| turn * p).collect();
        for (p, from) in fit.positions(&turned).iter().zip(&fit.mesh.positions) {
            assert!((p - turn * from).norm() < 1e-9);
        }
    }
}
