//! The surfaces that blocks of pixels show: the nearest of each pixel, and those behind it in order of distance.
//!
//! Surfaces go by one number over all objects of a scene: object by object, triangle by triangle. Of those at the very same
//! distance the lowest number counts, so the order of drawing leaves no trace.

use crate::cutout::Admit;
use crate::lanes::{Eight, LANES, LaneMask, Lanes, lanes_of};
use crate::packet::Meeting;
use crate::ray::Hit;
use crate::scene::Scene;

/// Nearest hits of a block of pixels so far.
#[derive(Clone, Copy)]
pub(super) struct HitBlock {
    pub(super) t: Eight,
    pub(super) u: Eight,
    pub(super) v: Eight,
    /// Bits are the surface's number, see [`Numbers`]; 0 for none.
    pub(super) number: Eight,
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

    /// Lanes with a hit.
    pub(super) fn hit(&self) -> u32 {
        let number = self.number.0.iter().enumerate();
        number.fold(0, |bits, (lane, v)| {
            bits | u32::from(v.to_bits() != 0) << lane
        })
    }

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
pub(super) fn lower_of(tied: u32, number: u32, others: &Eight) -> u32 {
    lanes_of(tied)
        .filter(|lane| number < others.0[*lane].to_bits())
        .fold(0, |bits, lane| bits | 1 << lane)
}

/// Puts surfaces in the lanes `bits` among the first `used` of a block's levels, nearest first; what is behind the last
/// level is dropped.
#[inline(always)]
pub(super) fn insert<L: Lanes>(
    levels: &mut [Level],
    used: &mut u8,
    (mut t, mut number): (L, L),
    mut bits: u32,
) {
    let none = L::splat(f32::INFINITY);
    for level in &mut levels[..usize::from(*used)] {
        if bits == 0 {
            return;
        }
        let (own_t, own) = (L::load(&level.t), L::load(&level.number));
        let open = L::Mask::from_bits(bits);
        // Of equal distances the lower number stays, and the other is no surface of its own
        let tied = (open & t.eq(own_t)).bits();
        let mut lower = 0;
        if tied != 0 {
            let numbers = number.store();
            for lane in lanes_of(tied) {
                lower |= lower_of(1 << lane, numbers.0[lane].to_bits(), &level.number);
            }
            bits &= !tied;
        }
        let closer = open & t.lt(own_t);
        let taken = closer | L::Mask::from_bits(lower);
        level.t = L::select(closer, t, own_t).store();
        level.number = L::select(taken, number, own).store();
        // What was there goes on to the next level
        t = L::select(closer, own_t, t);
        number = L::select(closer, own, number);
        bits &= !(closer & own_t.eq(none)).bits();
    }
    if bits != 0
        && let Some(level) = levels.get_mut(usize::from(*used))
    {
        let mask = L::Mask::from_bits(bits);
        level.t = L::select(mask, t, none).store();
        level.number = L::select(mask, number, L::splat(0.0)).store();
        *used += 1;
    }
}
