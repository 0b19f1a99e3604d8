//! Even points of a surface, one for each cube that holds some, and which of them is near to any place.

use facile_core::{Mesh, Point3, Vector3};

/// Side of the cubes that thin a surface out to even points, mm.
pub(crate) const SIDE: f64 = 6.0;
/// Places further than this from the surface know no nearest point, mm.
const REACH: f64 = 42.0;
/// Largest extent of the box that is looked at, along each axis, mm: islands far away are left out.
const LARGEST_BOX: f64 = 900.0;
/// No point.
const NONE: u32 = u32::MAX;

/// Even points of a surface in a box of cubes.
pub(crate) struct Cubes {
    low: Vector3,
    size: [usize; 3],
    /// Point of each cube, or [`NONE`].
    own: Vec<u32>,
    /// Nearest point to each cube's centre, or [`NONE`] out of reach.
    nearest: Vec<u32>,
    /// Means of the surface's points in each cube, mm.
    pub(crate) points: Vec<Vector3>,
    /// Unit normals there.
    pub(crate) normals: Vec<Vector3>,
}

impl Cubes {
    /// Points of `mesh`, whose vertices have unit `normals`; `scale` brings it to mm. Cost O(n + volume of the box).
    pub(crate) fn new(mesh: &Mesh, normals: &[Vector3], scale: f64) -> Self {
        let (low, high) = robust_box(mesh, scale);
        let size = [0, 1, 2].map(|k| ((high[k] - low[k]) / SIDE).floor() as usize + 1);
        let mut cubes = Self {
            low,
            size,
            own: vec![NONE; size[0] * size[1] * size[2]],
            nearest: Vec::new(),
            points: Vec::new(),
            normals: Vec::new(),
        };
        let mut counts: Vec<f64> = Vec::new();
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].coords * scale);
            let [na, nb, nc] = triangle.map(|v| normals[v as usize]);
            let mut add = |p: Vector3, n: Vector3| {
                let Some(cube) = cubes.cube(&p) else { return };
                if cubes.own[cube] == NONE {
                    cubes.own[cube] = cubes.points.len() as u32;
                    cubes.points.push(Vector3::zeros());
                    cubes.normals.push(Vector3::zeros());
                    counts.push(0.0);
                }
                let i = cubes.own[cube] as usize;
                cubes.points[i] += p;
                cubes.normals[i] += n;
                counts[i] += 1.0;
            };
            for (p, n) in [(a, na), (b, nb), (c, nc)] {
                add(p, n);
            }
            // Points inside large triangles, so that coarse meshes leave no gaps.
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            let steps = ((longest / SIDE).ceil() as u32).min(12);
            for i in 1..steps {
                for j in 1..=steps - i {
                    let (v, w) = (
                        f64::from(i) / f64::from(steps),
                        f64::from(j) / f64::from(steps),
                    );
                    let u = 1.0 - v - w;
                    add(a * u + b * v + c * w, na * u + nb * v + nc * w);
                }
            }
        }
        for (i, count) in counts.iter().enumerate() {
            cubes.points[i] /= *count;
            cubes.normals[i] = cubes.normals[i]
                .try_normalize(1e-12)
                .unwrap_or_else(Vector3::z);
        }
        cubes.spread();
        cubes
    }

    /// The point and normal nearest to `p`, to within a cube. `None` far from the surface. Cost O(1).
    pub(crate) fn nearest(&self, p: &Point3) -> Option<(Point3, Vector3)> {
        let i = self.nearest[self.cube(&p.coords)?];
        (i != NONE).then(|| (self.points[i as usize].into(), self.normals[i as usize]))
    }

    /// Indices of the points within `radius` mm of `at`, in a fixed order.
    pub(crate) fn near(&self, at: &Vector3, radius: f64) -> impl Iterator<Item = usize> {
        let at = *at;
        let range = move |k: usize| {
            let low = ((at[k] - radius - self.low[k]) / SIDE).floor().max(0.0) as usize;
            let high = ((at[k] + radius - self.low[k]) / SIDE).floor().max(0.0) as usize;
            low..(high + 1).min(self.size[k])
        };
        let xs = range(0);
        range(2)
            .flat_map(move |z| range(1).map(move |y| (z, y)))
            .flat_map(move |(z, y)| {
                let row = (z * self.size[1] + y) * self.size[0];
                self.own[row + xs.start.min(xs.end)..row + xs.end]
                    .iter()
                    .copied()
            })
            .filter(move |i| {
                *i != NONE && (self.points[*i as usize] - at).norm_squared() <= radius * radius
            })
            .map(|i| i as usize)
    }

    fn cube(&self, p: &Vector3) -> Option<usize> {
        let mut index = 0;
        for k in [2, 1, 0] {
            // Cut, not rounded down: the same for what is not negative, and no call.
            let c = (p[k] - self.low[k]) / SIDE;
            if !(c >= 0.0 && c < self.size[k] as f64) {
                return None;
            }
            index = index * self.size[k] + c as usize;
        }
        Some(index)
    }

    /// Grows the nearest points outwards, one layer of cubes at a time.
    fn spread(&mut self) {
        self.nearest = self.own.clone();
        let [nx, ny, nz] = self.size;
        let place = |i: usize| [i % nx, i / nx % ny, i / nx / ny];
        let center = |low: &Vector3, [x, y, z]: [usize; 3]| {
            low + Vector3::new(x as f64 + 0.5, y as f64 + 0.5, z as f64 + 0.5) * SIDE
        };
        let mut front: Vec<usize> = (0..self.own.len())
            .filter(|i| self.own[*i] != NONE)
            .collect();
        let mut distance: Vec<f32> = vec![f32::INFINITY; self.own.len()];
        for &i in &front {
            distance[i] = 0.0;
        }
        for _ in 0..(REACH / SIDE).ceil() as usize {
            let mut next = Vec::new();
            for &i in &front {
                let at = place(i);
                let source = self.nearest[i];
                let low = at.map(|c| c.saturating_sub(1));
                for z in low[2]..=(at[2] + 1).min(nz - 1) {
                    for y in low[1]..=(at[1] + 1).min(ny - 1) {
                        for x in low[0]..=(at[0] + 1).min(nx - 1) {
                            let j = (z * ny + y) * nx + x;
                            if self.own[j] != NONE {
                                continue;
                            }
                            let from = center(&self.low, [x, y, z]);
                            let d = (self.points[source as usize] - from).norm() as f32;
                            if d < distance[j] {
                                if distance[j] == f32::INFINITY {
                                    next.push(j);
                                }
                                distance[j] = d;
                                self.nearest[j] = source;
                            }
                        }
                    }
                }
            }
            front = next;
        }
    }
}

/// Box around the middle 98 % of the vertices along each axis and a margin, mm, cut to a fixed size about its centre.
fn robust_box(mesh: &Mesh, scale: f64) -> (Vector3, Vector3) {
    let mut low = Vector3::zeros();
    let mut high = Vector3::zeros();
    for axis in 0..3 {
        let mut values: Vec<f64> = (mesh.triangles.iter())
            .map(|t| mesh.positions[t[0] as usize][axis] * scale)
            .collect();
        let n = values.len();
        let mut ranked = |rank: usize| *values.select_nth_unstable_by(rank, f64::total_cmp).1;
        let (a, b) = if n == 0 {
            (0.0, 0.0)
        } else {
            (ranked(n / 100), ranked(n - 1 - n / 100))
        };
        let half = (0.5 * (b - a) + REACH).min(0.5 * LARGEST_BOX);
        low[axis] = 0.5 * (a + b) - half;
        high[axis] = 0.5 * (a + b) + half;
    }
    (low, high)
}
