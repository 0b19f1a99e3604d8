//! Draws new people from the identity model: attributes, shape, skin, eyes.

use crate::color::{LINEAR_FROM_SRGB8, srgb8_from_linear};
use crate::identity::{IdentityModel, MAX_COEFFICIENT, Skin};
use crate::rng::RandomStream;
use crate::{Attributes, CoreError, ReferenceHead, Subject, Texture};

/// Ages of sampled people, years: those of the population behind the model.
const AGES: [f64; 2] = [18.0, 76.0];

/// Least share of a sampled person's first ancestry.
const MAIN_ANCESTRY: f64 = 0.8;

/// Identities draw from the upper half of the stream numbers of a seed, samples of a dataset from the lower.
const IDENTITY_STREAMS: u64 = 1 << 63;

impl IdentityModel {
    /// Draws person number `index` of the family `seed`: sex and ancestry evenly, age from 18 to 76, then shape and skin
    /// that suit, and an eye colour that suits the skin.
    ///
    /// A pure function of its arguments and the model, to the last bit. `reference` is the head that the model was loaded
    /// for. Cost: some 0.1 s, most of it the skin.
    ///
    /// # Errors
    /// [`CoreError::Format`] if a skin of a model that was loaded from a folder is damaged.
    pub fn sample(
        &self,
        reference: &ReferenceHead,
        seed: u64,
        index: u64,
    ) -> Result<Subject, CoreError> {
        let mut stream = RandomStream::new(seed, IDENTITY_STREAMS | index);
        let person = self.draw_person(&mut stream);
        let coefficients = self.draw_coefficients(&person, &mut stream);
        let shape = self.shape(reference, &coefficients);
        let (first, second, weight) = self.draw_skins(&person, &mut stream);
        let gains = self.draw_tint(&mut stream);
        let texture = mix(first, second, weight, gains)?;
        let eyes = &first.facts.eyes;
        let eye_color = eyes[stream.index(eyes.len())].clone();
        Ok(Subject {
            id: format!("sampled-{seed}-{index}"),
            attributes: Attributes {
                sex: Some(person.sex.to_owned()),
                ancestry: Some(person.ancestry.to_owned()),
                age: Some(format!("{:.0}", person.years)),
                eye_color: Some(eye_color.clone()),
                hair: Some(first.facts.hair.clone()),
                source: Some("identity model".to_owned()),
                license: Some("CC0-1.0".to_owned()),
            },
            expected_error: vec![0.0; shape.positions.len()],
            positions: shape.positions,
            texture,
            eyes: shape.eyes,
            eye_color,
            skull_from_reference: shape.skull_from_reference,
        })
    }

    /// Sex and ancestry of a skin of the model, each evenly, with an age.
    fn draw_person(&self, stream: &mut RandomStream) -> Person<'_> {
        let distinct = |of: fn(&Skin) -> &str, keep: &dyn Fn(&Skin) -> bool| {
            let mut names: Vec<&str> = self.skins.iter().filter(|s| keep(s)).map(of).collect();
            names.sort_unstable();
            names.dedup();
            names
        };
        let sexes = distinct(|s| &s.facts.sex, &|_| true);
        let sex = sexes[stream.index(sexes.len())];
        let ancestries = distinct(|s| &s.facts.ancestry, &|s| s.facts.sex == sex);
        let ancestry = ancestries[stream.index(ancestries.len())];
        Person {
            sex,
            ancestry,
            purity: stream.uniform(MAIN_ANCESTRY, 1.0),
            years: stream.uniform(AGES[0], AGES[1]),
        }
    }

    fn draw_coefficients(&self, person: &Person<'_>, stream: &mut RandomStream) -> Vec<f64> {
        let is_male = f64::from(u8::from(person.sex == "male"));
        let share = |name: &str| {
            if person.ancestry == name {
                person.purity
            } else {
                (1.0 - person.purity) / 2.0
            }
        };
        let x = [
            is_male,
            share("african"),
            share("asian"),
            person.years / 10.0,
        ];
        let model = &self.from_attributes;
        (0..self.len())
            .map(|k| {
                let mean: f64 = (0..4).map(|a| model.slope[k][a] * x[a]).sum();
                let value = model.offset[k] + mean + model.spread[k] * stream.normal();
                value.clamp(-MAX_COEFFICIENT, MAX_COEFFICIENT)
            })
            .collect()
    }

    /// The skin of the nearest age among those of the person's sex and ancestry, another one of them, and the share of
    /// the first.
    fn draw_skins(&self, person: &Person<'_>, stream: &mut RandomStream) -> (&Skin, &Skin, f64) {
        let distance = |s: &Skin| (s.facts.years - person.years).abs();
        let mut suiting: Vec<&Skin> = self
            .skins
            .iter()
            .filter(|s| s.facts.sex == person.sex && s.facts.ancestry == person.ancestry)
            .collect();
        // A stable sort: equal ages stay in the model's order.
        suiting.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let nearest = suiting.partition_point(|s| distance(s) <= distance(suiting[0]));
        let first = suiting.remove(stream.index(nearest));
        let second = match suiting.len() {
            0 => first,
            n => suiting[stream.index(n.min(2))],
        };
        let weight = stream.uniform(self.mix.weight[0], self.mix.weight[1]);
        (first, second, weight)
    }

    /// Linear gains of red, green and blue.
    fn draw_tint(&self, stream: &mut RandomStream) -> [f64; 3] {
        let tint = &self.tint;
        let mut normal = || stream.normal().clamp(-tint.clamp, tint.clamp);
        let brightness = 1.0 + tint.brightness * normal();
        let warmth = tint.warmth * normal();
        [
            brightness * (1.0 + warmth),
            brightness,
            brightness * (1.0 - warmth),
        ]
    }
}

