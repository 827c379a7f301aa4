//! Path tracing: next-event estimation and BSDF sampling, combined by the power heuristic; Russian roulette.
//!
//! A path is a small state that [`path_hit`] and [`path_miss`] advance by one vertex, as the GPU's wavefront does. The
//! light that a BSDF-sampled ray finds at vertex `n + 1` belongs to the direct light of vertex `n`; so a path with
//! `max_bounces = 0` is direct light with soft shadows, and `max_bounces = 4` allows four indirect bounces behind the
//! first hit.
//!
//! Occlusion textures are ignored on import: they stand for ambient visibility, which rays find out here.

use glam::Vec3;

use super::alpha::{AlphaFilter, alpha_seed};
use super::bsdf::{Bsdf, eval_bsdf, make_bsdf, sample_bsdf};
use super::environment::{environment_pdf, environment_radiance};
use super::lights::{LightSample, apparent_size, emitter_pdf, sample_light};
use super::math::{basis, is_finite, offset_origin, power_heuristic, to_local, to_world};
use super::sampler::{SET_PATH, SETS_PER_BOUNCE, pixel_seed, sample_4d, sample_4d_bits, unit_float};
use super::surface::{Surface, hit_point, shade_point};
use super::{Sample, Tally, primary_ray};
use crate::accel::Purpose;
use crate::pack::{MATERIAL_UNLIT, NONE, PackedScene};
use crate::trace::{Hit, Ray};

/// Vertices before which no path is ended by Russian roulette.
const ROULETTE_START: u32 = 3;
/// No path survives with certainty, so that closed white rooms end too.
const MAX_SURVIVAL: f32 = 0.95;
/// Bound on the rounding error of where a shadow ray meets its light, relative to the largest coordinates of its ends:
/// 64 half units in the last place, because GPUs' divisions and roots may each be off by five.
const SHADOW_ERROR: f32 = 4.0 * super::math::LOCAL_ERROR;

#[derive(Clone, Copy, Debug)]
pub struct PathState {
    pub ray: Ray,
    pub throughput: Vec3,
    pub radiance: Vec3,
    /// Density with which the BSDF sampled `ray`; 0 for the camera's ray, to which no other technique competes.
    pub pdf: f32,
    /// Density with which the previous vertex's light sampling would find the environment in this direction.
    pub environment_pdf: f32,
    /// Number of the vertex that `ray` leads to.
    pub bounce: u32,
}

/// A connection to a light, and what it adds to the path's radiance if nothing is in between.
#[derive(Clone, Copy, Debug)]
pub struct ShadowRay {
    pub ray: Ray,
    pub contribution: Vec3,
    /// Size of the light by its distance.
    pub light: f32,
}

/// What a vertex leads to.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    pub shadow: Option<ShadowRay>,
    /// Whether `state.ray` is to be traced on.
    pub alive: bool,
}

const ENDED: Step = Step { shadow: None, alive: false };

pub fn path_radiance(scene: &PackedScene, sample: Sample, max_bounces: u32, tally: &mut Tally) -> Vec3 {
    let seed = pixel_seed(sample.x, sample.y, sample.seed);
    let mut state = PathState {
        ray: primary_ray(scene, sample),
        throughput: Vec3::ONE,
        radiance: Vec3::ZERO,
        pdf: 0.0,
        environment_pdf: 0.0,
        bounce: 0,
    };
    loop {
        if state.bounce == 0 {
            tally.rays.primary += 1;
        } else {
            tally.rays.indirect += 1;
        }
        let filter = AlphaFilter { scene, seed: alpha_seed(seed, sample.index, 2 * state.bounce) };
        let Some(hit) = tally.nearest(scene, &state.ray, state.bounce, &filter) else {
            path_miss(scene, &mut state);
            break;
        };
        let bounce = state.bounce;
        let step = path_hit(scene, &mut state, &hit, seed, sample.index, max_bounces);
        if let Some(shadow) = step.shadow {
            tally.rays.shadow += 1;
            let filter = AlphaFilter { scene, seed: alpha_seed(seed, sample.index, 2 * bounce + 1) };
            let purpose = Purpose { bounce, light: shadow.light, is_ambient: false };
            if !tally.blocked(scene, &shadow.ray, purpose, &filter) {
                state.radiance += shadow.contribution;
            }
        }
        if !step.alive {
            break;
        }
    }
    state.radiance
}

/// Adds the environment's light; the path ends.
pub fn path_miss(scene: &PackedScene, state: &mut PathState) {
    if scene.environment.light == NONE {
        return;
    }
    let weight = if state.pdf > 0.0 { power_heuristic(state.pdf, state.environment_pdf) } else { 1.0 };
    state.radiance += state.throughput * environment_radiance(scene, state.ray.direction) * weight;
}

