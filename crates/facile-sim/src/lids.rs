//! Eyelids as tarsal plates that slide on the eyeball.
//!
//! The tarsus is a stiff plate in the lid: levator palpebrae and orbicularis oculi pull on the plate, not on single
//! points of skin. Each point of a lid turns about the eyeball's horizontal axis, so that it keeps its distance from
//! the eyeball's centre. How far it turns at full closure follows from the subject's own lid margins: both meet on one
//! line, most of the way travelled by the upper lid. The fascia of the plates is moved, skin around it is simulated.

use std::collections::BTreeMap;

use crate::vector::{V3, norm, sub};

/// Share of the opening that the lower lid closes.
const LOWER_SHARE: f64 = 0.16;
/// The margins pass each other by this much at full closure, mm, so that no gap is left between them where they
/// are steep.
const OVERLAP_MM: f64 = 0.8;
/// Turn of the upper lid by a fully contracted levator, rad.
const LEVATOR_UP_RAD: f64 = 0.17;
/// Turn of the lower lid at the same time (its retractors work along), rad.
const LEVATOR_DOWN_RAD: f64 = 0.045;
/// Share of the eye's pitch that the upper and the lower lid follow.
const GAZE_FOLLOW: [f64; 2] = [0.62, 0.42];

/// How a cage vertex turns with the lid it belongs to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LidVertex {
    /// 0 for the left eye, 1 for the right.
    pub(crate) eye: usize,
    /// Signed weight: positive on the upper lid.
    weight: f64,
    /// Rise (change of elevation seen from the eyeball's centre) at full closure, rad.
    closure: f64,
}

/// What moves a pair of lids.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LidPose {
    /// Contraction of the palpebral orbicularis oculi.
    pub(crate) close: f64,
    /// Contraction of the levator palpebrae.
    pub(crate) open: f64,
    /// Pitch of the eye, rad, positive up.
    pub(crate) pitch: f64,
}

impl LidVertex {
    /// Change of elevation, rad.
    pub(crate) fn rise(&self, pose: &LidPose) -> f64 {
        let upper = self.weight > 0.0;
        // The lower lid, which has little way to go, is there first: narrowed eyes show a raised lower lid.
        let closed = if upper {
            pose.close
        } else {
            pose.close * (2.0 - pose.close)
        };
        let follow = pose.pitch * GAZE_FOLLOW[usize::from(!upper)];
        let levator = pose.open
            * if upper {
                LEVATOR_UP_RAD
            } else {
                -LEVATOR_DOWN_RAD
            };
        self.weight.abs() * (1.0 - closed) * (follow + levator) + closed * self.closure
    }
}

/// The lid vertices of a subject: for each cage vertex with a lid weight.
///
/// `positions`, `weights`: per cage vertex. `rims`: cage vertices of the three rings of margin of each eye. `centers`:
/// of both eyeballs.
pub(crate) fn lid_vertices(
    positions: &[V3],
    weights: &[f64],
    rims: &[Vec<u32>; 2],
    centers: &[V3; 2],
) -> BTreeMap<u32, LidVertex> {
    let margins = [0, 1].map(|e| Margin::new(positions, weights, &rims[e], centers[e]));
    let mut out = BTreeMap::new();
    for (v, &weight) in weights.iter().enumerate() {
        if weight == 0.0 {
            continue;
        }
        let p = positions[v];
        let eye = usize::from(norm(sub(p, centers[1])) < norm(sub(p, centers[0])));
        let margin = &margins[eye];
        let closure = if rims[eye].contains(&(v as u32)) {
            margin.closure_of_rim(p[0], elevation(p, centers[eye]), weight)
        } else {
            margin.closure(p[0], weight)
        };
        let vertex = LidVertex {
            eye,
            weight,
            closure,
        };
        out.insert(v as u32, vertex);
    }
    out
}

/// Both lid margins of one eye as curves: elevation over `x`.
struct Margin {
    /// `x`, lowest elevation of the upper margin, highest of the lower, and the margins' lid weights.
    columns: Vec<[f64; 5]>,
    radius: f64,
}

const COLUMNS: usize = 48;

impl Margin {
    fn new(positions: &[V3], weights: &[f64], rim: &[u32], center: V3) -> Self {
        let at = |v: u32| positions[v as usize];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut radius = 0.0;
        for &v in rim {
            low = low.min(at(v)[0]);
            high = high.max(at(v)[0]);
            radius += norm(sub(at(v), center)) / rim.len() as f64;
        }
        let side = |upper: bool| -> Vec<[f64; 3]> {
            let mut points: Vec<[f64; 3]> = rim
                .iter()
                .filter(|&&v| (weights[v as usize] > 0.0) == upper && weights[v as usize] != 0.0)
                .map(|&v| {
                    [
                        at(v)[0],
                        elevation(at(v), center),
                        weights[v as usize].abs(),
                    ]
                })
                .collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            points
        };
        let (upper, lower) = (side(true), side(false));
        let mut columns = Vec::new();
        for k in 0..=COLUMNS {
            let x = low + (high - low) * k as f64 / COLUMNS as f64;
            let reach = (high - low) * 2.0 / COLUMNS as f64;
            let edge = |points: &[[f64; 3]], sign: f64| -> Option<[f64; 2]> {
                points
                    .iter()
                    .filter(|p| (p[0] - x).abs() <= reach)
                    .map(|p| [p[1], p[2]])
                    .min_by(|a, b| (sign * a[0]).total_cmp(&(sign * b[0])))
            };
            if let (Some(u), Some(l)) = (edge(&upper, 1.0), edge(&lower, -1.0)) {
                columns.push([x, u[0], l[0], u[1], l[1]]);
            }
        }
        // Evens out the steps of the envelope.
        for _ in 0..6 {
            let old = columns.clone();
            for k in 1..columns.len().saturating_sub(1) {
                for c in 1..5 {
                    columns[k][c] = 0.25 * (old[k - 1][c] + 2.0 * old[k][c] + old[k + 1][c]);
                }
            }
        }
        Self {
            columns,
            radius: radius.max(1.0),
        }
    }

