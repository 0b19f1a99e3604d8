//! The scan as the registration sees it: cleaned, oriented, in the head frame.

use facile_core::{Isometry3, Mesh, Plane, Point3, Similarity3, Texture, Vector3};

use crate::FlowError;
use crate::channels::{Attributes, ChannelWeights, RawImage, sample_channels};
use crate::curvature::{Operator, vertex_operators};
use crate::decimate::thin_out;
use crate::neighbors::{NONE, TriangleNeighbors};
use crate::radial_map::{CylinderGrid, HOLE, RadialMap};
use crate::surface::Surface;

/// Fewer triangles than this show no face.
const MIN_TRIANGLES: usize = 100;

/// A cleaned scan: what does not change while it is posed.
pub(crate) struct CleanScan {
    /// The scan's own unit. Degenerate and repeated triangles are left out, the rest faces outwards.
    pub(crate) mesh: Mesh,
    /// Unit normals of the vertices.
    pub(crate) normals: Vec<Vector3>,
    pub(crate) neighbors: TriangleNeighbors,
}

/// A scan in the head frame.
pub(crate) struct WorkingScan<'a> {
    /// Head frame, mm.
    pub(crate) mesh: Mesh,
    pub(crate) normals: Vec<Vector3>,
    /// Shape operators in the frame where the scan was first, 1/mm.
    pub(crate) operators: Vec<Operator>,
    pub(crate) texture: Option<&'a Texture>,
    pub(crate) neighbors: TriangleNeighbors,
    /// Vertices on the scan's borders.
    pub(crate) on_border: Vec<bool>,
    /// The surface where the scan was first, and its vertices there; `moved` brings it here.
    surface: Surface,
    first_positions: Vec<Point3>,
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

/// The triangles of `mesh` that have an area, each once, thinned out if they are too many, turned to face outwards.
///
/// # Errors
/// [`FlowError::TooFewTriangles`] if fewer than 100 remain.
pub(crate) fn clean(mesh: &Mesh) -> Result<CleanScan, FlowError> {
    let mut mesh = sound_triangles(&thin_out(mesh))?;
    let neighbors = TriangleNeighbors::new(mesh.positions.len(), &mesh.triangles);
    let turned = neighbors.turned(&mesh);
    let has_texcoords = !mesh.texcoord_triangles.is_empty();
    for t in (0..turned.len()).filter(|t| turned[*t]) {
        mesh.triangles[t].swap(1, 2);
        if has_texcoords {
            mesh.texcoord_triangles[t].swap(1, 2);
        }
    }
    let neighbors = if turned.contains(&true) {
        TriangleNeighbors::new(mesh.positions.len(), &mesh.triangles)
    } else {
        neighbors
    };
    Ok(CleanScan {
        normals: mesh.vertex_normals(),
        mesh,
        neighbors,
    })
}

/// The triangles of `mesh` that have an area, each once.
fn sound_triangles(mesh: &Mesh) -> Result<Mesh, FlowError> {
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
    Ok(Mesh {
        positions: mesh.positions.clone(),
        triangles: pick(&mesh.triangles),
        texcoords: mesh.texcoords.clone(),
        texcoord_triangles: pick(&mesh.texcoord_triangles),
        colors: mesh.colors.clone(),
        segments: Vec::new(),
    })
}

impl<'a> WorkingScan<'a> {
    /// Brings a cleaned scan into the head frame.
    pub(crate) fn new(
        clean: CleanScan,
        texture: Option<&'a Texture>,
        head_from_scan: &Similarity3,
    ) -> Self {
        let CleanScan {
            mut mesh,
            mut normals,
            neighbors,
        } = clean;
        for p in &mut mesh.positions {
            *p = head_from_scan * *p;
        }
        for n in &mut normals {
            *n = head_from_scan.isometry.rotation * *n;
        }
        Self {
            surface: Surface::new(&mesh.positions, &mesh.triangles),
            first_positions: mesh.positions.clone(),
            operators: vertex_operators(&mesh, &normals),
            on_border: neighbors.border_vertices(mesh.positions.len(), &mesh.triangles),
            mesh,
            normals,
            neighbors,
            texture,
            moved: Isometry3::identity(),
            first_from_scan: *head_from_scan,
        }
    }

