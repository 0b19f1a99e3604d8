//! Shadow rays of one light without a tree: rays are sorted into the cells of an image that the light sees, and triangles
//! are drawn over the cells.
//!
//! A ray towards a point light is one point of the light's image, so only triangles around that point can block it. Each
//! gets the test that a packet through the tree would give it, on the same numbers: the cells decide what is tested and
//! never what is blocked. Source: Johnson, Lee, Burns, Mark, The Irregular Z-Buffer, ACM TOG 24(4), 2005.

mod sort;

use crate::direct::Arriving;
use crate::footprint::{LocalProjection, Projection, Steps, footprints, project_corners};
use crate::lanes::{Eight, Kernel, LANES, LaneMask, Lanes, Portable, V3, lanes_of, run};
use crate::light::Light;
use crate::math::Vec3;
use crate::object::Object;
use crate::packet::{ShearBlock, meet_sheared};
use crate::sight::LightRays;
use crate::slopes::{self, Slopes};

/// Rays of a cell on average.
const RAYS_PER_CELL: usize = 4;

/// More triangles per ray than this, and packets through the tree are faster.
const MAX_TRIANGLES_PER_RAY: usize = 8;

/// Cells along each side of a tile.
const TILE: usize = 8;

/// Cells along each side of the image at most.
const MAX_SIDE: f32 = 2048.0;

/// Distance by which boxes around objects grow, in cells, and share by which they come nearer to the light.
const NEAR_MARGIN: f32 = 1.0 / 16.0;
const NEAR_SLACK: f32 = 1e-4;

/// What a light sees of the starts of its rays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Image {
    pub(crate) projection: Projection,
    /// Number of rays.
    pub(crate) rays: usize,
}

/// Rays of one cell, ready to be tested.
#[derive(Clone, Copy, Debug)]
struct CellBlock {
    origin: [Eight; 3],
    t_max: Eight,
    shear: ShearBlock,
}

/// What decides whether a triangle needs to look at a block: apart from it, since most do not.
#[derive(Clone, Copy, Debug)]
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

/// Whether drawing an object over the cells of an image is possible and worth it: it has no holes, is posed as its mesh is,
/// lies on one side of the light, and has few enough triangles.
pub(crate) fn suits(object: &Object, image: &Projection, rays: usize) -> bool {
    object.cutout.is_none()
        && object.world_from_object.is_none()
        && object.geometry.triangles.len() <= MAX_TRIANGLES_PER_RAY * rays
        && object
            .bounds_in_world()
            .is_some_and(|b| image.is_in_front(b))
}

/// The image that a light sees of the starts of its rays. `None` if there is none, such as for a light among them.
pub(crate) fn image_of(rays: &LightRays<'_>) -> Option<Image> {
    let count = rays.lit().iter().map(|l| l.count_ones() as usize).sum();
    let (min, max) = run(Extent(rays.arriving));
    if count == 0 || !(max - min).iter().all(|v| v.is_finite()) {
        return None;
    }
    let projection = match rays.light {
        Light::Point { position, .. }
        | Light::Spot { position, .. }
        | Light::Patch { position, .. } => Projection::through(*position, min, max),
        Light::Directional { towards, .. } => Projection::along(-towards, min, max),
        Light::Ambient { .. } | Light::Harmonic { .. } => None,
    }?;
    projection.is_in_front((min, max)).then_some(Image {
        projection,
        rays: count,
    })
}

/// The box around all starts.
struct Extent<'a>(&'a Arriving);

