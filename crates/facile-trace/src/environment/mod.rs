//! Environment maps: light from every direction, as an equirectangular picture.
//!
//! The middle of the picture is what lies behind a head that looks at the viewer, direction `-z`; its right quarter is `+x`,
//! its top `+y`. Values are linear; a map of 1 everywhere lights a white surface to 1. [`EnvironmentMap::patches`] cuts a
//! map into regions of equal light, each of which stands for a lamp far away; [`EnvironmentMap::harmonics`] sums it to nine
//! numbers a channel, without shadows.
//!
//! Sources: Debevec, A Median Cut Algorithm for Light Probe Sampling, SIGGRAPH 2005 posters; Ramamoorthi and Hanrahan, An
//! Efficient Representation for Irradiance Environment Maps, SIGGRAPH 2001.

mod file;

use crate::TraceError;
use crate::math::{Rgb, Vec3};

/// Largest width and height of a map.
pub const MAX_SIDE: usize = 16_384;

/// Light from every direction.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    /// Linear RGB, top row first.
    texels: Vec<[f32; 3]>,
}

/// A region of a map as a lamp far away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentPatch {
    /// Unit direction to its middle.
    pub towards: Vec3,
    /// What it gives a white surface that faces it.
    pub power: Rgb,
}

/// A rectangle of texels `[x0, y0, x1, y1)`.
type Region = [usize; 4];

impl EnvironmentMap {
    /// A map over linear texels, top row first.
    ///
    /// # Errors
    /// [`TraceError::SizeMismatch`] if they do not fill the size, [`TraceError::NotFinite`] for light that is not finite or
    /// negative.
    pub fn new(width: usize, height: usize, texels: Vec<[f32; 3]>) -> Result<Self, TraceError> {
        let is_size = |v: usize| (1..=MAX_SIDE).contains(&v);
        if !is_size(width) || !is_size(height) || texels.len() != width * height {
            return Err(TraceError::SizeMismatch {
                what: "texels of an environment map",
                expected: width * height,
                got: texels.len(),
            });
        }
        let is_bad = |t: &[f32; 3]| !t.iter().all(|v| v.is_finite() && *v >= 0.0);
        if let Some(index) = texels.iter().position(is_bad) {
            return Err(TraceError::NotFinite {
                what: "texel of an environment map",
                index,
                value: format!("{:?}", texels[index]),
            });
        }
        Ok(Self {
            width,
            height,
            texels,
        })
    }

