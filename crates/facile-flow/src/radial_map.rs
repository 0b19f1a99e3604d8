//! The radial map of eq. 1: the outermost surface around the cylinder's axis, cell by cell.
//!
//! A cell is one ray from the axis at height `h` and angle `phi`. The map keeps which triangle the ray leaves the head
//! through and where, so that any quantity of the mesh can be read at the cell. Cells without surface are holes. The
//! range of angles ends before the back of the head, so no face crosses a seam.

use facile_core::math::{cylinder_from_point, radius_of_point};
use facile_core::{Plane, Point3, Vector3};

/// How far outside a triangle a ray may pass and still hit it, in barycentric weight: no ray slips between neighbours.
const EDGE_SLACK: f64 = -1e-9;

/// Marks a cell without surface.
pub const HOLE: u32 = u32::MAX;

/// The cells of a radial map: columns are angles, rows are heights, both growing with the index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CylinderGrid {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Angle of the left border of column 0, rad.
    pub phi_min: f64,
    /// Height of the lower border of row 0, mm.
    pub h_min: f64,
    /// Angle of one column, rad.
    pub phi_step: f64,
    /// Height of one row, mm.
    pub h_step: f64,
}

impl CylinderGrid {
    /// A grid over `|phi| <= phi_max` (rad) and `[h_min, h_max]` (mm) whose cells are `cell` mm squares at radius
    /// `radius` (mm), a little narrower where that makes the columns a multiple of eight: then each level of a pyramid
    /// halves them, and left and right stay mirror images.
    pub fn new(phi_max: f64, h_min: f64, h_max: f64, cell: f64, radius: f64) -> Self {
        let width = ((2.0 * phi_max * radius / cell).ceil().max(1.0) as usize).next_multiple_of(8);
        let height = ((h_max - h_min) / cell).ceil().max(1.0) as usize;
        Self {
            width,
            height,
            phi_min: -phi_max,
            h_min,
            phi_step: 2.0 * phi_max / width as f64,
            h_step: cell,
        }
    }

    /// Continuous cell position `[x, y]` of `(h, phi)`: cell centres lie at whole numbers.
    pub fn cell_from_cylinder(&self, h: f64, phi: f64) -> [f64; 2] {
        [
            (phi - self.phi_min) / self.phi_step - 0.5,
            (h - self.h_min) / self.h_step - 0.5,
        ]
    }

    /// `(h, phi)` of a continuous cell position.
    pub fn cylinder_from_cell(&self, [x, y]: [f64; 2]) -> (f64, f64) {
        (
            self.h_min + (y + 0.5) * self.h_step,
            self.phi_min + (x + 0.5) * self.phi_step,
        )
    }

    /// Continuous cell position of a point, mm.
    pub fn cell_from_point(&self, p: &Point3) -> [f64; 2] {
        let c = cylinder_from_point(p);
        self.cell_from_cylinder(c.x, c.y)
    }
}

/// The outermost surface of a mesh on a cylinder.
#[derive(Clone, Debug)]
pub struct RadialMap {
    /// Where the cells lie.
    pub grid: CylinderGrid,
    /// Distance from the axis, mm; 0 in holes.
    pub radius: Plane<f64>,
    /// Triangle each cell's ray leaves through, or [`HOLE`].
    pub triangle: Plane<u32>,
    /// Weights of the triangle's second and third corner.
    pub weights: Plane<[f32; 2]>,
}

impl RadialMap {
    /// Casts one ray per cell from the axis and keeps the outermost hit.
    ///
    /// Cost O(cells covered by each triangle). Triangles around the axis itself are left out.
    pub fn cast(positions: &[Point3], triangles: &[[u32; 3]], grid: CylinderGrid) -> Self {
        let mut map = Self {
            grid,
            radius: Plane::filled(grid.width, grid.height, 0.0),
            triangle: Plane::filled(grid.width, grid.height, HOLE),
            weights: Plane::filled(grid.width, grid.height, [0.0; 2]),
        };
        let directions: Vec<(f64, f64)> = (0..grid.width)
            .map(|x| {
                let phi = grid.cylinder_from_cell([x as f64, 0.0]).1;
                (libm::sin(phi), libm::cos(phi))
            })
            .collect();
        let cells: Vec<[f64; 2]> = positions.iter().map(|p| grid.cell_from_point(p)).collect();
        for (t, triangle) in triangles.iter().enumerate() {
            let corners = triangle.map(|v| positions[v as usize]);
            let at = triangle.map(|v| cells[v as usize]);
            map.rasterize(t as u32, &corners, &at, &directions);
        }
        map
    }

    /// Whether a cell has surface.
    pub fn is_covered(&self, x: usize, y: usize) -> bool {
        self.triangle[(x, y)] != HOLE
    }

    /// Reads a quantity given per vertex at one cell. `None` in holes.
    pub fn interpolate(
        &self,
        triangles: &[[u32; 3]],
        values: &[Vector3],
        x: usize,
        y: usize,
    ) -> Option<Vector3> {
        let t = self.triangle[(x, y)];
        if t == HOLE {
            return None;
        }
        let [v, w] = self.weights[(x, y)].map(f64::from);
        let [a, b, c] = triangles[t as usize].map(|i| values[i as usize]);
        Some(a * (1.0 - v - w) + b * v + c * w)
    }

