//! Punctual and area lights against quadrature, and the techniques against each other.

use glam::{Affine3A, Quat, Vec3};

use super::{assert_close, camera, glow, matte, mean, prepare, render, scene, settings, sphere, square};
use crate::integrate::bsdf::{eval_bsdf, make_bsdf};
use crate::pack::{NONE, PackedScene};
use crate::scene::{Material, PunctualKind, PunctualLight};
use crate::settings::{Integrator, RenderSettings};

/// A tiny view of the origin of the XY plane, from above at an angle.
fn view() -> crate::scene::Camera {
    camera(Vec3::ZERO, Vec3::new(0.0, -0.6, 0.8), 5.0, 1e-3)
}

fn light(kind: PunctualKind, intensity: f32) -> PunctualLight {
    PunctualLight {
        name: String::new(),
        position: Vec3::new(0.0, 0.0, 2.0),
        direction: Vec3::NEG_Z,
        intensity: Vec3::splat(intensity),
        range: f32::INFINITY,
        kind,
    }
}

/// Radiance towards the camera of [`view`] from unit irradiance perpendicular to `wi`, as the integrators' BSDF has it.
fn response(packed: &PackedScene, settings: &RenderSettings, material: &Material, wi: Vec3) -> f32 {
    // The plane's local frame is the world's up to a rotation about Z, to which the BSDF is indifferent.
    let wo = -settings.camera.forward;
    let [r, g, b, _] = material.base_color;
    let (color, table) = (Vec3::new(r, g, b), &packed.ggx_albedo);
    let bsdf = make_bsdf(table, color, material.metallic, material.roughness, material.dielectric_f0, wo);
    eval_bsdf(table, &bsdf, wi).x
}

fn lit_plane(
    material: Material,
    lights: Vec<PunctualLight>,
    integrator: Integrator,
) -> (f32, PackedScene, RenderSettings) {
    let scene = scene(vec![(square(), material, Affine3A::IDENTITY)]);
    let mut settings = settings(integrator, view(), 0.0);
    settings.extra_lights = lights;
    settings.spp = 4;
    let packed = prepare(&scene, &settings);
    (mean(&packed, &settings).x, packed, settings)
}

#[test]
fn punctual_lights_have_photometric_units() {
    let material = matte(0.5, 0.8);
    for integrator in [Integrator::Direct, Integrator::Whitted { max_bounces: 1 }, Integrator::Path { max_bounces: 2 }]
    {
        let spot = PunctualKind::Spot { inner_cone_rad: 0.2, outer_cone_rad: 0.5 };
        for (light, expected) in [
            (light(PunctualKind::Point, 20.0), 20.0 / 4.0),
            (light(PunctualKind::Directional, 3.0), 3.0),
            (light(spot, 8.0), 8.0 / 4.0),
            // KHR_lights_punctual's window: (1 - (d / range)^4) / d^2.
            (PunctualLight { range: 4.0, ..light(PunctualKind::Point, 20.0) }, 5.0 * (1.0 - 1.0 / 16.0)),
            (PunctualLight { range: 1.9, ..light(PunctualKind::Point, 20.0) }, 0.0),
        ] {
            let (got, packed, settings) = lit_plane(material.clone(), vec![light.clone()], integrator);
            let expected = expected * response(&packed, &settings, &material, Vec3::Z);
            assert!((got - expected).abs() <= 1e-4 * expected + 1e-7, "{light:?}: {got}, expected {expected}");
        }
    }
}

#[test]
fn spots_fade_between_their_cones_as_the_extension_says() {
    let material = matte(0.5, 1.0);
    for angle in [0.1f32, 0.3, 0.45, 0.6] {
        let (inner, outer) = (0.2f32, 0.5f32);
        let mut spot = light(PunctualKind::Spot { inner_cone_rad: inner, outer_cone_rad: outer }, 4.0);
        spot.direction = Vec3::new(angle.sin(), 0.0, -angle.cos());
        let (got, packed, settings) = lit_plane(material.clone(), vec![spot], Integrator::Direct);
        let linear = ((angle.cos() - outer.cos()) / (inner.cos() - outer.cos())).clamp(0.0, 1.0);
        let expected = linear * linear * response(&packed, &settings, &material, Vec3::Z);
        assert!((got - expected).abs() <= 1e-3 * expected + 1e-7, "{angle}: {got}, expected {expected}");
    }
}