/// Adds the light that the hit surface emits, connects it to a light, and scatters the path.
pub fn path_hit(
    scene: &PackedScene,
    state: &mut PathState,
    hit: &Hit,
    pixel_seed: u32,
    sample_index: u32,
    max_bounces: u32,
) -> Step {
    let to_viewer = -state.ray.direction;
    let surface = shade_point(scene, &hit_point(scene, &state.ray, hit), to_viewer);
    if surface.flags & MATERIAL_UNLIT != 0 {
        state.radiance += state.throughput * surface.base_color;
        return ENDED;
    }
    if surface.emission != Vec3::ZERO {
        let mut weight = 1.0;
        if state.pdf > 0.0 {
            let (from, n) = (state.ray.origin, surface.geometric_normal);
            let light_pdf = emitter_pdf(scene, hit.instance, hit.primitive, from, surface.position, n);
            weight = power_heuristic(state.pdf, light_pdf);
        }
        state.radiance += state.throughput * surface.emission * weight;
    }
    if state.bounce > max_bounces {
        return ENDED;
    }

    let (tangent, bitangent) = basis(surface.normal);
    let wo = to_local(tangent, bitangent, surface.normal, to_viewer);
    let bsdf = make_bsdf(
        &scene.ggx_albedo,
        surface.base_color,
        surface.metallic,
        surface.roughness,
        surface.dielectric_f0,
        wo,
    );
    let set = SET_PATH + state.bounce * SETS_PER_BOUNCE;
    let numbers = sample_4d_bits(pixel_seed, sample_index, set);
    let shadow = connect(scene, &surface, &bsdf, tangent, bitangent, state.throughput, numbers);

    let directions = sample_4d(pixel_seed, sample_index, set + 1);
    let sampled = sample_bsdf(&scene.ggx_albedo, &bsdf, directions[0], directions[1], directions[2]);
    let wi = to_world(tangent, bitangent, surface.normal, sampled.wi);
    let throughput = state.throughput * sampled.weight;
    let largest = throughput.x.max(throughput.y).max(throughput.z);
    if sampled.pdf <= 0.0 || wi.dot(surface.geometric_normal) <= 0.0 || largest <= 0.0 || !is_finite(throughput) {
        return Step { shadow, alive: false };
    }
    state.throughput = throughput;
    if state.bounce >= ROULETTE_START {
        let survival = largest.min(MAX_SURVIVAL);
        if unit_float(numbers[3]) >= survival {
            return Step { shadow, alive: false };
        }
        state.throughput *= 1.0 / survival;
    }
    state.pdf = sampled.pdf;
    state.environment_pdf = 0.0;
    if scene.environment.light != NONE {
        let selection = scene.lights[scene.environment.light as usize].selection;
        state.environment_pdf = selection * environment_pdf(scene, surface.normal, wi);
    }
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, wi);
    state.ray = Ray::new(origin, wi);
    state.bounce += 1;
    Step { shadow, alive: true }
}

/// Next-event estimation: one light, one point on it, weighted against BSDF sampling.
fn connect(
    scene: &PackedScene,
    surface: &Surface,
    bsdf: &Bsdf,
    tangent: Vec3,
    bitangent: Vec3,
    throughput: Vec3,
    numbers: [u32; 4],
) -> Option<ShadowRay> {
    let (u, v) = (unit_float(numbers[1]), unit_float(numbers[2]));
    let light = sample_light(scene, surface.position, surface.normal, numbers[0], u, v);
    if light.pdf <= 0.0 || light.direction.dot(surface.geometric_normal) <= 0.0 {
        return None;
    }
    let wi = to_local(tangent, bitangent, surface.normal, light.direction);
    let reflected = eval_bsdf(&scene.ggx_albedo, bsdf, wi);
    let weight = if light.is_delta { 1.0 } else { power_heuristic(light.pdf, super::bsdf::pdf_bsdf(bsdf, wi)) };
    let contribution = throughput * reflected * light.radiance * (weight / light.pdf);
    if contribution == Vec3::ZERO || !is_finite(contribution) {
        return None;
    }
    let apparent = apparent_size(scene, numbers[0], light.distance);
    Some(ShadowRay { ray: shadow_ray(surface, &light), contribution, light: apparent })
}

/// The segment from a surface to a light. It ends at a punctual light itself, which nothing can hit; short of an area
/// light by the bound on rounding errors, since the light is no occluder to itself.
pub fn shadow_ray(surface: &Surface, light: &LightSample) -> Ray {
    let origin = offset_origin(surface.position, surface.error, surface.geometric_normal, light.direction);
    if light.distance == f32::INFINITY {
        return Ray::new(origin, light.direction);
    }
    let to_light = light.direction * light.distance - (origin - surface.position);
    let mut t_max = 1.0;
    if !light.is_delta {
        let error = (largest_component(origin) + largest_component(to_light)) * SHADOW_ERROR;
        t_max = (1.0 - error / light.distance).max(0.0);
    }
    Ray { origin, t_min: 0.0, direction: to_light, t_max }
}

fn largest_component(v: Vec3) -> f32 {
    v.x.abs().max(v.y.abs()).max(v.z.abs())
}
