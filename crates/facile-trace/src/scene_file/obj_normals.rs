//! Vertex normals of an OBJ file, which [`facile_core::io`] has no use for.

use crate::math::{Vec3, unit_or};

/// The normal of each vertex, if every corner of the file names one and the normals that a vertex's corners name agree.
/// `None` otherwise: normals are then computed. Indices that do not parse count as absent.
pub(super) fn vertex_normals(bytes: &[u8], vertices: usize) -> Option<Vec<Vec3>> {
    let text = std::str::from_utf8(bytes).ok()?;
    let mut listed: Vec<Vec3> = Vec::new();
    let mut normals = vec![Vec3::zeros(); vertices];
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("vn ") {
            let mut values = rest.split_ascii_whitespace().map(str::parse::<f32>);
            let mut next = || values.next()?.ok().filter(|v| v.is_finite());
            listed.push(Vec3::new(next()?, next()?, next()?));
        } else if let Some(rest) = line.strip_prefix("f ") {
            for corner in rest.split_ascii_whitespace() {
                let mut parts = corner.split('/');
                let vertex = index(parts.next()?, vertices)?;
                let normal = index(parts.nth(1)?, listed.len())?;
                let normal = unit_or(listed[normal], Vec3::zeros());
                if normals[vertex] == Vec3::zeros() {
                    normals[vertex] = normal;
                } else if normals[vertex].dot(&normal) < 0.999 {
                    return None;
                }
            }
        }
    }
    let has_any = normals.iter().any(|n| *n != Vec3::zeros());
    has_any.then_some(normals)
}

fn index(text: &str, count: usize) -> Option<usize> {
    let value: i64 = text.parse().ok()?;
    let index = if value < 0 {
        count as i64 + value
    } else {
        value - 1
    };
    (0..count as i64).contains(&index).then_some(index as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 2\nvn 0 1 0\n";

    #[test]
    fn normals_are_read_when_they_agree() {
        let read = |faces: &str| vertex_normals(format!("{TRIANGLE}{faces}").as_bytes(), 3);
        assert_eq!(read("f 1//1 2//1 3//-2\n"), Some(vec![Vec3::z(); 3]));
        assert_eq!(read("f 1 2 3\n"), None);
        assert_eq!(read("f 1/1/1 2/1/1 3/1/1\nf 1//2 2//1 3//1\n"), None);
        assert_eq!(read("f 1//1 2//1 3//9\n"), None);
        assert_eq!(read(""), None);
    }
}
