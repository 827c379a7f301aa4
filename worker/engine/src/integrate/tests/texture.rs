//! Texture look-ups: orientation, filters, wrap modes, colour space, transforms.

use std::sync::Arc;

use glam::{Affine3A, Vec3};

use super::{camera, matte, prepare, scene, settings, square};
use crate::integrate::texture::{sample_texture, srgb_to_linear};
use crate::pack::PackedScene;
use crate::scene::{Filter, Image, Texture, TextureRef, Wrap};
use crate::settings::Integrator;

/// A 2x2 texture: upper left 0, upper right 255, lower left 51, lower right 102, in all channels.
fn packed(wrap_u: Wrap, wrap_v: Wrap, filter: Filter, transform: [[f32; 3]; 2], srgb: bool) -> PackedScene {
    let mut material = matte(1.0, 1.0);
    let used = Some(TextureRef { texture: 0, uv_set: 0, transform });
    if srgb {
        material.base_color_texture = used;
    } else {
        material.metallic_roughness_texture = used;
    }
    let mut scene = scene(vec![(square(), material, Affine3A::IDENTITY)]);
    let rgba8 = [0u8, 255, 51, 102].iter().flat_map(|&v| [v; 4]).collect();
    scene.images.push(Arc::new(Image { name: String::new(), width: 2, height: 2, rgba8 }));
    scene.textures.push(Texture { image: 0, wrap_u, wrap_v, filter });
    prepare(&scene, &settings(Integrator::Aov, camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0), 0.0))
}

fn red(scene: &PackedScene, u: f32, v: f32) -> f32 {
    sample_texture(scene, 0, [u, v], [9.0, 9.0])[0]
}

#[track_caller]
fn check(got: f32, expected: f32) {
    assert!((got - expected).abs() < 1e-5, "{got}, expected {expected}");
}

#[test]
fn the_first_texel_is_the_upper_left() {
    let t = packed(Wrap::Repeat, Wrap::Repeat, Filter::Nearest, TextureRef::IDENTITY, false);
    check(red(&t, 0.1, 0.1), 0.0);
    check(red(&t, 0.9, 0.1), 1.0);
    check(red(&t, 0.1, 0.9), 0.2);
    check(red(&t, 0.9, 0.9), 0.4);
}

#[test]
fn bilinear_filtering_meets_texel_centres_and_middles() {
    let t = packed(Wrap::ClampToEdge, Wrap::ClampToEdge, Filter::Linear, TextureRef::IDENTITY, false);
    check(red(&t, 0.25, 0.25), 0.0);
    check(red(&t, 0.75, 0.25), 1.0);
    check(red(&t, 0.5, 0.25), 0.5);
    check(red(&t, 0.5, 0.5), (0.0 + 1.0 + 0.2 + 0.4) / 4.0);
    check(red(&t, 0.0, 0.0), 0.0);
    check(red(&t, 7.0, 0.25), 1.0);
    check(red(&t, -7.0, 0.25), 0.0);
}

#[test]
fn wrap_modes_outside_of_the_unit_square() {
    let repeat = packed(Wrap::Repeat, Wrap::Repeat, Filter::Linear, TextureRef::IDENTITY, false);
    check(red(&repeat, 1.25, -0.75), 0.0);
    check(red(&repeat, 1.75, 3.25), 1.0);
    // Across the seam the first and the last column mix.
    check(red(&repeat, 0.0, 0.25), 0.5);
    check(red(&repeat, 1.0, 0.25), 0.5);
    let mirrored = packed(Wrap::MirroredRepeat, Wrap::MirroredRepeat, Filter::Linear, TextureRef::IDENTITY, false);
    check(red(&mirrored, 1.25, 0.25), 1.0);
    check(red(&mirrored, -0.25, 0.25), 0.0);
    check(red(&mirrored, 2.75, 0.25), 1.0);
    check(red(&mirrored, 1.0, 0.25), 1.0);
    // Each axis has its own mode.
    let mixed = packed(Wrap::Repeat, Wrap::ClampToEdge, Filter::Nearest, TextureRef::IDENTITY, false);
    check(red(&mixed, 1.1, 5.0), 0.2);
}

#[test]
fn coordinates_that_are_no_numbers_still_give_a_texel() {
    for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
        for filter in [Filter::Nearest, Filter::Linear] {
            let t = packed(wrap, wrap, filter, TextureRef::IDENTITY, false);
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e-30] {
                assert!(red(&t, bad, bad).is_finite());
            }
        }
    }
}

#[test]
fn colours_are_decoded_before_filtering_and_alpha_is_not() {
    let t = packed(Wrap::ClampToEdge, Wrap::ClampToEdge, Filter::Linear, TextureRef::IDENTITY, true);
    let [r, _, _, a] = sample_texture(&t, 0, [0.25, 0.5], [0.0; 2]);
    check(r, 0.5 * srgb_to_linear(51.0 / 255.0));
    check(a, 0.1);
    check(srgb_to_linear(0.5), 0.214_041_14);
    check(srgb_to_linear(1.0), 1.0);
}

#[test]
fn the_uv_transform_is_applied() {
    let turned = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    let t = packed(Wrap::Repeat, Wrap::Repeat, Filter::Nearest, turned, false);
    check(red(&t, 0.9, 0.1), 0.2);
    let shifted = [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]];
    let t = packed(Wrap::Repeat, Wrap::Repeat, Filter::Nearest, shifted, false);
    check(red(&t, 0.1, 0.1), 1.0);
}
