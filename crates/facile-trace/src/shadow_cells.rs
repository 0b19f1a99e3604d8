//! Shadow rays of one light without a tree: rays are sorted into the cells of an image that the light sees, and triangles
//! are drawn over the cells.
//!
//! A ray towards a point light is one point of the light's image, so only triangles around that point can block it. Each
//! gets the test that a packet through the tree would give it, on the same numbers: the cells decide what is tested and
//! never what is blocked. Source: Johnson, Lee, Burns, Mark, The Irregular Z-Buffer, ACM TOG 24(4), 2005.

use crate::footprint::{LocalProjection, Projection, Steps, footprints, project_corners};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, V3, lanes_of, run};
use crate::light::Light;
use crate::math::Vec3;
use crate::object::Object;
use crate::packet::{RayBlock, ShearBlock, meet_sheared};
use crate::slopes::Slopes;

/// Rays of a cell on average.
const RAYS_PER_CELL: usize = 4;

/// More triangles per ray than this, and packets through the tree are faster.
const MAX_TRIANGLES_PER_RAY: usize = 8;

/// Cells along each side of a tile.
const TILE: usize = 8;

/// Rays of one cell, ready to be tested.
#[derive(Clone, Copy)]
struct CellBlock {
    origin: [Eight; 3],
    t_max: Eight,
    shear: ShearBlock,
}

/// What decides whether a triangle needs to look at a block: apart from it, since most do not.
#[derive(Clone, Copy)]
struct Head {
    /// Smallest nearness of the rays' starts in the light's image.
    lowest: f32,
    /// Lanes with a ray.
    present: u8,
    /// Lanes with a ray that nothing blocks so far.
    open: u8,
    /// Number among the blocks that a triangle came close to, [`UNTOUCHED`] for none.
    block: u32,
}

/// Nothing came close to the rays.
const UNTOUCHED: u32 = u32::MAX;

/// Where the rays of a block start: `x` and `y` in cells, and nearness.
type Starts = [Eight; 3];

/// Whether sorting `rays` into cells is possible and worth it for an object: it has no holes, is posed as its mesh is, lies
/// on one side of the light, and has few enough triangles.
pub(crate) fn suits(object: &Object, image: &Projection, rays: usize) -> bool {
    object.cutout.is_none()
        && object.world_from_object.is_none()
        && object.geometry.triangles.len() <= MAX_TRIANGLES_PER_RAY * rays
        && object
            .bounds_in_world()
            .is_some_and(|b| image.is_in_front(b))
}

/// The image that a light sees of the starts of `count` rays. `None` if there is none, such as for a light among them.
pub(crate) fn image_of(light: &Light, blocks: &[RayBlock], count: usize) -> Option<Projection> {
    let (mut min, mut max) = (Vec3::repeat(f32::INFINITY), Vec3::repeat(f32::NEG_INFINITY));
    for i in 0..count {
        let origin = &blocks[i / LANES].origin;
        let p = Vec3::from_fn(|k, _| origin[k].0[i % LANES]);
        (min, max) = (min.inf(&p), max.sup(&p));
    }
    if count == 0 || !(max - min).iter().all(|v| v.is_finite()) {
        return None;
    }
    let image = match light {
        Light::Point { position, .. }
        | Light::Spot { position, .. }
        | Light::Patch { position, .. } => Projection::through(*position, min, max),
        Light::Directional { towards, .. } => Projection::along(-towards, min, max),
        Light::Ambient { .. } | Light::Harmonic { .. } => None,
    }?;
    image.is_in_front((min, max)).then_some(image)
}

/// Sets bit `k` of `blocked[i]` where lane `k` of `blocks[i]`, one of the first `count` rays, meets one of `objects`.
/// All rays run along the lines of `image`.
pub(crate) fn block(
    objects: &[&Object],
    image: &Projection,
    blocks: &[RayBlock],
    count: usize,
    blocked: &mut [u32],
) {
    run(Block {
        objects,
        image: *image,
        blocks,
        count,
        blocked,
    });
}

struct Block<'a> {
    objects: &'a [&'a Object],
    image: Projection,
    blocks: &'a [RayBlock],
    count: usize,
    blocked: &'a mut [u32],
}

/// The cells and what they hold, row by row.
struct Cells {
    columns: usize,
    rows: usize,
    /// First block of each cell, and the number of blocks.
    first: Vec<u32>,
    heads: Vec<Head>,
    starts: Vec<Starts>,
    /// The ray of each lane.
    rays: Vec<[u32; LANES]>,
    /// Blocks that some triangle came close to.
    blocks: Vec<CellBlock>,
    /// Smallest nearness in each tile of cells, row by row: most triangles of a head's far side stop here.
    tiles: Vec<f32>,
    tile_columns: usize,
}