#[test]
fn many_lights_add_up() {
    let material = matte(0.5, 1.0);
    let lights = vec![light(PunctualKind::Point, 20.0), light(PunctualKind::Directional, 3.0)];
    let scene = scene(vec![(square(), material.clone(), Affine3A::IDENTITY)]);
    let mut settings = settings(Integrator::Direct, view(), 0.0);
    settings.extra_lights = lights;
    let packed = prepare(&scene, &settings);
    let expected = 8.0 * response(&packed, &settings, &material, Vec3::Z);
    assert_close(mean(&packed, &settings).x, expected, 0.01);
}

/// Radiance from a lamp whose unit-radiance points `(direction, solid angle)` are given.
fn by_quadrature(
    packed: &PackedScene,
    settings: &RenderSettings,
    material: &Material,
    points: impl Iterator<Item = (Vec3, f32)>,
) -> f32 {
    points.map(|(wi, solid_angle)| f64::from(response(packed, settings, material, wi) * solid_angle)).sum::<f64>()
        as f32
}

#[test]
fn a_spherical_lamp_matches_quadrature_over_its_cone() {
    // Radius 0.5 by instance scale, centre 2 above the plane, 1 aside.
    let center = Vec3::new(1.0, 0.0, 2.0);
    let lamp = Affine3A::from_scale_rotation_translation(Vec3::splat(0.5), Quat::IDENTITY, center);
    for roughness in [0.3, 1.0] {
        let material = matte(0.5, roughness);
        let scene =
            scene(vec![(square(), material.clone(), Affine3A::IDENTITY), (sphere(), glow(Vec3::splat(3.0)), lamp)]);
        let settings = settings(Integrator::Direct, view(), 0.0);
        let packed = prepare(&scene, &settings);
        let cone = 1.0 - (1.0 - 0.25f32 / center.length_squared()).sqrt();
        let (t, b) = center.normalize().any_orthonormal_pair();
        let n = 200;
        let points = (0..n * n).map(|i| {
            let cosine = 1.0 - cone * ((i % n) as f32 + 0.5) / n as f32;
            let phi = std::f32::consts::TAU * ((i / n) as f32 + 0.5) / n as f32;
            let sine = (1.0 - cosine * cosine).sqrt();
            let wi = t * (sine * phi.cos()) + b * (sine * phi.sin()) + center.normalize() * cosine;
            (wi, std::f32::consts::TAU * cone / (n * n) as f32)
        });
        let expected = 3.0 * by_quadrature(&packed, &settings, &material, points);
        assert_close(mean(&packed, &settings).x, expected, 0.01);
    }
}

#[test]
fn a_square_lamp_matches_quadrature_over_its_area() {
    // Facing away: both sides emit.
    let transform = Affine3A::from_scale_rotation_translation(
        Vec3::new(0.7, 0.4, 1.0),
        Quat::from_rotation_y(0.5),
        Vec3::new(-0.5, 0.3, 1.5),
    );
    let material = matte(0.6, 0.5);
    let scene = scene(vec![
        (square(), material.clone(), Affine3A::from_scale(Vec3::splat(0.1))),
        (square(), glow(Vec3::splat(2.0)), transform),
    ]);
    let settings = settings(Integrator::Direct, view(), 0.0);
    let packed = prepare(&scene, &settings);
    let normal = transform.transform_vector3(Vec3::Z).normalize();
    let n = 300;
    let points = (0..n * n).map(|i| {
        let (x, y) = (((i % n) as f32 + 0.5) / n as f32 * 2.0 - 1.0, ((i / n) as f32 + 0.5) / n as f32 * 2.0 - 1.0);
        let p = transform.transform_point3(Vec3::new(x, y, 0.0));
        let wi = p.normalize();
        (wi, normal.dot(wi).abs() / p.length_squared() * (4.0 * 0.7 * 0.4) / (n * n) as f32)
    });
    let expected = 2.0 * by_quadrature(&packed, &settings, &material, points);
    assert_close(mean(&packed, &settings).x, expected, 0.01);
}

