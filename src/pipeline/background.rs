//! What is behind the head in a sample: drawn among the recipe's backgrounds.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use facile_core::Texture;
use facile_core::io::{decode_texture, read_file};
use facile_core::rng::RandomStream;
use facile_trace::math::Rgb;
use facile_trace::{Backdrop, LightSource, backdrop};
use serde::Serialize;

use super::render::linear;
use crate::Error;
use crate::recipe::{Background, Lighting, Recipe, WeightedBackground};
use crate::sampling::Weights;

/// Random streams of backgrounds: this number with that of the sample.
const BACKGROUND_STREAMS: u64 = 1 << 60;
/// Pictures that are kept after their first use.
const MAX_KEPT: usize = 400;

/// What is behind the head, as records say it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BackgroundRecord {
    /// `color`, `gradient`, `room`, `images` or `environment`.
    pub kind: &'static str,
    /// The picture's file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
}

/// A background as it is rendered.
#[derive(Debug)]
pub(super) struct Drawn {
    /// Plain colour, for what has no place in the image.
    pub(super) color: Rgb,
    pub(super) backdrop: Option<Backdrop>,
    pub(super) record: BackgroundRecord,
}

/// The pictures of a recipe's backgrounds, read when first drawn.
#[derive(Debug)]
pub(super) struct Gallery {
    weights: Option<Weights>,
    /// Pictures by background and file.
    pictures: Vec<Vec<OnceLock<Arc<Texture>>>>,
    /// Pictures are reduced to about this side, texels.
    side: usize,
}

impl Gallery {
    pub(super) fn new(recipe: &Recipe) -> Self {
        let slots = |b: &WeightedBackground| match &b.background {
            Background::Images { files, .. } => files.len().min(MAX_KEPT),
            _ => 0,
        };
        let weights: Vec<f64> = recipe.backgrounds.iter().map(|b| b.weight).collect();
        Self {
            weights: Weights::new(&weights),
            pictures: recipe
                .backgrounds
                .iter()
                .map(|b| (0..slots(b)).map(|_| OnceLock::new()).collect())
                .collect(),
            side: 2 * recipe.image.width.max(recipe.image.height) as usize,
        }
    }

    /// The background of sample `index` under a lighting.
    pub(super) fn draw(
        &self,
        recipe: &Recipe,
        index: u64,
        lighting: &Lighting,
    ) -> Result<Drawn, Error> {
        let own = linear(recipe.image.background);
        let plain = |color| Drawn {
            color,
            backdrop: None,
            record: BackgroundRecord {
                kind: "color",
                file: None,
            },
        };
        let Some(weights) = &self.weights else {
            return Ok(plain(own));
        };
        let mut stream = RandomStream::new(recipe.seed, BACKGROUND_STREAMS | index);
        let pick = weights.at(stream.unit());
        let with = |kind, file, color, backdrop| Drawn {
            color,
            backdrop: Some(backdrop),
            record: BackgroundRecord { kind, file },
        };
        Ok(match &recipe.backgrounds[pick].background {
            Background::Color(color) => plain(linear(*color)),
            Background::Gradient { top, bottom } => {
                let (top, bottom) = (linear(*top), linear(*bottom));
                let ramp = Backdrop::Gradient { top, bottom };
                with("gradient", None, (top + bottom) * 0.5, ramp)
            }
            Background::Room { blur } => {
                let texture = Arc::new(backdrop::room(&mut stream, *blur));
                let color = Rgb::from(texture.sample([0.5, 0.5]));
                let picture = Backdrop::Picture { texture, gain: 1.0 };
                with("room", None, color, picture)
            }
            Background::Images { files, intensity } => {
                let number = stream.index(files.len());
                let texture = self.picture(pick, number, &files[number])?;
                let color = Rgb::from(texture.sample([0.5, 0.5])) * *intensity;
                let gain = *intensity;
                let file = Some(files[number].to_string_lossy().into_owned());
                with("images", file, color, Backdrop::Picture { texture, gain })
            }
            Background::Environment {
                map,
                turn,
                intensity,
            } => {
                let gain = Rgb::repeat(*intensity);
                let shown = match map {
                    Some((file, map)) => Some((file.clone(), map.clone(), *turn, gain)),
                    None => of_light(lighting).map(|(file, map, own_turn, own_gain)| {
                        (file, map, own_turn + turn, own_gain * *intensity)
                    }),
                };
                let Some((file, map, turn, gain)) = shown else {
                    return Ok(plain(own));
                };
                let color = map.mean().component_mul(&gain);
                let around = Backdrop::Environment { map, turn, gain };
                with("environment", Some(file), color, around)
            }
        })
    }

