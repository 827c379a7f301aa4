//! Normals, normal maps, vertex colours, and rays that leave surfaces.

use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};

use super::{camera, matte, prepare, scene, settings, square};
use crate::integrate::aov::first_hit;
use crate::integrate::math::offset_origin;
use crate::integrate::sampler::{hash, unit_float};
use crate::integrate::surface::{shade_point, triangle_point};
use crate::scene::{Image, Material, Mesh, Scene, Texture, TextureRef};
use crate::settings::Integrator;

fn centre(scene: &Scene, from: Vec3) -> crate::integrate::aov::FirstHit {
    let packed = prepare(scene, &settings(Integrator::Aov, camera(Vec3::ZERO, from, 3.0, 0.01), 0.0));
    first_hit(&packed, 16, 16, &mut Default::default())
}

/// A square with a normal map of one texel that tilts towards +U and +V of the map.
fn mapped(texel: [u8; 4], transform: Affine3A) -> Scene {
    let mut mesh = square();
    mesh.normals = vec![Vec3::Z; 4];
    mesh.tangents = vec![[1.0, 0.0, 0.0, 1.0]; 4];
    let used = Some(TextureRef { texture: 0, uv_set: 0, transform: TextureRef::IDENTITY });
    let mut scene = scene(vec![(mesh, Material { normal_texture: used, ..matte(0.5, 1.0) }, transform)]);
    scene.images.push(Arc::new(Image { name: String::new(), width: 1, height: 1, rgba8: texel.to_vec() }));
    let texture =
        Texture { image: 0, wrap_u: Default::default(), wrap_v: Default::default(), filter: Default::default() };
    scene.textures.push(texture);
    scene
}

#[test]
fn normal_maps_tilt_along_tangent_and_bitangent() {
    let map = |texel: [u8; 4], transform| centre(&mapped(texel, transform), Vec3::Z).shading_normal;
    // Three fifths and four fifths of a unit: steep, but not so that a view from above is mirrored into the surface.
    let right = map([204, 128, 230, 255], Affine3A::IDENTITY);
    assert!((right.x - 0.6).abs() < 0.01 && right.y.abs() < 0.05, "{right}");
    let up = map([128, 204, 230, 255], Affine3A::IDENTITY);
    assert!((up.y - 0.6).abs() < 0.01 && up.x.abs() < 0.05, "{up}");
    // Mirroring an object mirrors its bumps.
    let mirrored = Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let right = map([204, 128, 230, 255], mirrored);
    assert!((right.x + 0.6).abs() < 0.01 && right.y.abs() < 0.05, "{right}");
    let up = map([128, 204, 230, 255], mirrored);
    assert!((up.y - 0.6).abs() < 0.01 && up.x.abs() < 0.05, "{up}");
}

#[test]
fn normals_face_the_viewer_on_both_sides() {
    let tilted = [255, 128, 200, 255];
    let front = centre(&mapped(tilted, Affine3A::IDENTITY), Vec3::Z);
    let back = centre(&mapped(tilted, Affine3A::IDENTITY), Vec3::NEG_Z);
    assert!(front.geometric_normal == Vec3::Z && back.geometric_normal == Vec3::NEG_Z);
    assert!((front.shading_normal + back.shading_normal).length() < 1e-3);
    // A map that turns the normal away from the viewer is held back.
    let away = centre(&mapped([128, 128, 0, 255], Affine3A::IDENTITY), Vec3::Z);
    assert!(away.shading_normal.z > 0.0, "{}", away.shading_normal);
}

/// A square whose normals lean over, mirrored by a camera that looks along the surface.
#[test]
fn normals_never_mirror_the_view_into_the_surface() {
    let lean = |x: f32| {
        let mut mesh = square();
        mesh.normals = vec![Vec3::new(x, 0.0, 1.0).normalize(); 4];
        let scene = scene(vec![(mesh, matte(0.5, 1.0), Affine3A::IDENTITY)]);
        prepare(&scene, &settings(Integrator::Aov, camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0), 0.0))
    };
    for (tilt, elevation) in [(0.0, 0.05f32), (0.5, 0.05), (-0.5, 0.05), (-0.5, 0.3), (-2.0, 0.01), (-2.0, 1.5)] {
        let packed = lean(tilt);
        for side in [1.0, -1.0] {
            let to_viewer = Vec3::new(elevation.cos(), 0.0, side * elevation.sin());
            let point = triangle_point(&packed, 0, 0, 0.2, 0.3);
            let surface = shade_point(&packed, &point, to_viewer);
            let mirrored = surface.normal * (2.0 * surface.normal.dot(to_viewer)) - to_viewer;
            let what = format!("tilt {tilt}, elevation {elevation}: normal {}", surface.normal);
            assert!(mirrored.dot(surface.geometric_normal) > 0.0 && surface.normal.dot(to_viewer) > 0.0, "{what}");
            // One that does not is left as it is.
            let given = point.smooth_normal * side;
            let there = given * (2.0 * given.dot(to_viewer)) - to_viewer;
            if there.dot(surface.geometric_normal) > 0.01 && given.dot(to_viewer) > 0.01 {
                assert_eq!(surface.normal, given, "{what}");
            }
        }
    }
}

