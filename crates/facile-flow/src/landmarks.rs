//! Landmarks given with a scan, to help where no face is found without.

use facile_core::{Point3, ReferenceHead, Vector3};

use crate::FlowError;

/// First of the 68 points inside the face: those on its contour depend on the view they were set in.
const FIRST_INNER: usize = 17;

/// Points of a landmark scheme in a scan's coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanLandmarks {
    /// Five points (centres of the eyes, nose tip, corners of the mouth; the person's right first) or the 68 of ibug.
    points: Vec<Point3>,
}

/// One landmark on the reference: its corners with their weights.
pub(crate) struct Anchor {
    pub(crate) corners: [u32; 3],
    pub(crate) barycentric: [f64; 3],
    /// Where it is on the scan.
    pub(crate) at: Point3,
}

impl ScanLandmarks {
    /// Takes 5 or 68 points.
    ///
    /// # Errors
    /// [`FlowError::Landmarks`] for another number, or coordinates that are not finite.
    pub fn new(points: Vec<Point3>) -> Result<Self, FlowError> {
        let refuse = |reason: String| Err(FlowError::Landmarks { reason });
        if points.len() != 5 && points.len() != 68 {
            return refuse(format!("{} points; 5 or 68 are known", points.len()));
        }
        if let Some(i) = points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return refuse(format!("point {i} is not finite"));
        }
        Ok(Self { points })
    }

    /// The points, in the scan's coordinates.
    pub fn points(&self) -> &[Point3] {
        &self.points
    }

    /// Reads landmarks from a file's text: JSON with `[x, y, z]` lists at any depth (plain lists, `ljson`), or lines of
    /// three numbers as in `.pts` files, other lines passed over.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn parse(text: &str) -> Result<Self, FlowError> {
        let is_json = matches!(text.trim_start().as_bytes().first(), Some(b'{' | b'['));
        let triple = |part: &str, separator: fn(char) -> bool| -> Option<Point3> {
            let mut numbers = part
                .split(separator)
                .map(str::trim)
                .filter(|w| !w.is_empty())
                .map(str::parse::<f64>);
            let p = [numbers.next()?, numbers.next()?, numbers.next()?];
            let [Ok(x), Ok(y), Ok(z)] = p else {
                return None;
            };
            numbers.next().is_none().then(|| Point3::new(x, y, z))
        };
        let points = if is_json {
            // The innermost lists are those that no bracket parts.
            text.split('[')
                .filter_map(|s| s.split_once(']'))
                .filter_map(|(inside, _)| triple(inside, |c| c == ','))
                .collect()
        } else {
            text.lines()
                .filter_map(|l| triple(l, |c| c.is_whitespace() || c == ','))
                .collect()
        };
        Self::new(points)
    }

    /// The points on the reference that these are the places of.
    ///
    /// # Errors
    /// [`FlowError::Landmarks`] if the reference has no such scheme.
    pub(crate) fn anchors(&self, reference: &ReferenceHead) -> Result<Vec<Anchor>, FlowError> {
        let scheme = reference
            .landmarks
            .iter()
            .find(|s| s.points.len() == self.points.len())
            .ok_or_else(|| FlowError::Landmarks {
                reason: format!(
                    "the reference has no scheme of {} points",
                    self.points.len()
                ),
            })?;
        let first = if self.points.len() == 68 {
            FIRST_INNER
        } else {
            0
        };
        Ok((scheme.points.iter().zip(&self.points).skip(first))
            .map(|(on, at)| Anchor {
                corners: reference.mesh.triangles[on.triangle as usize],
                barycentric: on.barycentric,
                at: *at,
            })
            .collect())
    }
}

impl Anchor {
    /// Where the landmark lies on a head with these fine positions, mm.
    pub(crate) fn on(&self, positions: &[Point3]) -> Point3 {
        let sum = (self.corners.iter().zip(self.barycentric))
            .fold(Vector3::zeros(), |s, (v, w)| {
                s + positions[*v as usize].coords * w
            });
        Point3::from(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn five() -> Vec<Point3> {
        (0..5)
            .map(|i| Point3::new(f64::from(i), 0.5, -2.0 * f64::from(i)))
            .collect()
    }

    #[test]
    fn json_at_any_depth_and_plain_lines_read_the_same() {
        let rows: Vec<String> = (five().iter())
            .map(|p| format!("[{}, {}, {}]", p.x, p.y, p.z))
            .collect();
        let list = format!("[{}]", rows.join(","));
        let ljson = format!(
            "{{\"version\": 3, \"labels\": [{{\"label\": \"all\", \"mask\": [0, 1]}}], \"landmarks\": {{\"points\": {list}}}}}"
        );
        let lines: Vec<String> = (five().iter())
            .map(|p| format!("{} {} {}\n", p.x, p.y, p.z))
            .collect();
        let pts = lines.concat();
        let pts = format!("version: 1\nn_points: 5\n{{\n{pts}}}\n");
        let expected = ScanLandmarks::new(five()).expect("five points");
        for text in [list, ljson, pts] {
            assert_eq!(ScanLandmarks::parse(&text), Ok(expected.clone()), "{text}");
        }
    }

    #[test]
    fn another_number_of_points_is_refused() {
        let error = ScanLandmarks::parse("1 2 3\n4 5 6\n").expect_err("two points");
        assert_eq!(error.to_string(), "landmarks: 2 points; 5 or 68 are known");
    }
}
