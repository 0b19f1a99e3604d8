//! Hair under something that is worn over it, such as a cap: pressed in, and cut where it would come through.
//!
//! Cards are cut fine near what is worn; their vertices come in under it, those next to its rim with them; what
//! crosses it still is left out.

use std::collections::BTreeMap;

use facile_core::{Mesh, Point3, Vector3};

use super::{Cards, Outwards, pushed_out};
use crate::TraceError;
use crate::cutout::Cutout;
use crate::math::{vec3_from_point, vec3_from_vector};
use crate::object::Object;
use crate::ray::Ray;

/// How far under what is worn over it hair lies, mm.
const UNDER_MM: f64 = 0.9;
/// How far over the skin it stays, mm.
const OVER_SKIN_MM: f64 = 0.5;
/// Distances at which hair looks for a rim above itself, or else below, and distance up to which it is drawn in wholly, mm.
const RIM_STEPS_MM: [f64; 9] = [0.0, 4.0, 8.0, 12.0, 18.0, 26.0, 36.0, 48.0, 60.0];
const RIM_MM: f64 = 10.0;
/// Halvings of the step in which the rim lies: to 0.4 mm.
const RIM_HALVINGS: usize = 5;
/// Longest edge of cards near what is worn, mm.
const LONGEST_MM: f64 = 6.0;
/// Rounds of cutting edges in two: 6 mm times 2^5 is longer than any card.
const ROUNDS: usize = 5;

/// A corner of a triangle: vertex and texture coordinate.
type Corner = [u32; 2];

/// The hair of `cards` under the object `worn`, outside of the skin.
pub(crate) fn pressed(cards: &Cards, worn: &Object, skin: &Object) -> Result<Object, TraceError> {
    let Some((low, high)) = worn.bounds_in_world() else {
        return cards.object(None);
    };
    let reach = RIM_STEPS_MM[RIM_STEPS_MM.len() - 1];
    let heights = f64::from(low.y) - reach..f64::from(high.y) + reach;
    let is_near = |p: &Point3| heights.contains(&p.y);
    let mut fine = cards.clone();
    for _ in 0..ROUNDS {
        if !cut(&mut fine.mesh, &mut fine.strands, &is_near) {
            break;
        }
    }
    let near: Vec<bool> = fine.mesh.positions.iter().map(is_near).collect();
    for (p, _) in fine
        .mesh
        .positions
        .iter_mut()
        .zip(&near)
        .filter(|(_, near)| **near)
    {
        *p = under(p, worn, skin);
    }
    let crosses = |a: &Point3, b: &Point3| {
        let ray = Ray::between(vec3_from_point(a), vec3_from_point(b));
        worn.closest_hit(&worn.ray_in_object(&ray)).is_some()
    };
    let mesh = &mut fine.mesh;
    let stays: Vec<bool> = (0..mesh.triangles.len())
        .map(|t| {
            let is_near = mesh.triangles[t].iter().any(|v| near[*v as usize]);
            let [a, b, c] = mesh.corners(t);
            !is_near || !(crosses(&a, &b) || crosses(&b, &c) || crosses(&c, &a))
        })
        .collect();
    let mut keep = stays.iter();
    mesh.triangles.retain(|_| *keep.next().unwrap_or(&true));
    let mut keep = stays.iter();
    mesh.texcoord_triangles
        .retain(|_| *keep.next().unwrap_or(&true));
    mesh.segments.truncate(mesh.triangles.len());
    let style = fine.style;
    let cutout = Cutout::new(&fine.mesh, style.size(), style.cover.clone())?;
    fine.object(Some(cutout.into()))
}

