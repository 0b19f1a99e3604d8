//! Things that people wear or hold before their face, by kind, colour, size and place.

use facile_core::{Mesh, Segment};
use serde::{Deserialize, Serialize};

use super::fit::FaceFit;
use super::{drape, fringe, hand, headphones};
use crate::TraceError;
use crate::geometry::Normals;
use crate::material::{Albedo, Material};
use crate::math::{Rgb, vec3_from_vector};
use crate::object::Object;

/// What a [`Prop`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PropKind {
    /// Pleated cloth over nose, mouth and chin, with loops around the ears.
    SurgicalMask,
    /// Cloth around neck, chin and mouth.
    Scarf,
    /// Cloth over the skull, with a brim over the forehead.
    Cap,
    /// Felt over the skull, with a brim all around.
    Hat,
    /// A band around the head, over the forehead.
    HeadBand,
    /// Cups over the ears and a bow over the head.
    Headphones,
    /// A hand before the face, fingers up.
    Hand,
    /// A pole across the face.
    Bar,
    /// Hair that falls over the forehead.
    Fringe,
}

impl PropKind {
    /// Every kind.
    pub const ALL: [Self; 9] = [
        Self::SurgicalMask,
        Self::Scarf,
        Self::Cap,
        Self::Hat,
        Self::HeadBand,
        Self::Headphones,
        Self::Hand,
        Self::Bar,
        Self::Fringe,
    ];

    /// Colour, 8-bit sRGB, of a prop that is given none.
    pub fn usual_color(self) -> [u8; 3] {
        match self {
            Self::SurgicalMask => [150, 190, 214],
            Self::Scarf => [122, 52, 48],
            Self::Cap => [40, 52, 84],
            Self::Hat => [92, 72, 52],
            Self::HeadBand => [170, 40, 60],
            Self::Headphones => [36, 36, 40],
            Self::Hand => [198, 150, 124],
            Self::Bar => [120, 122, 126],
            Self::Fringe => [58, 40, 28],
        }
    }

    /// Class of its surface in label maps.
    pub fn segment(self) -> Segment {
        match self {
            Self::SurgicalMask => Segment::SurgicalMask,
            Self::Scarf => Segment::Scarf,
            Self::Cap => Segment::Cap,
            Self::Hat => Segment::Hat,
            Self::HeadBand => Segment::HeadBand,
            Self::Headphones => Segment::Headphones,
            Self::Hand => Segment::Hand,
            Self::Bar => Segment::Bar,
            Self::Fringe => Segment::Fringe,
        }
    }

    /// Which of the places `x_mm`, `y_mm` and `turn_deg` it has.
    pub fn places(self) -> &'static [&'static str] {
        match self {
            Self::Hand | Self::Bar => &["x_mm", "y_mm", "turn_deg"],
            Self::Cap => &["y_mm", "turn_deg"],
            _ => &["y_mm"],
        }
    }
}

/// Something worn or held, fitted to a head when it is put on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prop {
    /// What it is.
    pub kind: PropKind,
    /// 8-bit sRGB colour; [`PropKind::usual_color`] if not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<[u8; 3]>,
    /// Size relative to a usual one, in `[0.7, 1.3]`: height of a mask, thickness of a scarf, length of a brim or fringe,
    /// width of a band, cups, hand, pole.
    pub size: f64,
    /// Motion to the subject's left, mm, in `[-150, 150]`.
    pub x_mm: f64,
    /// Motion upwards, mm, in `[-150, 150]`.
    pub y_mm: f64,
    /// Turn, degrees, in `[-180, 180]`: of a hand or pole counter-clockwise for the viewer, of a cap to the subject's left.
    pub turn_deg: f64,
}

impl Prop {
    /// A usual one.
    pub fn new(kind: PropKind) -> Self {
        Self {
            kind,
            color: None,
            size: 1.0,
            x_mm: 0.0,
            y_mm: 0.0,
            turn_deg: 0.0,
        }
    }

    /// The prop on a head, ready to be added to its scene.
    ///
    /// # Errors
    /// [`TraceError::Setting`] for numbers out of range; as [`Object::new`].
    pub fn object(&self, fit: &FaceFit<'_>) -> Result<Object, TraceError> {
        self.check()?;
        let color = self.linear_color();
        if self.kind == PropKind::Fringe {
            let (mut mesh, strands) = fringe::fringe(self, fit);
            mesh.segments.fill(self.kind.segment());
            let strands = strands.iter().map(vec3_from_vector).collect();
            let hair = Object::new(&mesh, Normals::Smooth, Material::matt(color))?;
            return Ok(hair.with_strands(strands)?.as_occluder());
        }
        let object = Object::new(&self.mesh(fit), Normals::Smooth, self.material(color))?;
        Ok(object.as_occluder())
    }

