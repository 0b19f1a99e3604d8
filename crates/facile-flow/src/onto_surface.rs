//! The last step: the fitted template ends on the scan's surface where that can be trusted.
//!
//! First the cage moves along the normals towards the nearest scan points, with ever shorter smoothing; then each fine
//! vertex takes the small offset that is left, along its normal. Neither slides along the surface, so the
//! correspondence of the flow stays. Vertices without a trustworthy point nearby take their neighbours' offsets,
//! fading with distance. Folds that a step makes are smoothed away before it counts.

use facile_core::{Point3, Vector3};
use rayon::prelude::*;

use crate::cage::Target;
use crate::fit::Shape;
use crate::scan::WorkingScan;
use crate::template::Template;
use crate::{FlowError, RegistrationParams};

/// Scan surface further away than this is not the template's, mm, in the first step; it halves by the last.
pub(crate) const REACH: f64 = 8.0;
/// Cosine between the template's and the scan's normal from which they are the same surface.
const SAME_SIDE: f64 = 0.5;
/// Largest offset of a single fine vertex, mm.
const MAX_OFFSET: f64 = 2.5;

/// The registered surface.
pub(crate) struct Settled {
    /// Fine positions, mm.
    pub(crate) positions: Vec<Point3>,
    /// Distance to the scan along the normal before the last offset, mm; `None` where there is nothing to trust.
    pub(crate) residual: Vec<Option<f64>>,
}

/// A trusted point of the scan for a fine vertex.
pub(crate) struct Contact {
    /// From the vertex to the point, mm.
    pub(crate) to: Vector3,
    /// Signed distance along the vertex's normal, mm.
    pub(crate) offset: f64,
    /// Unit normal between the vertex's and the scan's.
    pub(crate) normal: Vector3,
    /// `[0, 1]`.
    pub(crate) weight: f64,
}

/// Moves the cage onto the scan and returns the fine surface on it.
pub(crate) fn settle(
    template: &Template<'_>,
    scan: &WorkingScan<'_>,
    shape: &mut Shape,
    params: &RegistrationParams,
) -> Result<Settled, FlowError> {
    let Shape { cage, starts, .. } = shape;
    let steps = params.surface_smoothing_mm.len().max(1) as f64;
    let mut beyond = vec![false; template.skin.len()];
    for (k, &length) in params.surface_smoothing_mm.iter().enumerate() {
        let reach = REACH * (1.0 - 0.5 * k as f64 / steps);
        let fine = template.fine(cage);
        let normals = facile_core::mesh::vertex_normals(&fine, &template.reference.mesh.triangles);
        let contacts = contacts(
            template,
            scan,
            (&fine, &normals),
            starts,
            &mut beyond,
            reach,
        );
        let targets: Vec<Target> = contacts
            .iter()
            .enumerate()
            .filter_map(|(v, contact)| {
                let contact = contact.as_ref()?;
                Some(Target {
                    vertex: v as u32,
                    displacement: normals[v] * contact.offset,
                    weight: contact.weight * template.areas[v],
                })
            })
            .collect();
        let step = template
            .cage_fit
            .solve(template.reference, &targets, length)?;
        for (p, d) in cage.iter_mut().zip(step) {
            *p += d;
        }
    }
    let fine = template.fine(cage);
    let normals = facile_core::mesh::vertex_normals(&fine, &template.reference.mesh.triangles);
    let found = contacts(
        template,
        scan,
        (&fine, &normals),
        starts,
        &mut beyond,
        MAX_OFFSET,
    );
    let offsets = spread_offsets(template, &found);
    let positions = fine
        .iter()
        .zip(&normals)
        .zip(&offsets)
        .map(|((p, n), o)| p + n * *o)
        .collect();
    Ok(Settled {
        positions,
        residual: found
            .iter()
            .map(|c| c.as_ref().map(|c| c.offset.abs()))
            .collect(),
    })
}

/// The scan's trusted point for every fine vertex. Vertices that find no surface at all are marked as `beyond` it and
/// asked no more, since the reach only shrinks.
pub(crate) fn contacts(
    template: &Template<'_>,
    scan: &WorkingScan<'_>,
    (fine, normals): (&[Point3], &[Vector3]),
    starts: &mut [u32],
    beyond: &mut [bool],
    reach: f64,
) -> Vec<Option<Contact>> {
    let one = |(v, (start, beyond)): (usize, (&mut u32, &mut bool))| {
        if template.skin[v] <= 0.0 || *beyond {
            return None;
        }
        let hit = scan.nearest_from(*start, &fine[v], &normals[v], reach);
        *beyond = hit.is_none();
        let hit = hit?;
        let same = hit.normal.dot(&normals[v]);
        if same < SAME_SIDE || scan.is_on_border(&hit) {
            return None;
        }
        *start = hit.triangle;
        let to = hit.point - fine[v];
        let offset = normals[v].dot(&to);
        let far = offset.abs() / reach;
        Some(Contact {
            to,
            offset,
            normal: (normals[v] + hit.normal) / (2.0 + 2.0 * same).sqrt(),
            weight: template.skin[v]
                * ((same - SAME_SIDE) / (1.0 - SAME_SIDE)).min(1.0)
                * (1.0 - far * far),
        })
    };
    starts
        .par_iter_mut()
        .zip(beyond)
        .enumerate()
        .map(one)
        .collect()
}

/// Offsets of all fine vertices: trusted ones keep theirs, lightly smoothed; others take their neighbours', fading.
fn spread_offsets(template: &Template<'_>, contacts: &[Option<Contact>]) -> Vec<f64> {
    /// Pull of a trusted vertex to its own offset against each neighbour's.
    const OWN: f64 = 4.0;
    /// Vertices trusted less follow the others.
    const LEAST: f64 = 0.1;
    /// Pull of any vertex to no offset against each neighbour's: fades within about four rings.
    const FADE: f64 = 0.4;
    const SWEEPS: usize = 24;
    let mut offsets: Vec<f64> = contacts
        .iter()
        .map(|c| match c {
            Some(c) if c.weight >= LEAST => c.offset,
            _ => 0.0,
        })
        .collect();
    // All at once from the sweep before: in turns, what comes first on the mesh would lead.
    let mut next = offsets.clone();
    for _ in 0..SWEEPS {
        for (v, next) in next.iter_mut().enumerate() {
            let neighbors = template.adjacency.of(v);
            let sum: f64 = neighbors.iter().map(|u| offsets[*u as usize]).sum();
            let count = neighbors.len() as f64;
            let (own, pull) = match &contacts[v] {
                Some(c) if c.weight >= LEAST => (c.offset, OWN * count * c.weight),
                _ => (0.0, FADE * count),
            };
            if count > 0.0 {
                *next = (sum + pull * own) / (count + pull);
            }
        }
        std::mem::swap(&mut offsets, &mut next);
    }
    offsets
}
