//! `[subjects]`, `[hair]` and `[clothes]`: whose faces, and what they wear.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[subjects]`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SubjectsTable {
    /// Scan files (OBJ, PLY, GLB) as globs, relative to the recipe.
    pub scans: Vec<String>,
    /// Built-in subjects by name, or `all`.
    pub builtin: Vec<String>,
    /// Number of new identities to draw from the identity model.
    pub sampled: i64,
    /// Even out the light that is baked into the colours of scans.
    pub delight: bool,
}

/// `[hair]`: cards of hair on heads, in a style and colour for each person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HairTable {
    /// Subjects that get hair and lashes; none for an empty list. Those that are left out show what is painted on their skin.
    pub on: Vec<SubjectKind>,
    /// Styles to draw from: `afro01`, `bob01`, `bob02`, `braid01`, `long01`, `ponytail01`, `short01` to `short04`, or `none`
    /// for the cropped hair that is painted on the skin. If there are none, one that suits the person.
    pub styles: Vec<String>,
    /// sRGB colours to draw from, from 0 to 255; the person's own if there are none.
    pub colors: Vec<[u8; 3]>,
    /// Whether the same subjects get lashes.
    pub lashes: bool,
}

impl Default for HairTable {
    fn default() -> Self {
        Self {
            on: vec![SubjectKind::Builtin, SubjectKind::Sampled],
            styles: Vec::new(),
            colors: Vec::new(),
            lashes: true,
        }
    }
}

/// `[clothes]`: a shirt around neck and shoulders, in a colour for each person.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ClothesTable {
    /// Subjects that wear a shirt; none for an empty list.
    pub on: Vec<SubjectKind>,
    /// sRGB colours to draw from, from 0 to 255; usual ones if there are none.
    pub colors: Vec<[u8; 3]>,
}

impl Default for ClothesTable {
    fn default() -> Self {
        Self {
            on: vec![SubjectKind::Builtin, SubjectKind::Sampled],
            colors: Vec::new(),
        }
    }
}

/// Where a subject comes from.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum SubjectKind {
    /// A scan of the user.
    Scan,
    /// A subject that ships with the program.
    Builtin,
    /// A draw from the identity model.
    Sampled,
}