    /// The margins at `x`: elevation of the upper and the lower one, their lid weights, and where they meet.
    fn at(&self, x: f64) -> Option<([f64; 4], f64)> {
        let last = self.columns.len().checked_sub(1).filter(|n| *n > 0)?;
        let k = self.columns.partition_point(|c| c[0] <= x).clamp(1, last);
        let (a, b) = (self.columns[k - 1], self.columns[k]);
        let t = ((x - a[0]) / (b[0] - a[0]).max(1e-9)).clamp(0.0, 1.0);
        let margins = [1, 2, 3, 4].map(|c| a[c] + t * (b[c] - a[c]));
        let [upper, lower, ..] = margins;
        Some((margins, lower + LOWER_SHARE * (upper - lower).max(0.0)))
    }

    /// Half of what margins that are `open` apart pass each other by, rad.
    fn overlap(&self, open: f64) -> f64 {
        // Where the margins already touch there is nothing to overlap.
        (0.5 * OVERLAP_MM / self.radius).min(0.5 * open.max(0.0))
    }

    /// Rise at full closure of a vertex of the margin: to where the margins meet, however steep they are there.
    fn closure_of_rim(&self, x: f64, elevation: f64, weight: f64) -> f64 {
        let Some((_, meet)) = self.at(x) else {
            return 0.0;
        };
        let open = elevation - meet;
        if weight > 0.0 {
            (-open - self.overlap(2.0 * open)).min(0.0)
        } else {
            (-open + self.overlap(-2.0 * open)).max(0.0)
        }
    }

    /// Rise at full closure of a vertex beside the margin, at `x` with this lid weight.
    fn closure(&self, x: f64, weight: f64) -> f64 {
        let (Some(first), Some(last), Some((margins, meet))) =
            (self.columns.first(), self.columns.last(), self.at(x))
        else {
            return 0.0;
        };
        // Beyond the corners of the eye the motion fades out.
        let outside = (first[0] - x).max(x - last[0]).max(0.0);
        let fade = (1.0 - outside / 4.0).clamp(0.0, 1.0);
        let [upper, lower, weight_of_upper, weight_of_lower] = margins;
        let overlap = self.overlap(upper - lower);
        let (way, rim_weight) = if weight > 0.0 {
            (meet - upper - overlap, weight_of_upper)
        } else {
            (meet - lower + overlap, weight_of_lower)
        };
        way * (weight.abs() / rim_weight.max(0.15)).min(1.0) * fade
    }
}

/// Elevation of a point seen from the eyeball's centre, rad.
fn elevation(p: V3, center: V3) -> f64 {
    libm::atan2(p[1] - center[1], p[2] - center[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Margins of an almond-shaped slit on a sphere of radius 12 around the origin.
    fn almond() -> (Vec<V3>, Vec<f64>, Vec<u32>) {
        let mut positions = Vec::new();
        let mut weights = Vec::new();
        for upper in [true, false] {
            for k in 0..=16 {
                let t = f64::from(k) / 8.0 - 1.0;
                let (x, bow) = (8.0 * t, 1.0 - t * t);
                let elevation = if upper { 0.3 * bow } else { -0.35 * bow };
                let ring = libm::sqrt(144.0 - x * x);
                positions.push([x, ring * libm::sin(elevation), ring * libm::cos(elevation)]);
                weights.push(if upper { bow } else { -bow });
            }
        }
        let rim = (0..positions.len() as u32).collect();
        (positions, weights, rim)
    }

    #[test]
    fn closed_margins_meet_and_overlap_a_little() {
        let (positions, weights, rim) = almond();
        let far = [100.0, 0.0, 0.0];
        let lids = lid_vertices(&positions, &weights, &[rim, vec![]], &[[0.0; 3], far]);
        let closed = LidPose {
            close: 1.0,
            ..LidPose::default()
        };
        let place = |v: u32| {
            let p = positions[v as usize];
            let rise = lids.get(&v).map_or(0.0, |l| l.rise(&closed));
            12.0 * (libm::atan2(p[1], p[2]) + rise)
        };
        // Up to the corners, where the margins are steep and near each other.
        for k in 1..16 {
            let gap = place(k) - place(17 + k);
            assert!((-OVERLAP_MM - 0.2..0.0).contains(&gap), "column {k}: {gap}");
        }
        assert!(lids[&8].closure < 0.0 && lids[&25].closure > 0.0);
        assert!(lids[&8].closure.abs() > 3.0 * lids[&25].closure.abs());
    }

    #[test]
    fn the_levator_opens_and_gaze_pulls_both_lids_along() {
        let (positions, weights, rim) = almond();
        let far = [100.0, 0.0, 0.0];
        let lids = lid_vertices(&positions, &weights, &[rim, vec![]], &[[0.0; 3], far]);
        let rise = |v: u32, open, pitch| {
            let pose = LidPose {
                close: 0.0,
                open,
                pitch,
            };
            lids[&v].rise(&pose)
        };
        assert!(rise(8, 1.0, 0.0) > 0.1 && rise(25, 1.0, 0.0) < 0.0);
        assert!(rise(8, 0.0, -0.4) < rise(25, 0.0, -0.4) && rise(25, 0.0, -0.4) < 0.0);
        assert!(rise(8, 0.0, 0.0) == 0.0);
    }
}