/// What is drawn before shape and skin.
struct Person<'a> {
    sex: &'a str,
    ancestry: &'a str,
    /// Share of that ancestry; the others split the rest.
    purity: f64,
    years: f64,
}

/// Mixes two skins in linear light, `weight` of the first, and multiplies by gains.
fn mix(first: &Skin, second: &Skin, weight: f64, gains: [f64; 3]) -> Result<Texture, CoreError> {
    let (mut texture, second_texture) = (first.texture()?.clone(), second.texture()?);
    let (expected, got) = (texture.texels().len(), second_texture.texels().len());
    if expected != got || texture.width() != second_texture.width() {
        return Err(CoreError::SizeMismatch {
            what: "texels of a skin",
            expected,
            got,
        });
    }
    // Every pair of codes once: there are sixteen times as many texels.
    let codes: [Vec<u8>; 3] = gains.map(|gain| mixed_codes(weight, gain));
    for (a, b) in texture.texels_mut().iter_mut().zip(second_texture.texels()) {
        for (k, codes) in codes.iter().enumerate() {
            a[k] = codes[usize::from(a[k]) << 8 | usize::from(b[k])];
        }
    }
    Ok(texture)
}

/// The code of the mix of two sRGB codes, at the first times 256 plus the second.
fn mixed_codes(weight: f64, gain: f64) -> Vec<u8> {
    let table = |share: f64| -> [f32; 256] {
        std::array::from_fn(|i| (f64::from(LINEAR_FROM_SRGB8[i]) * share * gain) as f32)
    };
    let (of_first, of_second) = (table(weight), table(1.0 - weight));
    let pairs = of_first
        .iter()
        .flat_map(|a| of_second.iter().map(move |b| a + b));
    pairs.map(srgb8_from_linear).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Segment;

    fn sample(seed: u64, index: u64) -> Subject {
        IdentityModel::embedded()
            .sample(ReferenceHead::embedded(), seed, index)
            .expect("the embedded skins decode")
    }

    #[test]
    fn a_person_is_a_pure_function_of_seed_and_index() {
        let person = sample(7, 3);
        assert_eq!(person.id, "sampled-7-3");
        assert!(person == sample(7, 3));
        let other = sample(7, 4);
        assert!(person.positions != other.positions && person.texture != other.texture);
        assert!(person.positions != sample(8, 3).positions);
    }

    #[test]
    fn people_are_human_and_various() {
        let reference = ReferenceHead::embedded();
        let people: Vec<Subject> = (0..12).map(|i| sample(1, i)).collect();
        for person in &people {
            let between = (person.eyes[0].center - person.eyes[1].center).norm();
            assert!(
                (50.0..75.0).contains(&between),
                "{}: {between} mm",
                person.id
            );
            assert!(person.positions.iter().all(|p| p.coords.amax() < 300.0));
            assert!(reference.eye_textures.contains_key(&person.eye_color));
            let scale = person.skull_from_reference.scaling();
            assert!((0.7..1.3).contains(&scale), "{scale}");
        }
        for of in [
            |p: &Subject| p.attributes.sex.clone(),
            |p: &Subject| p.attributes.ancestry.clone(),
            |p: &Subject| p.attributes.age.clone(),
        ] {
            let mut names: Vec<_> = people.iter().map(of).collect();
            names.sort();
            names.dedup();
            assert!(names.len() >= 2 && names[0].is_some(), "{names:?}");
        }
    }

    #[test]
    fn attributes_show_in_the_shape() {
        // Men's noses are larger on the mean of many.
        let reference = ReferenceHead::embedded();
        let is_nose: Vec<bool> = {
            let mut flags = vec![false; reference.mesh.positions.len()];
            let triangles = reference
                .mesh
                .triangles
                .iter()
                .zip(&reference.mesh.segments);
            for (t, _) in triangles.filter(|(_, s)| **s == Segment::Nose) {
                for v in t {
                    flags[*v as usize] = true;
                }
            }
            flags
        };
        let model = IdentityModel::embedded();
        let height = |sex: &str| {
            let mut stream = RandomStream::new(3, 0);
            let mut sum = 0.0;
            for _ in 0..12 {
                let person = Person {
                    sex,
                    ancestry: "caucasian",
                    purity: 0.9,
                    years: 40.0,
                };
                let shape = model.shape(reference, &model.draw_coefficients(&person, &mut stream));
                let nose = shape.positions.iter().zip(&is_nose).filter(|(_, n)| **n);
                let y: Vec<f64> = nose.map(|(p, _)| p.y).collect();
                let low = y.iter().copied().fold(f64::INFINITY, f64::min);
                let high = y.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                sum += high - low;
            }
            sum / 12.0
        };
        let (male, female) = (height("male"), height("female"));
        assert!(male > female + 1.0, "{male} mm against {female} mm");
    }
}