#[test]
fn light_sampling_bsdf_sampling_and_both_agree() {
    let tilted = Affine3A::from_rotation_translation(Quat::from_rotation_x(0.4), Vec3::new(0.0, 1.0, 1.6));
    let stretched = Affine3A::from_scale_rotation_translation(
        Vec3::new(0.6, 0.3, 0.4),
        Quat::from_rotation_z(0.5),
        Vec3::new(0.0, 1.0, 1.6),
    );
    for (lamp, transform) in [(square(), tilted), (sphere(), stretched)] {
        for (roughness, metallic) in [(0.4, 1.0), (0.7, 0.0)] {
            let material = Material { metallic, ..matte(0.7, roughness) };
            let scene = scene(vec![
                (square(), material, Affine3A::IDENTITY),
                (lamp.clone(), glow(Vec3::new(1.0, 2.0, 3.0)), transform),
            ]);
            let mut settings = settings(Integrator::Direct, view(), 0.0);
            settings.spp = 256;
            let mut packed = prepare(&scene, &settings);
            let both = mean(&packed, &settings).y;
            settings.integrator = Integrator::Whitted { max_bounces: 0 };
            let light_only = mean(&packed, &settings).y;
            settings.integrator = Integrator::Direct;
            packed.lights.clear();
            packed.instances.iter_mut().for_each(|i| i.emitter_base = NONE);
            let bsdf_only = mean(&packed, &settings).y;
            assert!(both > 0.01);
            assert_close(light_only, both, 0.015);
            assert_close(bsdf_only, both, 0.015);
        }
    }
}

#[test]
fn a_lamp_inside_a_box_of_shadow_lights_nothing() {
    let lamp = Affine3A::from_scale_rotation_translation(Vec3::splat(0.2), Quat::IDENTITY, Vec3::new(0.0, 0.0, 2.0));
    let shade = Affine3A::from_scale_rotation_translation(Vec3::splat(0.5), Quat::IDENTITY, Vec3::new(0.0, 0.0, 2.0));
    let scene = scene(vec![
        (square(), matte(0.5, 1.0), Affine3A::IDENTITY),
        (sphere(), glow(Vec3::ONE), lamp),
        (sphere(), matte(0.0, 1.0), shade),
    ]);
    assert_eq!(render(&scene, &settings(Integrator::Direct, view(), 0.0)), Vec3::ZERO);
}

#[test]
fn probabilities_of_lights_add_up_to_one() {
    let lamp = Affine3A::from_translation(Vec3::new(0.0, 0.0, 3.0));
    let scene = scene(vec![(square(), matte(0.5, 1.0), Affine3A::IDENTITY), (square(), glow(Vec3::ONE), lamp)]);
    let mut settings = settings(Integrator::Direct, view(), 0.5);
    settings.extra_lights = vec![light(PunctualKind::Point, 2.0), light(PunctualKind::Directional, 2.0)];
    let packed = prepare(&scene, &settings);
    assert_eq!(packed.lights.len(), 5, "point, directional, two triangles, environment");
    assert_close(packed.lights.iter().map(|l| l.selection).sum(), 1.0, 1e-6);
    assert_eq!(packed.light_cdf.last(), Some(&u32::MAX));
    assert!(packed.light_cdf.is_sorted());
    assert_eq!(packed.environment.light, 4);
    // Both halves of the lamp, and only the lamp, are known as lights.
    assert_eq!(packed.instances[0].emitter_base, NONE);
    let base = packed.instances[1].emitter_base as usize;
    assert_eq!(packed.emitter_lights[base..base + 2], [2, 3]);
}