    /// Size and texels, for hashes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let size = [self.width as u32, self.height as u32];
        let size = size.iter().flat_map(|v| v.to_le_bytes());
        let texels = self.texels.iter().flatten();
        size.chain(texels.flat_map(|v| v.to_le_bytes())).collect()
    }

    /// Light from a direction of any length, bilinear.
    pub fn light(&self, direction: Vec3) -> Rgb {
        let length = direction.norm();
        let up = if length > 0.0 {
            direction.y / length
        } else {
            0.0
        };
        let turn = libm::atan2f(direction.x, -direction.z);
        let u = 0.5 + turn / std::f32::consts::TAU;
        let v = libm::acosf(up.clamp(-1.0, 1.0)) / std::f32::consts::PI;
        let x = u * self.width as f32 - 0.5;
        let y = (v * self.height as f32 - 0.5).clamp(0.0, self.height as f32 - 1.0);
        let (x0, y0) = (x.floor(), y as usize);
        let (fx, fy) = (x - x0, y - y0 as f32);
        let column = |c: i64| c.rem_euclid(self.width as i64) as usize;
        let (left, right) = (column(x0 as i64), column(x0 as i64 + 1));
        let y1 = (y0 + 1).min(self.height - 1);
        let at = |x: usize, y: usize| Rgb::from(self.texels[y * self.width + x]);
        let top = at(left, y0).lerp(&at(right, y0), fx);
        let bottom = at(left, y1).lerp(&at(right, y1), fx);
        top.lerp(&bottom, fy)
    }

    /// Mean light over all directions.
    pub fn mean(&self) -> Rgb {
        let (mut sum, mut total) = ([0.0_f64; 3], 0.0);
        for (y, row) in self.texels.chunks_exact(self.width).enumerate() {
            let angle = self.solid_angle(y);
            for texel in row {
                total += angle;
                for k in 0..3 {
                    sum[k] += f64::from(texel[k]) * angle;
                }
            }
        }
        Rgb::from(sum.map(|v| (v / total) as f32))
    }

    /// Cuts the map into at most `count` regions of about equal light, each with its middle and what it gives.
    pub fn patches(&self, count: usize) -> Vec<EnvironmentPatch> {
        let sums = self.sums();
        let mut regions: Vec<Region> = vec![[0, 0, self.width, self.height]];
        while regions.len() < count {
            // Cut what holds most light; of equals the first
            let lightest = (0..regions.len())
                .filter(|i| extent(&regions[*i]) > 1)
                .max_by(|a, b| {
                    let [a_sum, b_sum] = [*a, *b].map(|i| self.energy(&sums, &regions[i]));
                    a_sum.total_cmp(&b_sum).then(b.cmp(a))
                });
            let Some(i) = lightest.filter(|i| self.energy(&sums, &regions[*i]) > 0.0) else {
                break;
            };
            let [first, second] = self.cut(&sums, regions[i]);
            regions[i] = first;
            regions.push(second);
        }
        regions.iter().filter_map(|r| self.patch(r)).collect()
    }

    /// Irradiance of nine harmonics, over pi: of a surface of unit normal `n` it is the constant, then
    /// `c[k + 1] n[k]`, then the coefficients of `xy, yz, zx, 3 z^2 - 1, x^2 - y^2`.
    pub fn harmonics(&self) -> [[f32; 3]; 9] {
        let mut sums = [[0.0_f64; 3]; 9];
        for y in 0..self.height {
            let angle = self.solid_angle(y);
            for x in 0..self.width {
                let basis = basis(self.direction(x as f64 + 0.5, y as f64 + 0.5));
                let texel = self.texels[y * self.width + x];
                for (sum, b) in sums.iter_mut().zip(basis) {
                    for k in 0..3 {
                        sum[k] += f64::from(texel[k]) * b * angle;
                    }
                }
            }
        }
        std::array::from_fn(|i| sums[i].map(|v| (v * FACTORS[i]) as f32))
    }

    /// Unit direction of a position in texels.
    fn direction(&self, x: f64, y: f64) -> [f64; 3] {
        let turn = (x / self.width as f64 - 0.5) * std::f64::consts::TAU;
        let polar = y / self.height as f64 * std::f64::consts::PI;
        let (sin, cos) = libm::sincos(polar);
        let (turn_sin, turn_cos) = libm::sincos(turn);
        [sin * turn_sin, cos, -sin * turn_cos]
    }

    /// Solid angle of a texel of row `y`.
    fn solid_angle(&self, y: usize) -> f64 {
        let edge = |y: usize| libm::cos(std::f64::consts::PI * y as f64 / self.height as f64);
        (edge(y) - edge(y + 1)) * std::f64::consts::TAU / self.width as f64
    }

    /// Sums of luminance times solid angle over the texels before each corner, `(width + 1) x (height + 1)`.
    fn sums(&self) -> Vec<f64> {
        let stride = self.width + 1;
        let mut sums = vec![0.0; stride * (self.height + 1)];
        for y in 0..self.height {
            let (angle, mut row) = (self.solid_angle(y), 0.0);
            for x in 0..self.width {
                let [r, g, b] = self.texels[y * self.width + x].map(f64::from);
                row += (0.2126 * r + 0.7152 * g + 0.0722 * b) * angle;
                sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + row;
            }
        }
        sums
    }

    fn energy(&self, sums: &[f64], &[x0, y0, x1, y1]: &Region) -> f64 {
        let at = |x: usize, y: usize| sums[y * (self.width + 1) + x];
        (at(x1, y1) - at(x0, y1) - at(x1, y0) + at(x0, y0)).max(0.0)
    }

    /// Halves a region's light across its longer side.
    fn cut(&self, sums: &[f64], region: Region) -> [Region; 2] {
        let [x0, y0, x1, y1] = region;
        let polar = std::f64::consts::PI * (y0 + y1) as f64 / (2.0 * self.height as f64);
        let width = (x1 - x0) as f64 / self.width as f64 * 2.0 * libm::sin(polar);
        let height = (y1 - y0) as f64 / self.height as f64;
        let by_column = y1 - y0 == 1 || (width >= height && x1 - x0 > 1);
        let (from, to) = if by_column { (x0, x1) } else { (y0, y1) };
        let halves = |at: usize| {
            if by_column {
                [[x0, y0, at, y1], [at, y0, x1, y1]]
            } else {
                [[x0, y0, x1, at], [x0, at, x1, y1]]
            }
        };
        let half = self.energy(sums, &region) / 2.0;
        let (mut low, mut high) = (from + 1, to - 1);
        while low < high {
            let middle = low.midpoint(high);
            if self.energy(sums, &halves(middle)[0]) < half {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        halves(low)
    }

    /// A region as a lamp; `None` if it is dark.
    fn patch(&self, &[x0, y0, x1, y1]: &Region) -> Option<EnvironmentPatch> {
        let (mut middle, mut power) = ([0.0_f64; 3], [0.0_f64; 3]);
        for y in y0..y1 {
            let angle = self.solid_angle(y);
            for x in x0..x1 {
                let texel = self.texels[y * self.width + x].map(|v| f64::from(v) * angle);
                let direction = self.direction(x as f64 + 0.5, y as f64 + 0.5);
                let weight: f64 = texel.iter().sum();
                for k in 0..3 {
                    power[k] += texel[k] / std::f64::consts::PI;
                    middle[k] += direction[k] * weight;
                }
            }
        }
        let towards = nalgebra::Vector3::from(middle).try_normalize(1e-300)?;
        Some(EnvironmentPatch {
            towards: towards.cast::<f32>(),
            power: Rgb::from(power.map(|v| v as f32)),
        })
    }
}

fn extent([x0, y0, x1, y1]: &Region) -> usize {
    (x1 - x0) * (y1 - y0)
}

/// The functions that [`EnvironmentMap::harmonics`] sums over.
pub(crate) fn basis([x, y, z]: [f64; 3]) -> [f64; 9] {
    [
        1.0,
        x,
        y,
        z,
        x * y,
        y * z,
        z * x,
        3.0 * z * z - 1.0,
        x * x - y * y,
    ]
}

/// Squared norms of the harmonics over these functions' times the cosine's weights `(1, 2/3, 1/4)`.
const FACTORS: [f64; 9] = {
    const PI: f64 = std::f64::consts::PI;
    [
        1.0 / (4.0 * PI),
        2.0 / (4.0 * PI),
        2.0 / (4.0 * PI),
        2.0 / (4.0 * PI),
        15.0 / (16.0 * PI),
        15.0 / (16.0 * PI),
        15.0 / (16.0 * PI),
        5.0 / (64.0 * PI),
        15.0 / (64.0 * PI),
    ]
};

#[cfg(test)]
mod tests {
    use super::*;

    /// A map of `light(direction)`.
    fn map(width: usize, height: usize, light: impl Fn([f64; 3]) -> [f32; 3]) -> EnvironmentMap {
        let blank = EnvironmentMap::new(width, height, vec![[0.0; 3]; width * height]);
        let blank = blank.expect("fits");
        let texels = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                light(blank.direction(x as f64 + 0.5, y as f64 + 0.5))
            })
            .collect();
        EnvironmentMap::new(width, height, texels).expect("fits")
    }

    /// What a white surface of normal `n` gets, by the sum over all texels.
    fn irradiance(map: &EnvironmentMap, n: Vec3) -> f64 {
        let mut sum = 0.0;
        for y in 0..map.height {
            for x in 0..map.width {
                let d = map.direction(x as f64 + 0.5, y as f64 + 0.5);
                let cosine: f64 = (0..3).map(|k| d[k] * f64::from(n[k])).sum();
                let light = f64::from(map.texels[y * map.width + x][0]);
                sum += light * cosine.max(0.0) * map.solid_angle(y) / std::f64::consts::PI;
            }
        }
        sum
    }

    fn normals() -> impl Iterator<Item = Vec3> {
        (0..24).map(|i| {
            let t = i as f32;
            crate::math::unit_or(
                Vec3::new((t * 1.7).sin(), (t * 0.9).cos(), (t * 2.3).sin()),
                Vec3::y(),
            )
        })
    }

    #[test]
    fn light_comes_from_where_the_picture_shows_it() {
        let map = map(64, 32, |d| d.map(|v| (0.5 + 0.5 * v) as f32));
        for n in normals() {
            let found = map.light(n * 3.0);
            let expected = n.map(|v| 0.5 + 0.5 * v);
            assert!((found - expected).norm() < 0.06, "{n}: {found}");
        }
        assert!((map.mean() - Rgb::repeat(0.5)).norm() < 1e-3);
    }

    #[test]
    fn more_patches_come_closer_to_the_map() {
        // A soft sun over a sky
        let map = map(128, 64, |[x, y, z]| {
            let sun = (0.4 * x + 0.6 * y - 0.69 * z).max(0.0).powi(60);
            [(0.2 + 0.2 * y.max(0.0) + 6.0 * sun) as f32; 3]
        });
        let error = |count: usize| {
            let patches = map.patches(count);
            assert!(patches.len() <= count);
            let total: f32 = patches.iter().map(|p| p.power.x).sum();
            assert!((total - 4.0 * map.mean().x).abs() < 1e-3 * total, "{total}");
            normals()
                .map(|n| {
                    let lamps = patches
                        .iter()
                        .map(|p| p.towards.dot(&n).max(0.0) * p.power.x);
                    (f64::from(lamps.sum::<f32>()) - irradiance(&map, n)).abs()
                })
                .fold(0.0, f64::max)
        };
        let errors = [4, 16, 64, 256].map(error);
        assert!(errors[3] < 0.01 && errors[2] < 0.03, "{errors:?}");
        assert!(errors[3] < 0.3 * errors[0], "{errors:?}");
        assert_eq!(map.patches(32), map.patches(32));
    }

    #[test]
    fn nine_harmonics_give_smooth_light() {
        let map = map(96, 48, |[x, y, z]| {
            [(1.0 + 0.5 * y + 0.3 * x * z + 0.2 * z * z) as f32; 3]
        });
        let c = map.harmonics();
        for n in normals() {
            let b = basis([n.x, n.y, n.z].map(f64::from));
            let found: f64 = (0..9).map(|i| f64::from(c[i][0]) * b[i]).sum();
            let exact = irradiance(&map, n);
            assert!((found - exact).abs() < 2e-3 * exact, "{n}: {found} {exact}");
        }
    }

    #[test]
    fn a_dark_map_has_no_patches() {
        assert!(map(8, 4, |_| [0.0; 3]).patches(16).is_empty());
        assert!(EnvironmentMap::new(2, 1, vec![[0.0; 3]]).is_err());
        assert!(EnvironmentMap::new(1, 1, vec![[-1.0, 0.0, 0.0]]).is_err());
        assert!(EnvironmentMap::new(1, 1, vec![[f32::NAN; 3]]).is_err());
        assert_eq!(map(1, 1, |_| [1.0; 3]).patches(16).len(), 1);
    }
}
