//! What the registration needs to know of a reference head, prepared once for many scans.

use facile_core::{Mesh, Plane, Point3, ReferenceHead, Segment, Vector3};

use crate::FlowError;
use crate::adjacency::Adjacency;
use crate::cage::CageFit;
use crate::channels::{Attributes, ChannelWeights, RawImage, sample_channels};
use crate::curvature::vertex_operators;
use crate::lips::Slit;
use crate::radial_map::{CylinderGrid, HOLE, RadialMap, visible_vertices};

/// A vertex this far below the outermost surface is hidden, mm.
const VISIBLE_SLACK: f64 = 1.5;

/// A reference head with its operators and masks.
pub(crate) struct Template<'a> {
    pub(crate) reference: &'a ReferenceHead,
    pub(crate) cage_fit: CageFit,
    /// Where the lips touch.
    pub(crate) slit: Slit,
    /// Neighbours on the fine mesh.
    pub(crate) adjacency: Adjacency,
    /// Neighbours on the cage.
    pub(crate) cage_adjacency: Adjacency,
    /// How far each fine triangle takes part in the flow, `[0, 1]`.
    pub(crate) flow_trust: Vec<f32>,
    /// How far each fine vertex may be drawn to the scan's surface, `[0, 1]`: 0 inside mouth and sockets.
    pub(crate) skin: Vec<f64>,
    /// Whether each fine vertex belongs to the face: outer skin from forehead to chin, between the ears.
    pub(crate) face: Vec<bool>,
    /// Whether each fine vertex belongs to an ear.
    pub(crate) is_ear: Vec<bool>,
    /// Area of each fine vertex, mm^2.
    pub(crate) areas: Vec<f64>,
    /// A number without pattern of each fine vertex that it shares with its mirror image.
    pub(crate) pair: Vec<u32>,
    /// Linear RGB at each fine vertex, from the mean texture.
    pub(crate) colors: Vec<Vector3>,
}

impl<'a> Template<'a> {
    pub(crate) fn new(reference: &'a ReferenceHead) -> Result<Self, FlowError> {
        let mesh = &reference.mesh;
        let flow_trust = mesh
            .segments
            .iter()
            .map(|s| match s {
                Segment::InnerMouth | Segment::EyeSocket => 0.0,
                Segment::Scalp => 0.3,
                Segment::Neck => 0.5,
                _ => 1.0,
            })
            .collect();
        let skin = skin_trust(mesh);
        let adjacency = Adjacency::from_triangles(mesh.positions.len(), &mesh.triangles);
        Ok(Self {
            slit: Slit::new(reference, &adjacency),
            reference,
            cage_fit: CageFit::new(reference)?,
            adjacency,
            cage_adjacency: Adjacency::from_faces(
                reference.cage.positions.len(),
                &reference.cage.faces,
            ),
            flow_trust,
            face: (mesh.positions.iter().zip(&skin))
                .map(|(p, skin)| in_front(p) && *skin > 0.0)
                .collect(),
            is_ear: of_ears(mesh),
            skin,
            areas: vertex_areas(&mesh.positions, &mesh.triangles),
            pair: pairs(reference),
            colors: vertex_colors(reference),
        })
    }

    /// Positions of the fine vertices from those of the cage.
    pub(crate) fn fine(&self, cage: &[Vector3]) -> Vec<Point3> {
        let stencils = &self.reference.subdivision.stencils;
        stencils
            .apply(cage, Vector3::zeros())
            .into_iter()
            .map(Point3::from)
            .collect()
    }

    /// The template in a shape, as the cylinder shows it.
    pub(crate) fn view(
        &self,
        positions: Vec<Point3>,
        grid: CylinderGrid,
        weights: &ChannelWeights,
        curvature_sigma: f64,
        with_color: bool,
    ) -> TemplateView {
        let mesh = Mesh {
            positions,
            triangles: self.reference.mesh.triangles.clone(),
            ..Mesh::default()
        };
        let normals = mesh.vertex_normals();
        let map = RadialMap::cast(&mesh.positions, &mesh.triangles, grid);
        let visible = visible_vertices(&map, &mesh.positions, VISIBLE_SLACK);
        let operators = vertex_operators(&mesh, &normals);
        let color = with_color.then(|| {
            Plane::from_fn(grid.width, grid.height, |x, y| {
                map.interpolate(&mesh.triangles, &self.colors, x, y)
                    .map_or([0.0; 3], |c| [c.x as f32, c.y as f32, c.z as f32])
            })
        });
        let attributes = Attributes {
            normals: &normals,
            operators: &operators,
            curvature_sigma,
            color: color.as_ref(),
        };
        let trust = |t: u32| {
            if t == HOLE {
                0.0
            } else {
                self.flow_trust[t as usize]
            }
        };
        let raw = sample_channels(&mesh, &map, &attributes, trust, weights);
        let ears = [Segment::LeftEar, Segment::RightEar].map(|ear| {
            let is_ear = |t: u32| t != HOLE && self.reference.mesh.segments[t as usize] == ear;
            map.triangle.map(|t| is_ear(*t))
        });
        TemplateView {
            mesh,
            normals,
            visible,
            ears,
            raw,
        }
    }
}