impl Kernel for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let reach = self.reach();
        let mut cells = self.sort::<L>(reach);
        let local = self.image.in_frame_of(None, reach);
        let steps = Steps {
            count: [cells.columns, cells.rows],
            first: [0.0; 2],
            is_lattice: false,
        };
        for object in self.objects {
            // In leaf order neighbours come together
            for triangles in object.bvh.corners.chunks(LANES) {
                let corners = project_corners::<L>(&local, triangles);
                let found = footprints::<L>(&local, &steps, &corners, triangles.len());
                if found.present == 0 {
                    continue;
                }
                let slopes = Slopes::new::<L>(&corners, self.image.is_parallel(), reach);
                for lane in lanes_of(found.present) {
                    let from = [found.first[0][lane], found.first[1][lane]];
                    let to = [found.last[0][lane], found.last[1][lane]];
                    let area = [from, to].map(|at| at.map(|v| v as usize));
                    cells.draw::<L>(self.blocks, &triangles[lane], area, &slopes, lane);
                }
            }
        }
        for (rays, head) in cells.rays.iter().zip(&cells.heads) {
            for lane in lanes_of(u32::from(head.present & !head.open)) {
                let ray = rays[lane] as usize;
                self.blocked[ray / LANES] |= 1 << (ray % LANES);
            }
        }
    }
}

impl Block<'_> {
    /// Largest distance of anything from the image's origin, mm.
    fn reach(&self) -> f32 {
        let boxes = self.objects.iter().filter_map(|o| o.bounds_in_world());
        let corners = boxes.flat_map(|(min, max)| [min, max]);
        let origin = self.image.origin();
        let of_objects = corners
            .map(|c| (c - origin).abs().norm())
            .fold(0.0, f32::max);
        // Rays start on the objects, or somewhere near them
        2.0 * of_objects
    }

    /// Sorts the rays into cells.
    #[inline(always)]
    fn sort<L: Lanes>(&mut self, reach: f32) -> Cells {
        // Find where the rays appear
        let local = self.image.in_frame_of(None, reach);
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        let mut at: Vec<[f32; 3]> = Vec::with_capacity(self.count);
        self.place::<L>(&local, &mut at);
        let is_parallel = self.image.is_parallel();
        for p in &at {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        // Lay square cells over them
        let size = [0, 1].map(|k| (high[k] - low[k]).max(1e-6));
        let wanted = (self.count / RAYS_PER_CELL).max(1) as f32;
        let across = (wanted * size[0] / size[1]).sqrt().clamp(1.0, 4096.0);
        let columns = across.ceil() as usize;
        let rows = ((wanted / across).ceil() as usize).clamp(1, 4096);
        let steps = [columns as f32, rows as f32];
        self.image.fit(low, high, steps);
        let scale = [0, 1].map(|k| steps[k] / size[k]);
        // Count the rays of each cell, and give them whole blocks
        let mut cell_of = Vec::with_capacity(self.count);
        let mut next = vec![0_u32; columns * rows];
        for p in &mut at {
            (p[0], p[1]) = ((p[0] - low[0]) * scale[0], (p[1] - low[1]) * scale[1]);
            p[2] = if is_parallel { -p[2] } else { 1.0 / p[2] };
            let x = (p[0] as usize).min(columns - 1);
            let y = (p[1] as usize).min(rows - 1);
            cell_of.push((y * columns + x) as u32);
            next[y * columns + x] += 1;
        }
        let mut first = Vec::with_capacity(next.len() + 1);
        let mut total = 0;
        for slot in &mut next {
            first.push(total);
            total += slot.div_ceil(LANES as u32);
            *slot = first[first.len() - 1] * LANES as u32;
        }
        first.push(total);
        // Move the rays there
        let nothing = Head {
            lowest: f32::INFINITY,
            present: 0,
            open: 0,
            block: UNTOUCHED,
        };
        let mut rays = vec![[0; LANES]; total as usize];
        let mut heads = vec![nothing; total as usize];
        let mut starts = vec![Starts::default(); total as usize];
        let tile_columns = columns.div_ceil(TILE);
        let mut tiles = vec![f32::INFINITY; tile_columns * rows.div_ceil(TILE)];
        for (ray, (cell, p)) in cell_of.iter().zip(&at).enumerate() {
            let slot = next[*cell as usize] as usize;
            next[*cell as usize] += 1;
            let (block, lane) = (slot / LANES, slot % LANES);
            rays[block][lane] = ray as u32;
            for (start, v) in starts[block].iter_mut().zip(p) {
                start.0[lane] = *v;
            }
            let head = &mut heads[block];
            head.lowest = head.lowest.min(p[2]);
            head.present |= 1 << lane;
            head.open = head.present;
            let (x, y) = (*cell as usize % columns, *cell as usize / columns);
            let tile = &mut tiles[y / TILE * tile_columns + x / TILE];
            *tile = tile.min(p[2]);
        }
        Cells {
            columns,
            rows,
            first,
            heads,
            starts,
            rays,
            blocks: Vec::new(),
            tiles,
            tile_columns,
        }
    }

    /// Image position and depth of the start of each ray.
    #[inline(always)]
    fn place<L: Lanes>(&self, local: &LocalProjection, at: &mut Vec<[f32; 3]>) {
        for (index, block) in self.blocks.iter().enumerate() {
            let V3([x, y, z]) = local.project(V3::<L>::load(&block.origin));
            let (x, y, z) = (x.store().0, y.store().0, z.store().0);
            for k in 0..LANES.min(self.count - (index * LANES).min(self.count)) {
                at.push([x[k], y[k], z[k]]);
            }
        }
    }
}

