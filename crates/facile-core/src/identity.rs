//! The identity model: new people as a linear combination of shape modes on the reference cage, with skins to match.
//!
//! A head is the mean cage plus `sum_k c_k mode_k`; a coefficient of 1 is one standard deviation of the population the
//! modes were found in. Eyes and skull follow the same coefficients. The files are in `assets/identity`, see
//! `assets/README.md`. Drawing a person is in `identity_sample`, fitting coefficients to points here.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use nalgebra::{DMatrix, DVector};
use ndarray::Array3;
use ndarray_npy::ReadNpyExt as _;
use serde::Deserialize;

use crate::assets::{self, IdentityFiles};
use crate::io::decode_texture;
use crate::{CoreError, Eye, Point3, ReferenceHead, Similarity3, Texture, UnitQuaternion, Vector3};

/// Coefficients are kept within this many standard deviations: beyond, heads turn into caricatures.
pub const MAX_COEFFICIENT: f64 = 2.5;

/// A linear model of heads on the reference topology.
#[derive(Debug)]
pub struct IdentityModel {
    /// Displacement of each cage vertex by +1 of each mode, mm.
    modes: Vec<Vec<Vector3>>,
    /// The same at the fine vertices, made when first asked for.
    fine_modes: OnceLock<Vec<Vec<[f32; 3]>>>,
    pub(crate) eyes: EyeModes,
    pub(crate) skull: SkullModes,
    pub(crate) from_attributes: FromAttributes,
    pub(crate) tint: Tint,
    pub(crate) mix: Mix,
    pub(crate) skins: Vec<Skin>,
}

/// How the eyes follow the modes.
#[derive(Debug, Deserialize)]
pub(crate) struct EyeModes {
    /// Motion of the left and right centre, mm, per mode.
    center: Vec<[Vector3; 2]>,
    /// Growth of the radius, mm, per mode.
    radius: Vec<f64>,
}

/// How what the skull carries follows the modes.
#[derive(Debug, Deserialize)]
pub(crate) struct SkullModes {
    /// Added to a scale of 1, per mode.
    scale: Vec<f64>,
    /// Motion, mm, per mode.
    translation: Vec<Vector3>,
}

/// Coefficients that suit a person's attributes: normal with mean `offset + slope x`, where `x` is
/// `(male, african, asian, age in decades)`.
#[derive(Debug, Deserialize)]
pub(crate) struct FromAttributes {
    pub(crate) offset: Vec<f64>,
    pub(crate) slope: Vec<[f64; 4]>,
    pub(crate) spread: Vec<f64>,
}

/// Spread of linear gains on a sampled skin.
#[derive(Debug, Deserialize)]
pub(crate) struct Tint {
    pub(crate) brightness: f64,
    pub(crate) warmth: f64,
    /// Standard deviations at which both are cut.
    pub(crate) clamp: f64,
}

/// Range of the share of the first skin in a mixture.
#[derive(Debug, Deserialize)]
pub(crate) struct Mix {
    pub(crate) weight: [f64; 2],
}

/// A skin in the reference UV and who wears it.
#[derive(Debug)]
pub(crate) struct Skin {
    pub(crate) facts: SkinFacts,
    /// JPEG.
    bytes: Cow<'static, [u8]>,
    decoded: OnceLock<Texture>,
}

impl Skin {
    /// Its texels, decoded for the first who wears it: 3 MB of each of a few dozen skins.
    ///
    /// # Errors
    /// [`CoreError::Format`] if the image is damaged.
    pub(crate) fn texture(&self) -> Result<&Texture, CoreError> {
        if let Some(texture) = self.decoded.get() {
            return Ok(texture);
        }
        let texture = decode_texture(&self.bytes, self.facts.file.as_ref())?;
        Ok(self.decoded.get_or_init(|| texture))
    }
}

