//! Integrators, and what they share: random numbers, cameras, surfaces, materials, lights.
//!
//! One Rust file per WGSL file: plain functions over the packed arrays, `f32` throughout, no recursion, so that
//! `shaders/` can repeat them line by line and both devices give the same picture. A sample's value depends on its
//! pixel, its number and the seed only.

pub mod alpha;
pub mod ao;
pub mod aov;
pub mod bsdf;
pub mod camera;
pub mod environment;
pub mod lights;
pub mod math;
pub mod path;
pub mod sampler;
pub mod surface;
pub mod texture;
pub mod whitted;

#[cfg(test)]
pub(crate) mod tests;

use glam::Vec3;

use crate::device::RayCounts;
use crate::pack::PackedScene;
use crate::settings::Integrator;
use crate::trace::{Counters, Ray};

/// Which sample of which pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    pub x: u32,
    pub y: u32,
    pub index: u32,
    /// The job's seed.
    pub seed: u32,
}

/// Rays traced and the work they did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    pub rays: RayCounts,
    pub counters: Counters,
}

/// The camera's ray of a sample: uniform over the pixel (a box filter of one pixel).
pub fn primary_ray(scene: &PackedScene, sample: Sample) -> Ray {
    let seed = sampler::pixel_seed(sample.x, sample.y, sample.seed);
    let numbers = sampler::sample_4d(seed, sample.index, sampler::SET_CAMERA);
    camera::camera_ray(&scene.camera, sample.x, sample.y, numbers[0], numbers[1])
}

/// Linear radiance of one sample; never NaN or infinite.
pub fn radiance(scene: &PackedScene, integrator: Integrator, sample: Sample, tally: &mut Tally) -> Vec3 {
    let value = match integrator {
        Integrator::Aov => aov::normal_radiance(scene, sample, tally),
        Integrator::Ao { samples, distance } => ao::ao_radiance(scene, sample, samples, distance, tally),
        Integrator::Direct => path::path_radiance(scene, sample, 0, tally),
        Integrator::Whitted { max_bounces } => whitted::whitted_radiance(scene, sample, max_bounces, tally),
        Integrator::Path { max_bounces } => path::path_radiance(scene, sample, max_bounces, tally),
    };
    if math::is_finite(value) { value } else { Vec3::ZERO }
}
