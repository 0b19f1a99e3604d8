//! Nearest points of a surface near the head, by a grid of cells.
//!
//! Cheaper to build than a tree by far, and as fast for what a registration asks: the surface within millimetres.

use facile_core::{Point3, Vector3, mesh::closest_barycentric};

/// Half the side of the box that is indexed, mm: what is further from the head's origin is not found.
const HALF_BOX: f64 = 260.0;
/// Side of a cell, mm.
const CELL: f64 = 4.0;

/// A point found on a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nearest {
    /// Its triangle.
    pub(crate) triangle: u32,
    /// Weights of the triangle's corners.
    pub(crate) barycentric: [f64; 3],
}

/// The triangles of a mesh in the cells of a grid around the head.
pub(crate) struct Surface {
    grid: Grid,
    /// First entry of each cell, and the end.
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

/// A triangle in a cell, with a ball around it: most triangles are told from the nearest by their ball.
#[derive(Clone, Copy)]
struct Entry {
    center: [f32; 3],
    radius: f32,
    triangle: u32,
}

/// Cells of one size in a box.
struct Grid {
    low: Vector3,
    size: [i64; 3],
}

impl Surface {
    /// Sorts triangles into cells. Cost O(cells they touch).
    pub(crate) fn new(positions: &[Point3], triangles: &[[u32; 3]]) -> Self {
        let grid = Grid::around(positions);
        let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
        let mut starts = vec![0_u32; grid.len() + 1];
        for t in triangles {
            grid.for_cells(&corners(t), |cell| starts[cell + 1] += 1);
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut entries =
            vec![Entry::around(&[Point3::origin(); 3], 0); starts[grid.len()] as usize];
        let mut next = starts.clone();
        for (t, triangle) in triangles.iter().enumerate() {
            let corners = corners(triangle);
            let entry = Entry::around(&corners, t as u32);
            grid.for_cells(&corners, |cell| {
                entries[next[cell] as usize] = entry;
                next[cell] += 1;
            });
        }
        Self {
            grid,
            starts,
            entries,
        }
    }

    /// The point nearest to `p` within `reach` mm, for the same mesh as in [`Self::new`]. Cost O(cells in reach).
    pub(crate) fn nearest(
        &self,
        positions: &[Point3],
        triangles: &[[u32; 3]],
        p: &Point3,
        reach: f64,
    ) -> Option<Nearest> {
        let at = (p.coords - self.grid.low) / CELL;
        let center = [0, 1, 2].map(|k| at[k].floor() as i64);
        // Distance to the nearest wall of the own cell: shell `s` is at least that and `s - 1` cells away.
        let wall = CELL * at.map(|c| (c - c.floor()).min(c.floor() + 1.0 - c)).min();
        let from = [0, 1, 2].map(|k| p[k] as f32);
        let mut best: Option<Nearest> = None;
        let mut limit = reach;
        let mut shell = 0_i64;
        while shell == 0 || wall + CELL * (shell - 1) as f64 <= limit {
            self.grid.for_shell(center, shell, |cell| {
                let range = self.starts[cell] as usize..self.starts[cell + 1] as usize;
                for entry in &self.entries[range] {
                    if entry.is_beyond(&from, limit as f32) {
                        continue;
                    }
                    let corners = triangles[entry.triangle as usize].map(|v| positions[v as usize]);
                    let barycentric = closest_barycentric(p, &corners);
                    let [u, v, w] = barycentric;
                    let q = corners[0].coords * u + corners[1].coords * v + corners[2].coords * w;
                    let distance = (q - p.coords).norm();
                    if distance < limit {
                        limit = distance;
                        best = Some(Nearest {
                            triangle: entry.triangle,
                            barycentric,
                        });
                    }
                }
            });
            shell += 1;
        }
        best
    }
}

impl Entry {
    fn around([a, b, c]: &[Point3; 3], triangle: u32) -> Self {
        let center = (a.coords + b.coords + c.coords) / 3.0;
        let radius = (a.coords - center)
            .norm()
            .max((b.coords - center).norm())
            .max((c.coords - center).norm());
        Self {
            center: [center.x as f32, center.y as f32, center.z as f32],
            // A little more, for the rounding of the centre.
            radius: radius as f32 * 1.0001 + 1e-3,
            triangle,
        }
    }

