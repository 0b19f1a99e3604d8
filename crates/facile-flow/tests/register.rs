//! Registration of scans made from the reference head itself, where the truth is known.

use facile_core::io::Scan;
use facile_core::{Mesh, Point3, ReferenceHead, Segment, Similarity3, Vector3};
use facile_flow::{FlowError, Registrar, Registration, RegistrationParams};

fn params() -> RegistrationParams {
    RegistrationParams {
        texture_size: 64,
        ..RegistrationParams::default()
    }
}

fn scan(mesh: Mesh) -> Scan {
    Scan {
        name: "scan".to_owned(),
        path: "scan.obj".into(),
        mesh,
        texture: None,
        groups: Vec::new(),
        triangle_groups: Vec::new(),
        notices: Vec::new(),
    }
}

/// The reference's outer skin as a scan would show it, without ears and back, with its own vertices.
fn face(reference: &ReferenceHead, place: impl Fn(Point3) -> Point3) -> Mesh {
    let mut mesh = Mesh {
        positions: reference.mesh.positions.iter().map(|p| place(*p)).collect(),
        ..Mesh::default()
    };
    for (t, s) in reference
        .mesh
        .triangles
        .iter()
        .zip(&reference.mesh.segments)
    {
        let seen = !matches!(s, Segment::InnerMouth | Segment::EyeSocket);
        let frontal = t
            .iter()
            .all(|&v| reference.mesh.positions[v as usize].z > 5.0);
        if seen && frontal {
            mesh.triangles.push(*t);
        }
    }
    mesh
}

/// A person: the reference with a longer face, a wider jaw and a bigger nose.
fn person(p: Point3) -> Point3 {
    let longer = 1.0 + 0.05 * libm::tanh(-p.y / 60.0);
    let wider = 1.0 + 0.06 * libm::exp(-((p.y + 80.0) / 40.0).powi(2));
    let nose = libm::exp(-((p.x / 16.0).powi(2) + ((p.y + 35.0) / 20.0).powi(2)));
    Point3::new(p.x * wider, p.y * longer, p.z + 4.0 * nose)
}

fn face_vertices(reference: &ReferenceHead) -> Vec<usize> {
    let mut used = vec![false; reference.mesh.positions.len()];
    for (t, s) in reference
        .mesh
        .triangles
        .iter()
        .zip(&reference.mesh.segments)
    {
        let skin = !matches!(
            s,
            Segment::InnerMouth
                | Segment::EyeSocket
                | Segment::Neck
                | Segment::Scalp
                | Segment::LeftEar
                | Segment::RightEar
        );
        for &v in t {
            used[v as usize] |= skin && reference.mesh.positions[v as usize].z > 30.0;
        }
    }
    (0..used.len()).filter(|&v| used[v]).collect()
}

/// Mean and largest distance over the face between the registered head and where its vertices really are.
fn errors(
    reference: &ReferenceHead,
    found: &Registration,
    truth_in_scan: impl Fn(Point3) -> Point3,
) -> (f64, f64) {
    let (mut sum, mut worst, mut count) = (0.0, 0.0_f64, 0.0);
    for v in face_vertices(reference) {
        let truth = found.head_from_scan * truth_in_scan(reference.mesh.positions[v]);
        let error = (found.subject.positions[v] - truth).norm();
        sum += error;
        worst = worst.max(error);
        count += 1.0;
    }
    (sum / count, worst)
}

#[test]
fn the_reference_registers_to_itself() {
    let reference = ReferenceHead::embedded();
    let registrar = Registrar::new(reference, params()).expect("registrar");
    let found = registrar
        .register(&scan(face(reference, |p| p)))
        .expect("a face");
    let (mean, worst) = errors(reference, &found, |p| p);
    assert!(mean < 0.05 && worst < 1.0, "mean {mean}, worst {worst}");
    let size = found.report.size;
    assert!((size - 1.0).abs() < 0.002, "size {size}");
    assert!(found.report.unit_is_known);
    assert_eq!(found.report.folded_triangles, 0);
}

#[test]
fn a_known_deformation_is_recovered_in_any_pose_and_unit() {
    let reference = ReferenceHead::embedded();
    let registrar = Registrar::new(reference, params()).expect("registrar");
    let cases = [
        (Vector3::new(0.0, 0.0, 0.0), 1.0),
        (Vector3::new(0.3, -0.45, 0.2), 0.1),
        (Vector3::new(-0.3, 0.4, -0.35), 0.001),
    ];
    for (turn, scale) in cases {
        let place = Similarity3::new(Vector3::new(3.0, -40.0, 7.0) * scale, turn, scale);
        let truth = |p: Point3| place * person(p);
        let found = registrar
            .register(&scan(face(reference, truth)))
            .expect("a face");
        assert!((found.report.unit_mm * scale - 1.0).abs() < 1e-9);
        let (mean, worst) = errors(reference, &found, truth);
        assert!(mean < 0.8, "{turn}: mean {mean}, worst {worst}");
    }
}

