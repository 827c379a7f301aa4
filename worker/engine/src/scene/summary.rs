//! What a scene holds, in numbers: for listings, for budgets, and for people who wonder what they uploaded.

use std::collections::HashMap;
use std::sync::Arc;

use glam::Vec3;

use super::model::{Aabb, Instance, MeshHash, Projection, PunctualKind, Scene};

#[derive(Clone, Debug, PartialEq)]
pub struct SceneSummary {
    /// One entry per unique mesh.
    pub meshes: Vec<MeshSummary>,
    pub instances: u64,
    /// Over unique meshes.
    pub triangles_total: u64,
    /// Over all instances.
    pub triangles_instanced: u64,
    /// Over unique meshes.
    pub spheres_total: u64,
    /// Names.
    pub materials: Vec<String>,
    pub textures: u64,
    /// Pixels over all images.
    pub texture_pixels: u64,
    pub cameras: Vec<CameraSummary>,
    pub lights: Vec<LightSummary>,
    /// Triangles and spheres that emit, over all instances.
    pub emitters: u64,
    /// In world space; empty for a scene that shows nothing.
    pub bounds: Aabb,
    /// Geometry, textures and structures in memory, roughly.
    pub estimated_bytes: u64,
    pub warnings: Vec<String>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct MeshSummary {
    pub hash: MeshHash,
    pub name: String,
    pub triangles: u64,
    pub spheres: u64,
    pub instances: u64,
    /// In object space.
    pub bounds: Aabb,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraSummary {
    pub name: String,
    /// `perspective` or `orthographic`.
    pub kind: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LightSummary {
    pub name: String,
    /// `point`, `spot` or `directional`.
    pub kind: &'static str,
}

/// Bytes that structures take per triangle or sphere, and per instance.
const STRUCTURE_BYTES_PER_PRIMITIVE: u64 = 80;
const STRUCTURE_BYTES_PER_INSTANCE: u64 = 256;

impl Scene {
    pub fn summary(&self) -> SceneSummary {
        let mut meshes: Vec<MeshSummary> = self
            .meshes
            .iter()
            .map(|mesh| MeshSummary {
                hash: mesh.hash,
                name: mesh.name.clone(),
                triangles: mesh.triangles.len() as u64,
                spheres: mesh.spheres.len() as u64,
                instances: 0,
                bounds: mesh.bounds,
            })
            .collect();
        for instance in &self.instances {
            meshes[instance.mesh as usize].instances += 1;
        }
        let texture_pixels = self.images.iter().map(|image| u64::from(image.width) * u64::from(image.height)).sum();
        SceneSummary {
            instances: self.instances.len() as u64,
            triangles_total: meshes.iter().map(|mesh| mesh.triangles).sum(),
            triangles_instanced: meshes.iter().map(|mesh| mesh.triangles * mesh.instances).sum(),
            spheres_total: meshes.iter().map(|mesh| mesh.spheres).sum(),
            materials: self.materials.iter().map(|material| material.name.clone()).collect(),
            textures: self.textures.len() as u64,
            texture_pixels,
            cameras: self
                .cameras
                .iter()
                .map(|camera| CameraSummary {
                    name: camera.name.clone(),
                    kind: match camera.projection {
                        Projection::Perspective { .. } => "perspective",
                        Projection::Orthographic { .. } => "orthographic",
                    },
                })
                .collect(),
            lights: self
                .lights
                .iter()
                .map(|light| LightSummary {
                    name: light.name.clone(),
                    kind: match light.kind {
                        PunctualKind::Point => "point",
                        PunctualKind::Directional => "directional",
                        PunctualKind::Spot { .. } => "spot",
                    },
                })
                .collect(),
            emitters: self.emitter_count(),
            bounds: self.world_bounds(),
            estimated_bytes: self.estimated_bytes(texture_pixels),
            warnings: self.warnings.clone(),
            meshes,
        }
    }

    /// Bounds of all instances in world space; empty when there are none.
    pub fn world_bounds(&self) -> Aabb {
        self.instances.iter().fold(Aabb::EMPTY, |bounds, instance| bounds.union(self.instance_bounds(instance)))
    }

    /// Bounds of one instance in world space: those of its mesh's transformed box.
    pub fn instance_bounds(&self, instance: &Instance) -> Aabb {
        let object = self.meshes[instance.mesh as usize].bounds;
        let mut world = Aabb::EMPTY;
        for corner in 0..8_u32 {
            let pick = |axis: u32, low: f32, high: f32| if corner >> axis & 1 == 0 { low } else { high };
            let point = Vec3::new(
                pick(0, object.min.x, object.max.x),
                pick(1, object.min.y, object.max.y),
                pick(2, object.min.z, object.max.z),
            );
            world.grow(instance.transform.transform_point3(point));
        }
        world
    }

    fn emitter_count(&self) -> u64 {
        // Counted once per mesh and list of materials, since a million instances may share them.
        let per_slot: Vec<Vec<u64>> = self
            .meshes
            .iter()
            .map(|mesh| {
                let mut counts = vec![0; mesh.slots as usize];
                for slot in mesh.triangle_slots.iter().copied().chain(mesh.spheres.iter().map(|sphere| sphere.slot)) {
                    counts[slot as usize] += 1;
                }
                counts
            })
            .collect();
        let mut known: HashMap<(u32, *const [u32]), u64> = HashMap::new();
        let emits = |material: &u32| self.materials[*material as usize].emissive.max_element() > 0.0;
        self.instances
            .iter()
            .map(|instance| {
                *known.entry((instance.mesh, Arc::as_ptr(&instance.materials))).or_insert_with(|| {
                    let slots = per_slot[instance.mesh as usize].iter().zip(instance.materials.iter());
                    slots.filter(|(_, material)| emits(material)).map(|(count, _)| count).sum()
                })
            })
            .sum()
    }

    fn estimated_bytes(&self, texture_pixels: u64) -> u64 {
        let geometry: u64 = self
            .meshes
            .iter()
            .map(|mesh| {
                let vertices = mesh.positions.len() * 12
                    + mesh.normals.len() * 12
                    + mesh.tangents.len() * 16
                    + (mesh.uv0.len() + mesh.uv1.len()) * 8
                    + mesh.colors.len() * 16;
                (vertices + mesh.triangles.len() * 16 + mesh.spheres.len() * 20) as u64
                    + mesh.primitive_count() as u64 * STRUCTURE_BYTES_PER_PRIMITIVE
            })
            .sum();
        geometry + self.instances.len() as u64 * STRUCTURE_BYTES_PER_INSTANCE + texture_pixels * 4
    }
}