/// A point of hair brought in under what is worn, if it is under it or next to its rim.
fn under(p: &Point3, worn: &Object, skin: &Object) -> Point3 {
    let limit = |p: &Point3| {
        let ray = Outwards::to(p);
        let outwards = Ray::new(vec3_from_point(&ray.middle), vec3_from_vector(&ray.out));
        let hit = worn.closest_hit(&worn.ray_in_object(&outwards))?;
        Some(f64::from(hit.t) - UNDER_MM)
    };
    let rim = |way: f64| {
        let at = |away: f64| limit(&(p + Vector3::y() * (way * away))).map(|limit| (away, limit));
        let mut free = 0.0;
        let mut found = RIM_STEPS_MM.iter().find_map(|away| {
            let found = at(*away);
            if found.is_none() {
                free = *away;
            }
            found
        })?;
        // The rim lies between two steps: hair follows it without steps of its own
        for _ in 0..RIM_HALVINGS {
            let middle = f64::midpoint(free, found.0);
            match at(middle) {
                Some(nearer) => found = nearer,
                None => free = middle,
            }
        }
        Some(found)
    };
    let found = rim(1.0).or_else(|| rim(-1.0));
    let ray = Outwards::to(p);
    let distance = (p - ray.middle).norm();
    match found {
        Some((away, limit)) if distance > limit => {
            // All the way at the rim, not at all at the last step
            let last = RIM_STEPS_MM[RIM_STEPS_MM.len() - 1];
            let free = ((away - RIM_MM) / (last - RIM_MM)).max(0.0);
            let free = free * free * (3.0 - 2.0 * free);
            let inside = ray.middle + ray.out * (limit + (distance - limit) * free);
            pushed_out(inside, OVER_SKIN_MM, skin)
        }
        _ => *p,
    }
}

/// Cuts every edge near what is worn that is too long in two; whether there were any.
fn cut(mesh: &mut Mesh, strands: &mut Vec<Vector3>, is_near: &impl Fn(&Point3) -> bool) -> bool {
    let mut middles: BTreeMap<[Corner; 2], Corner> = BTreeMap::new();
    let mut vertices: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    let triangles = mesh.triangles.iter().zip(&mesh.texcoord_triangles);
    let triangles: Vec<[Corner; 3]> = triangles
        .map(|(v, t)| std::array::from_fn(|k| [v[k], t[k]]))
        .collect();
    let segment = mesh.segments.first().copied();
    let mut out: Vec<[Corner; 3]> = Vec::with_capacity(triangles.len());
    for corners in &triangles {
        let mut middle = |k: usize| {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let [p, q] = [a, b].map(|c| mesh.positions[c[0] as usize]);
            if (q - p).norm() <= LONGEST_MM || !(is_near(&p) || is_near(&q)) {
                return None;
            }
            let key = if a < b { [a, b] } else { [b, a] };
            Some(*middles.entry(key).or_insert_with(|| {
                let ends = [a[0].min(b[0]), a[0].max(b[0])];
                let vertex = *vertices.entry(ends).or_insert_with(|| {
                    mesh.positions.push(nalgebra::center(&p, &q));
                    let [s, t] = ends.map(|v| strands[v as usize]);
                    strands.push(if s.dot(&t) < 0.0 { s } else { s + t });
                    mesh.positions.len() as u32 - 1
                });
                let [s, t] = [a, b].map(|c| mesh.texcoords[c[1] as usize]);
                mesh.texcoords
                    .push([0, 1].map(|k| f32::midpoint(s[k], t[k])));
                [vertex, mesh.texcoords.len() as u32 - 1]
            }))
        };
        let middles = [middle(0), middle(1), middle(2)];
        out.extend(parts(corners, &middles));
    }
    let has_cut = out.len() > triangles.len();
    mesh.triangles = out.iter().map(|t| t.map(|c| c[0])).collect();
    mesh.texcoord_triangles = out.iter().map(|t| t.map(|c| c[1])).collect();
    if let Some(segment) = segment {
        mesh.segments = vec![segment; mesh.triangles.len()];
    }
    has_cut
}

