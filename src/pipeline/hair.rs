//! Whose hair is which: chosen by the recipe, or drawn with the identity.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use facile_core::rng::RandomStream;
use facile_core::{Attributes, HairStyle, ReferenceHead, Subject};
use facile_trace::clothes::ShirtFit;
use facile_trace::hair::{Hair, HairFit, LashFit};

use crate::Error;
use crate::recipe::HairSettings;
use crate::recipe::file::{ClothesTable, SubjectKind};
use crate::sampling::Weights;

/// Random streams of hair: this number with that of the subject.
const HAIR_STREAMS: u64 = 1 << 61;
/// Random streams of clothes.
const CLOTHES_STREAMS: u64 = 3 << 59;
/// sRGB colours of shirts.
const SHIRTS: [[u8; 3]; 12] = [
    [228, 228, 224],
    [36, 38, 44],
    [52, 66, 104],
    [122, 128, 134],
    [142, 42, 46],
    [70, 92, 72],
    [196, 180, 150],
    [88, 116, 150],
    [84, 60, 50],
    [206, 160, 90],
    [110, 78, 118],
    [60, 120, 118],
];
/// Standard deviations of the brightness of hair and of its warmth, as shares.
const BRIGHTNESS: f64 = 0.14;
const WARMTH: f64 = 0.06;
/// From this age on men lose their hair more often, years.
const BALDING: f64 = 45.0;

/// sRGB mean colour of hair by its name in a person's attributes.
const COLORS: [(&str, [u8; 3]); 8] = [
    ("black", [27, 23, 21]),
    ("dark_brown", [48, 34, 26]),
    ("brown", [76, 52, 35]),
    ("dark_blond", [122, 96, 66]),
    ("blond", [168, 136, 92]),
    ("red", [122, 62, 32]),
    ("grey", [130, 128, 124]),
    ("white", [196, 194, 190]),
];

/// How often a style is worn: by women and men, of African ancestry and of others. `none` is the cropped hair that is painted
/// on the skin.
const WORN: [(&str, [f64; 4]); 11] = [
    ("none", [0.6, 0.2, 4.0, 1.5]),
    ("afro01", [3.0, 0.0, 2.0, 0.0]),
    ("bob01", [0.3, 2.0, 0.0, 0.0]),
    ("bob02", [0.6, 2.0, 0.0, 0.0]),
    ("braid01", [1.5, 1.5, 0.0, 0.0]),
    ("long01", [0.8, 3.0, 0.0, 0.2]),
    ("ponytail01", [1.5, 3.0, 0.1, 0.2]),
    ("short01", [0.1, 0.3, 0.5, 3.0]),
    ("short02", [0.1, 0.4, 0.4, 3.0]),
    ("short03", [0.2, 1.0, 0.0, 1.0]),
    ("short04", [1.0, 0.6, 0.6, 2.0]),
];

/// The hair of subject number `subject`; `None` for none but what the skin shows.
pub(super) fn draw(
    settings: &HairSettings,
    seed: u64,
    subject: u64,
    attributes: &Attributes,
) -> Option<Hair> {
    let mut stream = RandomStream::new(seed, HAIR_STREAMS | subject);
    let style = if settings.styles.is_empty() {
        WORN[worn(attributes).at(stream.unit())].0.to_owned()
    } else {
        settings.styles[stream.index(settings.styles.len())].clone()
    };
    let color = if settings.colors.is_empty() {
        own_color(attributes, &mut stream)
    } else {
        settings.colors[stream.index(settings.colors.len())]
    };
    (style != "none").then_some(Hair { style, color })
}

fn worn(attributes: &Attributes) -> Weights {
    let is = |value: &Option<String>, wanted: &str| value.as_deref() == Some(wanted);
    let is_male = is(&attributes.sex, "male");
    let column = 2 * usize::from(is_male) + usize::from(!is(&attributes.ancestry, "african"));
    let years = attributes.age.as_ref().and_then(|a| a.parse::<f64>().ok());
    let loss = years.map_or(0.0, |y| ((y - BALDING) / 10.0).max(0.0));
    let weights = WORN.map(|(name, weights)| {
        let loss = if is_male && name == "none" { loss } else { 0.0 };
        weights[column] * (1.0 + loss)
    });
    Weights::new(&weights).unwrap_or_else(|| Weights::equal(WORN.len()))
}

/// The colour that the person's attributes name, varied.
fn own_color(attributes: &Attributes, stream: &mut RandomStream) -> [u8; 3] {
    let name = attributes.hair.as_deref().unwrap_or("dark_brown");
    let named = COLORS.iter().find(|(n, _)| *n == name);
    let base = named.map_or(COLORS[1].1, |(_, color)| *color);
    let mut normal = || stream.normal().clamp(-2.0, 2.0);
    let (light, warmth) = (1.0 + BRIGHTNESS * normal(), WARMTH * normal());
    let gains = [light * (1.0 + warmth), light, light * (1.0 - warmth)];
    std::array::from_fn(|k| libm::round(f64::from(base[k]) * gains[k]).clamp(0.0, 255.0) as u8)
}

