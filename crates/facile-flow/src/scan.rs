//! The scan as the registration sees it: cleaned, oriented, in the head frame.

use facile_core::{Isometry3, Mesh, Plane, Point3, Similarity3, Texture, Vector3};

use crate::FlowError;
use crate::adjacency::Adjacency;
use crate::channels::{Attributes, ChannelWeights, CylinderImage, cylinder_image};
use crate::curvature::{Curvature, vertex_curvature};
use crate::radial_map::{CylinderGrid, HOLE, RadialMap};
use crate::surface::Surface;

/// Fewer triangles than this show no face.
const MIN_TRIANGLES: usize = 100;

/// A scan with what does not change while it is posed: curvature in 1/mm needs the unit, so it comes with the pose.
pub(crate) struct WorkingScan<'a> {
    /// Head frame, mm. Degenerate and repeated triangles are left out.
    pub(crate) mesh: Mesh,
    pub(crate) normals: Vec<Vector3>,
    pub(crate) curvature: Curvature,
    pub(crate) texture: Option<&'a Texture>,
    /// Vertices on the scan's borders.
    pub(crate) on_border: Vec<bool>,
    /// The surface where the scan was first; `moved` brings it here.
    surface: Surface,
    moved: Isometry3,
    first_from_scan: Similarity3,
}

/// A point of the scan.
pub(crate) struct Contact {
    /// Head frame, mm.
    pub(crate) point: Point3,
    /// Unit normal there.
    pub(crate) normal: Vector3,
    pub(crate) triangle: u32,
    pub(crate) barycentric: [f64; 3],
}

/// The triangles of `mesh` that have an area, each once; flipped as a whole if they face inwards.
///
/// # Errors
/// [`FlowError::TooFewTriangles`] if fewer than 100 remain.
pub(crate) fn clean(mesh: &Mesh) -> Result<Mesh, FlowError> {
    let mut seen: Vec<([u32; 3], u32)> = Vec::with_capacity(mesh.triangles.len());
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        if (b - a).cross(&(c - a)).norm() > 1e-6 * longest * longest {
            let mut key = *triangle;
            key.sort_unstable();
            seen.push((key, t as u32));
        }
    }
    seen.sort_unstable();
    seen.dedup_by_key(|s| s.0);
    let mut kept: Vec<u32> = seen.into_iter().map(|s| s.1).collect();
    kept.sort_unstable();
    if kept.len() < MIN_TRIANGLES {
        return Err(FlowError::TooFewTriangles {
            triangles: kept.len(),
            needed: MIN_TRIANGLES,
        });
    }
    let pick = |list: &[[u32; 3]]| -> Vec<[u32; 3]> {
        if list.is_empty() {
            return Vec::new();
        }
        kept.iter().map(|&t| list[t as usize]).collect()
    };
    let mut clean = Mesh {
        positions: mesh.positions.clone(),
        triangles: pick(&mesh.triangles),
        texcoords: mesh.texcoords.clone(),
        texcoord_triangles: pick(&mesh.texcoord_triangles),
        colors: mesh.colors.clone(),
        segments: Vec::new(),
    };
    if faces_inwards(&clean) {
        for t in clean
            .triangles
            .iter_mut()
            .chain(&mut clean.texcoord_triangles)
        {
            t.swap(1, 2);
        }
    }
    Ok(clean)
}

/// Whether the normals point towards the centre of the surface on the whole.
fn faces_inwards(mesh: &Mesh) -> bool {
    let (mut center, mut total) = (Vector3::zeros(), 0.0);
    let facets: Vec<(Vector3, Vector3)> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (
                (a.coords + b.coords + c.coords) / 3.0,
                (b - a).cross(&(c - a)),
            )
        })
        .collect();
    for (at, area) in &facets {
        center += at * area.norm();
        total += area.norm();
    }
    center /= total;
    facets
        .iter()
        .map(|(at, area)| (at - center).dot(area))
        .sum::<f64>()
        < 0.0
}

impl<'a> WorkingScan<'a> {
    /// Brings a cleaned scan into the head frame and estimates its curvature.
    pub(crate) fn new(
        mut mesh: Mesh,
        texture: Option<&'a Texture>,
        head_from_scan: &Similarity3,
        curvature_sigma: f64,
    ) -> Result<Self, FlowError> {
        for p in &mut mesh.positions {
            *p = head_from_scan * *p;
        }
        let normals = mesh.vertex_normals();
        let (curvature, surface) = rayon::join(
            || vertex_curvature(&mesh, &normals, curvature_sigma),
            || Surface::new(&mesh, normals.clone()),
        );
        let on_border = Adjacency::from_triangles(mesh.positions.len(), &mesh.triangles).on_border;
        Ok(Self {
            surface: surface.ok_or(FlowError::TooFewTriangles {
                triangles: mesh.triangles.len(),
                needed: MIN_TRIANGLES,
            })?,
            mesh,
            normals,
            curvature,
            texture,
            on_border,
            moved: Isometry3::identity(),
            first_from_scan: *head_from_scan,
        })
    }

    /// Brings the scan file's coordinates into the head frame as it is now.
    pub(crate) fn head_from_scan(&self) -> Similarity3 {
        self.moved * self.first_from_scan
    }

    /// The scan's point nearest to `p` within `reach` mm. Cost O(log n).
    pub(crate) fn nearest(&self, p: &Point3, reach: f64) -> Option<Contact> {
        let hit = self
            .surface
            .nearest(&self.moved.inverse_transform_point(p), reach)?;
        Some(Contact {
            point: self.moved * hit.point,
            normal: self.moved.rotation * self.surface.normal(&hit),
            triangle: hit.triangle,
            barycentric: hit.barycentric,
        })
    }

