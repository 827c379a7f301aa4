//! Environment maps: orientation, densities, and light from them.

use std::sync::Arc;

use glam::{Affine3A, Vec3};

use super::{assert_close, camera, matte, mean, prepare, scene, settings, sphere};
use crate::integrate::environment::{environment_pdf, environment_radiance, sample_environment};
use crate::integrate::sampler::{hash, unit_float};
use crate::pack::PackedScene;
use crate::settings::{Environment, HdrImage, Integrator};

const SIZE: (u32, u32) = (32, 16);

fn packed(texel: impl Fn(u32, u32) -> [f32; 3], rotation_y_rad: f32) -> PackedScene {
    let (width, height) = SIZE;
    let rgb = (0..width * height).map(|i| texel(i % width, i / width)).collect();
    let image = Arc::new(HdrImage { width, height, rgb });
    let mut settings = settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.6), 0.0);
    settings.environment = Environment::Map { image, intensity: 2.0, rotation_y_rad };
    prepare(&scene(vec![(sphere(), matte(1.0, 1.0), Affine3A::IDENTITY)]), &settings)
}

#[test]
fn the_centre_of_the_map_lies_at_minus_z_and_its_right_at_plus_x() {
    // Radiance tells the texel's place.
    let map = |x: u32, y: u32| [x as f32, y as f32, 0.0];
    let look = |p: &PackedScene, d: Vec3| environment_radiance(p, d.normalize()) / 2.0;
    let p = packed(map, 0.0);
    let tilt = 1e-3;
    assert!((look(&p, Vec3::new(tilt, 0.0, -1.0)) - Vec3::new(15.5, 7.5, 0.0)).length() < 0.1);
    assert!((look(&p, Vec3::X) - Vec3::new(23.5, 7.5, 0.0)).length() < 0.1);
    assert!((look(&p, Vec3::NEG_X) - Vec3::new(7.5, 7.5, 0.0)).length() < 0.1);
    assert!(look(&p, Vec3::new(tilt, 1.0, 0.0)).y < 0.1);
    assert!(look(&p, Vec3::new(tilt, -1.0, 0.0)).y > 14.9);
    // A quarter turn about +Y takes what was at -Z to -X.
    let p = packed(map, std::f32::consts::FRAC_PI_2);
    assert!((look(&p, Vec3::new(-1.0, 0.0, tilt)) - Vec3::new(15.5, 7.5, 0.0)).length() < 0.1);
}

#[test]
fn samples_follow_their_density_and_estimate_the_mean() {
    let bright = |x: u32, y: u32| if (20..22).contains(&x) && y == 5 { [100.0; 3] } else { [0.5 + y as f32 * 0.1; 3] };
    for rotation in [0.0, 1.0] {
        let p = packed(bright, rotation);
        let n = 400;
        // Quadrature over the sphere: the density is one in total.
        let (mut total, mut radiance) = (0.0f64, 0.0f64);
        for i in 0..n * n {
            let z = ((i % n) as f32 + 0.5) / n as f32 * 2.0 - 1.0;
            let phi = std::f32::consts::TAU * ((i / n) as f32 + 0.5) / n as f32;
            let r = (1.0 - z * z).sqrt();
            let d = Vec3::new(r * phi.cos(), z, r * phi.sin());
            total += f64::from(environment_pdf(&p, Vec3::Y, d));
            radiance += f64::from(environment_radiance(&p, d).x);
        }
        let cell = 4.0 * std::f64::consts::PI / f64::from(n * n);
        assert_close((total * cell) as f32, 1.0, 0.01);
        let mut estimate = 0.0f64;
        let samples = 100_000;
        for i in 0..samples {
            let d = sample_environment(&p, Vec3::Y, unit_float(hash(2 * i + 1)), unit_float(hash(2 * i + 2)));
            assert_close(d.length(), 1.0, 1e-4);
            estimate += f64::from(environment_radiance(&p, d).x / environment_pdf(&p, Vec3::Y, d));
        }
        assert_close((estimate / f64::from(samples)) as f32, (radiance * cell) as f32, 0.02);
    }
}

#[test]
fn an_even_map_is_a_furnace_and_a_black_one_is_dark() {
    let settings = settings(Integrator::Path { max_bounces: 2 }, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.6), 0.0);
    assert_close(mean(&packed(|_, _| [0.5; 3], 0.3), &settings).x, 1.0, 0.01);
    assert_eq!(mean(&packed(|_, _| [0.0; 3], 0.0), &settings), Vec3::ZERO);
}

#[test]
fn a_bright_spot_lights_like_the_light_that_it_stands_for() {
    // The same map seen by light sampling alone, by BSDF sampling alone and by both.
    let spot = |x: u32, y: u32| if x == 24 && y == 6 { [300.0, 200.0, 100.0] } else { [0.01; 3] };
    let mut settings = settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.6), 0.0);
    settings.spp = 256;
    let mut p = packed(spot, 0.0);
    let both = mean(&p, &settings);
    settings.integrator = Integrator::Whitted { max_bounces: 0 };
    let light_only = mean(&p, &settings);
    settings.integrator = Integrator::Direct;
    p.lights[0].selection = 0.0;
    let bsdf_only = mean(&p, &settings);
    for c in 0..3 {
        assert_close(light_only[c], both[c], 0.01);
        assert_close(bsdf_only[c], both[c], 0.03);
    }
}