    /// Brings the scan file's coordinates into the head frame as it is now.
    pub(crate) fn head_from_scan(&self) -> Similarity3 {
        self.moved * self.first_from_scan
    }

    /// The scan's point nearest to `p` within `reach` mm. Cost O(log n).
    pub(crate) fn nearest(&self, p: &Point3, reach: f64) -> Option<Contact> {
        let hit = self.surface.nearest(
            &self.first_positions,
            &self.mesh.triangles,
            &self.moved.inverse_transform_point(p),
            reach,
        )?;
        Some(self.contact(hit.triangle, hit.barycentric))
    }

    fn contact(&self, triangle: u32, barycentric: [f64; 3]) -> Contact {
        let corners = self.mesh.triangles[triangle as usize].map(|v| v as usize);
        let (mut point, mut normal) = (Vector3::zeros(), Vector3::zeros());
        for (v, w) in corners.into_iter().zip(barycentric) {
            point += self.mesh.positions[v].coords * w;
            normal += self.normals[v] * w;
        }
        Contact {
            point: Point3::from(point),
            normal: (normal.try_normalize(1e-12)).unwrap_or(self.normals[corners[0]]),
            triangle,
            barycentric,
        }
    }

    /// As [`Self::nearest`], by a walk from triangle `start`, if it ends within `reach` on a surface that faces `normal`;
    /// else by search. Cost O(1) where the walk is short.
    pub(crate) fn nearest_from(
        &self,
        start: u32,
        p: &Point3,
        normal: &Vector3,
        reach: f64,
    ) -> Option<Contact> {
        if start != NONE {
            let (triangle, barycentric, square) = self.neighbors.walk(&self.mesh, start, p);
            if square < reach * reach {
                let contact = self.contact(triangle, barycentric);
                if contact.normal.dot(normal) > 0.5 && !self.is_on_border(&contact) {
                    return Some(contact);
                }
            }
        }
        self.nearest(p, reach)
    }

    /// Whether a point lies on the scan's border, where the nearest point says nothing about the surface beyond.
    pub(crate) fn is_on_border(&self, contact: &Contact) -> bool {
        let corners = self.mesh.triangles[contact.triangle as usize];
        (0..3).any(|k| contact.barycentric[k] > 1e-6 && self.on_border[corners[k] as usize])
    }

    /// For each vertex 0 on the border, 1/2 one triangle away from it, 1 elsewhere.
    pub(crate) fn distance_from_border(&self) -> Vec<f32> {
        let mut distance: Vec<f32> = (self.on_border.iter())
            .map(|b| if *b { 0.0 } else { 1.0 })
            .collect();
        for corners in &self.mesh.triangles {
            let corners = corners.map(|v| v as usize);
            if corners.iter().any(|v| self.on_border[*v]) {
                for v in corners {
                    distance[v] = distance[v].min(0.5);
                }
            }
        }
        distance
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
    pub(crate) fn view(
        &self,
        grid: CylinderGrid,
        weights: &ChannelWeights,
        curvature_sigma: f64,
    ) -> ScanView {
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
            operators: &self.operators,
            curvature_sigma,
            color: color.as_ref(),
        };
        let raw = sample_channels(&self.mesh, &map, &attributes, |_| 1.0, weights);
        ScanView { map, raw }
    }
}

/// The scan on the cylinder.
pub(crate) struct ScanView {
    pub(crate) map: RadialMap,
    pub(crate) raw: RawImage,
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
        assert_eq!(clean.mesh.triangles.len(), count);
        assert!(clean.normals[84].z > 0.9, "turned outwards");
        mesh.triangles.truncate(50);
        assert!(matches!(
            super::clean(&mesh),
            Err(FlowError::TooFewTriangles { triangles: 50, .. })
        ));
    }
}
