//! The scene file of `facile render`: any meshes, camera and lights, in TOML.
//!
//! [`SceneFile`] is the file as written, unknown keys refused; [`render`](render_scene_file) makes the images, label maps
//! and timings. Paths in the file are relative to its folder. Colours are 8-bit sRGB.

mod bench;
mod cost;
mod load;
mod obj_normals;
mod render;
mod timing;

use std::path::{Path, PathBuf};

use facile_core::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::TraceError;
use crate::camera::Camera;
use crate::gbuffer::Truth;
use crate::lens::Lens;
use crate::light::LightSource;
use crate::sampling::Samples;
use crate::sensor::Sensor;
use crate::view::RenderSettings;

pub use bench::{BenchRow, bench_scene_file};
pub use cost::{CostRow, bench_scene_cost};
pub use render::render_scene_file;
pub use timing::{Spread, TimingReport};

/// A scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Size, sampling, labels.
    pub image: ImageSection,
    /// The camera.
    pub camera: CameraSection,
    /// What is seen.
    #[serde(default)]
    pub mesh: Vec<MeshSection>,
    /// What it is lit by.
    #[serde(default)]
    pub light: Vec<LightSource>,
    /// What the camera does to the light.
    #[serde(default)]
    pub sensor: Sensor,
    /// How often the frame is rendered, for timings.
    #[serde(default = "one")]
    pub frames: u32,
    /// Before each frame every vertex moves to within this distance of its place in each coordinate, mm. The image then
    /// shows the last frame.
    #[serde(default)]
    pub jitter_mm: f64,
}

fn one() -> u32 {
    1
}

/// Names of label maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TruthMap {
    /// `depth.png`: 16-bit, in steps of the scale that `scene.json` names.
    Depth,
    /// `normals.png`: 8-bit RGB, world axes, `127.5 (n + 1)`.
    Normals,
    /// `segments.png`: 8-bit ids.
    Segments,
    /// `occlusion.png` and `amodal_segments.png`.
    Occlusion,
    /// `albedo.png`, sRGB.
    Albedo,
    /// `shadow.png`: 8-bit share of directed light.
    Shadow,
    /// `coverage.png`: 8-bit share of the pixel that shows any surface.
    Coverage,
    /// `layers.png` and `layer_depth.png`: segments and depths of the first four surfaces of each pixel, as those of the
    /// first; four images one below the other, the nearest surface on top.
    Layers,
}

/// `[image]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageSection {
    /// Width and height, px.
    pub size: [usize; 2],
    /// Samples per pixel: a number or `"adaptive"`.
    #[serde(default)]
    pub samples: Samples,
    /// Label maps to write.
    #[serde(default)]
    pub truth: Vec<TruthMap>,
    /// Colour where nothing is hit.
    #[serde(default)]
    pub background: [u8; 3],
    /// See [`crate::RenderSettings::offset_mm`].
    #[serde(default = "default_offset")]
    pub offset_mm: f32,
    /// See [`crate::RenderSettings::smooth_shadows`].
    #[serde(default = "default_smooth_shadows")]
    pub smooth_shadows: bool,
}

fn default_smooth_shadows() -> bool {
    RenderSettings::default().smooth_shadows
}

fn default_offset() -> f32 {
    RenderSettings::default().offset_mm
}

/// `[camera]`: either `position`, `target` and `fov_y_deg`, or the matrices `k`, `r` and `t`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub enum CameraSection {
    /// By what it looks at.
    LookAt {
        /// Place, mm.
        position: [f64; 3],
        /// What is in the middle of the image, mm.
        target: [f64; 3],
        /// Upwards in the image.
        #[serde(default = "y_axis")]
        up: [f64; 3],
        /// Angle that the image's height spans, degrees.
        fov_y_deg: f64,
        /// Parallel rays; the image's height spans what it does at the target.
        #[serde(default)]
        orthographic: bool,
        /// Diameter of the lens's opening, mm; 0 for a pinhole. Needs a number of samples from 2 on.
        #[serde(default)]
        aperture_mm: f64,
        /// Depth that is in focus, mm; that of the target if not given.
        focus_mm: Option<f64>,
    },
    /// By its matrices, see [`Camera::from_matrices`]; rows.
    Matrices {
        /// K, px.
        k: [[f64; 3]; 3],
        /// R.
        r: [[f64; 3]; 3],
        /// t, mm.
        t: [f64; 3],
    },
}

fn y_axis() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

/// `[[mesh]]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshSection {
    /// OBJ, PLY or GLB. OBJ groups become segments; a group that is no segment's name becomes `other`.
    pub file: PathBuf,
    /// Image file; without one the file's own texture or colours, else `color`.
    pub texture: Option<PathBuf>,
    /// Colour without a texture.
    #[serde(default = "light_grey")]
    pub color: [u8; 3],
    /// See [`crate::Material::specular`].
    #[serde(default)]
    pub specular: f32,
    /// See [`crate::Material::shininess`].
    #[serde(default = "default_shininess")]
    pub shininess: f32,
    /// See [`crate::Material::roughness`].
    #[serde(default)]
    pub roughness: f32,
    /// See [`crate::Material::scatter_mm`].
    #[serde(default)]
    pub scatter_mm: [f32; 3],
    /// See [`crate::Material::reflectivity`].
    #[serde(default)]
    pub reflectivity: f32,
    /// Share of light that passes, linear RGB; makes the mesh transparent.
    pub transmission: Option<[f32; 3]>,
    /// Refractive index; without one a transparent mesh is thin and does not refract.
    pub ior: Option<f32>,
    /// Smooth normals instead of flat triangles.
    #[serde(default = "yes")]
    pub smooth: bool,
    /// Whether amodal labels look through the mesh.
    #[serde(default)]
    pub occluder: bool,
}