/// A number of each fine vertex that it shares with its mirror image and few others: from the cage vertices that it hangs
/// on, in the order of their pairs.
fn pairs(reference: &ReferenceHead) -> Vec<u32> {
    let stencils = &reference.subdivision.stencils;
    let mirror = &reference.cage.mirror;
    (0..stencils.len())
        .map(|v| {
            // Sums do not depend on the order of a stencil's entries; weights are the same on both sides.
            let sum = stencils.row(v).iter().fold(0_u32, |sum, &(u, w)| {
                let pair = u.min(mirror[u as usize]).wrapping_add(1);
                let weight = (w * 1024.0).round() as i64 as u32;
                sum.wrapping_add(pair.wrapping_mul(weight.wrapping_mul(0x9E37_79B1) | 1))
            });
            sum.wrapping_mul(0x85EB_CA6B) >> 8
        })
        .collect()
}

/// The template in one shape.
pub(crate) struct TemplateView {
    pub(crate) mesh: Mesh,
    pub(crate) normals: Vec<Vector3>,
    pub(crate) visible: Vec<bool>,
    /// The cells that show the left and the right ear.
    pub(crate) ears: [Plane<bool>; 2],
    pub(crate) raw: RawImage,
}

/// Whether a point in the head frame lies between forehead and chin, ear and ear.
pub(crate) fn in_front(p: &Point3) -> bool {
    let frontal = libm::atan2(p.x, p.z).abs() < 1.15 && p.z > 30.0;
    frontal && (-110.0..60.0).contains(&p.y)
}

/// A third of the area of each vertex's triangles, mm^2.
pub(crate) fn vertex_areas(positions: &[Point3], triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut areas = vec![0.0; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let area = 0.5 * (b - a).cross(&(c - a)).norm();
        for &v in t {
            areas[v as usize] += area / 3.0;
        }
    }
    areas
}

/// Which vertices belong to an ear.
fn of_ears(mesh: &Mesh) -> Vec<bool> {
    let mut of_ears = vec![false; mesh.positions.len()];
    for (triangle, segment) in mesh.triangles.iter().zip(&mesh.segments) {
        if matches!(segment, Segment::LeftEar | Segment::RightEar) {
            for &v in triangle {
                of_ears[v as usize] = true;
            }
        }
    }
    of_ears
}

/// How far each vertex may be drawn to a scan: what scans do not show must follow its surroundings.
fn skin_trust(mesh: &Mesh) -> Vec<f64> {
    /// Ears: thin, folded, half hidden; the nearest point of a scan is often the wrong side.
    const EAR: f64 = 0.05;
    let normals = mesh.vertex_normals();
    let mut skin = vec![1.0_f64; mesh.positions.len()];
    for (triangle, segment) in mesh.triangles.iter().zip(&mesh.segments) {
        for v in triangle.map(|v| v as usize) {
            let limit = match segment {
                Segment::InnerMouth | Segment::EyeSocket => 0.0,
                Segment::LeftEar | Segment::RightEar => EAR,
                // The faces with which the lips touch each other look up and down: scans show one closed surface.
                Segment::UpperLip | Segment::LowerLip => {
                    ((normals[v].z - 0.15) / 0.35).clamp(0.0, 1.0)
                }
                _ => 1.0,
            };
            skin[v] = skin[v].min(limit);
        }
    }
    skin
}

fn vertex_colors(reference: &ReferenceHead) -> Vec<Vector3> {
    let mesh = &reference.mesh;
    let mut colors = vec![Vector3::zeros(); mesh.positions.len()];
    for (corners, texcoords) in mesh.triangles.iter().zip(&mesh.texcoord_triangles) {
        for (v, t) in corners.iter().zip(texcoords) {
            let rgb = reference.texture.sample(mesh.texcoords[*t as usize]);
            colors[*v as usize] = Vector3::from(rgb.map(f64::from));
        }
    }
    colors
}