    fn rasterize(
        &mut self,
        t: u32,
        [a, b, c]: &[Point3; 3],
        cells: &[[f64; 2]; 3],
        directions: &[(f64, f64)],
    ) {
        let low = |k: usize| cells[0][k].min(cells[1][k]).min(cells[2][k]);
        let high = |k: usize| cells[0][k].max(cells[1][k]).max(cells[2][k]);
        // A triangle over the seam at the back or around the axis spans more than a third of the circle.
        let third = 2.1 / self.grid.phi_step;
        if high(0) - low(0) > third {
            return;
        }
        let (nx, ny) = (self.grid.width as f64, self.grid.height as f64);
        // The straight edge of a triangle bulges by less than a cell against its corners' angles.
        let x_range = (low(0).floor() - 1.0).max(0.0)..=(high(0).ceil() + 1.0).min(nx - 1.0);
        let y_range = low(1).ceil().max(0.0)..=high(1).floor().min(ny - 1.0);
        if x_range.is_empty() || y_range.is_empty() {
            return;
        }
        let (ab, ac) = (b - a, c - a);
        for x in *x_range.start() as usize..=*x_range.end() as usize {
            let (sin, cos) = directions[x];
            let direction = Vector3::new(sin, 0.0, cos);
            let across = direction.cross(&ac);
            let determinant = ab.dot(&across);
            if determinant.abs() < 1e-12 {
                continue;
            }
            for y in *y_range.start() as usize..=*y_range.end() as usize {
                let h = self.grid.cylinder_from_cell([0.0, y as f64]).0;
                let from_a = Vector3::new(-a.x, h - a.y, -a.z);
                let v = from_a.dot(&across) / determinant;
                let along = from_a.cross(&ab);
                let w = direction.dot(&along) / determinant;
                if v < EDGE_SLACK || w < EDGE_SLACK || v + w > 1.0 - EDGE_SLACK {
                    continue;
                }
                let r = ac.dot(&along) / determinant;
                if r > self.radius[(x, y)] {
                    self.radius[(x, y)] = r;
                    self.triangle[(x, y)] = t;
                    self.weights[(x, y)] = [v as f32, w as f32];
                }
            }
        }
    }
}

/// Which vertices the cylinder sees: those no more than `slack` mm below the outermost surface of their cell.
pub fn visible_vertices(map: &RadialMap, positions: &[Point3], slack: f64) -> Vec<bool> {
    let (nx, ny) = (map.grid.width as f64, map.grid.height as f64);
    positions
        .iter()
        .map(|p| {
            let [x, y] = map.grid.cell_from_point(p).map(f64::round);
            if x < 0.0 || y < 0.0 || x >= nx || y >= ny {
                return false;
            }
            let r = map.radius[(x as usize, y as usize)];
            r > 0.0 && radius_of_point(p) >= r - slack
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::math::point_from_cylinder;

    fn tube(r: f64, n: u32) -> (Vec<Point3>, Vec<[u32; 3]>) {
        let mut positions = Vec::new();
        for h in [-20.0, 20.0] {
            for k in 0..n {
                let phi = f64::from(k) / f64::from(n) * std::f64::consts::TAU;
                positions.push(point_from_cylinder(h, phi, r));
            }
        }
        let triangles = (0..n)
            .flat_map(|k| {
                let next = (k + 1) % n;
                [[k, next, n + k], [next, n + next, n + k]]
            })
            .collect();
        (positions, triangles)
    }

    #[test]
    fn the_outermost_of_two_tubes_is_seen_without_gaps() {
        let (mut positions, mut triangles) = tube(50.0, 64);
        let (outer, outer_triangles) = tube(80.0, 64);
        let offset = positions.len() as u32;
        positions.extend(outer);
        triangles.extend(outer_triangles.iter().map(|t| t.map(|v| v + offset)));
        let grid = CylinderGrid::new(2.0, -15.0, 15.0, 1.0, 80.0);
        let map = RadialMap::cast(&positions, &triangles, grid);
        for y in 0..grid.height {
            for x in 0..grid.width {
                let r = map.radius[(x, y)];
                assert!(
                    (80.0 * libm::cos(std::f64::consts::PI / 64.0) - 1e-9..=80.0 + 1e-9)
                        .contains(&r),
                    "cell {x} {y}: {r}"
                );
            }
        }
        let visible = visible_vertices(&map, &positions, 1.0);
        assert!(
            !visible[..128].iter().any(|v| *v),
            "the inner tube is hidden"
        );
    }

    #[test]
    fn a_cell_knows_the_point_of_its_ray() {
        let positions = vec![
            Point3::new(-30.0, -20.0, 70.0),
            Point3::new(30.0, -20.0, 90.0),
            Point3::new(0.0, 25.0, 80.0),
        ];
        let grid = CylinderGrid::new(1.0, -30.0, 30.0, 1.0, 80.0);
        let map = RadialMap::cast(&positions, &[[0, 1, 2]], grid);
        let coords: Vec<Vector3> = positions.iter().map(|p| p.coords).collect();
        let mut covered = 0;
        for y in 0..grid.height {
            for x in 0..grid.width {
                let Some(p) = map.interpolate(&[[0, 1, 2]], &coords, x, y) else {
                    continue;
                };
                covered += 1;
                let [cx, cy] = grid.cell_from_point(&Point3::from(p));
                assert!((cx - x as f64).abs() < 1e-4 && (cy - y as f64).abs() < 1e-4);
                assert!((radius_of_point(&p.into()) - map.radius[(x, y)]).abs() < 1e-4);
            }
        }
        assert!(covered > 800, "{covered} cells");
    }
}
