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
    /// Points of `mesh`, whose vertices have unit `normals`; `scale` brings it to mm. Cost O(n).
    pub(crate) fn new(mesh: &Mesh, normals: &[Vector3], scale: f64) -> Self {
        let (center, half) = robust_box(mesh, scale);
        // Whole cubes about the centre, so that a mirrored surface has the mirrored cubes.
        let size = [0, 1, 2].map(|k| (2.0 * half[k] / SIDE).ceil().max(1.0) as usize);
        let mut cubes = Self {
            low: center - Vector3::from(size.map(|n| 0.5 * SIDE * n as f64)),
            size,
            own: vec![NONE; size[0] * size[1] * size[2]],
            nearest: Vec::new(),
            points: Vec::new(),
            normals: Vec::new(),
        };
        let mut counts: Vec<f64> = Vec::new();
        let mut add = |p: Vector3, n: Vector3, count: f64| {
            let Some(cube) = cubes.cube(&p) else { return };
            if cubes.own[cube] == NONE {
                cubes.own[cube] = cubes.points.len() as u32;
                cubes.points.push(Vector3::zeros());
                cubes.normals.push(Vector3::zeros());
                counts.push(0.0);
            }
            let i = cubes.own[cube] as usize;
            cubes.points[i] += p * count;
            cubes.normals[i] += n * count;
            counts[i] += count;
        };
        // Every corner of every triangle.
        let mut corners = vec![0_u32; mesh.positions.len()];
        for v in mesh.triangles.as_flattened() {
            corners[*v as usize] += 1;
        }
        for (v, count) in corners.into_iter().enumerate().filter(|c| c.1 > 0) {
            let p = mesh.positions[v].coords * scale;
            add(p, normals[v], f64::from(count));
        }
        // Points inside large triangles, so that coarse meshes leave no gaps.
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize].coords * scale);
            let longest = ((b - a).norm_squared())
                .max((c - b).norm_squared())
                .max((a - c).norm_squared());
            if longest <= SIDE * SIDE {
                continue;
            }
            let [na, nb, nc] = triangle.map(|v| normals[v as usize]);
            let steps = ((longest.sqrt() / SIDE).ceil() as u32).min(12);
            for i in 1..steps {
                for j in 1..=steps - i {
                    let (v, w) = (
                        f64::from(i) / f64::from(steps),
                        f64::from(j) / f64::from(steps),
                    );
                    let u = 1.0 - v - w;
                    add(a * u + b * v + c * w, na * u + nb * v + nc * w, 1.0);
                }
            }
        }
        for (i, count) in counts.iter().enumerate() {
            cubes.points[i] /= *count;
            cubes.normals[i] = cubes.normals[i]
                .try_normalize(1e-12)
                .unwrap_or_else(Vector3::z);
        }
        cubes
    }

    /// The point and normal nearest to `p`, to within a cube, after [`Self::spread`]. `None` far from the surface. Cost O(1).
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

    /// Finds the points that [`Self::nearest`] gives: they grow outwards, one layer of cubes at a time. Cost O(volume).
    pub(crate) fn spread(mut self) -> Self {
        self.nearest.clone_from(&self.own);
        let [nx, ny, nz] = self.size;
        let place = |i: usize| [i % nx, i / nx % ny, i / nx / ny];
        let mut front: Vec<usize> = (0..self.own.len())
            .filter(|i| self.own[*i] != NONE)
            .collect();
        let mut square: Vec<f64> = vec![f64::INFINITY; self.own.len()];
        for &i in &front {
            square[i] = 0.0;
        }
        for _ in 0..(REACH / SIDE).ceil() as usize {
            let mut next = Vec::new();
            // As they are before this layer: no cube of it learns from another.
            let sources: Vec<u32> = front.iter().map(|i| self.nearest[*i]).collect();
            for (&i, source) in front.iter().zip(sources) {
                let at = place(i);
                let low = at.map(|c| c.saturating_sub(1));
                let high = [nx, ny, nz];
                // Squared distances of the cubes' centres from the source, axis by axis.
                let p = self.points[source as usize];
                let squares = [0, 1, 2].map(|k| {
                    [0, 1, 2].map(|j| {
                        let center = self.low[k] + ((low[k] + j) as f64 + 0.5) * SIDE;
                        (p[k] - center) * (p[k] - center)
                    })
                });
                let range = |k: usize| low[k]..(at[k] + 2).min(high[k]);
                for z in range(2) {
                    for y in range(1) {
                        let row = (z * ny + y) * nx;
                        let beside = squares[1][y - low[1]] + squares[2][z - low[2]];
                        for x in range(0) {
                            let j = row + x;
                            let d = squares[0][x - low[0]] + beside;
                            // The cubes of the surface itself are at no distance.
                            if d < square[j] {
                                if square[j] == f64::INFINITY {
                                    next.push(j);
                                }
                                square[j] = d;
                                self.nearest[j] = source;
                            }
                        }
                    }
                }
            }
            front = next;
        }
        self
    }
}

/// Centre and half sides of a box around the middle 98 % of the vertices along each axis and a margin, mm, cut to a
/// fixed size.
fn robust_box(mesh: &Mesh, scale: f64) -> (Vector3, Vector3) {
    let mut center = Vector3::zeros();
    let mut half = Vector3::zeros();
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
        center[axis] = 0.5 * (a + b);
        half[axis] = (0.5 * (b - a) + REACH).min(0.5 * LARGEST_BOX);
    }
    (center, half)
}
