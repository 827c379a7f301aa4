//! Meshes and instances into flat arrays.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{Affine3A, Mat3A};

use super::{
    INSTANCE_ALPHA, INSTANCE_MIRRORED, INSTANCE_SIMILARITY, NONE, PackError, PackedInstance, PackedMesh, index,
};
use crate::scene::{Aabb, AlphaMode, Instance, Mesh, Scene};

pub(super) struct Geometry {
    pub meshes: Vec<PackedMesh>,
    pub instances: Vec<PackedInstance>,
    pub positions: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub slots: Vec<u32>,
    pub spheres: Vec<[f32; 4]>,
    pub attributes: Vec<f32>,
    pub instance_materials: Vec<u32>,
    pub bounds: Aabb,
}

pub(super) fn pack_geometry(scene: &Scene) -> Result<Geometry, PackError> {
    let mut out = Geometry {
        meshes: Vec::with_capacity(scene.meshes.len()),
        instances: Vec::with_capacity(scene.instances.len()),
        positions: Vec::new(),
        triangles: Vec::new(),
        slots: Vec::new(),
        spheres: Vec::new(),
        attributes: Vec::new(),
        instance_materials: Vec::new(),
        bounds: Aabb::EMPTY,
    };
    for mesh in &scene.meshes {
        pack_mesh(mesh, &mut out)?;
    }
    let mut lists = MaterialLists::default();
    for (number, instance) in scene.instances.iter().enumerate() {
        let packed = pack_instance(scene, number, instance, &mut lists)?;
        out.instances.push(packed);
    }
    out.instance_materials = lists.materials;
    out.bounds = scene.world_bounds();
    index("vertices", out.positions.len())?;
    index("primitives", out.slots.len())?;
    index("vertex attribute values", out.attributes.len())?;
    index("instances", out.instances.len())?;
    index("instance materials", out.instance_materials.len())?;
    Ok(out)
}

fn pack_mesh(mesh: &Mesh, out: &mut Geometry) -> Result<(), PackError> {
    let invalid = |detail: String| PackError::InvalidScene(format!("mesh {:?}: {detail}", mesh.name));
    let vertices = mesh.positions.len();
    if let Some(i) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= vertices)) {
        return Err(invalid(format!("triangle {i} names a vertex beyond the {vertices} there are")));
    }
    if mesh.triangle_slots.len() != mesh.triangles.len() {
        let (slots, triangles) = (mesh.triangle_slots.len(), mesh.triangles.len());
        return Err(invalid(format!("has {slots} triangle slots for {triangles} triangles")));
    }
    let most = mesh.triangle_slots.iter().chain(mesh.spheres.iter().map(|s| &s.slot)).max();
    if let Some(slot) = most.filter(|&&slot| slot >= mesh.slots) {
        return Err(invalid(format!("names slot {slot} of {}", mesh.slots)));
    }
    let packed = PackedMesh {
        position_offset: index("vertices", out.positions.len())?,
        triangle_offset: index("triangles", out.triangles.len())?,
        triangle_count: index("triangles", mesh.triangles.len())?,
        sphere_offset: index("spheres", out.spheres.len())?,
        sphere_count: index("spheres", mesh.spheres.len())?,
        slot_offset: index("primitives", out.slots.len())?,
        normal_offset: append(
            &mut out.attributes,
            vertices,
            mesh.normals.len(),
            mesh.normals.iter().flat_map(|n| n.to_array()),
        )
        .map_err(|e| invalid(format!("normals {e}")))?,
        tangent_offset: append(
            &mut out.attributes,
            vertices,
            mesh.tangents.len(),
            mesh.tangents.iter().copied().flatten(),
        )
        .map_err(|e| invalid(format!("tangents {e}")))?,
        uv0_offset: append(&mut out.attributes, vertices, mesh.uv0.len(), mesh.uv0.iter().copied().flatten())
            .map_err(|e| invalid(format!("first texture coordinates {e}")))?,
        uv1_offset: append(&mut out.attributes, vertices, mesh.uv1.len(), mesh.uv1.iter().copied().flatten())
            .map_err(|e| invalid(format!("second texture coordinates {e}")))?,
        color_offset: append(&mut out.attributes, vertices, mesh.colors.len(), mesh.colors.iter().copied().flatten())
            .map_err(|e| invalid(format!("vertex colours {e}")))?,
        _pad: 0,
    };
    out.positions.extend(mesh.positions.iter().map(|p| p.to_array()));
    out.triangles.extend_from_slice(&mesh.triangles);
    out.spheres.extend(mesh.spheres.iter().map(|s| [s.center.x, s.center.y, s.center.z, s.radius]));
    out.slots.extend_from_slice(&mesh.triangle_slots);
    out.slots.extend(mesh.spheres.iter().map(|s| s.slot));
    out.meshes.push(packed);
    Ok(())
}

/// Appends a per-vertex attribute; its offset, or [`NONE`] where the mesh has none.
fn append(
    attributes: &mut Vec<f32>,
    vertices: usize,
    count: usize,
    values: impl Iterator<Item = f32>,
) -> Result<u32, String> {
    if count == 0 {
        return Ok(NONE);
    }
    if count != vertices {
        return Err(format!("are {count} for {vertices} vertices"));
    }
    let offset = index("vertex attribute values", attributes.len()).map_err(|e| e.to_string())?;
    attributes.extend(values);
    Ok(offset)
}

