use super::source::WHITE;
use super::*;
use crate::Camera;
use approx::assert_relative_eq;
use facile_core::{Point3, Vector3};

fn camera() -> Camera {
    let eye = Point3::new(500.0, 0.0, 0.0);
    Camera::look_at(8, 8, eye, Point3::origin(), Vector3::y(), 0.5).expect("valid")
}

#[test]
fn intensity_one_at_a_metre_is_one() {
    let light = LightSource::Point {
        position: [0.0, 0.0, 1_000.0],
        intensity: 1.0,
        color: WHITE,
        attach: Attach::Head,
    };
    let light = light.in_world(&camera()).expect("valid");
    let near = light.arrival(Vec3::zeros()).expect("lit");
    assert_relative_eq!(near.power, Rgb::repeat(1.0), epsilon = 1e-6);
    let far = light.arrival(Vec3::new(0.0, 0.0, -1_000.0)).expect("lit");
    assert_relative_eq!(far.power, Rgb::repeat(0.25), epsilon = 1e-6);
    assert_relative_eq!(far.direction, Vec3::z());
}

#[test]
fn camera_lights_move_with_the_camera() {
    let light = LightSource::Point {
        position: [10.0, 20.0, 30.0],
        intensity: 1.0,
        color: WHITE,
        attach: Attach::Camera,
    };
    let light = light.in_world(&camera()).expect("valid");
    // The camera looks along -x: right in the image is -z, towards the viewer is +x
    let position = light.position().expect("a place");
    assert_relative_eq!(position, Vec3::new(530.0, 20.0, -10.0), epsilon = 1e-4);
}

#[test]
fn a_spot_fades_to_nothing_at_its_angle() {
    let spot = LightSource::Spot {
        position: [0.0, 0.0, 1_000.0],
        target: [0.0; 3],
        intensity: 1.0,
        angle_deg: 30.0,
        softness: 0.5,
        color: WHITE,
        attach: Attach::Head,
    };
    let light = spot.in_world(&camera()).expect("valid");
    let at = |degrees: f32| {
        let x = 1_000.0 * degrees.to_radians().tan();
        light
            .arrival(Vec3::new(x, 0.0, 0.0))
            .map_or(0.0, |a| a.power.x)
    };
    assert_relative_eq!(at(0.0), 1.0, epsilon = 1e-5);
    assert!(at(14.0) > 0.9 && at(22.0) > 0.1 && at(22.0) < at(16.0));
    assert!(at(31.0) == 0.0);
}

#[test]
fn an_area_light_is_a_point_from_afar_and_dark_behind() {
    let text = "kind = 'area'\nposition = [0, 0, 1000]\ntarget = [0, 0, 0]\nsize = [20, 10]\nintensity = 1";
    let source: LightSource = toml::from_str(text).expect("valid");
    let mut patches = Vec::new();
    source.add_to(&mut patches, &camera()).expect("valid");
    assert_eq!(patches.len(), 16);
    let sum = |point: Vec3| {
        let arrivals = patches.iter().filter_map(|p| p.arrival(point));
        arrivals.fold(0.0, |sum, a| sum + a.power.x)
    };
    assert_relative_eq!(sum(Vec3::zeros()), 1.0, epsilon = 1e-3);
    assert_relative_eq!(sum(Vec3::new(0.0, 0.0, 2_000.0)), 0.0);
    // At 45 degrees: twice the squared distance, and the cosine at the light
    let oblique = sum(Vec3::new(1_000.0, 0.0, 0.0));
    assert_relative_eq!(oblique, 0.5 * 0.5_f32.sqrt(), epsilon = 1e-3);
    let places: Vec<Vec3> = patches.iter().filter_map(Light::position).collect();
    let mean = places.iter().sum::<Vec3>() / 16.0;
    assert_relative_eq!(mean, Vec3::new(0.0, 0.0, 1_000.0), epsilon = 1e-3);
    assert!(places.iter().all(|p| p.x.abs() < 10.0 && p.y.abs() < 5.0));
}

#[test]
fn a_hemisphere_runs_from_sky_to_ground() {
    let text = "kind = 'hemisphere'\nintensity = 0.5\ncolor = [1, 1, 1]\nground = [0.2, 0.1, 0]";
    let source: LightSource = toml::from_str(text).expect("valid");
    let mut lights = Vec::new();
    source.add_to(&mut lights, &camera()).expect("valid");
    let sum = AmbientSum::of(&lights);
    assert_relative_eq!(sum.on(Vec3::y()), Rgb::repeat(0.5), epsilon = 1e-6);
    assert_relative_eq!(sum.on(-Vec3::y()), Rgb::new(0.1, 0.05, 0.0), epsilon = 1e-6);
    assert_relative_eq!(
        sum.on(Vec3::z()),
        Rgb::new(0.3, 0.275, 0.25),
        epsilon = 1e-6
    );
}

#[test]
fn bad_numbers_are_refused() {
    let directional = |direction, intensity| LightSource::Directional {
        direction,
        intensity,
        color: WHITE,
        attach: Attach::Head,
    };
    assert!(directional([0.0; 3], 1.0).in_world(&camera()).is_err());
    assert!(directional([f32::NAN; 3], 1.0).in_world(&camera()).is_err());
    assert!(directional([1.0; 3], -1.0).in_world(&camera()).is_err());
    assert!(directional([1.0; 3], 1.0).in_world(&camera()).is_ok());
}

#[test]
fn unknown_keys_are_refused() {
    let parse = |text: &str| toml::from_str::<LightSource>(text);
    assert!(parse("kind = 'ambient'\nintensity = 0.2").is_ok());
    assert!(parse("kind = 'ambient'\nintensity = 0.2\npower = 3").is_err());
    assert!(parse("kind = 'lamp'\nintensity = 0.2").is_err());
    let attached = "kind = 'point'\nposition = [1, 2, 3]\nintensity = 1\nattach = 'camera'";
    assert!(parse(attached).is_ok());
}
