//! Integrators against closed forms and against each other, over scenes built in code.

mod alpha;
mod bsdf;
mod environment;
mod furnace;
mod lights;
mod surface;
mod texture;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Vec3};

use super::{Sample, Tally, radiance};
use crate::accel::{BuildParams, MeshStructure, SceneAccel};
use crate::pack::{PackedScene, pack, placements, with_overlays};
use crate::scene::{Camera, Instance, Material, Mesh, Projection, Scene, Sphere, mesh_hash};
use crate::settings::{Environment, Integrator, RenderSettings};

/// A dielectric of one colour.
pub(crate) fn matte(albedo: f32, roughness: f32) -> Material {
    Material { base_color: [albedo, albedo, albedo, 1.0], metallic: 0.0, roughness, ..Material::default() }
}

pub(crate) fn glow(radiance: Vec3) -> Material {
    Material { emissive: radiance, ..matte(0.0, 1.0) }
}

/// The unit sphere around the origin.
pub(crate) fn sphere() -> Mesh {
    let spheres = vec![Sphere { center: Vec3::ZERO, radius: 1.0, slot: 0 }];
    Mesh::of_shapes("", Vec::new(), Vec::new(), spheres)
}

/// The square from (-1, -1, 0) to (1, 1, 0), facing +Z, with texture coordinates (0, 0) at its upper left.
pub(crate) fn square() -> Mesh {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
    let mut mesh = Mesh::of_shapes("", corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]], Vec::new());
    mesh.uv0 = vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    mesh
}

/// A scene of single-material objects.
pub(crate) fn scene(objects: Vec<(Mesh, Material, Affine3A)>) -> Scene {
    let mut scene = Scene::default();
    for (number, (mut mesh, material, transform)) in objects.into_iter().enumerate() {
        mesh.hash = mesh_hash(&mesh);
        let number = number as u32;
        scene.meshes.push(Arc::new(mesh));
        scene.materials.push(material);
        scene.instances.push(Instance { name: "".into(), mesh: number, transform, materials: [number].into() });
    }
    scene
}

/// An orthographic camera `distance` in front of `target` on the side of `from` (unit).
pub(crate) fn camera(target: Vec3, from: Vec3, distance: f32, half_height: f32) -> Camera {
    let up = if from.y.abs() > 0.9 { Vec3::NEG_Z } else { Vec3::Y };
    Camera {
        name: String::new(),
        position: target + from * distance,
        forward: -from,
        up,
        projection: Projection::Orthographic { half_height },
        frame_aspect: None,
    }
}

pub(crate) fn settings(integrator: Integrator, camera: Camera, environment: f32) -> RenderSettings {
    RenderSettings {
        integrator,
        width: 32,
        height: 32,
        spp: 64,
        seed: 1,
        camera,
        environment: Environment::Constant(Vec3::splat(environment)),
        extra_lights: Vec::new(),
        ground: None,
        aovs: Vec::new(),
    }
}

pub(crate) fn prepare(scene: &Scene, settings: &RenderSettings) -> PackedScene {
    let scene = with_overlays(scene, settings);
    let never = AtomicBool::new(false);
    let build = |mesh: &Arc<Mesh>| MeshStructure::build(mesh, &BuildParams::default(), &never).map(Arc::new);
    let structures: Result<Vec<_>, _> = scene.meshes.iter().map(build).collect();
    let accel = SceneAccel::build(structures.expect("small meshes build"), &placements(&scene));
    pack(&scene, settings, Arc::new(accel)).expect("test scenes are consistent")
}

/// Mean radiance of the picture.
pub(crate) fn mean(packed: &PackedScene, settings: &RenderSettings) -> Vec3 {
    let mut sum = glam::DVec3::ZERO;
    let mut tally = Tally::default();
    for y in 0..settings.height {
        for x in 0..settings.width {
            for index in 0..settings.spp {
                let sample = Sample { x, y, index, seed: settings.seed };
                sum += radiance(packed, settings.integrator, sample, &mut tally).as_dvec3();
            }
        }
    }
    (sum / f64::from(settings.width * settings.height * settings.spp)).as_vec3()
}

pub(crate) fn render(scene: &Scene, settings: &RenderSettings) -> Vec3 {
    mean(&prepare(scene, settings), settings)
}

#[track_caller]
pub(crate) fn assert_close(got: f32, expected: f32, relative: f32) {
    assert!((got - expected).abs() <= relative * expected.abs().max(1e-6), "{got}, expected {expected} +- {relative}");
}