    /// The surface, mm, head frame.
    pub fn mesh(&self, fit: &FaceFit<'_>) -> Mesh {
        let mut mesh = match self.kind {
            PropKind::SurgicalMask => drape::mask(self, fit),
            PropKind::Scarf => drape::scarf(self, fit),
            PropKind::Cap => drape::cap(self, fit),
            PropKind::Hat => drape::hat(self, fit),
            PropKind::HeadBand => drape::head_band(self, fit),
            PropKind::Headphones => headphones::headphones(self, fit),
            PropKind::Hand => hand::hand(self, fit, self.linear_color().into()),
            PropKind::Bar => hand::bar(self, fit),
            PropKind::Fringe => fringe::fringe(self, fit).0,
        };
        mesh.segments.fill(self.kind.segment());
        mesh
    }

    fn linear_color(&self) -> Rgb {
        let color = self.color.unwrap_or(self.kind.usual_color());
        Rgb::from(color.map(|v| facile_core::color::LINEAR_FROM_SRGB8[usize::from(v)]))
    }

    fn material(&self, color: Rgb) -> Material {
        let rough = |specular, roughness| Material {
            albedo: Albedo::Constant(color),
            specular,
            roughness,
            ..Material::default()
        };
        match self.kind {
            PropKind::Hand => Material {
                albedo: Albedo::VertexColor,
                scatter_mm: Material::SKIN_SCATTER_MM,
                ..rough(0.028, 0.5)
            },
            // Plastic
            PropKind::Headphones => rough(0.04, 0.35),
            // Brushed metal: its highlight has its colour's strength
            PropKind::Bar => rough(0.5, 0.38),
            // Cloth
            _ => rough(0.02, 0.85),
        }
    }

    fn check(&self) -> Result<(), TraceError> {
        let is_place = |v: f64, limit: f64| v.abs() <= limit;
        if (0.7..=1.3).contains(&self.size)
            && is_place(self.x_mm, 150.0)
            && is_place(self.y_mm, 150.0)
            && is_place(self.turn_deg, 180.0)
        {
            return Ok(());
        }
        Err(TraceError::Setting {
            name: "occluder",
            expected: "a size in [0.7, 1.3], x_mm and y_mm in [-150, 150], turn_deg in [-180, 180]",
            got: format!("{self:?}"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hair::gap_from_skin;
    use crate::head::HeadScene;
    use facile_core::{IdentityModel, ReferenceHead};

    #[test]
    fn nothing_cuts_into_any_face() {
        let reference = ReferenceHead::embedded();
        for index in 0..4 {
            let subject = IdentityModel::embedded()
                .sample(reference, 11, index)
                .expect("draws");
            let head = HeadScene::new(reference, &subject, Rgb::zeros()).expect("valid");
            let fit = FaceFit::new(reference, &head).expect("measures");
            let skin = &head.scene.objects()[HeadScene::SKIN];
            for kind in PropKind::ALL {
                for size in [0.7, 1.3] {
                    let prop = Prop {
                        size,
                        ..Prop::new(kind)
                    };
                    let mesh = prop.mesh(&fit);
                    assert!(mesh.triangles.len() > 50, "{kind:?}");
                    // Loops and bands go close to the ears, whose own surface does not count
                    let outside = mesh.positions.iter().filter(|p| p.x.abs() < 60.0);
                    for p in outside {
                        let gap = gap_from_skin(p, skin).unwrap_or(f64::INFINITY);
                        assert!(
                            gap > -0.8,
                            "{kind:?} of size {size} on {index}: {gap} at {p}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let reference = ReferenceHead::embedded();
        let subject = IdentityModel::embedded()
            .sample(reference, 11, 0)
            .expect("draws");
        let head = HeadScene::new(reference, &subject, Rgb::zeros()).expect("valid");
        let fit = FaceFit::new(reference, &head).expect("measures");
        for prop in [
            Prop {
                size: 2.0,
                ..Prop::new(PropKind::Cap)
            },
            Prop {
                y_mm: f64::NAN,
                ..Prop::new(PropKind::Hand)
            },
            Prop {
                turn_deg: 200.0,
                ..Prop::new(PropKind::Bar)
            },
        ] {
            assert!(prop.object(&fit).is_err(), "{prop:?}");
        }
    }
}