#[test]
fn what_is_no_face_is_refused_with_the_measure_that_failed() {
    let reference = ReferenceHead::embedded();
    let registrar = Registrar::new(reference, params()).expect("registrar");
    let ball = |stretch: f64| {
        let (n, m) = (60_u32, 40_u32);
        let mut mesh = Mesh::default();
        for j in 0..=m {
            for i in 0..n {
                let (a, b) = (
                    f64::from(i) / f64::from(n) * std::f64::consts::TAU,
                    f64::from(j) / f64::from(m) * std::f64::consts::PI,
                );
                mesh.positions.push(Point3::new(
                    80.0 * libm::sin(b) * libm::sin(a),
                    -110.0 * stretch * libm::cos(b),
                    90.0 * libm::sin(b) * libm::cos(a),
                ));
            }
        }
        for j in 0..m {
            for i in 0..n {
                let (v, w) = (j * n + i, j * n + (i + 1) % n);
                mesh.triangles.push([v, w, v + n]);
                mesh.triangles.push([w, w + n, v + n]);
            }
        }
        mesh
    };
    for stretch in [0.8, 1.0] {
        match registrar.register(&scan(ball(stretch))) {
            Err(FlowError::NoFace { .. }) => {}
            other => panic!("a ball is no face: {:?}", other.map(|r| r.report)),
        }
    }
}

#[test]
fn equal_scans_give_equal_bits_for_any_number_of_threads() {
    let reference = ReferenceHead::embedded();
    let mesh = scan(face(reference, person));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| {
            let registrar = Registrar::new(reference, params()).expect("registrar");
            registrar.register(&mesh).expect("a face")
        })
    };
    let (one, many) = (run(1), run(4));
    assert_eq!(one.subject, many.subject);
    assert_eq!(one.report, many.report);
}

#[test]
fn light_baked_into_the_scan_is_evened_out_on_request() {
    use facile_flow::synthetic::{Scanner, scan_of};
    let reference = ReferenceHead::embedded();
    let mut subject = facile_core::IdentityModel::embedded()
        .sample(reference, 5, 1)
        .expect("a person");
    subject.texture = reference.texture.clone();
    let scanner = Scanner {
        cell_mm: 2.2,
        ..Scanner::default()
    };
    let mut known = scan_of(reference, &subject, &scanner);
    let mesh = &mut known.scan.mesh;
    let normals = mesh.vertex_normals();
    for (color, n) in mesh.colors.iter_mut().zip(&normals) {
        let shade = (0.5 + 0.5 * n.x) as f32;
        *color = color.map(|c| c * shade);
    }
    // Brightness of the left cheek against the right one.
    let imbalance = |delight: bool| {
        let params = RegistrationParams {
            texture_size: 256,
            delight,
            ..RegistrationParams::default()
        };
        let registrar = Registrar::new(reference, params).expect("registrar");
        let texture = registrar
            .register(&known.scan)
            .expect("a face")
            .subject
            .texture;
        let mut sides = [0.0_f64; 2];
        for (t, uv) in reference
            .mesh
            .triangles
            .iter()
            .zip(&reference.mesh.texcoord_triangles)
        {
            let p = reference.mesh.positions[t[0] as usize];
            if (35.0..50.0).contains(&p.x.abs()) && (-60.0..-25.0).contains(&p.y) && p.z > 30.0 {
                let [r, g, b] = texture.sample(reference.mesh.texcoords[uv[0] as usize]);
                sides[usize::from(p.x > 0.0)] += f64::from(r + g + b);
            }
        }
        libm::fabs(libm::log(sides[1] / sides[0]))
    };
    let (as_scanned, evened) = (imbalance(false), imbalance(true));
    assert!(as_scanned > 0.6, "{as_scanned}");
    assert!(evened < 0.25 * as_scanned, "{evened} against {as_scanned}");
}

#[test]
fn the_colour_of_the_eyes_is_seen_on_the_scan() {
    let registrar = Registrar::new(ReferenceHead::embedded(), params()).expect("valid");
    for name in ["bjorn", "ivy", "jomo"] {
        let (scan, attributes) = facile_core::builtin::load(name).expect("ships");
        let found = registrar.register(&scan).expect("a face").subject;
        assert_eq!(Some(found.eye_color), attributes.eye_color, "{name}");
    }
}
