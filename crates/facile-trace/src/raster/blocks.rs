//! The surfaces that pixels and blocks of samples show: the nearest of each, and those behind it in order of distance.
//!
//! Surfaces go by one number over all objects of a scene: object by object, triangle by triangle. Of those at the very same
//! distance the lowest number counts, so the order of drawing leaves no trace.

use crate::cutout::Admit;
use crate::lanes::{Eight, LANES, LaneMask, Lanes, lanes_of};
use crate::packet::Meeting;
use crate::ray::Hit;
use crate::scene::Scene;

/// Nearest hits of a block of samples so far.
#[derive(Clone, Copy)]
pub(super) struct HitBlock {
    pub(super) t: Eight,
    pub(super) u: Eight,
    pub(super) v: Eight,
    /// Bits are the surface's number, see [`Numbers`]; 0 for none.
    pub(super) number: Eight,
}

/// Nearest hits of all pixels so far, block by block.
#[derive(Clone, Default)]
pub(super) struct Nearest {
    /// Infinite where there is none.
    pub(super) t: Vec<f32>,
    /// The rest of the hits; any where there is none.
    pub(super) places: Vec<Place>,
}

/// Where a surface is hit.
#[derive(Clone, Copy, Default)]
pub(super) struct Place {
    /// See [`Numbers`].
    pub(super) number: u32,
    pub(super) u: f32,
    pub(super) v: f32,
}

impl Nearest {
    /// Nothing is hit.
    pub(super) fn clear(&mut self, blocks: usize) {
        self.t.clear();
        self.t.resize(blocks * LANES, f32::INFINITY);
        self.places.resize(blocks * LANES, Place::default());
    }

    /// Takes over in a pixel if a triangle is nearer than what is there.
    #[inline(always)]
    pub(super) fn take(
        &mut self,
        pixel: usize,
        (t, place): (f32, Place),
        triangle: u32,
        admit: impl Admit,
    ) {
        let (nearest, own) = (&mut self.t[pixel], &mut self.places[pixel]);
        // Of equal distances the lower object, then the lower triangle wins
        let is_closer =
            t < *nearest || (t == *nearest && t < f32::INFINITY && place.number < own.number);
        if 0.0 < t && is_closer && admit.admits(triangle, place.u, place.v) {
            (*nearest, *own) = (t, place);
        }
    }

    /// The hit of a pixel, [`Hit::MISS`] if there is none.
    #[inline(always)]
    pub(super) fn get(&self, pixel: usize, numbers: &Numbers) -> Hit {
        let (t, place) = (self.t[pixel], &self.places[pixel]);
        if t == f32::INFINITY {
            return Hit::MISS;
        }
        let [object, triangle] = numbers.surface(place.number);
        Hit {
            t,
            object,
            triangle,
            u: place.u,
            v: place.v,
        }
    }
}

/// Surfaces of a block of pixels that are as many levels behind the nearest ones.
#[derive(Clone, Copy)]
pub(super) struct Level {
    /// Infinite where there is none.
    pub(super) t: Eight,
    pub(super) number: Eight,
}

/// First number of each object's triangles, from 1 on.
#[derive(Default)]
pub(super) struct Numbers {
    first: Vec<u32>,
}

/// A number in the bits of an `f32`, for lanes that are moved and never computed with.
pub(super) fn carried(number: u32) -> f32 {
    f32::from_bits(number)
}

impl Numbers {
    pub(super) fn take(&mut self, scene: &Scene) {
        self.first.clear();
        let mut next = 1;
        for object in scene.objects() {
            self.first.push(next);
            next += object.geometry.triangles.len() as u32;
        }
    }

    /// Number of an object's first triangle.
    pub(super) fn of(&self, object: usize) -> u32 {
        self.first[object]
    }