fn light_grey() -> [u8; 3] {
    [200; 3]
}

fn default_shininess() -> f32 {
    24.0
}

fn yes() -> bool {
    true
}

impl SceneFile {
    /// Reads and parses a file.
    ///
    /// # Errors
    /// [`TraceError::Io`], or [`TraceError::SceneFile`] with the line and what is allowed there.
    pub fn read(path: &Path) -> Result<Self, TraceError> {
        let text = std::fs::read_to_string(path).map_err(|source| TraceError::Io {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(&text, path)
    }

    /// Parses a file's text; `path` names it.
    ///
    /// # Errors
    /// [`TraceError::SceneFile`] with the line and what is allowed there.
    pub fn parse(text: &str, path: &Path) -> Result<Self, TraceError> {
        let file: Self = toml::from_str(text).map_err(|e| TraceError::SceneFile {
            path: path.to_owned(),
            reason: e.to_string(),
        })?;
        if file.frames == 0 || !(file.jitter_mm >= 0.0 && file.jitter_mm.is_finite()) {
            return Err(TraceError::SceneFile {
                path: path.to_owned(),
                reason: "frames must be at least 1 and jitter_mm a finite distance of at least 0"
                    .to_owned(),
            });
        }
        Ok(file)
    }

    /// The camera.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for impossible numbers.
    pub fn camera(&self) -> Result<Camera, TraceError> {
        let [width, height] = self.image.size;
        match &self.camera {
            CameraSection::LookAt {
                position,
                target,
                up,
                fov_y_deg,
                orthographic,
                aperture_mm,
                focus_mm,
            } => {
                let (position, target) = (Point3::from(*position), Point3::from(*target));
                let (up, fov_y) = (Vector3::from(*up), fov_y_deg.to_radians());
                let mut camera = Camera::look_at(width, height, position, target, up, fov_y)?;
                let distance = (target - position).norm();
                if *orthographic {
                    camera = camera.orthographic(distance)?;
                }
                if *aperture_mm != 0.0 {
                    camera = camera.with_lens(Lens {
                        radius_mm: aperture_mm / 2.0,
                        focus_mm: focus_mm.unwrap_or(distance),
                    })?;
                }
                Ok(camera)
            }
            CameraSection::Matrices { k, r, t } => {
                let matrix = |rows: &[[f64; 3]; 3]| Matrix3::from_row_slice(rows.as_flattened());
                Camera::from_matrices(width, height, matrix(k), matrix(r), Vector3::from(*t))
            }
        }
    }

    /// How to render.
    pub fn settings(&self) -> RenderSettings {
        RenderSettings {
            samples: self.image.samples,
            truth: self.truth(),
            offset_mm: self.image.offset_mm,
            smooth_shadows: self.image.smooth_shadows,
            ..RenderSettings::default()
        }
    }

    /// The labels that are asked for.
    pub fn truth(&self) -> Truth {
        let wants = |map| self.image.truth.contains(&map);
        Truth {
            depth_z: wants(TruthMap::Depth),
            normal_in_world: wants(TruthMap::Normals),
            segment: wants(TruthMap::Segments),
            occlusion: wants(TruthMap::Occlusion),
            albedo: wants(TruthMap::Albedo),
            shadow: wants(TruthMap::Shadow),
            coverage: wants(TruthMap::Coverage),
            layers: if wants(TruthMap::Layers) { 4 } else { 0 },
            ..Truth::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = r#"
[image]
size = [256, 256]
samples = 1
truth = ["depth", "normals", "segments"]
[camera]
position = [60, 10, 640]
target = [0, -5, 20]
fov_y_deg = 25
[[mesh]]
file = "head_36k.obj"
texture = "tex.png"
specular = 0.06
shininess = 24
[[light]]
kind = "point"
position = [-260, 300, 520]
intensity = 0.366
[[light]]
kind = "ambient"
intensity = 0.18
"#;

    #[test]
    fn the_documented_example_parses() {
        let file: SceneFile = toml::from_str(EXAMPLE).expect("valid");
        assert_eq!(file.image.samples, Samples::Count(1));
        assert_eq!((file.frames, file.mesh.len(), file.light.len()), (1, 1, 2));
        let camera = file.camera().expect("valid");
        assert_eq!((camera.width(), camera.height()), (256, 256));
        let truth = file.truth();
        assert!(truth.depth_z && truth.normal_in_world && truth.segment && !truth.occlusion);
    }

    #[test]
    fn matrices_and_unknown_keys() {
        let by_matrices = EXAMPLE.replace(
            "position = [60, 10, 640]\ntarget = [0, -5, 20]\nfov_y_deg = 25",
            "k = [[500, 0, 128], [0, 500, 128], [0, 0, 1]]\nr = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]\nt = [0, 0, 600]",
        );
        let file: SceneFile = toml::from_str(&by_matrices).expect("valid");
        assert!(file.camera().is_ok());
        for (from, to) in [
            ("specular", "specularity"),
            ("fov_y_deg", "fov"),
            ("samples", "sample"),
            ("\"depth\"", "\"deepness\""),
        ] {
            let text = EXAMPLE.replacen(from, to, 1);
            assert!(toml::from_str::<SceneFile>(&text).is_err(), "{to}");
        }
    }
}
