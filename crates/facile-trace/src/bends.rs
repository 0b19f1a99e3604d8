//! Which pixels do not follow their neighbours.

use facile_core::Plane;
use facile_core::color::Srgb8Codes;

use crate::lanes::{Kernel, LANES, LaneMask, Lanes, lanes_of, run};
use crate::math::Rgb;
use crate::ray::NO_OBJECT;
use crate::sampling::{BEND_LIMIT, STEP_LIMIT};

/// The pixels of a list that are bent or stepped against two opposite neighbours, by more than [`BEND_LIMIT`] or
/// [`STEP_LIMIT`], and those next to another object, where neighbours tell nothing. Even slopes are right as they are: the
/// centre's colour is their mean. Pixels of [`NO_OBJECT`] are left out.
pub(crate) fn bent_pixels(
    colors: &Plane<Rgb>,
    objects: &Plane<u32>,
    pixels: &[[u32; 2]],
) -> Vec<[u32; 2]> {
    // Rows beside those of the pixels say nothing
    let rows = || pixels.iter().map(|[_, y]| *y as usize);
    let (Some(first), Some(last)) = (rows().min(), rows().max()) else {
        return Vec::new();
    };
    let (first, end) = (first.saturating_sub(1), (last + 2).min(colors.height()));
    let width = colors.width();
    let area = first * width..end * width;
    let number = |object: &u32| match *object {
        NO_OBJECT => 0.0,
        object => object as f32 + 1.0,
    };
    let objects = &objects.as_slice()[area.clone()];
    let mut is_bent = vec![false; objects.len()];
    run(Bends {
        codes: &channels(&colors.as_slice()[area]),
        objects: &objects.iter().map(number).collect::<Vec<_>>(),
        size: [width, end - first],
        is_bent: &mut is_bent,
    });
    let own = |[x, y]: &[u32; 2]| is_bent[(*y as usize - first) * width + *x as usize];
    pixels.iter().copied().filter(own).collect()
}

/// The channels of colours in 8-bit sRGB.
fn channels(colors: &[Rgb]) -> [Vec<f32>; 3] {
    let codes = Srgb8Codes::default();
    let mut channels = [const { Vec::new() }; 3];
    for channel in &mut channels {
        channel.reserve(colors.len());
    }
    // Backgrounds are long runs of one colour
    let (mut last, mut own) = (Rgb::zeros(), [0.0; 3]);
    for color in colors {
        if *color != last {
            last = *color;
            own = [color.x, color.y, color.z].map(|v| f32::from(codes.of(v)));
        }
        for (channel, code) in channels.iter_mut().zip(own) {
            channel.push(code);
        }
    }
    channels
}

/// Marks bent pixels.
struct Bends<'a> {
    codes: &'a [Vec<f32>; 3],
    /// Numbers of the objects, 0 for none.
    objects: &'a [f32],
    size: [usize; 2],
    is_bent: &'a mut [bool],
}

impl Kernel for Bends<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self) {
        let [width, height] = self.size;
        for y in 0..height {
            let row = y * width;
            let is_inside = y > 0 && y + 1 < height && width > 2;
            let mut x = 0;
            while x < width {
                let at = row + x;
                if is_inside && x > 0 && x + LANES < width {
                    let bits = self.eight::<L>(at);
                    for lane in lanes_of(bits) {
                        self.is_bent[at + lane] = true;
                    }
                    x += LANES;
                } else {
                    self.is_bent[at] = self.one(x, y);
                    x += 1;
                }
            }
        }
    }
}