    /// Object and triangle of a number.
    pub(super) fn surface(&self, number: u32) -> [u32; 2] {
        // The first object is mostly the head; one without triangles has the first number of the next
        let next = self.first.iter().position(|first| *first > number);
        let object = next.unwrap_or(self.first.len()) - 1;
        [object as u32, number - self.first[object]]
    }
}

impl HitBlock {
    pub(super) const EMPTY: Self = Self {
        t: Eight([f32::INFINITY; LANES]),
        u: Eight([0.0; LANES]),
        v: Eight([0.0; LANES]),
        number: Eight([0.0; LANES]),
    };

    /// The largest distance of the lanes `present`.
    #[inline(always)]
    pub(super) fn furthest(&self, present: u32) -> f32 {
        let t = |lane: usize| {
            if present >> lane & 1 == 1 {
                self.t.0[lane]
            } else {
                0.0
            }
        };
        (0..LANES).map(t).fold(0.0, f32::max)
    }

    /// Takes over where a block meets a triangle nearer than what it has; whether it does anywhere.
    #[inline(always)]
    pub(super) fn take<L: Lanes>(
        &mut self,
        meeting: &Meeting<L>,
        [triangle, number]: [u32; 2],
        admit: impl Admit,
    ) -> bool {
        let (t, nearest) = (meeting.t, L::load(&self.t));
        let met = meeting.met & L::splat(0.0).lt(t);
        let mut closer = met & t.lt(nearest);
        // Of equal distances the lower object, then the lower triangle wins
        let tied = (met & t.eq(nearest)).bits();
        if tied != 0 {
            closer = closer | L::Mask::from_bits(lower_of(tied, number, &self.number));
        }
        closer = admit.admitted::<L>(closer, triangle, meeting.v, meeting.w);
        if !closer.any() {
            return false;
        }
        self.t = L::select(closer, t, nearest).store();
        self.u = L::select(closer, meeting.v, L::load(&self.u)).store();
        self.v = L::select(closer, meeting.w, L::load(&self.v)).store();
        let own = L::splat(carried(number));
        self.number = L::select(closer, own, L::load(&self.number)).store();
        true
    }

    /// The hit of a lane, [`Hit::MISS`] if there is none.
    pub(super) fn get(&self, lane: usize, numbers: &Numbers) -> Hit {
        let number = self.number.0[lane].to_bits();
        if number == 0 {
            return Hit::MISS;
        }
        let [object, triangle] = numbers.surface(number);
        Hit {
            t: self.t.0[lane],
            object,
            triangle,
            u: self.u.0[lane],
            v: self.v.0[lane],
        }
    }
}

/// The lanes `tied` of a surface that has a lower number than the one it meets there.
#[inline(always)]
fn lower_of(tied: u32, number: u32, others: &Eight) -> u32 {
    lanes_of(tied)
        .filter(|lane| number < others.0[*lane].to_bits())
        .fold(0, |bits, lane| bits | 1 << lane)
}

/// Puts a surface of one lane among the first `used` of a block's levels, nearest first; what is behind the last level is
/// dropped.
pub(super) fn insert(
    levels: &mut [Level],
    used: &mut u8,
    lane: usize,
    (mut t, mut number): (f32, u32),
) {
    for level in &mut levels[..usize::from(*used)] {
        let (own_t, own) = (&mut level.t.0[lane], &mut level.number.0[lane]);
        if t == *own_t {
            // Of equal distances the lower number stays, and the other is no surface of its own
            *own = carried(number.min(own.to_bits()));
            return;
        }
        if t < *own_t {
            // What was there goes on to the next level
            std::mem::swap(&mut t, own_t);
            let onwards = own.to_bits();
            *own = carried(number);
            number = onwards;
            if t == f32::INFINITY {
                return;
            }
        }
    }
    if let Some(level) = levels.get_mut(usize::from(*used)) {
        level.t = Eight([f32::INFINITY; LANES]);
        level.t.0[lane] = t;
        level.number.0[lane] = carried(number);
        *used += 1;
    }
}