/// Styles and lashes on the reference head, each made when first worn.
#[derive(Debug)]
pub(super) struct Wardrobe {
    styles: BTreeMap<&'static str, OnceLock<HairFit>>,
    lashes: OnceLock<Arc<LashFit>>,
    shirt: OnceLock<ShirtFit>,
}

impl Wardrobe {
    pub(super) fn new() -> Self {
        Self {
            styles: HairStyle::names().map(|n| (n, OnceLock::new())).collect(),
            lashes: OnceLock::new(),
            shirt: OnceLock::new(),
        }
    }

    pub(super) fn shirt(&self, reference: &ReferenceHead) -> &ShirtFit {
        self.shirt.get_or_init(|| ShirtFit::new(reference))
    }

    /// A style, which is one of the known.
    pub(super) fn style(&self, reference: &ReferenceHead, name: &str) -> Result<&HairFit, Error> {
        let Some(slot) = self.styles.get(name) else {
            return Err(Error::Internal {
                reason: format!("hair style `{name}` was checked and is not there"),
            });
        };
        if let Some(fit) = slot.get() {
            return Ok(fit);
        }
        let fit = HairFit::new(reference, name)?;
        Ok(slot.get_or_init(|| fit))
    }

    pub(super) fn lashes(&self, reference: &ReferenceHead) -> Result<&Arc<LashFit>, Error> {
        if let Some(fit) = self.lashes.get() {
            return Ok(fit);
        }
        let fit = Arc::new(LashFit::new(reference)?);
        Ok(self.lashes.get_or_init(|| fit))
    }
}

/// The colour of the shirt of a subject; `None` for none.
pub(super) fn shirt(
    settings: &ClothesTable,
    seed: u64,
    number: u64,
    kind: &str,
) -> Option<[u8; 3]> {
    if !settings.on.contains(&subject_kind(kind)) {
        return None;
    }
    let mut stream = RandomStream::new(seed, CLOTHES_STREAMS | number);
    let colors = match &settings.colors[..] {
        [] => &SHIRTS[..],
        colors => colors,
    };
    Some(colors[stream.index(colors.len())])
}

/// Whether hair is for a subject of a kind: `scan`, `builtin`, `sampled`, or given by a caller, which counts as a scan.
pub(super) fn is_for(settings: &HairSettings, kind: &str) -> bool {
    settings.on.contains(&subject_kind(kind))
}

fn subject_kind(kind: &str) -> SubjectKind {
    match kind {
        "builtin" => SubjectKind::Builtin,
        "sampled" => SubjectKind::Sampled,
        _ => SubjectKind::Scan,
    }
}

/// The attributes by which hair is drawn.
pub(super) fn of_subject(
    settings: &HairSettings,
    seed: u64,
    number: u64,
    kind: &str,
    subject: &Subject,
) -> Option<Hair> {
    if is_for(settings, kind) {
        draw(settings, seed, number, &subject.attributes)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn person(sex: &str, ancestry: &str, hair: &str) -> Attributes {
        Attributes {
            sex: Some(sex.to_owned()),
            ancestry: Some(ancestry.to_owned()),
            hair: Some(hair.to_owned()),
            age: Some("30".to_owned()),
            ..Attributes::default()
        }
    }

    #[test]
    fn hair_suits_and_repeats() {
        let settings = HairSettings::default();
        let blond = person("female", "caucasian", "blond");
        let mut styles = std::collections::BTreeSet::new();
        for subject in 0..200 {
            let hair = draw(&settings, 5, subject, &blond);
            assert_eq!(hair, draw(&settings, 5, subject, &blond));
            if let Some(hair) = hair {
                assert!(
                    hair.color[0] > hair.color[2] && hair.color[0] > 100,
                    "{hair:?}"
                );
                assert_ne!(hair.style, "afro01");
                styles.insert(hair.style);
            }
        }
        assert!(styles.len() >= 6, "{styles:?}");
        let bald = |years: &str| {
            let mut man = person("male", "caucasian", "grey");
            man.age = Some(years.to_owned());
            (0..400)
                .filter(|s| draw(&settings, 1, *s, &man).is_none())
                .count()
        };
        assert!(bald("75") > 2 * bald("30"));
    }

    #[test]
    fn a_recipe_chooses() {
        let settings = HairSettings {
            styles: vec!["bob01".to_owned()],
            colors: vec![[200, 30, 90]],
            ..HairSettings::default()
        };
        let hair = draw(&settings, 1, 2, &Attributes::default()).expect("chosen");
        assert_eq!((hair.style.as_str(), hair.color), ("bob01", [200, 30, 90]));
        assert!(is_for(&settings, "sampled") && !is_for(&settings, "scan"));
        let known: Vec<&str> = HairStyle::names().collect();
        assert!(WORN.iter().skip(1).all(|(name, _)| known.contains(name)));
    }
}