impl Bends<'_> {
    /// Bits of the eight pixels from `at` on, none of which lies on the image's border.
    #[inline(always)]
    fn eight<L: Lanes>(&self, at: usize) -> u32 {
        let zero = L::splat(0.0);
        let objects = L::load_from(&self.objects[at..]);
        let present = zero.lt(objects);
        if !present.any() {
            return 0;
        }
        let width = self.size[0];
        let (bend, step_limit) = (
            L::splat(f32::from(BEND_LIMIT)),
            L::splat(f32::from(STEP_LIMIT)),
        );
        let mut is_even = present;
        for step in [1, width, width + 1, width - 1] {
            let before = L::load_from(&self.objects[at - step..]);
            let after = L::load_from(&self.objects[at + step..]);
            is_even = is_even & before.eq(objects) & after.eq(objects);
            for codes in self.codes {
                let own = L::load_from(&codes[at..]);
                let before = own - L::load_from(&codes[at - step..]);
                let after = L::load_from(&codes[at + step..]) - own;
                let turn = before - after;
                let turn = turn.max(zero - turn);
                let largest = before.max(zero - before).max(after).max(zero - after);
                is_even = is_even & turn.le(bend) & largest.le(step_limit);
            }
        }
        (present & !is_even).bits()
    }

    /// Whether a pixel is bent, at the border of the image or not.
    fn one(&self, x: usize, y: usize) -> bool {
        let [width, height] = self.size;
        let at = y * width + x;
        let object = self.objects[at];
        if object == 0.0 {
            return false;
        }
        let (is_across, is_along) = (x > 0 && x + 1 < width, y > 0 && y + 1 < height);
        let ways = [
            (is_across, 1),
            (is_along, width),
            (is_across && is_along, width + 1),
            (is_across && is_along, width.saturating_sub(1)),
        ];
        ways.into_iter().any(|(is_inside, step)| {
            is_inside
                && (self.objects[at - step] != object
                    || self.objects[at + step] != object
                    || self.codes.iter().any(|codes| {
                        let before = codes[at] - codes[at - step];
                        let after = codes[at + step] - codes[at];
                        (before - after).abs() > f32::from(BEND_LIMIT)
                            || before.abs().max(after.abs()) > f32::from(STEP_LIMIT)
                    }))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facile_core::color::LINEAR_FROM_SRGB8;
    use facile_core::rng::RandomStream;

    #[test]
    fn eight_pixels_are_as_one() {
        let mut random = RandomStream::new(4, 0);
        for [width, height] in [[1, 1], [2, 5], [37, 11], [64, 3]] {
            let codes: [Vec<f32>; 3] = std::array::from_fn(|_| {
                let code = |_| (random.unit() * 20.0).floor() as f32;
                (0..width * height).map(code).collect()
            });
            // Few steps between objects, some pixels of none
            let mut object = |_| match random.unit() {
                u if u < 0.02 => 0.0,
                u if u < 0.05 => 2.0,
                _ => 1.0,
            };
            let objects: Vec<f32> = (0..width * height).map(&mut object).collect();
            let mut is_bent = vec![false; width * height];
            let size = [width, height];
            run(Bends {
                codes: &codes,
                objects: &objects,
                size,
                is_bent: &mut is_bent,
            });
            let mut nothing = [];
            let plain = Bends {
                codes: &codes,
                objects: &objects,
                size,
                is_bent: &mut nothing,
            };
            for (i, found) in is_bent.iter().enumerate() {
                assert_eq!(*found, plain.one(i % width, i / width), "{i} of {size:?}");
            }
            let bent = is_bent.iter().filter(|b| **b).count();
            assert!(width < 30 || (bent > 20 && bent < is_bent.len()));
        }
    }

    #[test]
    fn steps_are_bent_and_slopes_are_not() {
        let pixels: Vec<[u32; 2]> = (0..24).map(|i| [i % 6, i / 6]).collect();
        let bent = |value: &dyn Fn(usize) -> f32, object: &dyn Fn(usize) -> u32| {
            let code = |x: usize| LINEAR_FROM_SRGB8[value(x) as usize];
            let image = Plane::from_fn(6, 4, |x, _| Rgb::repeat(code(x)));
            let objects = Plane::from_fn(6, 4, |x, _| object(x));
            bent_pixels(&image, &objects, &pixels)
        };
        let step = |x: usize| if x < 3 { 100.0 } else { 120.0 };
        let columns: Vec<u32> = bent(&step, &|_| 0).iter().map(|p| p[0]).collect();
        assert_eq!(columns, [2, 3, 2, 3, 2, 3, 2, 3]);
        assert!(bent(&|x| 20.0 * x as f32, &|_| 0).is_empty());
        // Next to another object neighbours tell nothing
        let columns: Vec<u32> = bent(&|_| 90.0, &|x| u32::from(x < 3))
            .iter()
            .map(|p| p[0])
            .collect();
        assert_eq!(columns, [2, 3, 2, 3, 2, 3, 2, 3]);
        assert!(bent(&step, &|_| NO_OBJECT).is_empty());
    }
}
