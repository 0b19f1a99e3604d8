//! What the tracer leaves out because it changes no pixel.

/// Savings, each on by default. Switched off, the same image takes longer: tests compare the bytes, benches the times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skips {
    /// Pixels outside the projected bounds of the scene are not traced.
    pub screen_bounds: bool,
    /// Points that face away from a light, or get nothing of it for another reason, send it no shadow ray.
    pub facing_away: bool,
}

impl Skips {
    /// All savings with one of them switched off, by its name.
    pub fn each_off() -> [(&'static str, Self); 2] {
        let all = Self::default();
        [
            (
                "screen_bounds",
                Self {
                    screen_bounds: false,
                    ..all
                },
            ),
            (
                "facing_away",
                Self {
                    facing_away: false,
                    ..all
                },
            ),
        ]
    }
}

impl Default for Skips {
    fn default() -> Self {
        Self {
            screen_bounds: true,
            facing_away: true,
        }
    }
}