    fn picture(
        &self,
        background: usize,
        number: usize,
        file: &Path,
    ) -> Result<Arc<Texture>, Error> {
        let slot = self.pictures[background].get(number);
        if let Some(texture) = slot.and_then(OnceLock::get) {
            return Ok(texture.clone());
        }
        let texture = decode_texture(&read_file(file)?, file)?;
        let texture = Arc::new(reduced(&texture, self.side));
        Ok(match slot {
            Some(slot) => slot.get_or_init(|| texture).clone(),
            None => texture,
        })
    }
}

/// The surroundings of the first source that has any.
fn of_light(lighting: &Lighting) -> Option<(String, Arc<facile_trace::EnvironmentMap>, f32, Rgb)> {
    lighting.sources.iter().find_map(|source| match source {
        LightSource::Environment {
            file,
            map: Some(map),
            intensity,
            color,
            turn_deg,
            ..
        } => Some((
            file.clone(),
            map.clone(),
            turn_deg.to_radians(),
            Rgb::from(*color) * *intensity,
        )),
        _ => None,
    })
}

/// A picture whose shorter side is at least `side`, if it was larger: every texel the mean of a whole block, in linear light.
fn reduced(texture: &Texture, side: usize) -> Texture {
    let factor = texture.width().min(texture.height()) / side.max(1);
    if factor < 2 {
        return texture.clone();
    }
    let lut = &*facile_core::color::LINEAR_FROM_SRGB8;
    let (width, height) = (texture.width() / factor, texture.height() / factor);
    let texel = |x: usize, y: usize| {
        let mut sum = [0.0_f32; 3];
        for dy in 0..factor {
            for dx in 0..factor {
                let own = texture.texel(x * factor + dx, y * factor + dy);
                for k in 0..3 {
                    sum[k] += lut[usize::from(own[k])];
                }
            }
        }
        sum.map(|v| facile_core::color::srgb8_from_linear(v / (factor * factor) as f32))
    };
    let texels = (0..width * height)
        .map(|i| texel(i % width, i / width))
        .collect();
    Texture::new(width, height, texels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(body: &str) -> Recipe {
        let text = format!("[dataset]\nname = \"t\"\n[subjects]\nsampled = 1\n{body}");
        Recipe::parse(&text, Path::new("t.toml"), Path::new("")).expect("valid")
    }

    #[test]
    fn backgrounds_come_as_often_as_they_weigh_and_repeat() {
        let recipe = recipe(
            "[[background]]\nkind = \"room\"\nweight = 3\n[[background]]\nkind = \"gradient\"\n\
             color = [200, 220, 255]\nbottom = [90, 90, 90]\n",
        );
        let gallery = Gallery::new(&recipe);
        let draw = |i| {
            gallery
                .draw(&recipe, i, &recipe.lightings[0])
                .expect("draws")
        };
        let rooms = (0..200).filter(|i| draw(*i).record.kind == "room").count();
        assert!((130..170).contains(&rooms), "{rooms}");
        let colors = |i| draw(i).color;
        assert_eq!(colors(5), colors(5));
    }

    #[test]
    fn without_backgrounds_the_image_has_its_colour() {
        let recipe = recipe("[image]\nbackground = [255, 0, 0]\n");
        let gallery = Gallery::new(&recipe);
        let drawn = gallery
            .draw(&recipe, 3, &recipe.lightings[0])
            .expect("draws");
        assert!(drawn.backdrop.is_none());
        assert_eq!(drawn.color, Rgb::new(1.0, 0.0, 0.0));
    }

    #[test]
    fn pictures_are_reduced_to_means() {
        let texels = (0..64)
            .map(|i| if i % 2 == 0 { [255; 3] } else { [0; 3] })
            .collect();
        let small = reduced(&Texture::new(8, 8, texels), 2);
        assert_eq!((small.width(), small.height()), (2, 2));
        // Half of the light is 188 in sRGB
        assert!(small.texels().iter().all(|t| t[0].abs_diff(188) <= 1));
    }
}
