//! A reference head as a folder laid out as `assets/reference`: what [`ReferenceHead::load`] reads.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use super::picture::{Packing, encode_texture};
use super::write_file;
use crate::reference::{Cage, Part};
use crate::{CoreError, LandmarkScheme, Point3, ReferenceHead, Role, Segment, Texture};

/// Quality of the skin's JPEG.
const SKIN_QUALITY: u8 = 92;

impl ReferenceHead {
    /// Writes the files of a reference head into `dir`, which is made if it is not there.
    ///
    /// Lengths are written to 0.0001 mm, weights to 0.0001; the skin becomes a JPEG. `note` is the first line of the
    /// files that can hold one: where the head comes from.
    ///
    /// # Errors
    /// [`CoreError::Io`] with the file that cannot be written.
    pub fn save(&self, dir: &Path, note: &str) -> Result<(), CoreError> {
        let write = |name: &str, bytes: &[u8]| write_file(&dir.join(name), bytes);
        std::fs::create_dir_all(dir).map_err(|source| CoreError::Io {
            path: dir.to_owned(),
            source,
        })?;
        write("head.obj", self.head_obj(note).as_bytes())?;
        write("head_vertices.csv", vertices_csv(&self.cage).as_bytes())?;
        write("head.toml", self.head_toml(note).as_bytes())?;
        write("landmarks.toml", self.landmarks_toml(note).as_bytes())?;
        write("parts.obj", parts_obj(&self.parts, note).as_bytes())?;
        let picture = |name: &str, texture: &Texture, packing: Packing| {
            let bytes = encode_texture(texture, packing, name.as_ref())?;
            write(name, &bytes)
        };
        picture("skin.jpg", &self.texture, Packing::Jpeg(SKIN_QUALITY))?;
        picture("mouth.png", &self.mouth_texture, Packing::Png)?;
        for (name, texture) in &self.eye_textures {
            picture(&format!("eye_{name}.png"), texture, Packing::Png)?;
        }
        Ok(())
    }

    /// The cage with its texture coordinates: the first corner of each fine quad is a corner of the cage's face.
    fn head_obj(&self, note: &str) -> String {
        let mesh = &self.mesh;
        let mut text = format!("# {note}\n");
        push_positions(&mut text, &self.cage.positions);
        let corner_of = |quad: usize| mesh.texcoord_triangles[2 * quad][0];
        let quads = self.subdivision.quads.len();
        let count = (0..quads).map(|q| corner_of(q) as usize + 1).max();
        push_texcoords(&mut text, &mesh.texcoords[..count.unwrap_or(0)]);
        let mut quad = 0;
        let mut group = None;
        for face in &self.cage.faces {
            let segment = mesh.segments[2 * quad];
            if group != Some(segment) {
                let _ = writeln!(text, "g {}", segment.name());
                group = Some(segment);
            }
            text.push('f');
            for (k, v) in face.iter().enumerate() {
                let _ = write!(text, " {}/{}", v + 1, corner_of(quad + k) + 1);
            }
            text.push('\n');
            quad += face.len();
        }
        text
    }

    fn head_toml(&self, note: &str) -> String {
        let mut text = format!("# {note}\n[jaw]\n");
        let _ = writeln!(text, "hinge_left = {}", array(&self.jaw.hinge_left));
        let _ = writeln!(text, "hinge_right = {}", array(&self.jaw.hinge_right));
        for (side, eye) in ["left", "right"].iter().zip(&self.eyes) {
            let _ = writeln!(text, "\n[eyes.{side}]\ncenter = {}", array(&eye.center));
            let _ = writeln!(text, "radius = {:.4}", eye.radius);
        }
        text
    }

    /// The landmarks' places on the mean head. Points on a lip name it, since the lips touch.
    fn landmarks_toml(&self, note: &str) -> String {
        let mut text = format!("# {note}\n");
        for LandmarkScheme { name, points } in &self.landmarks {
            let _ = writeln!(text, "[{name}]\npoints = [");
            let mut on: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
            for (i, point) in points.iter().enumerate() {
                let at = point.position(&self.mesh.positions, &self.mesh.triangles);
                let _ = writeln!(text, "  {},", array(&at));
                let segment = self.mesh.segments[point.triangle as usize];
                if matches!(segment, Segment::UpperLip | Segment::LowerLip) {
                    on.entry(segment.name()).or_default().push(i);
                }
            }
            text.push_str("]\n");
            if !on.is_empty() {
                let _ = writeln!(text, "[{name}.on]");
            }
            for (segment, points) in on {
                let _ = writeln!(text, "{segment} = {points:?}");
            }
        }
        text
    }
}

fn vertices_csv(cage: &Cage) -> String {
    let mut text = String::from("role,jaw,lid,thickness_mm,attached,mirror\n");
    for v in 0..cage.positions.len() {
        let role = match cage.roles[v] {
            Role::Free => "free",
            Role::Fixed => "fixed",
            Role::Passive => "passive",
        };
        let _ = writeln!(
            text,
            "{role},{:.4},{:.4},{:.3},{},{}",
            cage.jaw[v],
            cage.lid[v],
            cage.thickness[v],
            u8::from(cage.attached[v]),
            cage.mirror[v],
        );
    }
    text
}

/// All parts share their texture coordinates.
fn parts_obj(parts: &[Part], note: &str) -> String {
    let mut text = format!("# {note}\n");
    for part in parts {
        push_positions(&mut text, &part.mesh.positions);
    }
    if let Some(part) = parts.first() {
        push_texcoords(&mut text, &part.mesh.texcoords);
    }
    let mut first = 1;
    for Part { segment, mesh } in parts {
        let _ = writeln!(text, "g {}", segment.name());
        for (corners, texcoords) in mesh.triangles.iter().zip(&mesh.texcoord_triangles) {
            text.push('f');
            for (v, t) in corners.iter().zip(texcoords) {
                let _ = write!(text, " {}/{}", v + first, t + 1);
            }
            text.push('\n');
        }
        first += mesh.positions.len() as u32;
    }
    text
}

fn push_positions(text: &mut String, positions: &[Point3]) {
    for p in positions {
        let _ = writeln!(text, "v {:.4} {:.4} {:.4}", p.x, p.y, p.z);
    }
}

fn push_texcoords(text: &mut String, texcoords: &[[f32; 2]]) {
    for [u, v] in texcoords {
        // As many digits as bring the same bits back: the topology's digest holds them.
        let _ = writeln!(text, "vt {u} {v}");
    }
}

fn array(p: &Point3) -> String {
    format!("[{:.4}, {:.4}, {:.4}]", p.x, p.y, p.z)
}