impl Kernel for Extent<'_> {
    type Output = (Vec3, Vec3);

    #[inline(always)]
    fn run<L: Lanes>(self) -> (Vec3, Vec3) {
        let (far, none) = (L::splat(f32::INFINITY), L::splat(f32::NEG_INFINITY));
        let (mut low, mut high) = ([far; 3], [none; 3]);
        for (lit, start) in self.0.lit.iter().zip(&self.0.start) {
            if *lit == 0 {
                continue;
            }
            let lit = L::Mask::from_bits(*lit);
            for k in 0..3 {
                let at = L::load(&start[k]);
                low[k] = L::select(lit, at, far).min(low[k]);
                high[k] = L::select(lit, at, none).max(high[k]);
            }
        }
        let (low, high) = (V3(low).store(), V3(high).store());
        let least = |v: &Eight| v.0.into_iter().fold(f32::INFINITY, f32::min);
        let most = |v: &Eight| v.0.into_iter().fold(f32::NEG_INFINITY, f32::max);
        (
            Vec3::from_fn(|k, _| least(&low[k])),
            Vec3::from_fn(|k, _| most(&high[k])),
        )
    }
}

/// The cells and what they hold, row by row.
#[derive(Debug, Default)]
pub(crate) struct Cells {
    columns: usize,
    rows: usize,
    /// The light's image in cells; `None` before there is any.
    local: Option<LocalProjection>,
    /// First block of each cell, and the number of blocks.
    first: Vec<u32>,
    heads: Vec<Head>,
    starts: Vec<Starts>,
    /// The ray of each lane: block times eight and lane among the light's rays.
    rays: Vec<[u32; LANES]>,
    /// Blocks that some triangle came close to.
    blocks: Vec<CellBlock>,
    /// Smallest nearness in each tile of cells, row by row: most triangles of a head's far side stop here.
    tiles: Vec<f32>,
    tile_columns: usize,
    /// Image position and nearness of each ray, and its cell, by the light's blocks.
    at: Vec<Starts>,
    cell_of: Vec<[u32; LANES]>,
    /// Where the next ray of each cell goes.
    next: Vec<u32>,
}

impl Cells {
    /// Sorts the rays of a light into cells, and sets the bits of `blocked` where one meets one of `objects`. `boxes` are
    /// those of everything that matters.
    pub(crate) fn block(
        &mut self,
        objects: &[&Object],
        image: &Image,
        boxes: impl Iterator<Item = (Vec3, Vec3)>,
        rays: &LightRays<'_>,
        blocked: &mut [u32],
    ) {
        // Rays start on the objects, or somewhere near them
        let origin = image.projection.origin();
        let corners = boxes.flat_map(|(min, max)| [min, max]);
        let reach = 2.0
            * corners
                .map(|c| (c - origin).abs().norm())
                .fold(0.0, f32::max);
        run(Block {
            cells: self,
            objects,
            image: *image,
            reach,
            rays,
            blocked,
        });
    }

    /// Sets the bits of `wanted` where a ray that is open so far may meet a box of the world in front of the light.
    pub(crate) fn near(&self, (min, max): (Vec3, Vec3), wanted: &mut [u32]) {
        let Some(local) = &self.local else {
            return;
        };
        let pick = |corner: usize, k: usize| if corner >> k & 1 == 0 { min[k] } else { max[k] };
        let corners = [0, 1, 2].map(|k| Eight(std::array::from_fn(|corner| pick(corner, k))));
        let [x, y, z] = local.project(V3::<Portable>::load(&corners)).store();
        let range = |v: &Eight, count: usize| {
            let low = v.0.into_iter().fold(f32::INFINITY, f32::min);
            let high = v.0.into_iter().fold(f32::NEG_INFINITY, f32::max);
            let margin = NEAR_MARGIN + 1e-5 * low.abs().max(high.abs());
            let last = count as f32 - 1.0;
            (high + margin >= 0.0 && low - margin <= count as f32).then(|| {
                let at = |v: f32| v.clamp(0.0, last) as usize;
                at(low - margin)..=at(high + margin)
            })
        };
        let (Some(columns), Some(rows)) = (range(&x, self.columns), range(&y, self.rows)) else {
            return;
        };
        let depth = z.0.into_iter().fold(f32::INFINITY, f32::min);
        let nearest = if local.is_parallel() {
            -depth + NEAR_SLACK * (depth.abs() + (max - min).norm())
        } else {
            (1.0 + NEAR_SLACK) / depth
        };
        for row in rows {
            let from = row * self.columns;
            let first = self.first[from + columns.start()] as usize;
            let end = self.first[from + columns.end() + 1] as usize;
            for index in first..end {
                let head = &self.heads[index];
                if head.open == 0 || nearest < head.lowest {
                    continue;
                }
                for lane in lanes_of(u32::from(head.open)) {
                    if self.starts[index][2].0[lane] <= nearest {
                        let ray = self.rays[index][lane] as usize;
                        wanted[ray / LANES] |= 1 << (ray % LANES);
                    }
                }
            }
        }
    }
}