/// What is known of a skin.
#[derive(Clone, Debug, Deserialize)]
pub(crate) struct SkinFacts {
    pub(crate) file: String,
    pub(crate) sex: String,
    pub(crate) ancestry: String,
    pub(crate) years: f64,
    pub(crate) hair: String,
    /// Eye colours that suit, names of [`ReferenceHead::eye_textures`].
    pub(crate) eyes: Vec<String>,
}

#[derive(Deserialize)]
struct IdentityToml {
    modes: usize,
    vertices: usize,
    /// Millimetres of one step of the stored modes.
    scale: f64,
    eyes: EyeModes,
    skull: SkullModes,
    from_attributes: FromAttributes,
    tint: Tint,
    mix: Mix,
    skin: Vec<SkinFacts>,
}

/// A head of the model: everything of a [`crate::Subject`] that is shape.
#[derive(Clone, Debug, PartialEq)]
pub struct IdentityShape {
    /// Fine vertices, mm, head frame.
    pub positions: Vec<Point3>,
    /// Left and right eye.
    pub eyes: [Eye; 2],
    /// Places teeth and tongue.
    pub skull_from_reference: Similarity3,
}

impl IdentityModel {
    /// The model that ships with the program, for [`ReferenceHead::embedded`]. Built once per process.
    ///
    /// # Panics
    /// If the embedded files are damaged; a test reads them.
    pub fn embedded() -> &'static Self {
        static MODEL: OnceLock<IdentityModel> = OnceLock::new();
        MODEL.get_or_init(|| {
            let files = IdentityFiles::embedded();
            Self::from_files(&files, ReferenceHead::embedded(), Path::new("identity"))
                .expect("the embedded identity model is tested")
        })
    }

    /// A model from a folder laid out as `assets/identity`, for `reference`.
    ///
    /// # Errors
    /// [`CoreError`] with the file and place of what is wrong.
    pub fn load(dir: &Path, reference: &ReferenceHead) -> Result<Self, CoreError> {
        Self::from_files(&IdentityFiles::read(dir)?, reference, dir)
    }

    /// Number of modes.
    pub fn len(&self) -> usize {
        self.modes.len()
    }

    /// Whether the model knows the mean only.
    pub fn is_empty(&self) -> bool {
        self.modes.is_empty()
    }

    /// Displacement of each cage vertex by +1 of mode `k`, mm.
    pub fn cage_mode(&self, k: usize) -> &[Vector3] {
        &self.modes[k]
    }

    /// Displacement of each fine vertex by +1 of each mode, mm. The first call costs O(modes x fine vertices).
    /// `reference` is the head that the model was loaded for.
    pub fn fine_modes(&self, reference: &ReferenceHead) -> &[Vec<[f32; 3]>] {
        self.fine_modes.get_or_init(|| {
            let stencils = &reference.subdivision.stencils;
            let fine = |mode: &Vec<Vector3>| {
                let displacements = stencils.apply(mode, Vector3::zeros());
                displacements
                    .iter()
                    .map(|d| d.map(|v| v as f32).into())
                    .collect()
            };
            self.modes.iter().map(fine).collect()
        })
    }

    /// The cage of a head, mm. `coefficients`: standard deviations, at most one per mode, the rest 0.
    pub fn cage(&self, reference: &ReferenceHead, coefficients: &[f64]) -> Vec<Point3> {
        let mut cage = reference.cage.positions.clone();
        for (mode, &c) in self.modes.iter().zip(coefficients) {
            for (position, displacement) in cage.iter_mut().zip(mode) {
                *position += displacement * c;
            }
        }
        cage
    }

    /// The head with these coefficients, as in [`Self::cage`]. `reference` is the head that the model was loaded for.
    pub fn shape(&self, reference: &ReferenceHead, coefficients: &[f64]) -> IdentityShape {
        let cage = self.cage(reference, coefficients);
        let coords: Vec<Vector3> = cage.iter().map(|p| p.coords).collect();
        let fine = reference
            .subdivision
            .stencils
            .apply(&coords, Vector3::zeros());
        let mut eyes = reference.eyes;
        let (mut scale, mut translation) = (1.0, Vector3::zeros());
        for (k, &c) in coefficients.iter().enumerate().take(self.modes.len()) {
            for (side, eye) in eyes.iter_mut().enumerate() {
                eye.center += self.eyes.center[k][side] * c;
                eye.radius += self.eyes.radius[k] * c;
            }
            scale += self.skull.scale[k] * c;
            translation += self.skull.translation[k] * c;
        }
        IdentityShape {
            positions: fine.into_iter().map(Point3::from).collect(),
            eyes,
            skull_from_reference: Similarity3::from_parts(
                translation.into(),
                UnitQuaternion::identity(),
                scale,
            ),
        }
    }

    /// Coefficients of the head nearest to fine positions: minimises
    /// `sum_i w_i |x_i(c) - target_i|^2 + prior |c|^2`.
    ///
    /// `targets` and `weights`: one per fine vertex, mm and at least 0 (0 for unknown places). `prior`, mm^2, at least 0:
    /// the variance of a target times its weight, for a most probable head. Coefficients are not clamped. `None` if the
    /// targets do not determine them. Cost O(modes^2 x fine vertices).
    ///
    /// # Panics
    /// If the lists do not have one entry per fine vertex.
    pub fn fit(
        &self,
        reference: &ReferenceHead,
        targets: &[Point3],
        weights: &[f64],
        prior: f64,
    ) -> Option<Vec<f64>> {
        let mean = &reference.mesh.positions;
        assert_eq!(targets.len(), mean.len(), "one target per fine vertex");
        assert_eq!(weights.len(), mean.len(), "one weight per fine vertex");
        let modes = self.fine_modes(reference);
        let n = modes.len();
        let mut normal = DMatrix::<f64>::identity(n, n) * prior;
        let mut right = DVector::<f64>::zeros(n);
        for (i, &weight) in weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let residual = targets[i] - mean[i];
            for a in 0..n {
                let mode = modes[a][i].map(f64::from);
                right[a] += weight * Vector3::from(mode).dot(&residual);
                for b in a..n {
                    let dot: f64 = (0..3).map(|k| mode[k] * f64::from(modes[b][i][k])).sum();
                    normal[(b, a)] += weight * dot;
                }
            }
        }
        // Cholesky reads the lower triangle only.
        let solution = normal.cholesky()?.solve(&right);
        Some(solution.iter().copied().collect())
    }

    fn from_files(
        files: &IdentityFiles,
        reference: &ReferenceHead,
        dir: &Path,
    ) -> Result<Self, CoreError> {
        let toml: IdentityToml = assets::parse_toml(&files.identity_toml, "identity.toml")?;
        let modes = read_modes(&files.modes, toml.scale, &dir.join("modes.npy"))?;
        let cage = reference.cage.positions.len();
        let counts = [
            ("modes of the identity model", toml.modes, modes.len()),
            ("vertices of the identity model", cage, toml.vertices),
            (
                "eye centres of the identity model",
                toml.modes,
                toml.eyes.center.len(),
            ),
            (
                "eye radii of the identity model",
                toml.modes,
                toml.eyes.radius.len(),
            ),
            (
                "skull scales of the identity model",
                toml.modes,
                toml.skull.scale.len(),
            ),
            (
                "skull translations of the identity model",
                toml.modes,
                toml.skull.translation.len(),
            ),
            (
                "offsets of the identity model",
                toml.modes,
                toml.from_attributes.offset.len(),
            ),
            (
                "slopes of the identity model",
                toml.modes,
                toml.from_attributes.slope.len(),
            ),
            (
                "spreads of the identity model",
                toml.modes,
                toml.from_attributes.spread.len(),
            ),
        ];
        let lengths = modes.iter().map(|m| ("vertices of a mode", cage, m.len()));
        for (what, expected, got) in counts.into_iter().chain(lengths) {
            if expected != got {
                return Err(CoreError::SizeMismatch {
                    what,
                    expected,
                    got,
                });
            }
        }
        let mut skins = Vec::new();
        for facts in toml.skin {
            let unknown = facts
                .eyes
                .iter()
                .find(|e| !reference.eye_textures.contains_key(*e));
            if facts.eyes.is_empty() || unknown.is_some() {
                let reason = format!("`{}` has no eye colour, or an unknown one", facts.file);
                let file = PathBuf::from("identity.toml");
                return Err(CoreError::format(&file, Some("skin".to_owned()), reason));
            }
            let bytes = files.skin(&facts.file)?;
            skins.push(Skin {
                facts,
                bytes,
                decoded: OnceLock::new(),
            });
        }
        Ok(Self {
            modes,
            fine_modes: OnceLock::new(),
            eyes: toml.eyes,
            skull: toml.skull,
            from_attributes: toml.from_attributes,
            tint: toml.tint,
            mix: toml.mix,
            skins,
        })
    }
}

