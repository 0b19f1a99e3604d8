//! Rounds of flow and fit: the reference is drawn towards the scan, and the flow explains what is left.
//!
//! Each round shows reference and scan on the cylinder, computes the flow both ways, and fits a smooth deformation of
//! the cage to where the flow leads the visible vertices, the smoothing length shrinking from round to round. As the
//! shapes come closer the flow has less to explain and the channels mean the same on both sides: plain flow between
//! two different heads does not have that. Source: [BPV06], bootstrapping.

use facile_core::math::fit_similarity;
use facile_core::mesh::vertex_normals;
use facile_core::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use crate::cage::Target;
use crate::flow::{DisplacementField, displacement_field, forward_backward};
use crate::identity_fit::FineModes;
use crate::pyramid::Pyramid;
use crate::radial_map::CylinderGrid;
use crate::scan::{ScanView, WorkingScan};
use crate::template::{Template, TemplateView};
use crate::{FlowError, RegistrationParams};

/// Widest angle of the radial maps, rad: up to behind the ears.
const PHI_MAX: f64 = 2.0;
/// Height range of the radial maps, mm: collar to forehead.
const HEIGHTS: (f64, f64) = (-130.0, 100.0);
/// Radius at which cells are squares, mm.
const NOMINAL_RADIUS: f64 = 80.0;

/// The reference's shape on a scan.
pub(crate) struct Shape {
    /// Cage positions, mm, head frame of the scan.
    pub(crate) cage: Vec<Vector3>,
    /// Size of the head against the reference's.
    pub(crate) size: f64,
    /// Distance between forward and backward flow at each fine vertex, mm; infinite where the flow says nothing.
    pub(crate) forward_backward: Vec<f64>,
    /// Share of its displacement that the flow determined at each fine vertex, `[0, 1]`.
    pub(crate) confidence: Vec<f64>,
}

/// A grid that covers the face.
pub(crate) fn face_grid(cell_mm: f64) -> CylinderGrid {
    CylinderGrid::new(PHI_MAX, HEIGHTS.0, HEIGHTS.1, cell_mm, NOMINAL_RADIUS)
}

/// Fits the template to `scan`, which is moved so that the head frame fits the deformed template.
pub(crate) fn fit_shape(
    template: &Template<'_>,
    modes: &FineModes,
    scan: &mut WorkingScan<'_>,
    size: f64,
    params: &RegistrationParams,
) -> Result<Shape, FlowError> {
    let grid = face_grid(params.cell_mm);
    let n = template.reference.mesh.positions.len();
    let rest = &template.reference.cage.positions;
    let mut shape = Shape {
        cage: modes.cage(rest, &[], size),
        size,
        forward_backward: vec![f64::INFINITY; n],
        confidence: vec![0.0; n],
    };
    for k in 0..params.nearest_rounds {
        let share = k as f64 / params.nearest_rounds as f64;
        let fine = template.fine(&shape.cage);
        let mut goals = nearest_goals(template, scan, &fine, 18.0 - 10.0 * share);
        shape.cage = fit_identity(template, modes, scan, &mut shape, &mut goals);
    }
    let with_color = scan.has_color();
    for &length in &params.smoothing_mm {
        let fine = template.fine(&shape.cage);
        let view = template.view(
            fine,
            grid,
            &params.weights,
            params.curvature_sigma_mm,
            with_color,
        );
        let seen = scan.view(grid, &params.weights);
        let mut goals = follow_flow(template, &view, &seen, scan, &mut shape, params);
        let base = fit_identity(template, modes, scan, &mut shape, &mut goals);
        let displacement = deform(template, &base, &goals, length)?;
        shape.cage = base.iter().zip(displacement).map(|(b, d)| b + d).collect();
    }
    Ok(shape)
}

/// Where a fine vertex should be.
pub(crate) struct Goal {
    pub(crate) vertex: u32,
    /// Head frame, mm.
    pub(crate) at: Point3,
    /// `[0, 1]`, without the vertex's area.
    pub(crate) weight: f64,
    /// `[0, 1]`: how far the place along the surface is known, against the distance to it.
    pub(crate) slide: f64,
}

/// Nearest points of the scan: they tell how far the surface is, and little about where on it.
fn nearest_goals(
    template: &Template<'_>,
    scan: &WorkingScan<'_>,
    fine: &[Point3],
    reach: f64,
) -> Vec<Goal> {
    let normals = vertex_normals(fine, &template.reference.mesh.triangles);
    let goal = |v: usize| {
        if template.skin[v] <= 0.0 {
            return None;
        }
        let hit = scan.nearest(&fine[v], reach)?;
        if hit.normal.dot(&normals[v]) < 0.6 || scan.is_on_border(&hit) {
            return None;
        }
        let far = (hit.point - fine[v]).norm() / reach;
        Some(Goal {
            vertex: v as u32,
            at: hit.point,
            weight: template.skin[v] * (1.0 - far * far).powi(2),
            slide: 0.1,
        })
    };
    // Every third vertex is plenty for a few dozen unknowns.
    (0..fine.len())
        .into_par_iter()
        .step_by(3)
        .filter_map(goal)
        .collect()
}

