//! A shirt on the reference head, so that necks end in something. The file is in `assets/clothes`.

use std::path::Path;
use std::sync::OnceLock;

use crate::assets::SHIRT_FILE;
use crate::io::obj::ObjFile;
use crate::{CoreError, Mesh, Segment};

/// The shirt around the reference head's neck and shoulders, mm, head frame. Read once per process.
///
/// # Panics
/// If the embedded file is damaged; a test reads it.
pub fn shirt() -> &'static Mesh {
    static SHIRT: OnceLock<Mesh> = OnceLock::new();
    SHIRT.get_or_init(|| parse(SHIRT_FILE).expect("the embedded shirt is tested"))
}

fn parse(obj: &[u8]) -> Result<Mesh, CoreError> {
    let path = Path::new("shirt.obj");
    let file = ObjFile::parse(obj, path)?;
    let mut mesh = Mesh {
        positions: file.positions.clone(),
        ..Mesh::default()
    };
    for polygon in &file.polygons {
        let [a, b, c] = file.corners_of(polygon) else {
            let place = Some(format!("line {}", polygon.line));
            return Err(CoreError::format(path, place, "is not a triangle"));
        };
        mesh.triangles.push([a[0], b[0], c[0]]);
    }
    mesh.segments = vec![Segment::Clothes; mesh.triangles.len()];
    mesh.validate(path)?;
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ReferenceHead;

    #[test]
    fn the_shirt_reaches_over_the_neck_s_rim() {
        let (low, high) = shirt().bounds().expect("not empty");
        let (neck, _) = ReferenceHead::embedded().mesh.bounds().expect("not empty");
        assert!(high.y > neck.y + 10.0 && low.y < neck.y - 150.0);
        assert!(low.x < -200.0 && high.x > 200.0);
    }
}
