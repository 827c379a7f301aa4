//! Small scenes that use all that shading knows.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::line_space::LineSpace;
use lightshaft_engine::accel::{BuildParams, MeshStructure, Quality, SceneAccel};
use lightshaft_engine::pack::{PackedScene, pack, placements, with_overlays};
use lightshaft_engine::scene::{
    AlphaMode, Camera, Filter, Image, Instance, Material, Mesh, MeshHash, Projection, PunctualKind, PunctualLight,
    Scene, Sphere, Texture, TextureRef, Wrap,
};
use lightshaft_engine::settings::{Environment, Ground, HdrImage, Integrator, RenderSettings};

use crate::common::{Random, ball, mesh};

/// The unit square in the xy plane with UVs, normals and tangents.
fn quad() -> Mesh {
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let positions = corners.map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec();
    let mut quad = mesh(positions, vec![[0, 1, 2], [0, 2, 3]], vec![]);
    quad.normals = vec![Vec3::Z; 4];
    quad.tangents = vec![[1.0, 0.0, 0.0, 1.0]; 4];
    quad.uv0 = corners.map(|(x, y)| [1.5 * x, 1.5 * y]).to_vec();
    quad.uv1 = corners.map(|(x, y)| [0.5 + 0.5 * x, 0.5 - 0.5 * y]).to_vec();
    quad.colors = vec![[1.0, 0.9, 0.8, 1.0], [0.8, 1.0, 0.9, 1.0], [1.0, 1.0, 1.0, 1.0], [0.7, 0.8, 1.0, 1.0]];
    quad
}

fn smooth_ball(rings: u32) -> Mesh {
    let mut shape = ball(rings, Vec3::ZERO, 1.0);
    shape.normals = shape.positions.iter().map(|p| p.normalize()).collect();
    shape
}

fn noise(width: u32, height: u32, seed: u64) -> Arc<Image> {
    let mut random = Random(seed);
    let rgba8 = (0..width * height * 4).map(|_| random.next() as u8).collect();
    Arc::new(Image { name: "noise".into(), width, height, rgba8 })
}

fn texture(texture: u32, uv_set: u32) -> Option<TextureRef> {
    Some(TextureRef { texture, uv_set, transform: [[1.2, 0.3, 0.1], [-0.2, 0.9, 0.4]] })
}

/// A box of quads with a lamp, and in it a ball, spheres, cards with alpha, a mirror and an unlit card.
pub(crate) fn everything() -> Scene {
    everything_with(smooth_ball(24), noise(8, 8, 1))
}

/// The same with larger arrays.
pub(crate) fn many_bytes() -> Scene {
    let mut scene = everything_with(smooth_ball(24), noise(128, 96, 1));
    // A mesh of one triangle takes more bytes of nodes than of primitives.
    scene.meshes.extend((0..250).map(|_| Arc::new(mesh(vec![Vec3::ZERO, Vec3::X, Vec3::Y], vec![[0, 1, 2]], vec![]))));
    scene
}

