//! The image function of eq. 4: normals, colour, mean and Gaussian curvature over the radial map.

use facile_core::{Mesh, Plane, Vector3};
use serde::{Deserialize, Serialize};

use crate::blur::{blur, masked_blur};
use crate::curvature::{Operator, invariants};
use crate::radial_map::{HOLE, RadialMap};

/// Number of channels: `N_x N_y N_z R G B H K`.
pub const CHANNELS: usize = 8;

/// Place of mean curvature among the channels.
pub(crate) const MEAN: usize = 6;

/// The weighted channels of one cell: squared, they sum to the `||I||^2` of eq. 4.
pub type Channels = [f32; CHANNELS];

/// Weights of eq. 4. All are for dimensionless channels of similar size: normals as they are, colour over its standard
/// deviation, curvature in units of [`ChannelWeights::curvature_unit`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ChannelWeights {
    /// `w_N`, the same for x, y and z.
    pub normal: f64,
    /// `w_R`, `w_G`, `w_B`.
    pub color: f64,
    /// `w_H`.
    pub mean_curvature: f64,
    /// `w_K`.
    pub gaussian_curvature: f64,
    /// A curvature that counts as 1, 1/mm; larger ones are compressed, as the brim of an ear would outshout a mouth.
    pub curvature_unit: f64,
    /// Variations wider than this, mm, are taken out of normals and colour: they tell faces and lights apart, not
    /// places on a face. Plain normals pull smooth cheeks by centimetres.
    pub detail_mm: f64,
}

impl Default for ChannelWeights {
    fn default() -> Self {
        Self {
            normal: 1.0,
            color: 0.15,
            mean_curvature: 0.5,
            gaussian_curvature: 0.15,
            curvature_unit: 0.05,
            detail_mm: 20.0,
        }
    }
}

/// What a surface shows on the cylinder.
#[derive(Clone, Debug)]
pub struct CylinderImage {
    /// Weighted channels; holes are filled smoothly.
    pub values: Plane<Channels>,
    /// How much each cell can be trusted, `[0, 1]`; 0 in holes.
    pub mask: Plane<f32>,
}

/// The channels of eq. 4 before anything is compared: what one surface shows on its own.
#[derive(Clone, Debug)]
pub(crate) struct RawImage {
    values: Plane<Channels>,
    /// 1 where there is surface.
    pub(crate) covered: Plane<f32>,
    /// How much each cell can be trusted, `[0, 1]`; 0 in holes.
    trust: Plane<f32>,
    h_step: f64,
}

/// Per-vertex input of the channels.
pub(crate) struct Attributes<'a> {
    /// Unit normals.
    pub(crate) normals: &'a [Vector3],
    /// Shape operators, in any frame.
    pub(crate) operators: &'a [Operator],
    /// Standard deviation of the neighbourhood over which operators are averaged, mm.
    pub(crate) curvature_sigma: f64,
    /// Linear RGB of every cell, if the surface has colour.
    pub(crate) color: Option<&'a Plane<[f32; 3]>>,
}

/// Samples the channels of eq. 4 over a radial map; `trust` in `[0, 1]` is that of each triangle.
pub(crate) fn sample_channels(
    mesh: &Mesh,
    map: &RadialMap,
    attributes: &Attributes<'_>,
    trust: impl Fn(u32) -> f32,
    weights: &ChannelWeights,
) -> RawImage {
    let (nx, ny) = (map.grid.width, map.grid.height);
    let mut trusted = Plane::filled(nx, ny, 0.0_f32);
    let mut covered = Plane::filled(nx, ny, 0.0_f32);
    let mut values = Plane::filled(nx, ny, [0.0_f32; CHANNELS]);
    let mut operators = Plane::filled(nx, ny, [0.0_f32; 6]);
    for y in 0..ny {
        for x in 0..nx {
            let t = map.triangle[(x, y)];
            if t == HOLE {
                continue;
            }
            let [v, w] = map.weights[(x, y)].map(f64::from);
            let share = [1.0 - v - w, v, w];
            let (mut normal, mut operator) = (Vector3::zeros(), [0.0_f64; 6]);
            for (corner, share) in mesh.triangles[t as usize].iter().zip(share) {
                normal += attributes.normals[*corner as usize] * share;
                for (o, value) in operator
                    .iter_mut()
                    .zip(attributes.operators[*corner as usize])
                {
                    *o += value * share;
                }
            }
            let (normal, sign) = outward(normal, map, x);
            let color = attributes.color.map_or([0.0; 3], |c| c[(x, y)]);
            trusted[(x, y)] = trust(t);
            covered[(x, y)] = 1.0;
            operators[(x, y)] = operator.map(|o| (o * sign) as f32);
            values[(x, y)] = [
                normal.x as f32,
                normal.y as f32,
                normal.z as f32,
                color[0],
                color[1],
                color[2],
                0.0,
                0.0,
            ];
        }
    }
    let sigma = attributes.curvature_sigma / map.grid.h_step;
    let operators = masked_blur(&operators, &covered, sigma);
    let unit = weights.curvature_unit;
    for (value, operator) in values.as_mut_slice().iter_mut().zip(operators.as_slice()) {
        let (h, k) = invariants(&operator.map(f64::from));
        value[MEAN] = compress(h / unit) as f32;
        value[MEAN + 1] = compress(k / (unit * unit)) as f32;
    }
    RawImage {
        values,
        covered,
        trust: trusted,
        h_step: map.grid.h_step,
    }
}

