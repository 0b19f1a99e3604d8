//! What a scene does not need is not done. Each such saving can be switched off, to see that it changes no byte and what
//! it saves: `facile bench savings` measures them.

/// Savings, each on by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent switches, one for each saving"
)]
pub struct Skips {
    /// Registrations of earlier runs are taken from the cache.
    pub cached_registrations: bool,
    /// Faces at rest are not simulated.
    pub faces_at_rest: bool,
    /// Equilibria of earlier runs are taken from the cache.
    pub cached_equilibria: bool,
    /// Muscles that do not pull are not gone through.
    pub idle_muscles: bool,
    /// Samples that differ in view, occluder and light share a face.
    pub shared_faces: bool,
    /// Samples that differ in light alone share rays, labels and maps.
    pub shared_views: bool,
    /// A person's next face moves the scene of the last one, the next person's first face its trees.
    pub moved_scenes: bool,
    /// What lies behind closed lips is left out of the scene.
    pub closed_mouths: bool,
    /// Eyes behind shut lids are left out of the scene.
    pub closed_eyes: bool,
    /// Pixels outside the projected bounds of the scene are not traced.
    pub screen_bounds: bool,
    /// Points that face away from a light send it no shadow ray.
    pub facing_away: bool,
    /// Truth that the recipe does not ask for is not computed.
    pub unasked_truth: bool,
}

type Switch = fn(&mut Skips) -> &mut bool;

const SWITCHES: [(&str, Switch); 12] = [
    ("cached_registrations", |s| &mut s.cached_registrations),
    ("faces_at_rest", |s| &mut s.faces_at_rest),
    ("cached_equilibria", |s| &mut s.cached_equilibria),
    ("idle_muscles", |s| &mut s.idle_muscles),
    ("shared_faces", |s| &mut s.shared_faces),
    ("shared_views", |s| &mut s.shared_views),
    ("moved_scenes", |s| &mut s.moved_scenes),
    ("closed_mouths", |s| &mut s.closed_mouths),
    ("closed_eyes", |s| &mut s.closed_eyes),
    ("screen_bounds", |s| &mut s.screen_bounds),
    ("facing_away", |s| &mut s.facing_away),
    ("unasked_truth", |s| &mut s.unasked_truth),
];

impl Default for Skips {
    fn default() -> Self {
        Self {
            cached_registrations: true,
            faces_at_rest: true,
            cached_equilibria: true,
            idle_muscles: true,
            shared_faces: true,
            shared_views: true,
            moved_scenes: true,
            closed_mouths: true,
            closed_eyes: true,
            screen_bounds: true,
            facing_away: true,
            unasked_truth: true,
        }
    }
}

impl Skips {
    /// Every saving switched off alone, with its name.
    ///
    /// Without [`Self::idle_muscles`] equilibria are not taken from the cache either, where nothing would be left to
    /// show.
    pub fn each_off() -> impl Iterator<Item = (&'static str, Self)> {
        SWITCHES.iter().map(|(name, switch)| {
            let mut skips = Self::default();
            *switch(&mut skips) = false;
            skips.cached_equilibria &= skips.idle_muscles;
            (*name, skips)
        })
    }

    /// The same, with the saving that [`Self::each_off`] calls `name` switched on.
    #[must_use]
    pub fn with(mut self, name: &str) -> Self {
        for (_, switch) in SWITCHES.iter().filter(|(n, _)| *n == name) {
            *switch(&mut self) = true;
        }
        self
    }
}