/// The materials of all instances, lists that instances share once.
#[derive(Default)]
struct MaterialLists {
    materials: Vec<u32>,
    /// Where each list begins, and the flags that its materials give to an instance; by the list's place in memory, so
    /// that a million instances do not cost a million looks at a long list.
    known: HashMap<*const [u32], (u32, u32)>,
}

impl MaterialLists {
    fn add(&mut self, scene: &Scene, list: &Arc<[u32]>) -> Result<(u32, u32), String> {
        if let Some(known) = self.known.get(&Arc::as_ptr(list)) {
            return Ok(*known);
        }
        let mut flags = 0;
        for &m in list.iter() {
            let there_are = scene.materials.len();
            let material = scene.materials.get(m as usize);
            let material = material.ok_or_else(|| format!("names material {m} of {there_are}"))?;
            if material.alpha_mode != AlphaMode::Opaque {
                flags |= INSTANCE_ALPHA;
            }
        }
        let base = index("instance materials", self.materials.len()).map_err(|e| e.to_string())?;
        self.materials.extend_from_slice(list);
        self.known.insert(Arc::as_ptr(list), (base, flags));
        Ok((base, flags))
    }
}

fn pack_instance(
    scene: &Scene,
    number: usize,
    instance: &Instance,
    lists: &mut MaterialLists,
) -> Result<PackedInstance, PackError> {
    let invalid =
        |detail: String| PackError::InvalidScene(format!("instance {number} ({:?}): {detail}", instance.name));
    let mesh = scene
        .meshes
        .get(instance.mesh as usize)
        .ok_or_else(|| invalid(format!("names mesh {} of {}", instance.mesh, scene.meshes.len())))?;
    if instance.materials.len() < mesh.slots as usize {
        let (given, slots) = (instance.materials.len(), mesh.slots);
        return Err(invalid(format!("has materials for {given} of the mesh's {slots} slots")));
    }
    let (material_base, mut flags) = lists.add(scene, &instance.materials).map_err(invalid)?;
    let matrix = instance.transform.matrix3;
    if matrix.determinant() < 0.0 {
        flags |= INSTANCE_MIRRORED;
    }
    if is_similarity(&matrix) {
        flags |= INSTANCE_SIMILARITY;
    }
    Ok(PackedInstance {
        object_to_world: rows(&instance.transform),
        world_to_object: rows(&inverse(&instance.transform)),
        mesh: instance.mesh,
        material_base,
        emitter_base: NONE,
        flags,
    })
}

/// The inverse, or zero for a transform that flattens the mesh (nothing hits such an instance).
fn inverse(transform: &Affine3A) -> Affine3A {
    let inverse = transform.inverse();
    if inverse.is_finite() && transform.matrix3.determinant() != 0.0 {
        inverse
    } else {
        Affine3A { matrix3: Mat3A::ZERO, translation: glam::Vec3A::ZERO }
    }
}

fn is_similarity(m: &Mat3A) -> bool {
    let (x, y, z) = (m.x_axis.length_squared(), m.y_axis.length_squared(), m.z_axis.length_squared());
    let tolerance = 1e-4 * x;
    (x - y).abs() <= tolerance
        && (x - z).abs() <= tolerance
        && m.x_axis.dot(m.y_axis).abs() <= tolerance
        && m.x_axis.dot(m.z_axis).abs() <= tolerance
        && m.y_axis.dot(m.z_axis).abs() <= tolerance
}

fn rows(t: &Affine3A) -> [[f32; 4]; 3] {
    let m = t.matrix3;
    [0, 1, 2].map(|r| [m.x_axis[r], m.y_axis[r], m.z_axis[r], t.translation[r]])
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};

    use super::*;

    #[test]
    fn rows_and_inverse_undo_each_other() {
        let t = Affine3A::from_scale_rotation_translation(
            Vec3::new(2.0, -0.5, 3.0),
            Quat::from_rotation_y(0.7),
            Vec3::new(4.0, 5.0, -6.0),
        );
        let p = Vec3::new(0.3, -1.0, 2.0);
        let world = crate::integrate::math::transform_point(&rows(&t), p);
        assert!((world - t.transform_point3(p)).length() < 1e-5);
        let back = crate::integrate::math::transform_point(&rows(&inverse(&t)), world);
        assert!((back - p).length() < 1e-5, "{back}");
    }

    #[test]
    fn flattened_instances_get_a_zero_inverse() {
        let flat = Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0));
        assert_eq!(rows(&inverse(&flat)), [[0.0; 4]; 3]);
    }

    #[test]
    fn only_even_scale_keeps_spheres() {
        let even = Affine3A::from_scale_rotation_translation(Vec3::splat(-3.0), Quat::from_rotation_x(1.0), Vec3::X);
        assert!(is_similarity(&even.matrix3));
        assert!(!is_similarity(&Mat3A::from_diagonal(Vec3::new(1.0, 1.0, 1.01))));
    }
}