fn everything_with(ball: Mesh, image: Arc<Image>) -> Scene {
    let plain = Material { metallic: 0.0, ..Material::default() };
    let materials = vec![
        Material { base_color: [0.8, 0.7, 0.6, 1.0], ..plain.clone() },
        Material { base_color_texture: texture(0, 0), ..plain.clone() },
        Material { base_color: [0.9, 0.8, 0.5, 1.0], roughness: 0.15, ..Material::default() },
        Material { emissive: Vec3::new(9.0, 8.0, 6.0), ..plain.clone() },
        Material { base_color_texture: texture(1, 1), alpha_mode: AlphaMode::Mask, ..plain.clone() },
        Material { base_color: [0.2, 0.5, 0.9, 0.4], alpha_mode: AlphaMode::Blend, ..plain.clone() },
        Material {
            roughness: 0.4,
            normal_texture: texture(2, 1),
            normal_scale: 0.6,
            metallic_roughness_texture: texture(3, 0),
            ..Material::default()
        },
        Material { base_color: [0.1, 0.9, 0.3, 1.0], unlit: true, ..plain.clone() },
        Material { emissive: Vec3::new(1.0, 2.0, 5.0), emissive_texture: texture(0, 1), ..plain.clone() },
        Material {
            base_color: [0.7, 0.3, 0.2, 1.0],
            roughness: 0.1,
            dielectric_f0: Vec3::new(0.9, 0.6, 0.3),
            specular_glossiness: true,
            metallic_roughness_texture: texture(3, 0),
            ..plain
        },
    ];
    let images = vec![image, noise(5, 7, 2), noise(4, 4, 3)];
    let textures = vec![
        Texture { image: 0, wrap_u: Wrap::Repeat, wrap_v: Wrap::MirroredRepeat, filter: Filter::Linear },
        Texture { image: 1, wrap_u: Wrap::ClampToEdge, wrap_v: Wrap::Repeat, filter: Filter::Nearest },
        Texture { image: 2, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, filter: Filter::Linear },
        Texture { image: 2, wrap_u: Wrap::MirroredRepeat, wrap_v: Wrap::ClampToEdge, filter: Filter::Linear },
    ];
    let mut beads = mesh(
        vec![],
        vec![],
        vec![
            Sphere { center: Vec3::ZERO, radius: 0.35, slot: 0 },
            Sphere { center: Vec3::new(0.6, 0.1, 0.2), radius: 0.2, slot: 1 },
            Sphere { center: Vec3::new(0.2, 0.6, 0.0), radius: 0.15, slot: 2 },
        ],
    );
    beads.slots = 3;
    let mut meshes = [quad(), ball, beads];
    for (i, mesh) in meshes.iter_mut().enumerate() {
        mesh.hash = MeshHash([i as u8 + 1; 32]);
    }
    let at = |scale: Vec3, rotation: Quat, x: f32, y: f32, z: f32| {
        Affine3A::from_scale_rotation_translation(scale, rotation, Vec3::new(x, y, z))
    };
    let (turn_x, turn_y) = (Quat::from_rotation_x, Quat::from_rotation_y);
    let quarter = std::f32::consts::FRAC_PI_2;
    let instance = |mesh: u32, transform, materials: &[u32]| Instance {
        name: "".into(),
        mesh,
        transform,
        materials: materials.into(),
    };
    let instances = vec![
        instance(0, at(Vec3::splat(2.0), turn_x(-quarter), 0.0, -1.0, 0.0), &[1]),
        instance(0, at(Vec3::splat(2.0), Quat::IDENTITY, 0.0, 1.0, -2.0), &[0]),
        instance(0, at(Vec3::splat(2.0), turn_y(quarter), -2.0, 1.0, 0.0), &[6]),
        instance(0, at(Vec3::splat(0.5), turn_x(quarter), 0.0, 2.6, 0.0), &[3]),
        instance(1, at(Vec3::new(-0.6, 0.5, 0.6), turn_y(0.4), -0.7, -0.4, -0.4), &[2]),
        instance(2, at(Vec3::splat(1.0), turn_y(1.0), 0.5, -0.5, 0.2), &[6, 8, 5]),
        instance(2, at(Vec3::new(1.0, 0.5, 0.8), turn_x(0.5), 0.9, 1.2, -0.8), &[8, 2, 9]),
        instance(0, at(Vec3::splat(0.5), turn_y(-0.5), 0.9, 0.3, 0.7), &[4]),
        instance(0, at(Vec3::splat(0.5), turn_y(0.5), -0.9, 0.6, 0.8), &[5]),
        instance(0, at(Vec3::new(0.3, 0.3, -0.3), turn_y(-0.2), -0.1, 1.2, -0.9), &[7]),
    ];
    let lights = vec![
        PunctualLight {
            name: String::new(),
            position: Vec3::new(1.5, 2.0, 1.5),
            direction: Vec3::new(-0.5, -0.7, -0.5).normalize(),
            intensity: Vec3::new(4.0, 5.0, 6.0),
            range: 9.0,
            kind: PunctualKind::Spot { inner_cone_rad: 0.3, outer_cone_rad: 0.6 },
        },
        PunctualLight {
            name: String::new(),
            position: Vec3::new(-1.0, 1.0, 2.0),
            direction: Vec3::NEG_Y,
            intensity: Vec3::new(1.0, 0.5, 0.4),
            range: f32::INFINITY,
            kind: PunctualKind::Point,
        },
        PunctualLight {
            name: String::new(),
            position: Vec3::ZERO,
            direction: Vec3::new(0.3, -0.8, -0.5).normalize(),
            intensity: Vec3::new(0.5, 0.6, 0.4),
            range: f32::INFINITY,
            kind: PunctualKind::Directional,
        },
    ];
    Scene {
        name: "everything".into(),
        meshes: meshes.into_iter().map(Arc::new).collect(),
        instances,
        materials,
        textures,
        images,
        lights,
        ..Scene::default()
    }
}

