//! Classes of surface: what a label map says each pixel shows.

use crate::CoreError;

macro_rules! segments {
    ($($(#[$doc:meta])* $name:ident = $id:literal, $text:literal;)*) => {
        /// A class of surface. The ids are part of the dataset format and never change.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum Segment { $($(#[$doc])* $name = $id,)* }

        impl Segment {
            /// Every class, by increasing id.
            pub const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// The name in files: groups of an OBJ, keys of a label map.
            pub fn name(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }
        }
    };
}

segments! {
    /// Nothing: the background.
    Background = 0, "background";
    /// Skin of the face that no other class names.
    Skin = 1, "skin";
    /// The subject's left brow.
    LeftBrow = 2, "left_brow";
    /// The subject's right brow.
    RightBrow = 3, "right_brow";
    /// Lids of the left eye.
    LeftEyelid = 4, "left_eyelid";
    /// Lids of the right eye.
    RightEyelid = 5, "right_eyelid";
    /// Inside of the eye sockets.
    EyeSocket = 6, "eye_socket";
    /// Nose.
    Nose = 7, "nose";
    /// Upper lip, vermilion.
    UpperLip = 8, "upper_lip";
    /// Lower lip, vermilion.
    LowerLip = 9, "lower_lip";
    /// Inside of the mouth.
    InnerMouth = 10, "inner_mouth";
    /// Upper teeth and gums.
    UpperTeeth = 11, "upper_teeth";
    /// Lower teeth and gums.
    LowerTeeth = 12, "lower_teeth";
    /// Tongue.
    Tongue = 13, "tongue";
    /// The subject's left ear.
    LeftEar = 14, "left_ear";
    /// The subject's right ear.
    RightEar = 15, "right_ear";
    /// Neck.
    Neck = 16, "neck";
    /// Scalp.
    Scalp = 17, "scalp";
    /// The subject's left eyeball without the iris.
    LeftEye = 18, "left_eye";
    /// The subject's right eyeball without the iris.
    RightEye = 19, "right_eye";
    /// The left eye's iris and pupil.
    LeftIris = 20, "left_iris";
    /// The right eye's iris and pupil.
    RightIris = 21, "right_iris";
    /// Eyelashes.
    Lashes = 22, "lashes";
    /// Hair of the head.
    Hair = 23, "hair";
    /// Clothes on the shoulders.
    Clothes = 24, "clothes";
    /// Frame of glasses.
    GlassesFrame = 30, "glasses_frame";
    /// Lenses of glasses.
    GlassesLens = 31, "glasses_lens";
    /// Surgical mask.
    SurgicalMask = 32, "surgical_mask";
    /// Scarf.
    Scarf = 33, "scarf";
    /// Cap.
    Cap = 34, "cap";
    /// Hat.
    Hat = 35, "hat";
    /// Head band.
    HeadBand = 36, "head_band";
    /// Headphones.
    Headphones = 37, "headphones";
    /// A hand that is no part of the scan.
    Hand = 38, "hand";
    /// A pole.
    Bar = 39, "bar";
    /// Any other occluder, or a mesh without a class.
    Other = 40, "other";
    /// Hair over the forehead that is put there as an occluder.
    Fringe = 41, "fringe";
}

impl Segment {
    /// The id in label maps.
    pub fn id(self) -> u8 {
        self as u8
    }

    /// The class with an id.
    pub fn from_id(id: u8) -> Option<Self> {
        Self::ALL.iter().copied().find(|s| s.id() == id)
    }

    /// The class with a name.
    ///
    /// # Errors
    /// [`CoreError::UnknownName`] with the allowed names.
    pub fn from_name(name: &str) -> Result<Self, CoreError> {
        Self::ALL
            .iter()
            .copied()
            .find(|s| s.name() == name)
            .ok_or_else(|| CoreError::UnknownName {
                kind: "segment",
                name: name.to_owned(),
                known: Self::ALL
                    .iter()
                    .map(|s| s.name())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }

    /// Whether the class belongs to something that was put in front of the face.
    pub fn is_occluder(self) -> bool {
        self.id() >= 30
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_ids_round_trip() {
        for &segment in Segment::ALL {
            assert_eq!(Segment::from_id(segment.id()), Some(segment));
            assert_eq!(Segment::from_name(segment.name()).expect("known"), segment);
        }
        assert!(Segment::from_name("elbow").is_err());
    }
}
