//! Alpha mask and alpha blend, decided hit by hit.
//!
//! A blended surface lets a ray through with probability `1 - alpha` (stochastic transparency). The decision hashes the
//! ray's seed, the instance and the primitive, never the order in which candidates are found, so every structure and
//! device decides alike. Each ray of a path has a seed of its own: what the camera ray saw says nothing about shadows.

use super::math::transform_vector;
use super::sampler::{hash_combine, unit_float};
use super::surface::{base_color, hit_point, material_index, sphere_direction};
use crate::accel::HitFilter;
use crate::pack::{MATERIAL_ALPHA_BLEND, MATERIAL_ALPHA_MASK, PackedScene};
use crate::trace::{Hit, Ray};

/// Seed under which blended surfaces are seen where alpha is at least a half: for layers that must not be noisy.
pub const SEED_HALF: u32 = u32::MAX;

/// The seed of ray number `ray_number` of one pixel sample.
pub fn alpha_seed(pixel_seed: u32, sample: u32, ray_number: u32) -> u32 {
    hash_combine(hash_combine(pixel_seed ^ 0x5bd1_e995, sample), ray_number) & 0x7fff_ffff
}

/// Whether a candidate hit counts.
pub fn alpha_accepts(scene: &PackedScene, seed: u32, ray: &Ray, hit: &Hit) -> bool {
    let instance = &scene.instances[hit.instance as usize];
    let mesh = &scene.meshes[instance.mesh as usize];
    let material = &scene.materials[material_index(scene, instance, mesh, hit.primitive) as usize];
    if material.flags & (MATERIAL_ALPHA_MASK | MATERIAL_ALPHA_BLEND) == 0 {
        return true;
    }
    let alpha = base_color(scene, material, &hit_point(scene, ray, hit))[3];
    if material.flags & MATERIAL_ALPHA_MASK != 0 {
        return alpha >= material.alpha_cutoff;
    }
    if seed == SEED_HALF {
        return alpha >= 0.5;
    }
    let mut key = hash_combine(hash_combine(seed, hit.instance), hit.primitive);
    if hit.primitive >= mesh.triangle_count {
        // A ray meets a sphere twice, and each wall decides for itself.
        let n = sphere_direction(scene, instance, hit.primitive, ray, hit.t);
        let ahead = transform_vector(&instance.world_to_object, ray.direction);
        key = hash_combine(key, u32::from(n.dot(ahead) > 0.0));
    }
    unit_float(key) < alpha
}

/// [`alpha_accepts`] for the CPU's kernels.
pub struct AlphaFilter<'a> {
    pub scene: &'a PackedScene,
    pub seed: u32,
}

impl HitFilter for AlphaFilter<'_> {
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool {
        alpha_accepts(self.scene, self.seed, ray, hit)
    }
}