impl Cells {
    /// Closes the rays that a triangle blocks in the cells `[first, last]`; `lane` is its place among the slopes.
    #[inline(always)]
    fn draw<L: Lanes>(
        &mut self,
        rays: &[RayBlock],
        corners: &[[f32; 3]; 3],
        [first, last]: [[usize; 2]; 2],
        slopes: &Slopes,
        lane: usize,
    ) {
        let nearest = slopes.nearest.0[lane];
        let tile_rows = first[1] / TILE..=last[1] / TILE;
        let is_hidden = tile_rows.into_iter().all(|row| {
            let row = row * self.tile_columns;
            let tiles = &self.tiles[row + first[0] / TILE..=row + last[0] / TILE];
            tiles.iter().all(|lowest| nearest < *lowest)
        });
        if is_hidden {
            return;
        }

        let (a, b, c) = (
            L::splat(slopes.a.0[lane]),
            L::splat(slopes.b.0[lane]),
            L::splat(slopes.c.0[lane]),
        );
        let (left, right) = (
            L::splat(slopes.low[0].0[lane]),
            L::splat(slopes.high[0].0[lane]),
        );
        let (top, bottom) = (
            L::splat(slopes.low[1].0[lane]),
            L::splat(slopes.high[1].0[lane]),
        );
        for row in first[1]..=last[1] {
            let from = row * self.columns;
            let blocks =
                self.first[from + first[0]] as usize..self.first[from + last[0] + 1] as usize;
            for (index, head) in blocks.clone().zip(&mut self.heads[blocks]) {
                if head.open == 0 || nearest < head.lowest {
                    continue;
                }
                // Most triangles are the ones that the rays start on, just behind them
                let [x, y, near] = &self.starts[index];
                let (x, y) = (L::load(x), L::load(y));
                let in_box = left.le(x) & x.le(right) & top.le(y) & y.le(bottom);
                let is_behind = in_box & L::load(near).le(a * x + b * y + c);
                if is_behind.bits() & u32::from(head.open) == 0 {
                    continue;
                }
                if head.block == UNTOUCHED {
                    head.block = self.blocks.len() as u32;
                    let present = u32::from(head.present);
                    let block = CellBlock::gather::<L>(rays, &self.rays[index], present);
                    self.blocks.push(block);
                }
                let open = u32::from(head.open);
                head.open = self.blocks[head.block as usize].open_behind::<L>(corners, open) as u8;
            }
        }
    }
}

impl CellBlock {
    /// The rays `numbers` of `rays` in the lanes `present`.
    #[inline(always)]
    fn gather<L: Lanes>(rays: &[RayBlock], numbers: &[u32; LANES], present: u32) -> Self {
        let mut direction = [Eight([1.0; LANES]); 3];
        let mut own = Self {
            origin: [Eight::default(); 3],
            t_max: Eight::default(),
            shear: ShearBlock::default(),
        };
        for lane in lanes_of(present) {
            let (from, k) = (
                &rays[numbers[lane] as usize / LANES],
                numbers[lane] as usize % LANES,
            );
            for (to, from) in own.origin.iter_mut().zip(&from.origin) {
                to.0[lane] = from.0[k];
            }
            for (to, from) in direction.iter_mut().zip(&from.direction) {
                to.0[lane] = from.0[k];
            }
            own.t_max.0[lane] = from.t_max.0[k];
        }
        own.shear = ShearBlock::new::<L>(&direction, present);
        own
    }

