//! Furnaces: where light comes equally from everywhere, a white object is invisible, for every integrator.

use glam::{Affine3A, Quat, Vec3};

use super::{assert_close, camera, glow, matte, prepare, render, scene, settings, sphere, square};
use crate::integrate::bsdf::{ggx_albedo, ggx_average_albedo};
use crate::scene::{Material, Mesh, Sphere};
use crate::settings::Integrator;

const INTEGRATORS: [Integrator; 3] =
    [Integrator::Direct, Integrator::Path { max_bounces: 4 }, Integrator::Whitted { max_bounces: 4 }];

#[test]
fn a_white_sphere_vanishes() {
    for integrator in INTEGRATORS {
        for roughness in [0.0, 0.3, 0.6, 1.0] {
            for metallic in [0.0, 1.0] {
                let material = Material { metallic, ..matte(1.0, roughness) };
                let scene = scene(vec![(sphere(), material, Affine3A::IDENTITY)]);
                let settings = settings(integrator, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.6), 1.0);
                let got = render(&scene, &settings);
                // A mirror by Schlick's term alone, beside diffuse weighted by the lobe's albedo, is a little off.
                let is_mirror = matches!(integrator, Integrator::Whitted { .. }) && roughness < 0.25;
                let tolerance = if is_mirror { 0.02 } else { 0.01 };
                assert!(
                    (got - Vec3::ONE).abs().max_element() < tolerance,
                    "{integrator:?}, roughness {roughness}, metallic {metallic}: {got}"
                );
            }
        }
    }
}

#[test]
fn ambient_occlusion_is_open_on_a_convex_body_and_closed_inside() {
    let scene = scene(vec![(sphere(), matte(0.5, 1.0), Affine3A::IDENTITY)]);
    let ao = Integrator::Ao { samples: 4, distance: 10.0 };
    assert_eq!(render(&scene, &settings(ao, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.6), 0.0)), Vec3::ONE);
    assert_eq!(render(&scene, &settings(ao, camera(Vec3::ZERO, Vec3::Z, 0.0, 0.6), 0.0)), Vec3::ZERO);
}

#[test]
fn ambient_occlusion_beside_a_wall_is_a_half() {
    // A floor and a tall wall: at the foot of the wall half of the directions are open.
    let wide = Affine3A::from_scale(Vec3::splat(1000.0));
    let floor = Affine3A::from_quat(Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2)) * wide;
    let scene = scene(vec![(square(), matte(0.5, 1.0), floor), (square(), matte(0.5, 1.0), wide)]);
    let view = camera(Vec3::new(0.0, 0.0, 0.01), Vec3::Y, 5.0, 0.001);
    let far = Integrator::Ao { samples: 16, distance: f32::INFINITY };
    assert_close(render(&scene, &settings(far, view.clone(), 0.0)).x, 0.5, 0.01);
    // Within a reach that ends before the wall everything is open.
    let near = Integrator::Ao { samples: 16, distance: 0.005 };
    assert_eq!(render(&scene, &settings(near, view, 0.0)).x, 1.0);
}

#[test]
fn half_the_albedo_leaves_half_of_what_enters() {
    let scene = scene(vec![(sphere(), matte(0.5, 0.7), Affine3A::IDENTITY)]);
    for integrator in INTEGRATORS {
        let settings = settings(integrator, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.6), 2.0);
        let packed = prepare(&scene, &settings);
        let table = &packed.ggx_albedo;
        // Specular albedo at each pixel, the rest halved.
        let (a_mean, b_mean) = ggx_average_albedo(table, 0.7);
        let average = a_mean + b_mean;
        let f0 = Material::DIELECTRIC_F0;
        let fresnel = f0 + (1.0 - f0) / 21.0;
        let multiple = fresnel * fresnel * average / (1.0 - fresnel * (1.0 - average));
        let mut expected = 0.0;
        for i in 0..1024 {
            let offset = |k: i32| (k as f32 + 0.5) / 32.0 * 1.2 - 0.6;
            let (x, y) = (offset(i % 32), offset(i / 32));
            let (a, b) = ggx_albedo(table, 0.7, (1.0 - x * x - y * y).sqrt());
            let specular = f0 * a + b + multiple * (1.0 - a - b);
            expected += 2.0 * (specular + 0.5 * (1.0 - specular)) / 1024.0;
        }
        assert_close(super::mean(&packed, &settings).y, expected, 0.005);
    }
}