/// Alternates pose, size and modes; moves the scan (and the goals) into the head frame. Returns the fitted cage.
fn fit_identity(
    template: &Template<'_>,
    modes: &FineModes,
    scan: &mut WorkingScan<'_>,
    shape: &mut Shape,
    goals: &mut [Goal],
) -> Vec<Vector3> {
    let rest = &template.reference.cage.positions;
    let mean = &template.reference.mesh.positions;
    let normals = vertex_normals(
        &template.fine(&shape.cage),
        &template.reference.mesh.triangles,
    );
    let mut coefficients: Vec<f64> = Vec::new();
    for _ in 0..3 {
        let unit = modes.cage(rest, &coefficients, 1.0);
        align(template, &unit, scan, shape, goals);
        coefficients = modes.fit(template, mean, &normals, goals, shape.size);
    }
    modes.cage(rest, &coefficients, shape.size)
}

/// Computes the flow both ways and reads where it leads the visible vertices.
fn follow_flow(
    template: &Template<'_>,
    view: &TemplateView,
    seen: &ScanView,
    scan: &WorkingScan<'_>,
    shape: &mut Shape,
    params: &RegistrationParams,
) -> Vec<Goal> {
    let source = Pyramid::new(view.image.clone(), params.flow.levels);
    let target = Pyramid::new(seen.image.clone(), params.flow.levels);
    let (forward, backward) = rayon::join(
        || displacement_field(&source, &target, &params.flow),
        || displacement_field(&target, &source, &params.flow),
    );
    let distance = forward_backward(&forward, &backward);
    let cell = seen.map.grid.h_step;
    let mut goals = Vec::new();
    for (v, p) in view.mesh.positions.iter().enumerate() {
        shape.forward_backward[v] = f64::INFINITY;
        shape.confidence[v] = 0.0;
        if !view.visible[v] || template.skin[v] <= 0.0 {
            continue;
        }
        let at = seen.map.grid.cell_from_point(p);
        let Some((to, confidence, round_trip)) = read_field(&forward, &distance, at) else {
            continue;
        };
        let Some(goal) = seen.point(to) else { continue };
        let round_trip = round_trip * cell;
        // The scan must look the same way, else it is another surface: hair, collar, the side of a hole.
        let agreement = scan_normal(seen, scan, to).map_or(0.0, |n| n.dot(&view.normals[v]));
        if agreement < 0.3 {
            continue;
        }
        let far = (goal - p).norm();
        let weight = template.skin[v] * (0.3 + 0.7 * confidence)
            / (1.0 + (round_trip / 2.0).powi(2))
            / (1.0 + (far / 12.0).powi(4));
        shape.forward_backward[v] = round_trip;
        shape.confidence[v] = confidence;
        goals.push(Goal {
            vertex: v as u32,
            at: goal,
            weight,
            slide: confidence,
        });
    }
    goals
}

/// Field, confidence and round trip (cells) at a continuous cell position. `None` outside the grid.
fn read_field(
    field: &DisplacementField,
    distance: &facile_core::Plane<f32>,
    [x, y]: [f64; 2],
) -> Option<([f64; 2], f64, f64)> {
    let (nx, ny) = (field.cells.width(), field.cells.height());
    if !(x >= 0.0 && y >= 0.0 && x < (nx - 1) as f64 && y < (ny - 1) as f64) {
        return None;
    }
    let v = crate::channels::bilinear(&field.cells, x as f32, y as f32);
    let cell = (x.round() as usize, y.round() as usize);
    Some((
        [x + f64::from(v[0]), y + f64::from(v[1])],
        f64::from(field.confidence[cell]),
        f64::from(distance[cell]),
    ))
}

fn scan_normal(seen: &ScanView, scan: &WorkingScan<'_>, [x, y]: [f64; 2]) -> Option<Vector3> {
    let normal = seen.map.interpolate(
        &scan.mesh.triangles,
        &scan.normals,
        x.round() as usize,
        y.round() as usize,
    )?;
    normal.try_normalize(1e-12)
}

/// Moves the scan (and the goals with it) so that `rest` in the head frame fits the goals best, and updates the size.
fn align(
    template: &Template<'_>,
    rest: &[Vector3],
    scan: &mut WorkingScan<'_>,
    shape: &mut Shape,
    goals: &mut [Goal],
) {
    let fine = template.fine(rest);
    let (mut from, mut to, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    for goal in goals.iter() {
        let v = goal.vertex as usize;
        from.push(fine[v]);
        to.push(goal.at);
        weights.push(goal.weight * template.areas[v]);
    }
    let Some(fit) = fit_similarity(&from, &to, &weights) else {
        return;
    };
    shape.size = fit.scaling();
    let motion: Isometry3 = fit.isometry.inverse();
    scan.transform(&motion);
    for goal in goals {
        goal.at = motion * goal.at;
    }
}

/// Displacements of the cage that bring the fine vertices to their goals.
fn deform(
    template: &Template<'_>,
    base: &[Vector3],
    goals: &[Goal],
    length: f64,
) -> Result<Vec<Vector3>, FlowError> {
    let fine = template.fine(base);
    let targets: Vec<Target> = goals
        .iter()
        .map(|g| {
            let v = g.vertex as usize;
            Target {
                vertex: g.vertex,
                displacement: g.at - fine[v],
                weight: g.weight * template.areas[v],
            }
        })
        .collect();
    template
        .cage_fit
        .solve(template.reference, &targets, length)
}