/// A room that only a weak lamp lights, while a sun shines on its floor from below.
#[test]
fn a_bright_light_that_is_hidden_starves_no_other() {
    let material = matte(0.5, 0.8);
    let sun = PunctualLight { direction: Vec3::Z, ..light(PunctualKind::Directional, 1e5) };
    for lamp in [light(PunctualKind::Point, 0.1), light(PunctualKind::Point, 100.0)] {
        let intensity = lamp.intensity.x;
        let scene = scene(vec![(square(), material.clone(), Affine3A::IDENTITY)]);
        let mut settings = settings(Integrator::Direct, view(), 0.0);
        settings.extra_lights = vec![sun.clone(), lamp];
        let packed = prepare(&scene, &settings);
        let expected = response(&packed, &settings, &material, Vec3::Z) * intensity / 4.0;
        assert_close(mean(&packed, &settings).x, expected, 0.01);
    }
}

#[test]
fn nothing_right_before_a_light_is_overlooked() {
    let before = Affine3A::from_scale_rotation_translation(
        Vec3::splat(0.9),
        Quat::IDENTITY,
        Vec3::new(0.0, 0.0, 2.0 * (1.0 - 3e-5)),
    );
    let lamp = Affine3A::from_scale_rotation_translation(Vec3::splat(0.5), Quat::IDENTITY, Vec3::new(0.0, 0.0, 2.0));
    for (punctual, area) in [(1.0, Vec3::ZERO), (0.0, Vec3::ONE)] {
        let floor = (square(), matte(0.5, 1.0), Affine3A::IDENTITY);
        let mut objects = vec![floor, (square(), glow(area), lamp)];
        let mut settings = settings(Integrator::Whitted { max_bounces: 0 }, view(), 0.0);
        if area == Vec3::ZERO {
            objects.pop();
        }
        settings.extra_lights = vec![light(PunctualKind::Point, punctual)];
        assert!(render(&scene(objects.clone()), &settings).x > 0.01);
        objects.push((square(), matte(0.0, 1.0), before));
        assert_eq!(render(&scene(objects), &settings), Vec3::ZERO);
    }
}

#[test]
fn the_ground_of_a_job_does_not_make_the_sky_weigh_more() {
    let lamp = Affine3A::from_translation(Vec3::new(0.0, 0.0, 3.0));
    let scene = scene(vec![(square(), glow(Vec3::ONE), lamp)]);
    let mut settings = settings(Integrator::Direct, view(), 0.01);
    let selection = |settings: &RenderSettings| {
        let packed = prepare(&scene, settings);
        packed.lights[packed.environment.light as usize].selection
    };
    let without = selection(&settings);
    settings.ground =
        Some(crate::settings::Ground { height: None, half_size: None, albedo: Vec3::ONE, roughness: 1.0 });
    assert_eq!(selection(&settings), without);
}

#[test]
fn only_primitives_that_emit_are_lights() {
    let mut mesh = square();
    mesh.slots = 2;
    mesh.triangle_slots = vec![0, 1];
    let mut scene = scene(vec![(mesh, matte(0.5, 1.0), Affine3A::IDENTITY)]);
    scene.materials.push(glow(Vec3::ONE));
    scene.instances[0].materials = [0, 1].into();
    scene.instances.push(scene.instances[0].clone());
    let packed = prepare(&scene, &settings(Integrator::Direct, view(), 0.0));
    assert_eq!(packed.instance_materials, [0, 1], "instances share their list of materials");
    assert_eq!(packed.emitter_lights, [NONE, 0, NONE, 1]);
    assert_eq!(packed.lights.iter().map(|l| (l.instance, l.primitive)).collect::<Vec<_>>(), [(0, 1), (1, 1)]);
}
