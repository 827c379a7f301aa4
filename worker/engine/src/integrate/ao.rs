//! Ambient occlusion: the share of cosine-weighted directions in which nothing lies within reach.

use glam::Vec3;

use super::alpha::{AlphaFilter, alpha_seed};
use super::math::{basis, cosine_hemisphere, offset_origin, to_world};
use super::sampler::{SET_AO, pixel_seed, sample_4d};
use super::surface::{hit_point, shade_point};
use super::{Sample, Tally, primary_ray};
use crate::accel::Purpose;
use crate::pack::PackedScene;
use crate::trace::Ray;

/// Grey 0..1; 1 where the camera's ray meets nothing. `distance` is in world units.
///
/// Directions are distributed about the shading normal; those that would start below the surface are mirrored at it,
/// so that smooth shading of coarse meshes brings no dark rims.
pub fn ao_radiance(scene: &PackedScene, sample: Sample, samples: u32, distance: f32, tally: &mut Tally) -> Vec3 {
    let seed = pixel_seed(sample.x, sample.y, sample.seed);
    let ray = primary_ray(scene, sample);
    tally.rays.primary += 1;
    let filter = AlphaFilter { scene, seed: alpha_seed(seed, sample.index, 0) };
    let Some(hit) = tally.nearest(scene, &ray, 0, &filter) else {
        return Vec3::ONE;
    };
    let surface = shade_point(scene, &hit_point(scene, &ray, &hit), -ray.direction);
    let (tangent, bitangent) = basis(surface.normal);
    let samples = samples.max(1);
    let mut open = 0u32;
    for k in 0..samples {
        let numbers = sample_4d(seed, sample.index.wrapping_mul(samples).wrapping_add(k), SET_AO);
        let local = cosine_hemisphere(numbers[0], numbers[1]);
        let mut direction = to_world(tangent, bitangent, surface.normal, local);
        let below = direction.dot(surface.geometric_normal);
        if below < 0.0 {
            direction -= surface.geometric_normal * (2.0 * below);
        }
        let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, direction);
        let ray = Ray { origin, t_min: 0.0, direction, t_max: distance };
        let filter = AlphaFilter { scene, seed: alpha_seed(seed, sample.index, 1 + k) };
        tally.rays.ao += 1;
        let purpose = Purpose { bounce: 0, light: 1.0, is_ambient: true };
        if !tally.blocked(scene, &ray, purpose, &filter) {
            open += 1;
        }
    }
    Vec3::splat(open as f32 / samples as f32)
}