    /// Whether the whole triangle is further than `limit` mm from `p`.
    fn is_beyond(&self, p: &[f32; 3], limit: f32) -> bool {
        let [x, y, z] = [0, 1, 2].map(|k| self.center[k] - p[k]);
        let far = limit + self.radius;
        x * x + y * y + z * z > far * far
    }
}

impl Grid {
    /// Cells over the box of the positions, as far as it is near the origin.
    fn around(positions: &[Point3]) -> Self {
        let (mut low, mut high) = (Vector3::repeat(HALF_BOX), Vector3::repeat(-HALF_BOX));
        for p in positions {
            let p = p.coords.map(|c| c.clamp(-HALF_BOX, HALF_BOX));
            (low, high) = (low.inf(&p), high.sup(&p));
        }
        let size = [0, 1, 2].map(|k| ((high[k] - low[k]).max(0.0) / CELL).floor() as i64 + 1);
        Self { low, size }
    }

    fn len(&self) -> usize {
        (self.size[0] * self.size[1] * self.size[2]) as usize
    }

    /// Calls `visit` with every cell that the triangle's box touches.
    fn for_cells(&self, corners: &[Point3; 3], mut visit: impl FnMut(usize)) {
        let range = |k: usize| {
            let low = corners[0][k].min(corners[1][k]).min(corners[2][k]);
            let high = corners[0][k].max(corners[1][k]).max(corners[2][k]);
            let [low, high] = [low, high].map(|c| (c - self.low[k]) / CELL);
            // Outside the box on one side the range is empty. Numbers that are not negative are cut, not rounded down.
            let end = if high < 0.0 { 0 } else { high as i64 + 1 };
            low.max(0.0) as i64..end.min(self.size[k])
        };
        let [xs, ys, zs] = [range(0), range(1), range(2)];
        for z in zs {
            for y in ys.clone() {
                for x in xs.clone() {
                    visit(self.index(x, y, z));
                }
            }
        }
    }

    /// Calls `visit` with the cells whose largest distance along an axis from `center` is `shell`, in a fixed order.
    fn for_shell(&self, center: [i64; 3], shell: i64, mut visit: impl FnMut(usize)) {
        let range =
            |k: usize| (center[k] - shell).max(0)..(center[k] + shell).min(self.size[k] - 1) + 1;
        for z in range(2) {
            for y in range(1) {
                if (z - center[2]).abs() == shell || (y - center[1]).abs() == shell {
                    for x in range(0) {
                        visit(self.index(x, y, z));
                    }
                } else {
                    for x in [center[0] - shell, center[0] + shell] {
                        if (0..self.size[0]).contains(&x) {
                            visit(self.index(x, y, z));
                        }
                    }
                }
            }
        }
    }

    fn index(&self, x: i64, y: i64, z: i64) -> usize {
        ((z * self.size[1] + y) * self.size[0] + x) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_is_that_of_a_search_over_all_triangles() {
        let reference = facile_core::ReferenceHead::embedded();
        let mesh = &reference.mesh;
        let surface = Surface::new(&mesh.positions, &mesh.triangles);
        for i in 0..300_u32 {
            let c =
                |k: u32| f64::from((i * 7 + k * 31).wrapping_mul(2_654_435_761) % 1000) / 1000.0;
            let p = Point3::new(
                200.0 * c(0) - 100.0,
                220.0 * c(1) - 120.0,
                240.0 * c(2) - 110.0,
            );
            let square = |t: usize, w: [f64; 3]| {
                let corners = mesh.corners(t);
                let q = (0..3).fold(Vector3::zeros(), |s, k| s + corners[k].coords * w[k]);
                (q - p.coords).norm_squared()
            };
            let expected = (0..mesh.triangles.len())
                .map(|t| square(t, closest_barycentric(&p, &mesh.corners(t))))
                .fold(f64::INFINITY, f64::min)
                .sqrt();
            let found = surface
                .nearest(&mesh.positions, &mesh.triangles, &p, 20.0)
                .map(|n| square(n.triangle as usize, n.barycentric).sqrt());
            match found {
                Some(found) => assert!((found - expected).abs() < 1e-9),
                None => assert!(expected >= 20.0, "{expected} mm"),
            }
        }
    }

    #[test]
    fn triangles_outside_the_box_are_left_out() {
        let far = |x: f64| Point3::new(x, 0.0, 0.0);
        for x in [-1e7, 1e7] {
            let positions = [far(x), far(x + 1.0), Point3::new(x, 1.0, 0.0)];
            let surface = Surface::new(&positions, &[[0, 1, 2]]);
            let found = surface.nearest(&positions, &[[0, 1, 2]], &far(x), 5.0);
            assert!(found.is_none());
        }
    }
}