struct Block<'a> {
    cells: &'a mut Cells,
    objects: &'a [&'a Object],
    image: Image,
    /// Largest distance of anything from the image's origin, mm.
    reach: f32,
    rays: &'a LightRays<'a>,
    blocked: &'a mut [u32],
}

impl Kernel for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let local = self.sort::<L>();
        let cells = self.cells;
        let steps = Steps {
            count: [cells.columns, cells.rows],
            first: [0.0; 2],
            is_lattice: false,
        };
        let is_parallel = local.is_parallel();
        for object in self.objects {
            // In leaf order neighbours come together
            for triangles in object.bvh.corners.chunks(LANES) {
                let corners = project_corners::<L>(&local, triangles);
                let found = footprints::<L>(&local, &steps, &corners, triangles.len());
                if found.present == 0 {
                    continue;
                }
                // Leave out what is behind all rays, before anything else is found out about it
                let depth = L::load(&found.nearest);
                let nearest = slopes::nearest::<L>(depth, is_parallel, self.reach);
                let mut present = 0;
                for lane in lanes_of(found.present) {
                    let is_hidden = cells.is_hidden(found.area(lane), nearest.0[lane]);
                    present |= u32::from(!is_hidden) << lane;
                }
                if present == 0 {
                    continue;
                }
                let slopes = Slopes::new::<L>(&corners, is_parallel, self.reach);
                for lane in lanes_of(present) {
                    let (area, nearest) = (found.area(lane), nearest.0[lane]);
                    cells.draw::<L>(self.rays, &triangles[lane], area, nearest, &slopes, lane);
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

impl Cells {
    /// Whether something in the cells `[first, last]` that comes as near as `nearest` to the light is behind all rays.
    #[inline(always)]
    fn is_hidden(&self, [first, last]: [[usize; 2]; 2], nearest: f32) -> bool {
        for row in first[1] / TILE..=last[1] / TILE {
            let row = row * self.tile_columns;
            let tiles = &self.tiles[row + first[0] / TILE..=row + last[0] / TILE];
            if tiles.iter().any(|lowest| *lowest <= nearest) {
                return false;
            }
        }
        true
    }

    /// Closes the rays that a triangle blocks in the cells `[first, last]`; `lane` is its place among the slopes.
    #[inline(always)]
    fn draw<L: Lanes>(
        &mut self,
        rays: &LightRays<'_>,
        corners: &[[f32; 3]; 3],
        [first, last]: [[usize; 2]; 2],
        nearest: f32,
        slopes: &Slopes,
        lane: usize,
    ) {
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
    /// The rays `numbers` of a light in the lanes `present`.
    #[inline(always)]
    fn gather<L: Lanes>(rays: &LightRays<'_>, numbers: &[u32; LANES], present: u32) -> Self {
        let mut origin = [Eight::default(); 3];
        for lane in lanes_of(present) {
            let ray = numbers[lane] as usize;
            let start = &rays.arriving.start[ray / LANES];
            for axis in 0..3 {
                origin[axis].0[lane] = start[axis].0[ray % LANES];
            }
        }
        let direction = rays.directions(V3::<L>::load(&origin)).store();
        Self {
            origin,
            t_max: Eight([rays.t_max(); LANES]),
            shear: ShearBlock::new::<L>(&direction, present),
        }
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
mod tests;