/// Makes one of two images that are to be compared. What is wide is taken out over `support`, the cells that both
/// surfaces cover: else every border of the one would be a slope in the other.
pub(crate) fn comparable(
    raw: &RawImage,
    support: &Plane<f32>,
    weights: &ChannelWeights,
) -> CylinderImage {
    let mut values = raw.values.clone();
    remove_wide_variation(&mut values, support, weights.detail_mm / raw.h_step);
    normalize_color(&mut values, support);
    apply_weights(&mut values, weights);
    let soft = blur(&raw.covered, 1.5);
    fill_holes(&mut values, &raw.covered);
    let (nx, ny) = (raw.trust.width(), raw.trust.height());
    // Beside a hole normals and curvature know one side only.
    let mask = Plane::from_fn(nx, ny, |x, y| {
        let inside = (2.0 * soft[(x, y)] - 1.0).clamp(0.0, 1.0);
        raw.trust[(x, y)] * inside * inside
    });
    CylinderImage { values, mask }
}

/// Smooth, odd, bounded by 2: keeps small values as they are.
fn compress(v: f64) -> f64 {
    2.0 * libm::tanh(0.5 * v)
}

/// Unit normal on the side of the axis that the ray leaves to, whatever the orientation of the triangle, and -1 if it
/// was turned.
fn outward(normal: Vector3, map: &RadialMap, x: usize) -> (Vector3, f64) {
    let phi = map.grid.cylinder_from_cell([x as f64, 0.0]).1;
    let unit = normal.try_normalize(1e-12).unwrap_or_else(Vector3::zeros);
    if unit.x * libm::sin(phi) + unit.z * libm::cos(phi) < 0.0 {
        (-unit, -1.0)
    } else {
        (unit, 1.0)
    }
}

/// Takes the local mean over `sigma` cells out of normals and colour.
fn remove_wide_variation(values: &mut Plane<Channels>, mask: &Plane<f32>, sigma: f64) {
    /// A wide blur needs no more than the means of so many cells either way.
    const STEP: usize = 4;
    if sigma <= 0.0 {
        return;
    }
    let wide = pooled(values, mask, STEP, sigma / STEP as f64);
    for y in 0..values.height() {
        for x in 0..values.width() {
            let mean = bilinear(&wide, pooled_cell::<STEP>(x), pooled_cell::<STEP>(y));
            for (value, mean) in values[(x, y)][..6].iter_mut().zip(mean) {
                *value -= mean;
            }
        }
    }
}

/// Divides colour by its standard deviation over the mask, so that tone and exposure of the scan do not matter.
fn normalize_color(values: &mut Plane<Channels>, mask: &Plane<f32>) {
    let (mut sum, mut weight) = (0.0_f64, 1e-9_f64);
    for (value, w) in values.as_slice().iter().zip(mask.as_slice()) {
        let square: f32 = value[3..6].iter().map(|c| c * c).sum();
        sum += f64::from(square * w);
        weight += f64::from(*w);
    }
    let deviation = (sum / (3.0 * weight)).sqrt();
    let scale = if deviation > 1e-6 {
        (1.0 / deviation) as f32
    } else {
        0.0
    };
    for value in values.as_mut_slice() {
        for c in &mut value[3..6] {
            *c = (*c * scale).clamp(-3.0, 3.0) * 0.3;
        }
    }
}

fn apply_weights(values: &mut Plane<Channels>, weights: &ChannelWeights) {
    let [n, c, h, k] = [
        weights.normal,
        weights.color,
        weights.mean_curvature,
        weights.gaussian_curvature,
    ]
    .map(|w| w.max(0.0).sqrt() as f32);
    let factors = [n, n, n, c, c, c, h, k];
    for value in values.as_mut_slice() {
        for (v, f) in value.iter_mut().zip(factors) {
            *v *= f;
        }
    }
}

