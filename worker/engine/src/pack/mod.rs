//! The packed scene: one set of flat arrays that the CPU shades from and the GPU uploads as they are.
//!
//! Both devices read the same numbers with the same arithmetic, so that their pictures agree. Every struct here has a
//! mirror in `shaders/shared/scene.wgsl`; a test compares sizes and offsets with naga's layout.

mod layout;

pub use layout::*;

use std::sync::Arc;

use glam::Vec3;

use crate::accel::SceneAccel;
use crate::scene::Aabb;

/// Everything a device needs to trace and shade one scene under one job's lights.
#[derive(Debug)]
pub struct PackedScene {
    pub meshes: Vec<PackedMesh>,
    pub instances: Vec<PackedInstance>,
    /// Object-space vertex positions of all meshes, one after the other.
    pub positions: Vec<[f32; 3]>,
    /// Vertex numbers relative to the mesh's `position_offset`.
    pub triangles: Vec<[u32; 3]>,
    /// Material slot of every primitive: per mesh first its triangles, then its spheres.
    pub slots: Vec<u32>,
    /// Centre and radius.
    pub spheres: Vec<[f32; 4]>,
    /// Normals, tangents, UVs and colours; each mesh's arrays start where its [`PackedMesh`] says.
    pub attributes: Vec<f32>,
    /// Material of slot `s` of an instance: `instance_materials[instance.material_base + s]`.
    pub instance_materials: Vec<u32>,
    pub materials: Vec<PackedMaterial>,
    pub textures: Vec<PackedTexture>,
    /// RGBA8 texels of all images, red in the low byte.
    pub texels: Vec<u32>,
    pub lights: Vec<PackedLight>,
    /// Inclusive cumulative selection probabilities, as long as `lights`, last value 1.
    pub light_cdf: Vec<f32>,
    /// Light number of each primitive of instances that emit: `emitter_lights[instance.emitter_base + primitive]`.
    pub emitter_lights: Vec<u32>,
    pub environment: PackedEnvironment,
    /// Linear radiance of the environment map, `width * height` texels; empty for a constant environment.
    pub environment_texels: Vec<[f32; 4]>,
    /// Inclusive cumulative probabilities of the rows (`height`), then of the texels in each row (`width * height`).
    pub environment_cdf: Vec<f32>,
    /// Directional albedo of the GGX lobe, for energy compensation (layout: see `integrate`).
    pub ggx_albedo: Vec<f32>,
    pub bounds: Aabb,
    pub accel: Arc<SceneAccel>,
}

impl PackedScene {
    /// Radius of the sphere around `bounds`, at least the smallest positive number.
    pub fn radius(&self) -> f32 {
        if self.bounds.is_empty() { 1.0 } else { (0.5 * self.bounds.extent()).length().max(f32::MIN_POSITIVE) }
    }

    pub fn center(&self) -> Vec3 {
        if self.bounds.is_empty() { Vec3::ZERO } else { self.bounds.center() }
    }
}