    /// Whether a point lies on the scan's border, where the nearest point says nothing about the surface beyond.
    pub(crate) fn is_on_border(&self, contact: &Contact) -> bool {
        let corners = self.mesh.triangles[contact.triangle as usize];
        (0..3).any(|k| contact.barycentric[k] > 1e-6 && self.on_border[corners[k] as usize])
    }

    /// Moves the scan rigidly.
    pub(crate) fn transform(&mut self, motion: &Isometry3) {
        self.moved = motion * self.moved;
        for p in &mut self.mesh.positions {
            *p = motion * *p;
        }
        for n in &mut self.normals {
            *n = motion.rotation * *n;
        }
    }

    /// Whether the scan has colour.
    pub(crate) fn has_color(&self) -> bool {
        let textured = self.texture.is_some() && !self.mesh.texcoord_triangles.is_empty();
        textured || !self.mesh.colors.is_empty()
    }

    /// Linear RGB at a point of a triangle. `None` if the scan has no colour.
    pub(crate) fn color(&self, triangle: u32, [u, v, w]: [f64; 3]) -> Option<[f32; 3]> {
        let t = triangle as usize;
        let (u, v, w) = (u as f32, v as f32, w as f32);
        if let (Some(texture), Some(corners)) = (self.texture, self.mesh.texcoord_triangles.get(t))
        {
            let [a, b, c] = corners.map(|i| self.mesh.texcoords[i as usize]);
            let at = |k: usize| a[k] * u + b[k] * v + c[k] * w;
            return Some(texture.sample([at(0), at(1)]));
        }
        if self.mesh.colors.is_empty() {
            return None;
        }
        let [a, b, c] = self.mesh.triangles[t].map(|i| self.mesh.colors[i as usize]);
        Some(std::array::from_fn(|k| a[k] * u + b[k] * v + c[k] * w))
    }

    /// The scan as the cylinder shows it.
    pub(crate) fn view(&self, grid: CylinderGrid, weights: &ChannelWeights) -> ScanView {
        let map = RadialMap::cast(&self.mesh.positions, &self.mesh.triangles, grid);
        let color = self.has_color().then(|| {
            Plane::from_fn(grid.width, grid.height, |x, y| {
                let t = map.triangle[(x, y)];
                if t == HOLE {
                    return [0.0; 3];
                }
                let [v, w] = map.weights[(x, y)].map(f64::from);
                self.color(t, [1.0 - v - w, v, w]).unwrap_or_default()
            })
        });
        let attributes = Attributes {
            normals: &self.normals,
            curvature: &self.curvature,
            color: color.as_ref(),
        };
        let image = cylinder_image(&self.mesh, &map, &attributes, |_| 1.0, weights);
        ScanView { map, image }
    }
}

/// The scan on the cylinder.
pub(crate) struct ScanView {
    pub(crate) map: RadialMap,
    pub(crate) image: CylinderImage,
}

impl ScanView {
    /// The scan's point at a continuous cell position, mm. `None` next to holes and where the radius jumps.
    pub(crate) fn point(&self, [x, y]: [f64; 2]) -> Option<Point3> {
        /// Neighbouring cells whose radii differ by more lie on two surfaces, mm.
        const JUMP: f64 = 6.0;
        let grid = &self.map.grid;
        let (nx, ny) = (grid.width as f64, grid.height as f64);
        if !(x >= 0.0 && y >= 0.0 && x < nx - 1.0 && y < ny - 1.0) {
            return None;
        }
        let (x0, y0) = (x as usize, y as usize);
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let r = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| self.map.radius[(x0 + i, y0 + j)]);
        let low = r.iter().copied().fold(f64::INFINITY, f64::min);
        let high = r.iter().copied().fold(0.0, f64::max);
        if low <= 0.0 || high - low > JUMP {
            return None;
        }
        let lower = r[0] + (r[1] - r[0]) * fx;
        let upper = r[2] + (r[3] - r[2]) * fx;
        let (h, phi) = grid.cylinder_from_cell([x, y]);
        Some(facile_core::math::point_from_cylinder(
            h,
            phi,
            lower + (upper - lower) * fy,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_and_repeated_triangles_are_left_out_and_inside_out_is_turned() {
        let mut mesh = Mesh::default();
        let n = 12_u32;
        for j in 0..=n {
            for i in 0..=n {
                let (x, y) = (f64::from(i) - 6.0, f64::from(j) - 6.0);
                mesh.positions
                    .push(Point3::new(x, y, -0.05 * (x * x + y * y)));
            }
        }
        for j in 0..n {
            for i in 0..n {
                let (v, w) = (j * (n + 1) + i, n + 1);
                mesh.triangles.push([v, v + w, v + 1]);
                mesh.triangles.push([v + 1, v + w, v + w + 1]);
            }
        }
        let count = mesh.triangles.len();
        let [a, b, c] = mesh.triangles[3];
        mesh.triangles.extend([[a, a, b], [c, a, b]]);
        let clean = clean(&mesh).expect("enough");
        assert_eq!(clean.triangles.len(), count);
        assert!(clean.vertex_normals()[84].z > 0.9, "turned outwards");
        mesh.triangles.truncate(50);
        assert!(matches!(
            super::clean(&mesh),
            Err(FlowError::TooFewTriangles { triangles: 50, .. })
        ));
    }
}
