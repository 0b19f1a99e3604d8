//! Scratch.
use facile_core::identity::IdentityModel;
use facile_core::{Point3, ReferenceHead, Vector3};
use facile_trace::math::Rgb;
use facile_trace::occluder::{Drape, DrapeKind, FaceFit, Glasses};
use facile_trace::*;

fn cpu() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ')
        .next()
        .and_then(|v| v.parse::<f64>().ok())
        .unwrap_or(0.0)
        / 1e6
}
fn light(text: &str) -> LightSource {
    toml::from_str(text).expect("valid")
}
fn median(v: &mut Vec<f64>) -> f64 {
    v.iter().sum::<f64>() / v.len() as f64
}
fn main() {
    let args: Vec<String> = std::env::args().collect();
    if args[1] == "file" {
        let report = render_scene_file(
            std::path::Path::new(&args[2]),
            std::path::Path::new(&args[3]),
            None,
        )
        .expect("renders");
        println!(
            "frame min {:.2} primary {:.2} shadow {:.2} shade {:.2} resolve {:.2}",
            report.frame_ms.min,
            report.primary_ms.min,
            report.shadow_ms.min,
            report.shade_ms.min,
            report.resolve_ms.min
        );
        return;
    }
    let n: usize = args[2].parse().expect("n");
    let samples = match args.get(3).map(String::as_str) {
        Some("a") => Samples::ADAPTIVE,
        Some(s) => Samples::Count(s.parse().expect("count")),
        None => Samples::Count(1),
    };
    let size: usize = args.get(4).map_or(256, |s| s.parse().expect("size"));
    let reference = ReferenceHead::embedded();
    let subject = IdentityModel::embedded()
        .sample(reference, 1, 3)
        .expect("subject");
    let mut head = HeadScene::new(reference, &subject, Rgb::repeat(0.2)).expect("head");
    head.show_mouth(true);
    let objects: Vec<Object> = {
        let fit = FaceFit::new(reference, &head).expect("fit");
        match args[1].as_str() {
            "glasses" => Glasses::default().objects(&fit).expect("fits").into(),
            "mask" => vec![
                Drape {
                    kind: DrapeKind::SurgicalMask,
                    color: [90, 130, 200],
                }
                .object(&fit)
                .expect("fits"),
            ],
            _ => Vec::new(),
        }
    };
    for o in objects {
        head.scene.add(o);
    }
    let lights = [
        light("kind = 'point'\nposition = [300, 250, 700]\nintensity = 1.0"),
        light("kind = 'ambient'\nintensity = 0.2"),
    ];
    let (mut t, mut s, mut e) = (vec![], vec![], vec![]);
    let mut hash = 0_u64;
    for i in 0..n {
        let yaw = (-40.0 + 10.0 * (i % 9) as f64).to_radians();
        let eye = Point3::new(900.0 * yaw.sin(), 0.0, 900.0 * yaw.cos());
        let camera = Camera::look_at(
            size,
            size,
            eye,
            Point3::origin(),
            Vector3::y(),
            18.0_f64.to_radians(),
        )
        .expect("cam");
        let truth = Truth {
            depth_z: true,
            segment: true,
            ..Truth::default()
        };
        let settings = RenderSettings {
            samples,
            truth,
            ..RenderSettings::default()
        };
        let a = cpu();
        let view = trace_view(&head.scene, &camera, &settings).expect("view");
        let b = cpu();
        let r = view.shade(&head.scene, &lights).expect("shade");
        let c = cpu();
        let image = r.to_srgb8();
        let d = cpu();
        t.push(b - a);
        s.push(c - b);
        e.push(d - c);
        if i < 9 {
            for p in image.as_slice() {
                for v in p {
                    hash = hash.wrapping_mul(0x100000001b3) ^ u64::from(*v);
                }
            }
        }
        if i == 4 {
            facile_trace::png_file::write_rgb8(std::path::Path::new("/tmp/t5/probe.png"), &image)
                .expect("png");
        }
    }
    let tri: usize = head
        .scene
        .objects()
        .iter()
        .map(|o| o.geometry().triangles().len())
        .sum();
    println!(
        "{} tri {tri} trace {:.2} shade {:.2} srgb {:.2} hash {hash:016x}",
        args[1],
        median(&mut t),
        median(&mut s),
        median(&mut e)
    );
}
