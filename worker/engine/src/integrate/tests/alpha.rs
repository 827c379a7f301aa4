//! Alpha mask and blend: expectation, and independence of the order of look-ups.

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};

use super::{assert_close, camera, matte, prepare, render, scene, settings, sphere, square};
use crate::scene::{AlphaMode, Filter, Image, Material, Scene, Texture, TextureRef, Wrap};
use crate::settings::{Integrator, RenderSettings};

fn unlit(color: [f32; 4], alpha_mode: AlphaMode) -> Material {
    Material { base_color: color, unlit: true, alpha_mode, ..matte(0.0, 1.0) }
}

fn at(z: f32) -> Affine3A {
    Affine3A::from_translation(Vec3::new(0.0, 0.0, z))
}

fn front(integrator: Integrator) -> RenderSettings {
    settings(integrator, camera(Vec3::ZERO, Vec3::Z, 5.0, 0.9), 0.0)
}

const PATH: Integrator = Integrator::Path { max_bounces: 4 };

#[test]
fn blended_layers_show_their_share() {
    let scene = scene(vec![
        (square(), unlit([1.0, 0.0, 0.0, 0.3], AlphaMode::Blend), at(1.0)),
        (square(), unlit([0.0, 1.0, 0.0, 0.5], AlphaMode::Blend), at(0.5)),
        (square(), unlit([0.0, 0.0, 1.0, 1.0], AlphaMode::Opaque), at(0.0)),
    ]);
    for integrator in [PATH, Integrator::Direct, Integrator::Whitted { max_bounces: 1 }] {
        let got = render(&scene, &front(integrator));
        assert!((got - Vec3::new(0.3, 0.35, 0.35)).abs().max_element() < 0.01, "{got}");
    }
}

#[test]
fn shadows_of_blended_surfaces_let_their_share_through() {
    let mut shadowed = scene(vec![
        (square(), matte(0.5, 1.0), at(0.0)),
        (square(), unlit([0.0, 0.0, 0.0, 0.4], AlphaMode::Blend), at(2.0)),
    ]);
    let mut open = scene(vec![(square(), matte(0.5, 1.0), at(0.0))]);
    let sun = crate::scene::PunctualLight {
        name: String::new(),
        position: Vec3::ZERO,
        direction: Vec3::NEG_Z,
        intensity: Vec3::ONE,
        range: f32::INFINITY,
        kind: crate::scene::PunctualKind::Directional,
    };
    shadowed.lights.push(sun.clone());
    open.lights.push(sun);
    // From between the layers, so that only the shadow rays cross one.
    let settings = settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::new(0.6, 0.0, 0.8), 1.0, 0.2), 0.0);
    assert_close(render(&shadowed, &settings).x, 0.6 * render(&open, &settings).x, 0.01);
}

#[test]
fn both_walls_of_a_blended_sphere_count() {
    let sphere_in_front = scene(vec![
        (sphere(), unlit([1.0, 0.0, 0.0, 0.5], AlphaMode::Blend), at(0.0)),
        (square(), unlit([0.0, 1.0, 0.0, 1.0], AlphaMode::Opaque), at(-2.0)),
    ]);
    let settings = settings(PATH, camera(Vec3::ZERO, Vec3::Z, 5.0, 0.5), 0.0);
    let got = render(&sphere_in_front, &settings);
    assert!((got - Vec3::new(0.75, 0.25, 0.0)).abs().max_element() < 0.01, "{got}");
}

/// A red square whose texture is opaque in its left half only, in front of a green one.
fn cut_out(alpha_mode: AlphaMode, cutoff: f32, left_alpha: u8) -> Scene {
    let mut front = unlit([1.0, 0.0, 0.0, 1.0], alpha_mode);
    front.alpha_cutoff = cutoff;
    front.base_color_texture = Some(TextureRef { texture: 0, uv_set: 0, transform: TextureRef::IDENTITY });
    let mut scene =
        scene(vec![(square(), front, at(1.0)), (square(), unlit([0.0, 1.0, 0.0, 1.0], AlphaMode::Opaque), at(0.0))]);
    let rgba8 = [255, 255, 255, left_alpha, 255, 255, 255, 0].repeat(2);
    scene.images.push(Arc::new(Image { name: String::new(), width: 2, height: 2, rgba8 }));
    let clamp = Wrap::ClampToEdge;
    scene.textures.push(Texture { image: 0, wrap_u: clamp, wrap_v: clamp, filter: Filter::Nearest });
    scene
}

#[test]
fn masks_cut_at_their_cutoff_and_on_the_right_side() {
    let half = |from: f32| {
        let mut settings = front(PATH);
        settings.camera = camera(Vec3::new(from, 0.0, 0.0), Vec3::Z, 5.0, 0.4);
        settings
    };
    for (cutoff, alpha, left) in [(0.5, 128, Vec3::X), (0.5, 127, Vec3::Y), (0.0, 0, Vec3::X)] {
        let scene = cut_out(AlphaMode::Mask, cutoff, alpha);
        assert_eq!(render(&scene, &half(-0.5)), left, "cutoff {cutoff}, alpha {alpha}");
    }
    assert_eq!(render(&cut_out(AlphaMode::Mask, 0.5, 255), &half(0.5)), Vec3::Y);
    // Opaque materials ignore alpha altogether.
    assert_eq!(render(&cut_out(AlphaMode::Opaque, 0.5, 0), &half(0.5)), Vec3::X);
}

#[test]
fn layers_beside_the_picture_are_free_of_noise() {
    for (alpha, expected) in [(0.4, 1), (0.6, 0)] {
        let scene = scene(vec![
            (square(), unlit([1.0, 0.0, 0.0, alpha], AlphaMode::Blend), at(1.0)),
            (square(), unlit([0.0, 1.0, 0.0, 1.0], AlphaMode::Opaque), at(0.0)),
        ]);
        let packed = prepare(&scene, &front(Integrator::Aov));
        for x in 0..32 {
            let hit = crate::integrate::aov::first_hit(&packed, x, 16, &mut Default::default());
            assert_eq!(hit.instance, expected);
        }
    }
}

#[test]
fn a_furnace_of_glass_cards_stays_even() {
    // White cards at any opacity reflect or pass all light: nothing is to be seen.
    let card = || Material { alpha_mode: AlphaMode::Blend, base_color: [1.0, 1.0, 1.0, 0.5], ..matte(1.0, 1.0) };
    let turned = |angle: f32, z: f32| Affine3A::from_rotation_translation(Quat::from_rotation_y(angle), Vec3::Z * z);
    let scene = scene(vec![(square(), card(), turned(0.3, 0.2)), (square(), card(), turned(-0.3, -0.2))]);
    let mut settings = front(Integrator::Path { max_bounces: 16 });
    settings.camera = camera(Vec3::ZERO, Vec3::Z, 5.0, 0.5);
    settings.environment = crate::settings::Environment::Constant(Vec3::ONE);
    assert_close(render(&scene, &settings).x, 1.0, 0.01);
}
