//! Whitted's ray tracer (1980): direct light everywhere, perfect mirrors where surfaces are smooth.
//!
//! A surface mirrors when its roughness is below [`MIRROR_ROUGHNESS`]; its specular lobe is then replaced by one
//! reflected ray, weighted by Schlick's Fresnel, which in a metal carries the base colour. Rougher surfaces reflect
//! lights by the full BSDF and mirror nothing. There is no indirect diffuse light.

use glam::Vec3;

use super::alpha::{AlphaFilter, alpha_seed};
use super::bsdf::{eval_bsdf, eval_cosine_lobes, make_bsdf, schlick};
use super::environment::environment_radiance;
use super::lights::{apparent_size, sample_light};
use super::math::{basis, is_finite, offset_origin, to_local};
use super::path::shadow_ray;
use super::sampler::{SET_PATH, SETS_PER_BOUNCE, pixel_seed, sample_4d_bits, unit_float};
use super::surface::{hit_point, shade_point};
use super::{Sample, Tally, primary_ray};
use crate::accel::Purpose;
use crate::pack::{MATERIAL_UNLIT, NONE, PackedScene};
use crate::trace::Ray;

/// Surfaces smoother than this are mirrors.
pub const MIRROR_ROUGHNESS: f32 = 0.25;

pub fn whitted_radiance(scene: &PackedScene, sample: Sample, max_bounces: u32, tally: &mut Tally) -> Vec3 {
    let seed = pixel_seed(sample.x, sample.y, sample.seed);
    let table = &scene.ggx_albedo;
    let mut ray = primary_ray(scene, sample);
    let mut throughput = Vec3::ONE;
    let mut radiance = Vec3::ZERO;
    for bounce in 0..=max_bounces {
        if bounce == 0 {
            tally.rays.primary += 1;
        } else {
            tally.rays.indirect += 1;
        }
        let filter = AlphaFilter { scene, seed: alpha_seed(seed, sample.index, 2 * bounce) };
        let Some(hit) = tally.nearest(scene, &ray, bounce, &filter) else {
            if scene.environment.light != NONE {
                radiance += throughput * environment_radiance(scene, ray.direction);
            }
            break;
        };
        let to_viewer = -ray.direction;
        let surface = shade_point(scene, &hit_point(scene, &ray, &hit), to_viewer);
        if surface.flags & MATERIAL_UNLIT != 0 {
            radiance += throughput * surface.base_color;
            break;
        }
        radiance += throughput * surface.emission;

        let (tangent, bitangent) = basis(surface.normal);
        let wo = to_local(tangent, bitangent, surface.normal, to_viewer);
        let bsdf = make_bsdf(table, surface.base_color, surface.metallic, surface.roughness, surface.dielectric_f0, wo);
        let is_mirror = surface.roughness < MIRROR_ROUGHNESS;
        let numbers = sample_4d_bits(seed, sample.index, SET_PATH + bounce * SETS_PER_BOUNCE);
        let (u, v) = (unit_float(numbers[1]), unit_float(numbers[2]));
        let light = sample_light(scene, surface.position, surface.normal, numbers[0], u, v);
        if light.pdf > 0.0 && light.direction.dot(surface.geometric_normal) > 0.0 {
            let wi = to_local(tangent, bitangent, surface.normal, light.direction);
            let reflected = if is_mirror { eval_cosine_lobes(table, &bsdf, wi) } else { eval_bsdf(table, &bsdf, wi) };
            let contribution = throughput * reflected * light.radiance * (1.0 / light.pdf);
            if contribution != Vec3::ZERO && is_finite(contribution) {
                tally.rays.shadow += 1;
                let filter = AlphaFilter { scene, seed: alpha_seed(seed, sample.index, 2 * bounce + 1) };
                let ray = shadow_ray(&surface, &light);
                let apparent = apparent_size(scene, numbers[0], light.distance);
                let purpose = Purpose { bounce, light: apparent, is_ambient: false };
                if !tally.blocked(scene, &ray, purpose, &filter) {
                    radiance += contribution;
                }
            }
        }

        if !is_mirror {
            break;
        }
        let wi = surface.normal * (2.0 * surface.normal.dot(to_viewer)) - to_viewer;
        throughput *= bsdf.f0 + (Vec3::ONE - bsdf.f0) * schlick(wo.z);
        if wi.dot(surface.geometric_normal) <= 0.0 || throughput == Vec3::ZERO {
            break;
        }
        ray = Ray::new(offset_origin(surface.position, surface.error, surface.geometric_normal, wi), wi);
    }
    radiance
}
