//! Renders a head from several angles: `portrait [--positions FILE.obj|FILE.npy] [--out OUT.png] [--size N]
//! [--yaw -60,-30,0,30,60] [--person SEED,INDEX] [--hair STYLE] [--color R,G,B]`. Positions replace the reference head's fine
//! vertices, mm; a person is drawn from the identity model.

use std::path::PathBuf;

use facile_core::{Plane, Point3, ReferenceHead, Subject, Vector3};
use facile_trace::clothes::ShirtFit;
use facile_trace::hair::{Hair, HairFit, LashFit};
use facile_trace::math::Rgb;
use facile_trace::{Camera, HeadScene, LightSource, RenderSettings, png_file, trace_view};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut positions, mut out, mut size) = (None, PathBuf::from("portrait.png"), 512);
    let (mut hair, mut person): (Option<String>, Option<Vec<u64>>) = (None, None);
    let mut color: Vec<u8> = vec![70, 45, 30];
    let mut yaws: Vec<f64> = vec![-60.0, -30.0, 0.0, 30.0, 60.0];
    let mut arguments = std::env::args().skip(1);
    while let Some(key) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{key} needs a value"));
        match key.as_str() {
            "--positions" => positions = Some(read_positions(&value()?)?),
            "--out" => out = value()?.into(),
            "--size" => size = value()?.parse()?,
            "--hair" => hair = Some(value()?),
            "--person" => person = Some(list(&value()?)?),
            "--color" => color = list(&value()?)?,
            "--yaw" => {
                yaws = list(&value()?)?;
            }
            _ => return Err(format!("unknown argument {key}").into()),
        }
    }
    let reference = ReferenceHead::embedded();
    let mut subject = Subject {
        id: "portrait".into(),
        attributes: facile_core::Attributes::default(),
        positions: positions.unwrap_or_else(|| reference.mesh.positions.clone()),
        expected_error: Vec::new(),
        texture: reference.texture.clone(),
        eyes: reference.eyes,
        eye_color: "brown".into(),
        skull_from_reference: facile_core::Similarity3::identity(),
    };
    if let Some([seed, index]) = person.as_deref() {
        subject = facile_core::IdentityModel::embedded().sample(reference, *seed, *index)?;
    }
    let mut head = HeadScene::new(reference, &subject, Rgb::new(0.13, 0.15, 0.18))?;
    head.add_shirt(
        reference,
        &subject,
        &ShirtFit::new(reference),
        [70, 92, 120],
    )?;
    head.add_lashes(&LashFit::new(reference)?.into(), &subject.positions)?;
    if let (Some(style), &[r, g, b]) = (hair, &color[..]) {
        let fit = HairFit::new(reference, &style)?;
        let color = [r, g, b];
        head.add_hair(reference, &subject, &fit, &Hair { style, color })?;
    }
    let lights: Vec<LightSource> = [
        "kind = 'point'\nposition = [350, 350, 700]\nintensity = 0.75",
        "kind = 'point'\nposition = [-600, 100, 500]\nintensity = 0.25",
        "kind = 'ambient'\nintensity = 0.25",
    ]
    .iter()
    .map(|text| toml::from_str(text))
    .collect::<Result<_, _>>()?;
    let mut sheet = Plane::filled(size * yaws.len(), size, [0; 3]);
    for (k, yaw) in yaws.iter().enumerate() {
        let angle = yaw.to_radians();
        let target = Point3::new(0.0, -25.0, 20.0);
        let eye = target + Vector3::new(angle.sin(), 0.05, angle.cos()) * 900.0;
        let camera = Camera::look_at(size, size, eye, target, Vector3::y(), 0.36)?;
        let view = trace_view(&head.scene, &camera, &RenderSettings::default())?;
        let image = view.shade(&head.scene, &lights)?.to_srgb8();
        for y in 0..size {
            sheet.row_mut(y)[k * size..(k + 1) * size].copy_from_slice(image.row(y));
        }
    }
    png_file::write_rgb8(&out, &sheet)?;
    Ok(())
}

fn list<T: std::str::FromStr>(text: &str) -> Result<Vec<T>, T::Err> {
    text.split(',').map(str::parse).collect()
}

fn read_positions(file: &str) -> Result<Vec<Point3>, Box<dyn std::error::Error>> {
    let path = std::path::Path::new(file);
    if path.extension().is_some_and(|e| e == "npy") {
        let array: ndarray::Array2<f64> = ndarray_npy::read_npy(path)?;
        return Ok(array
            .rows()
            .into_iter()
            .map(|r| Point3::new(r[0], r[1], r[2]))
            .collect());
    }
    Ok(facile_core::io::obj::ObjFile::parse(&std::fs::read(path)?, path)?.positions)
}