/// Reads modes x vertices x 3 whole numbers and scales them to mm.
fn read_modes(bytes: &[u8], scale: f64, path: &Path) -> Result<Vec<Vec<Vector3>>, CoreError> {
    let array =
        Array3::<i16>::read_npy(bytes).map_err(|e| CoreError::format(path, None, e.to_string()))?;
    let (_, _, axes) = array.dim();
    if axes != 3 {
        return Err(CoreError::SizeMismatch {
            what: "coordinates of a mode's displacement",
            expected: 3,
            got: axes,
        });
    }
    let mode = |mode: ndarray::ArrayView2<'_, i16>| {
        mode.outer_iter()
            .map(|d| Vector3::from_fn(|k, _| f64::from(d[k]) * scale))
            .collect()
    };
    Ok(array.outer_iter().map(mode).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_has_no_coefficients() {
        let reference = ReferenceHead::embedded();
        let shape = IdentityModel::embedded().shape(reference, &[]);
        assert_eq!(shape.positions, reference.mesh.positions);
        assert_eq!(shape.eyes, reference.eyes);
        assert_eq!(shape.skull_from_reference, Similarity3::identity());
    }

    #[test]
    fn a_shape_is_linear_in_its_coefficients() {
        let (reference, model) = (ReferenceHead::embedded(), IdentityModel::embedded());
        let fine = model.fine_modes(reference);
        let shape = model.shape(reference, &[0.0, 2.0, -1.0]);
        for (i, position) in shape.positions.iter().enumerate().step_by(97) {
            let linear = |k: usize| {
                let [a, b] = [fine[1][i][k], fine[2][i][k]].map(f64::from);
                reference.mesh.positions[i][k] + 2.0 * a - b
            };
            let expected = Point3::new(linear(0), linear(1), linear(2));
            assert!((position - expected).norm() < 1e-5, "vertex {i}");
        }
    }

    #[test]
    fn a_fit_finds_the_coefficients_again_from_half_a_face() {
        let (reference, model) = (ReferenceHead::embedded(), IdentityModel::embedded());
        let truth: Vec<f64> = (0..model.len())
            .map(|k| f64::from(k as u32 % 5) / 2.0 - 1.0)
            .collect();
        let shape = model.shape(reference, &truth);
        let weights: Vec<f64> = shape
            .positions
            .iter()
            .map(|p| if p.z > 0.0 && p.x > -20.0 { 1.0 } else { 0.0 })
            .collect();
        let fit = model
            .fit(reference, &shape.positions, &weights, 1e-6)
            .expect("determined");
        for (k, (found, wanted)) in fit.iter().zip(&truth).enumerate() {
            assert!(
                (found - wanted).abs() < 0.02,
                "mode {k}: {found} for {wanted}"
            );
        }
        let none = vec![0.0; weights.len()];
        let mean = model
            .fit(reference, &shape.positions, &none, 1.0)
            .expect("prior");
        assert!(mean.iter().all(|c| c.abs() < 1e-12));
    }
}