#[test]
fn a_closed_glowing_room_adds_one_for_each_bounce() {
    // Inside a sphere that emits 1 and reflects all: the eye sees 1, and every vertex up to the last one adds 1.
    let material = Material { emissive: Vec3::ONE, ..matte(1.0, 1.0) };
    let scene = scene(vec![(sphere(), material, Affine3A::IDENTITY)]);
    for max_bounces in [0, 1, 4, 6] {
        let mut settings = settings(Integrator::Path { max_bounces }, camera(Vec3::ZERO, Vec3::Z, 0.0, 0.5), 0.0);
        settings.spp = 128;
        assert_close(render(&scene, &settings).x, max_bounces as f32 + 2.0, 0.01);
    }
}

#[test]
fn furnaces_hold_far_from_the_origin_and_at_any_scale() {
    for (center, radius) in [(1e5, 1.0), (3e4, 1e3), (0.0, 1e-4), (-2e3, 1e-1)] {
        let center = Vec3::new(center, 0.5 * center, -center);
        let transform = Affine3A::from_scale_rotation_translation(
            Vec3::splat(radius),
            Quat::from_rotation_y(1.0) * Quat::from_rotation_x(0.4),
            center,
        );
        // A ball, and a closed box of six squares to look at from inside.
        let ball = scene(vec![(sphere(), matte(1.0, 0.8), transform)]);
        let view = camera(center, Vec3::Z, 3.0 * radius, 0.6 * radius);
        let got = render(&ball, &settings(Integrator::Direct, view, 1.0));
        assert!((got - Vec3::ONE).abs().max_element() < 0.02, "ball of {radius} at {center}: {got}");

        let lit = Material { emissive: Vec3::ONE, ..matte(1.0, 1.0) };
        let room = scene(vec![(cube(), lit, transform)]);
        let view = camera(center, Vec3::Z, 0.0, 0.3 * radius);
        let got = render(&room, &settings(Integrator::Path { max_bounces: 2 }, view, 0.0));
        assert!((got - Vec3::splat(4.0)).abs().max_element() < 0.08, "room of {radius} at {center}: {got}");
    }
}

/// The cube of side 2 around the origin.
fn cube() -> Mesh {
    let mut cube = Mesh::of_shapes("", vec![], vec![], vec![]);
    for face in 0..6 {
        let turn = match face {
            0..=3 => Quat::from_rotation_y(face as f32 * std::f32::consts::FRAC_PI_2),
            4 => Quat::from_rotation_x(std::f32::consts::FRAC_PI_2),
            _ => Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2),
        };
        let base = cube.positions.len() as u32;
        cube.positions.extend(square().positions.iter().map(|p| (turn * (*p + Vec3::Z)).round()));
        cube.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        cube.triangle_slots.extend([0, 0]);
    }
    cube.bounds = cube.shape_bounds();
    cube
}

#[test]
fn mirrored_instances_are_lit_from_the_outside() {
    let mirrored = Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let lamp = Mesh::of_shapes(
        "",
        Vec::new(),
        Vec::new(),
        vec![Sphere { center: Vec3::new(3.0, 0.0, 3.0), radius: 1.0, slot: 0 }],
    );
    let build = |body: Affine3A| {
        scene(vec![(cube(), matte(0.8, 0.9), body), (lamp.clone(), glow(Vec3::splat(5.0)), Affine3A::IDENTITY)])
    };
    let settings = settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::Z, 5.0, 0.9), 0.0);
    let (plain, mirrored) = (render(&build(Affine3A::IDENTITY), &settings), render(&build(mirrored), &settings));
    assert!(plain.x > 0.05);
    assert_close(mirrored.x, plain.x, 1e-3);
}
