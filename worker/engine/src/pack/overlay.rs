//! What a job adds to a scene's geometry, and how the top level sees the result.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{Affine3A, Mat3A, Vec3, Vec3A};

use crate::accel::Placement;
use crate::scene::{Aabb, AlphaMode, Instance, Material, Mesh, Scene, mesh_hash};
use crate::settings::{Ground, RenderSettings};

/// The scene with the job's ground plane in it. Call this before structures are looked up: the ground is a mesh like
/// any other. It is the same unit square in every job, placed by its instance, so its structure is built once ever.
pub fn with_overlays(scene: &Scene, settings: &RenderSettings) -> Scene {
    let mut scene = scene.clone();
    if let Some(ground) = &settings.ground {
        add_ground(&mut scene, ground);
    }
    scene
}

/// One placement for each instance, in order.
pub fn placements(scene: &Scene) -> Vec<Placement> {
    let has_alpha: Vec<bool> = scene.materials.iter().map(|m| m.alpha_mode != AlphaMode::Opaque).collect();
    // By the place of the list in memory, since many instances share one.
    let mut known: HashMap<*const [u32], bool> = HashMap::new();
    let mut is_filtered = |instance: &Instance| {
        *known
            .entry(Arc::as_ptr(&instance.materials))
            .or_insert_with(|| instance.materials.iter().any(|&m| has_alpha.get(m as usize).copied().unwrap_or(false)))
    };
    scene
        .instances
        .iter()
        .map(|i| Placement { mesh: i.mesh, transform: i.transform, filtered: is_filtered(i) })
        .collect()
}

/// Bounds of what the job did not add itself: by them lights are weighed, and a ground that reaches to the horizon would
/// say that next to all light comes from the sky.
pub(super) fn own_bounds(scene: &Scene, settings: &RenderSettings) -> Aabb {
    let own = scene.instances.len() - usize::from(settings.ground.is_some()).min(scene.instances.len());
    let own = if own == 0 { &scene.instances } else { &scene.instances[..own] };
    own.iter().fold(Aabb::EMPTY, |bounds, instance| bounds.union(scene.instance_bounds(instance)))
}

/// How far below the scene's lowest point the ground lies when its height is not given, in scene radii: enough that it
/// does not coincide with the undersides that stand on it.
const GROUND_GAP: f32 = 1e-4;

fn add_ground(scene: &mut Scene, ground: &Ground) {
    let bounds = scene.world_bounds();
    let (center, radius) =
        if bounds.is_empty() { (Vec3::ZERO, 1.0) } else { (bounds.center(), 0.5 * bounds.extent().length()) };
    let radius = if radius > 0.0 { radius } else { 1.0 };
    let lowest = if bounds.is_empty() { 0.0 } else { bounds.min.y };
    let height = ground.height.unwrap_or(lowest - GROUND_GAP * radius);
    let half_size = ground.half_size.unwrap_or(20.0 * radius);

    let mesh = ground_mesh();
    let known = scene.meshes.iter().position(|m| m.hash == mesh.hash);
    let mesh_index = known.unwrap_or(scene.meshes.len());
    if known.is_none() {
        scene.meshes.push(Arc::new(mesh));
    }
    let [r, g, b] = ground.albedo.to_array();
    let material = Material {
        name: "ground".into(),
        base_color: [r, g, b, 1.0],
        metallic: 0.0,
        roughness: ground.roughness,
        ..Material::default()
    };
    scene.materials.push(material);
    scene.instances.push(Instance {
        name: "ground".into(),
        mesh: mesh_index as u32,
        transform: Affine3A {
            matrix3: Mat3A::from_diagonal(Vec3::new(half_size, 1.0, half_size)),
            translation: Vec3A::new(center.x, height, center.z),
        },
        materials: Arc::new([(scene.materials.len() - 1) as u32]),
    });
}

/// The square from (-1, 0, -1) to (1, 0, 1), facing up.
fn ground_mesh() -> Mesh {
    let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(|[x, z]| Vec3::new(x, 0.0, z));
    let mut mesh = Mesh::of_shapes("ground", corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]], Vec::new());
    mesh.hash = mesh_hash(&mesh);
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::tests::{camera, matte, scene, settings, sphere};
    use crate::settings::Integrator;

    fn with_ground(height: Option<f32>) -> Scene {
        let base = scene(vec![(sphere(), matte(0.5, 1.0), Affine3A::from_translation(Vec3::new(3.0, 5.0, 0.0)))]);
        let mut settings = settings(Integrator::Direct, camera(Vec3::ZERO, Vec3::Z, 3.0, 1.0), 0.0);
        settings.ground = Some(Ground { height, half_size: None, albedo: Vec3::new(0.1, 0.2, 0.3), roughness: 0.7 });
        with_overlays(&base, &settings)
    }

    #[test]
    fn the_ground_lies_under_the_scene_and_reaches_twenty_radii() {
        let scene = with_ground(None);
        assert_eq!((scene.meshes.len(), scene.instances.len(), scene.materials.len()), (2, 2, 2));
        let bounds = scene.instance_bounds(&scene.instances[1]);
        let radius = 3f32.sqrt();
        assert!((bounds.min.y - 4.0).abs() < 1e-3 && bounds.min.y < 4.0, "{bounds:?}");
        assert!((bounds.extent().x - 40.0 * radius).abs() < 1e-3 && (bounds.center().x - 3.0).abs() < 1e-4);
        assert_eq!(scene.materials[1].base_color, [0.1, 0.2, 0.3, 1.0]);
        assert_eq!(with_ground(Some(-2.0)).instance_bounds(&with_ground(Some(-2.0)).instances[1]).min.y, -2.0);
    }

    #[test]
    fn every_ground_is_the_same_mesh() {
        assert_eq!(with_ground(None).meshes[1].hash, with_ground(Some(9.0)).meshes[1].hash);
    }

    #[test]
    fn only_instances_with_alpha_are_filtered() {
        let mut scene = with_ground(None);
        scene.materials[0].alpha_mode = AlphaMode::Mask;
        assert_eq!(placements(&scene).iter().map(|p| p.filtered).collect::<Vec<_>>(), [true, false]);
    }
}
