use super::*;

/// A smooth pattern with features everywhere, in all channels.
fn pattern(x: f64, y: f64) -> Channels {
    std::array::from_fn(|k| {
        let (f, g) = (0.09 + 0.02 * k as f64, 0.13 - 0.01 * k as f64);
        (0.3 * libm::sin(f * x + k as f64) * libm::cos(g * y + 0.3 * k as f64)) as f32
    })
}

fn image(nx: usize, ny: usize, warp: impl Fn(f64, f64) -> (f64, f64)) -> CylinderImage {
    CylinderImage {
        values: Plane::from_fn(nx, ny, |x, y| {
            let (u, v) = warp(x as f64, y as f64);
            pattern(u, v)
        }),
        mask: Plane::filled(nx, ny, 1.0),
    }
}

/// Largest and mean distance to the true field over cells away from the border.
fn errors(field: &DisplacementField, truth: impl Fn(f64, f64) -> (f64, f64)) -> (f64, f64) {
    let (nx, ny) = (field.cells.width(), field.cells.height());
    let (mut worst, mut sum, mut count) = (0.0_f64, 0.0, 0.0);
    for y in 12..ny - 12 {
        for x in 12..nx - 12 {
            let (tx, ty) = truth(x as f64, y as f64);
            let [dx, dy] = field.cells[(x, y)].map(f64::from);
            let e = (dx - tx).hypot(dy - ty);
            worst = worst.max(e);
            sum += e;
            count += 1.0;
        }
    }
    (worst, sum / count)
}

#[test]
fn a_translation_is_found_to_a_tenth_of_a_cell() {
    let source = image(120, 100, |x, y| (x, y));
    let target = image(120, 100, |x, y| (x - 5.25, y + 3.5));
    let params = FlowParams {
        smoothness: 0.002,
        ..FlowParams::default()
    };
    let field = displacement_field(&Pyramid::new(source, 4), &Pyramid::new(target, 4), &params);
    let (worst, mean) = errors(&field, |_, _| (5.25, -3.5));
    assert!(mean < 0.03 && worst < 0.1, "mean {mean}, worst {worst}");
}

#[test]
fn a_smooth_warp_is_found_and_the_way_back_agrees() {
    let (a, b) = (4.0, 0.05);
    let field_at = |x: f64, y: f64| (a * libm::sin(b * y), 0.8 * a * libm::cos(b * x));
    // The target shows at x + v(x) what the source shows at x: invert by fixed point.
    let inverse = |x: f64, y: f64| {
        let (mut u, mut v) = (x, y);
        for _ in 0..60 {
            let (du, dv) = field_at(u, v);
            (u, v) = (x - du, y - dv);
        }
        (u, v)
    };
    let source = Pyramid::new(image(140, 120, |x, y| (x, y)), 4);
    let target = Pyramid::new(image(140, 120, inverse), 4);
    let params = FlowParams {
        smoothness: 0.001,
        ..FlowParams::default()
    };
    let forward = displacement_field(&source, &target, &params);
    let (worst, mean) = errors(&forward, field_at);
    assert!(mean < 0.1 && worst < 0.6, "mean {mean}, worst {worst}");
    let backward = displacement_field(&target, &source, &params);
    let distance = forward_backward(&forward, &backward);
    assert!(distance[(70, 60)] < 0.15, "{}", distance[(70, 60)]);
}

#[test]
fn flat_regions_take_what_their_neighbors_found() {
    // Features only in a ring; the middle is featureless in both images.
    let flat = |x: f64, y: f64, cx: f64| (x - cx).hypot(y - 60.0) < 22.0;
    let make = |shift: f64| CylinderImage {
        values: Plane::from_fn(130, 120, |x, y| {
            let (x, y) = (x as f64, y as f64);
            if flat(x, y, 65.0 + shift) {
                [0.0; CHANNELS]
            } else {
                pattern(x - shift, y)
            }
        }),
        mask: Plane::filled(130, 120, 1.0),
    };
    let (source, target) = (Pyramid::new(make(0.0), 4), Pyramid::new(make(3.0), 4));
    let coupled = displacement_field(&source, &target, &FlowParams::default());
    assert!((coupled.cells[(65, 60)][0] - 3.0).abs() < 0.4);
    assert!(coupled.confidence[(65, 60)] < 0.05 && coupled.confidence[(25, 60)] > 0.2);
    let alone = FlowParams {
        smoothness: 0.0,
        levels: 1,
        ..FlowParams::default()
    };
    let single = |image: f64| Pyramid::new(make(image), 1);
    let plain = displacement_field(&single(0.0), &single(3.0), &alone);
    assert!(
        plain.cells[(65, 60)][0].abs() < 1e-6,
        "eq. 3 alone has nothing to solve there"
    );
}

#[test]
fn a_hole_in_the_target_does_not_pull() {
    let source = image(120, 100, |x, y| (x, y));
    let mut target = image(120, 100, |x, y| (x - 2.0, y));
    for y in 40..60 {
        for x in 50..75 {
            target.values[(x, y)] = [5.0; CHANNELS];
            target.mask[(x, y)] = 0.0;
        }
    }
    let params = FlowParams {
        smoothness: 0.005,
        ..FlowParams::default()
    };
    let field = displacement_field(&Pyramid::new(source, 3), &Pyramid::new(target, 3), &params);
    let (worst, mean) = errors(&field, |_, _| (2.0, 0.0));
    assert!(mean < 0.15 && worst < 1.5, "mean {mean}, worst {worst}");
}

#[test]
fn the_window_system_is_solved_exactly_and_refused_when_singular() {
    // J = [[2, 1], [1, 3]], v = (1, -2): b = -J v.
    let found = solve_window(&[2.0, 1.0, 3.0, 0.0, 5.0]).expect("well conditioned");
    assert!((found[0] - 1.0).abs() < 1e-6 && (found[1] + 2.0).abs() < 1e-6);
    assert_eq!(solve_window(&[1.0, 1.0, 1.0, 0.3, 0.3]), None);
}