    /// The lanes of `open` that a triangle leaves open.
    #[inline(always)]
    fn open_behind<L: Lanes>(&self, [a, b, c]: &[[f32; 3]; 3], mut open: u32) -> u32 {
        let shear = self.shear.shear::<L>();
        for axis in self.shear.axes() {
            let [i, j, k] = ShearBlock::axes_from(axis);
            let x = L::load(&self.origin[i]);
            let y = L::load(&self.origin[j]);
            let z = L::load(&self.origin[k]);
            let Some(meeting) = meet_sheared(
                [
                    [L::splat(a[i]) - x, L::splat(a[j]) - y, L::splat(a[k]) - z],
                    [L::splat(b[i]) - x, L::splat(b[j]) - y, L::splat(b[k]) - z],
                    [L::splat(c[i]) - x, L::splat(c[j]) - y, L::splat(c[k]) - z],
                ],
                &shear,
                L::Mask::from_bits(self.shear.by_axis[axis] & open),
            ) else {
                continue;
            };
            let after_start = L::splat(0.0).lt(meeting.t);
            let before_end = meeting.t.lt(L::load(&self.t_max));
            open &= !(meeting.met & after_start & before_end).bits();
        }
        open
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;
    use crate::ray::Ray;
    use crate::scene::Scene;
    use crate::{Material, Normals};
    use facile_core::rng::RandomStream;
    use facile_core::{Mesh, Point3};

    /// Triangles of many sizes in a box of side 200 mm.
    fn scene() -> Scene {
        let mut random = RandomStream::new(5, 0);
        let mut mesh = Mesh::default();
        for t in 0..400_u32 {
            let size = 25.0 * random.unit().powi(3) + 0.5;
            let center = [0; 3].map(|_| random.uniform(-100.0, 100.0));
            for _ in 0..3 {
                let at = center.map(|c| c + random.uniform(-size, size));
                mesh.positions.push(Point3::from(at));
            }
            mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
        }
        let mut scene = Scene::default();
        scene.add(Object::new(&mesh, Normals::Flat, Material::default()).expect("valid"));
        scene
    }

    #[test]
    fn cells_block_what_single_rays_find_blocked() {
        let scene = scene();
        let position = Vec3::new(40.0, 90.0, 700.0);
        let towards = Vec3::new(0.0, 0.6, 0.8);
        let power = Rgb::repeat(1.0);
        let lights = [
            Light::Point { position, power },
            Light::Directional { towards, power },
        ];
        for light in lights {
            let mut random = RandomStream::new(9, 1);
            let rays: Vec<Ray> = (0..3_003)
                .map(|_| {
                    let start = Vec3::from([0; 3].map(|_| random.uniform(-90.0, 90.0) as f32));
                    match light.position() {
                        Some(position) => Ray::between(start, position),
                        None => Ray::new(start, towards),
                    }
                })
                .collect();
            let mut blocks = vec![RayBlock::default(); rays.len().div_ceil(LANES)];
            for (i, ray) in rays.iter().enumerate() {
                blocks[i / LANES].set(i % LANES, ray);
            }
            let image = image_of(&light, &blocks, rays.len()).expect("all on one side");
            assert!(suits(&scene.objects()[0], &image, rays.len()));
            let mut found = Vec::new();
            scene.blocked(Some(&light), &blocks, rays.len(), &mut found);
            let mut blocked = 0;
            for (i, ray) in rays.iter().enumerate() {
                let expected = scene.any_opaque_hit(ray);
                assert_eq!(
                    found[i / LANES] >> (i % LANES) & 1 == 1,
                    expected,
                    "{ray:?}"
                );
                blocked += usize::from(expected);
            }
            assert!(
                blocked > 200 && blocked < 2_500,
                "the rays try both: {blocked}"
            );
        }
    }

    #[test]
    fn a_light_among_the_rays_has_no_image() {
        let mut blocks = [RayBlock::default()];
        for lane in 0..LANES {
            let start = Vec3::new(lane as f32 - 4.0, 0.0, 0.0);
            blocks[0].set(lane, &Ray::new(start, Vec3::y()));
        }
        let power = Rgb::repeat(1.0);
        let position = Vec3::new(-0.5, 0.0, 0.0);
        assert!(image_of(&Light::Point { position, power }, &blocks, LANES).is_none());
        let ambient = Light::Ambient {
            power,
            slope: power,
            up: Vec3::y(),
        };
        assert!(image_of(&ambient, &blocks, LANES).is_none());
    }
}