/// Nothing but opaque materials: the variant without the alpha filter.
pub(crate) fn opaque() -> Scene {
    let mut scene = everything();
    scene.materials.iter_mut().for_each(|m| m.alpha_mode = AlphaMode::Opaque);
    scene
}

pub(crate) fn sky() -> Environment {
    let (width, height) = (32, 16);
    let mut random = Random(77);
    let mut rgb: Vec<[f32; 3]> = (0..width * height).map(|_| (0.6 * random.point()).to_array()).collect();
    rgb[3 * width as usize + 20] = [60.0, 50.0, 40.0];
    let image = Arc::new(HdrImage { width, height, rgb });
    Environment::Map { image, intensity: 0.8, rotation_y_rad: 0.7 }
}

pub(crate) fn settings(integrator: Integrator) -> RenderSettings {
    RenderSettings {
        integrator,
        width: 64,
        height: 48,
        spp: 16,
        seed: 9,
        camera: Camera {
            name: String::new(),
            position: Vec3::new(0.3, 0.9, 4.2),
            forward: Vec3::new(-0.05, -0.06, -1.0).normalize(),
            up: Vec3::Y,
            projection: Projection::Perspective { fov_y_rad: 0.9 },
            frame_aspect: None,
        },
        environment: Environment::Constant(Vec3::new(0.3, 0.35, 0.4)),
        extra_lights: vec![],
        ground: Some(Ground { height: Some(-1.3), half_size: None, albedo: Vec3::splat(0.5), roughness: 0.7 }),
        aovs: vec![],
    }
}

pub(crate) fn packed(scene: &Scene, settings: &RenderSettings) -> Arc<PackedScene> {
    packed_with(scene, settings, |_, _| None)
}

/// With the Line Spaces that `space` makes of the meshes.
pub(crate) fn packed_with(
    scene: &Scene,
    settings: &RenderSettings,
    space: impl Fn(&Mesh, &Arc<MeshStructure>) -> Option<Arc<LineSpace>>,
) -> Arc<PackedScene> {
    let scene = with_overlays(scene, settings);
    let params = BuildParams { quality: Quality::Medium, spatial_splits: false };
    let build =
        |mesh: &Arc<Mesh>| Arc::new(MeshStructure::build(mesh, &params, &AtomicBool::new(false)).expect("builds"));
    let structures: Vec<_> = scene.meshes.iter().map(build).collect();
    let spaces = scene.meshes.iter().zip(&structures).map(|(mesh, structure)| space(mesh, structure)).collect();
    let accel = SceneAccel::build(structures, &placements(&scene)).with_line_spaces(spaces).expect("one each");
    Arc::new(pack(&scene, settings, Arc::new(accel)).expect("packs"))
}