/// Fills cells without surface with the mean of what is near, so that borders of holes make no gradients.
fn fill_holes(values: &mut Plane<Channels>, mask: &Plane<f32>) {
    // The filling is smooth: half the cells are enough.
    const STEP: usize = 2;
    let near = pooled(values, mask, STEP, 1.5);
    for y in 0..values.height() {
        for x in 0..values.width() {
            if mask[(x, y)] <= 0.0 {
                values[(x, y)] = bilinear(&near, pooled_cell::<STEP>(x), pooled_cell::<STEP>(y));
            }
        }
    }
}

/// Gaussian mean of the cells that `mask` lets through, over blocks of `step` x `step` cells; `sigma` in blocks. Nothing
/// where the mask lets nothing through nearby.
fn pooled(values: &Plane<Channels>, mask: &Plane<f32>, step: usize, sigma: f64) -> Plane<Channels> {
    let size = (
        values.width().div_ceil(step),
        values.height().div_ceil(step),
    );
    let mut sum = Plane::filled(size.0, size.1, [0.0_f32; CHANNELS]);
    let mut weight = Plane::filled(size.0, size.1, 0.0_f32);
    let share = 1.0 / (step * step) as f32;
    for y in 0..values.height() {
        let (row, trust) = (values.row(y), mask.row(y));
        let (sums, weights) = (sum.row_mut(y / step), weight.row_mut(y / step));
        for x in 0..values.width() {
            let w = share * trust[x];
            for (c, v) in sums[x / step].iter_mut().zip(row[x]) {
                *c += w * v;
            }
            weights[x / step] += w;
        }
    }
    let (mut sum, total) = (blur(&sum, sigma), blur(&weight, sigma));
    for (cell, w) in sum.as_mut_slice().iter_mut().zip(total.as_slice()) {
        *cell = cell.map(|v| if *w > 1e-4 { v / w } else { 0.0 });
    }
    sum
}

/// Continuous place of a cell among blocks of `STEP` cells.
fn pooled_cell<const STEP: usize>(x: usize) -> f32 {
    (x as f32 + 0.5) / STEP as f32 - 0.5
}

/// Bilinear value at a continuous cell position, clamped at the border.
pub(crate) fn bilinear<const N: usize>(plane: &Plane<[f32; N]>, x: f32, y: f32) -> [f32; N] {
    let (nx, ny) = (plane.width(), plane.height());
    let x = x.clamp(0.0, (nx - 1) as f32);
    let y = y.clamp(0.0, (ny - 1) as f32);
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(nx - 1), (y0 + 1).min(ny - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let (row0, row1) = (plane.row(y0), plane.row(y1));
    let (a, b, c, d) = (&row0[x0], &row0[x1], &row1[x0], &row1[x1]);
    std::array::from_fn(|k| {
        let low = a[k] + (b[k] - a[k]) * fx;
        let high = c[k] + (d[k] - c[k]) * fx;
        low + (high - low) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weighted_norm_is_the_sum_of_eq_4() {
        let weights = ChannelWeights {
            normal: 2.0,
            color: 3.0,
            mean_curvature: 5.0,
            gaussian_curvature: 7.0,
            ..ChannelWeights::default()
        };
        let mut values = Plane::filled(1, 1, [0.6, 0.0, 0.8, 0.1, 0.2, 0.3, 0.4, 0.5]);
        apply_weights(&mut values, &weights);
        let norm: f32 = values.as_slice()[0].iter().map(|v| v * v).sum();
        let expected = 2.0 + 3.0 * (0.01 + 0.04 + 0.09) + 5.0 * 0.16 + 7.0 * 0.25;
        assert!((norm - expected).abs() < 1e-5, "{norm} against {expected}");
    }

    #[test]
    fn bilinear_reads_between_cells() {
        let plane = Plane::from_fn(4, 3, |x, y| [x as f32, 10.0 * y as f32]);
        assert_eq!(bilinear(&plane, 1.25, 0.5), [1.25, 5.0]);
        assert_eq!(bilinear(&plane, -5.0, 9.0), [0.0, 20.0]);
    }

    #[test]
    fn holes_take_the_colour_of_what_is_near() {
        let mut values = Plane::filled(20, 20, [2.0; CHANNELS]);
        let mut mask = Plane::filled(20, 20, 1.0_f32);
        values[(10, 10)] = [-50.0; CHANNELS];
        mask[(10, 10)] = 0.0;
        fill_holes(&mut values, &mask);
        assert!((values[(10, 10)][0] - 2.0).abs() < 1e-4);
        assert_eq!(values[(11, 10)][3], 2.0);
    }
}