/// The parts of a triangle whose edges, each from a corner to the next, may be cut.
fn parts(corners: &[Corner; 3], middles: &[Option<Corner>; 3]) -> Vec<[Corner; 3]> {
    let turned = |k: usize| [0, 1, 2].map(|i| corners[(i + k) % 3]);
    match middles {
        [None, None, None] => vec![*corners],
        [Some(u), Some(v), Some(w)] => {
            let [a, b, c] = *corners;
            vec![[a, *u, *w], [*u, b, *v], [*w, *v, c], [*u, *v, *w]]
        }
        [Some(m), None, None] | [None, Some(m), None] | [None, None, Some(m)] => {
            let k = middles.iter().position(Option::is_some).unwrap_or(0);
            let [a, b, c] = turned(k);
            vec![[a, *m, c], [*m, b, c]]
        }
        [None, Some(v), Some(w)] | [Some(w), None, Some(v)] | [Some(v), Some(w), None] => {
            let k = middles.iter().position(Option::is_none).unwrap_or(0);
            let [a, b, c] = turned(k);
            vec![[a, b, *v], [a, *v, *w], [*w, *v, c]]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hair::HairFit;
    use crate::head::HeadScene;
    use crate::math::Rgb;
    use crate::occluder::{FaceFit, Prop, PropKind};
    use facile_core::{IdentityModel, ReferenceHead};

    #[test]
    fn no_hair_comes_through_what_is_worn() {
        let reference = ReferenceHead::embedded();
        let subject = IdentityModel::embedded()
            .sample(reference, 11, 1)
            .expect("draws");
        let head = HeadScene::new(reference, &subject, Rgb::zeros()).expect("valid");
        let fit = FaceFit::new(reference, &head).expect("measures");
        let skin = &head.scene.objects()[HeadScene::SKIN];
        for style in ["short03", "bob01"] {
            let cards = HairFit::new(reference, style).expect("ships").cards(
                reference,
                &subject,
                skin,
                [40, 30, 20],
            );
            for kind in [PropKind::Cap, PropKind::Hat, PropKind::HeadBand] {
                let worn = Prop::new(kind).object(&fit).expect("fits");
                let hair = pressed(&cards, &worn, skin).expect("valid");
                let (mut outside, mut seen) = (0, 0);
                // Outwards of every point of what is worn there is no hair
                for p in worn.geometry().positions() {
                    let way = Outwards::to(&Point3::from(p.cast::<f64>())).out;
                    let start = Point3::from(p.cast::<f64>()) + way * 300.0;
                    let mut ray = Ray::new(vec3_from_point(&start), vec3_from_vector(&-way));
                    ray.t_max = 299.5;
                    outside += i32::from(hair.closest_hit(&ray).is_some());
                    seen += 1;
                }
                assert!(
                    seen > 200 && outside * 50 <= seen,
                    "{style} {kind:?}: {outside} of {seen}"
                );
                let kept = hair.geometry().triangles().len();
                assert!(
                    kept >= cards.mesh.triangles.len() / 2,
                    "{style} {kind:?}: {kept}"
                );
            }
        }
    }

    #[test]
    fn parts_of_a_triangle_have_its_area() {
        let at = |c: Corner| {
            [
                [0.0, 0.0],
                [8.0, 0.0],
                [2.0, 6.0],
                [4.0, 0.0],
                [5.0, 3.0],
                [1.0, 3.0],
            ][c[0] as usize]
        };
        let area = |t: &[Corner; 3]| {
            let [a, b, c]: [[f64; 2]; 3] = t.map(at);
            ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2.0
        };
        let corners = [[0, 0], [1, 0], [2, 0]];
        for cuts in 0..8 {
            let middles: [Option<Corner>; 3] =
                std::array::from_fn(|k| (cuts >> k & 1 == 1).then_some([3 + k as u32, 0]));
            let parts = parts(&corners, &middles);
            assert_eq!(parts.len(), 1 + middles.iter().flatten().count());
            assert!(parts.iter().all(|t| area(t) > 0.0), "{parts:?}");
            assert!((parts.iter().map(area).sum::<f64>() - area(&corners)).abs() < 1e-9);
        }
    }
}