#[test]
fn specular_glossiness_textures_hold_reflectance_and_glossiness() {
    let mut scene = mapped([255, 188, 0, 51], Affine3A::IDENTITY);
    scene.materials[0] = Material {
        roughness: 0.5,
        dielectric_f0: Vec3::new(0.4, 0.8, 0.6),
        specular_glossiness: true,
        metallic_roughness_texture: scene.materials[0].normal_texture,
        ..matte(0.5, 1.0)
    };
    let packed = prepare(&scene, &settings(Integrator::Aov, camera(Vec3::ZERO, Vec3::Z, 3.0, 0.01), 0.0));
    let surface = shade_point(&packed, &triangle_point(&packed, 0, 0, 0.2, 0.3), Vec3::Z);
    // 188 is a half in sRGB.
    assert!((surface.dielectric_f0 - Vec3::new(0.4, 0.4, 0.0)).length() < 0.005, "{}", surface.dielectric_f0);
    assert!((surface.roughness - (1.0 - 0.5 * 0.2)).abs() < 1e-6, "{}", surface.roughness);
    assert_eq!(surface.metallic, 0.0);
}

#[test]
fn vertex_colours_multiply_the_base_colour() {
    let mut mesh = square();
    mesh.colors = vec![[1.0, 0.5, 0.25, 1.0]; 4];
    let hit = centre(&scene(vec![(mesh, matte(0.5, 1.0), Affine3A::IDENTITY)]), Vec3::Z);
    assert!((hit.albedo - Vec3::new(0.5, 0.25, 0.125)).length() < 1e-6);
    assert!((hit.depth - 3.0).abs() < 1e-5 && hit.position.length() < 0.01);
}

#[test]
fn smooth_normals_follow_uneven_scale() {
    let mut mesh = square();
    mesh.normals = vec![Vec3::new(1.0, 0.0, 1.0).normalize(); 4];
    let stretched = Affine3A::from_scale(Vec3::new(2.0, 1.0, 1.0));
    let n = centre(&scene(vec![(mesh, matte(0.5, 1.0), stretched)]), Vec3::Z).shading_normal;
    assert!((n - Vec3::new(0.5, 0.0, 1.0).normalize()).length() < 1e-4, "{n}");
}

/// After pbrt's test: triangles at sizes and distances from 1e-4 to 1e4, each traced away from on both sides.
#[test]
fn rays_do_not_meet_the_triangle_that_they_leave() {
    let random = |i: u32, k: u32| unit_float(hash(hash(i) ^ k)) * 2.0 - 1.0;
    let power = |i: u32, k: u32| 10f32.powf(4.0 * random(i, k));
    for i in 0..300 {
        let vector = |k: u32| Vec3::new(random(i, k), random(i, k + 1), random(i, k + 2));
        let size = power(i, 100);
        let positions: Vec<Vec3> = (0..3).map(|c| vector(3 * c) * size).collect();
        let mesh = Mesh::of_shapes("", positions, vec![[0, 1, 2]], vec![]);
        let turn = Quat::from_scaled_axis(vector(20) * 3.0);
        let scale = Vec3::splat(power(i, 101)) * (Vec3::splat(1.5) + vector(30));
        let transform = Affine3A::from_scale_rotation_translation(scale, turn, vector(40) * power(i, 102));
        let scene = scene(vec![(mesh, matte(0.5, 1.0), transform)]);
        let packed = prepare(&scene, &settings(Integrator::Aov, camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0), 0.0));
        for k in 0..20 {
            let (u, v) = (0.5 * (random(i, 200 + k) + 1.0), 0.5 * (random(i, 300 + k) + 1.0));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let point = triangle_point(&packed, 0, 0, u, v);
            let direction = vector(400 + 3 * k).normalize();
            let origin = offset_origin(point.position, point.error, point.geometric_normal, direction);
            let ray = crate::trace::Ray::new(origin, direction);
            let filter = crate::integrate::alpha::AlphaFilter { scene: &packed, seed: 0 };
            let hit = packed.accel.closest(&ray, &filter, &mut Default::default());
            assert!(hit.is_none(), "triangle {i} ({size}), point {k}: met itself at {:?}", hit.map(|h| h.t));
        }
    }
}
