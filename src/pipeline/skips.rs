//! What a scene does not need is not done. Each such saving can be switched off, to see that it changes no byte and what
//! it saves: `facile bench gen` measures them.

/// Savings, each on by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent switches, one for each saving"
)]
pub struct Skips {
    /// Faces at rest are not simulated.
    pub faces_at_rest: bool,
    /// Equilibria of earlier runs are taken from the cache.
    pub cached_equilibria: bool,
    /// Samples that differ in view, occluder and light share a face.
    pub shared_faces: bool,
    /// Samples that differ in light alone share rays, labels and maps.
    pub shared_views: bool,
    /// A person's next face moves the scene of the last one, the next person's first face its trees.
    pub moved_scenes: bool,
    /// What lies behind closed lips is left out of the scene.
    pub closed_mouths: bool,
    /// Truth that the recipe does not ask for is not computed.
    pub unasked_truth: bool,
}

impl Default for Skips {
    fn default() -> Self {
        Self {
            faces_at_rest: true,
            cached_equilibria: true,
            shared_faces: true,
            shared_views: true,
            moved_scenes: true,
            closed_mouths: true,
            unasked_truth: true,
        }
    }
}

impl Skips {
    /// Every saving switched off alone, with its name.
    pub fn each_off() -> [(&'static str, Self); 7] {
        let all = Self::default();
        [
            (
                "faces_at_rest",
                Self {
                    faces_at_rest: false,
                    ..all
                },
            ),
            (
                "cached_equilibria",
                Self {
                    cached_equilibria: false,
                    ..all
                },
            ),
            (
                "shared_faces",
                Self {
                    shared_faces: false,
                    ..all
                },
            ),
            (
                "shared_views",
                Self {
                    shared_views: false,
                    ..all
                },
            ),
            (
                "moved_scenes",
                Self {
                    moved_scenes: false,
                    ..all
                },
            ),
            (
                "closed_mouths",
                Self {
                    closed_mouths: false,
                    ..all
                },
            ),
            (
                "unasked_truth",
                Self {
                    unasked_truth: false,
                    ..all
                },
            ),
        ]
    }
}
