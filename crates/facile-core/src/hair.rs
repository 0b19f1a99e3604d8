//! Hair styles: cards around the reference head, with the direction of their strands, and the lashes.
//!
//! The files are in `assets/hair`, see `assets/README.md`. Cards lie as on the reference head; the tracer fits them to a
//! person and lets only what [`HairStyle::cover`] shows be seen.

use std::path::Path;
use std::sync::OnceLock;

use crate::assets::{HAIR_FILES, LASHES_FILES, SCALP_FILE};
use crate::io::decode_texture;
use crate::io::obj::ObjFile;
use crate::{CoreError, Mesh, Segment, Texture, Vector3};

/// Cards of hair on the reference head.
#[derive(Clone, Debug)]
pub struct HairStyle {
    /// Name in recipes.
    pub name: &'static str,
    /// Triangles with texture coordinates, mm, head frame.
    pub mesh: Mesh,
    /// Direction of the strands at each vertex, away from the roots.
    pub strands: Vec<Vector3>,
    /// Brightness of the strands, grey: 1 for the brightest.
    pub light: Texture,
    /// Where strands are, by texel of `light`: 255 for there, 0 for not.
    pub cover: Vec<u8>,
}

impl HairStyle {
    /// Names of all styles, sorted.
    pub fn names() -> impl Iterator<Item = &'static str> {
        HAIR_FILES.iter().map(|(name, _)| *name)
    }

    /// A style that ships with the program, read once per process.
    ///
    /// # Errors
    /// [`CoreError::UnknownName`] with the known names.
    ///
    /// # Panics
    /// If the embedded files are damaged; a test reads them.
    pub fn embedded(name: &str) -> Result<&'static Self, CoreError> {
        static STYLES: [OnceLock<HairStyle>; HAIR_FILES.len()] =
            [const { OnceLock::new() }; HAIR_FILES.len()];
        let Some(index) = HAIR_FILES.iter().position(|(n, _)| *n == name) else {
            return Err(CoreError::UnknownName {
                kind: "hair style",
                name: name.to_owned(),
                known: Self::names().collect::<Vec<_>>().join(", "),
            });
        };
        let (name, files) = HAIR_FILES[index];
        Ok(STYLES[index].get_or_init(|| {
            Self::parse(name, files, Segment::Hair).expect("the embedded hair is tested")
        }))
    }

    /// The lashes of both eyes, read once per process.
    ///
    /// # Panics
    /// If the embedded files are damaged; a test reads them.
    pub fn lashes() -> &'static Self {
        static LASHES: OnceLock<HairStyle> = OnceLock::new();
        LASHES.get_or_init(|| {
            Self::parse("lashes", LASHES_FILES, Segment::Lashes)
                .expect("the embedded lashes are tested")
        })
    }

    /// Width and height of the texture.
    pub fn size(&self) -> [usize; 2] {
        [self.light.width(), self.light.height()]
    }

    /// Mean brightness of what is there, linear.
    pub fn mean_light(&self) -> f32 {
        self.mean_light_of(&self.light)
    }

    /// The same for other brightnesses of the same texels.
    pub fn mean_light_of(&self, light: &Texture) -> f32 {
        let lut = &*crate::color::LINEAR_FROM_SRGB8;
        let there = light
            .texels()
            .iter()
            .zip(&self.cover)
            .filter(|(_, c)| **c > 127);
        let (sum, count) = there.fold((0.0_f64, 0_u32), |(sum, n), (t, _)| {
            (sum + f64::from(lut[usize::from(t[0])]), n + 1)
        });
        (sum / f64::from(count.max(1))) as f32
    }

    fn parse(
        name: &'static str,
        [obj, png]: [&[u8]; 2],
        segment: Segment,
    ) -> Result<Self, CoreError> {
        let path = Path::new(name);
        let file = ObjFile::parse(obj, path)?;
        let mut mesh = Mesh {
            positions: file.positions.clone(),
            texcoords: file.texcoords.clone(),
            ..Mesh::default()
        };
        for polygon in &file.polygons {
            let [a, b, c] = file.corners_of(polygon) else {
                let place = Some(format!("line {}", polygon.line));
                return Err(CoreError::format(path, place, "is not a triangle"));
            };
            mesh.triangles.push([a[0], b[0], c[0]]);
            mesh.texcoord_triangles.push([a[1], b[1], c[1]]);
        }
        mesh.segments = vec![segment; mesh.triangles.len()];
        mesh.validate(path)?;
        // Red is brightness, green is cover
        let mut light = decode_texture(png, path)?;
        let cover = light.texels().iter().map(|t| t[1]).collect();
        for texel in light.texels_mut() {
            *texel = [texel[0]; 3];
        }
        let strands = directions(obj);
        if strands.len() != mesh.positions.len() {
            return Err(CoreError::SizeMismatch {
                what: "directions of strands",
                expected: mesh.positions.len(),
                got: strands.len(),
            });
        }
        Ok(Self {
            name,
            mesh,
            strands,
            light,
            cover,
        })
    }
}

/// Share of hair on each texel of the reference UV, linear in the grey level.
///
/// # Panics
/// If the embedded file is damaged; a test reads it.
pub fn scalp() -> &'static Texture {
    static SCALP: OnceLock<Texture> = OnceLock::new();
    SCALP.get_or_init(|| {
        decode_texture(SCALP_FILE, Path::new("scalp.png")).expect("the embedded scalp is tested")
    })
}

/// The lines `vn x y z`, one per vertex in its order.
fn directions(obj: &[u8]) -> Vec<Vector3> {
    let text = String::from_utf8_lossy(obj);
    let lines = text.lines().filter_map(|l| l.strip_prefix("vn "));
    lines
        .map(|l| {
            let mut numbers = l.split_ascii_whitespace().map(|v| v.parse().unwrap_or(0.0));
            Vector3::from_fn(|_, _| numbers.next().unwrap_or(0.0))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_style_reads_and_lies_around_the_head() {
        let names: Vec<&str> = HairStyle::names().collect();
        assert_eq!(names.len(), 10);
        assert!(names.is_sorted());
        for name in names {
            let style = HairStyle::embedded(name).expect("ships");
            let (low, high) = style.mesh.bounds().expect("not empty");
            assert!(
                high.y > 90.0 && low.x < -60.0 && high.x > 60.0,
                "{name}: {low} {high}"
            );
            let unit = |s: &Vector3| (s.norm() - 1.0).abs() < 0.02;
            assert!(style.strands.iter().all(unit), "{name}");
            let there = style.cover.iter().filter(|c| **c > 127).count();
            assert!(there > style.cover.len() / 20, "{name}");
            assert!(style.mean_light() > 0.05, "{name}: {}", style.mean_light());
        }
        assert!(HairStyle::embedded("mohawk").is_err());
        assert!(HairStyle::lashes().mesh.triangles.len() > 100);
        let hair = scalp().texels().iter().filter(|t| t[0] > 128).count();
        assert!((5_000..40_000).contains(&hair), "{hair}");
    }
}
