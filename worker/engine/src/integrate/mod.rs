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
pub mod usage;
pub mod whitted;

#[cfg(test)]
pub(crate) mod tests;

use glam::Vec3;

use self::alpha::AlphaFilter;
use self::usage::Usage;
use crate::accel::Purpose;
use crate::device::RayCounts;
use crate::pack::PackedScene;
use crate::settings::Integrator;
use crate::trace::{Counters, Hit, Ray};

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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    pub rays: RayCounts,
    pub counters: Counters,
    /// What Line Spaces did for them, where someone wants to know.
    usage: Option<Usage>,
}

impl Tally {
    /// The nearest hit of a ray that leaves its `bounce`-th bounce (0: the camera).
    #[inline]
    fn nearest(&mut self, scene: &PackedScene, ray: &Ray, bounce: u32, filter: &AlphaFilter<'_>) -> Option<Hit> {
        let Some(usage) = &mut self.usage else {
            return scene.accel.nearest(ray, bounce, filter, &mut self.counters);
        };
        let mut counters = Counters::default();
        let hit = scene.accel.nearest(ray, bounce, filter, &mut counters);
        usage.add(&counters, false);
        self.counters += counters;
        hit
    }

    /// Whether an occlusion ray is blocked.
    #[inline]
    fn blocked(&mut self, scene: &PackedScene, ray: &Ray, purpose: Purpose, filter: &AlphaFilter<'_>) -> bool {
        let Some(usage) = &mut self.usage else {
            return scene.accel.blocked(ray, purpose, filter, &mut self.counters);
        };
        let mut counters = Counters::default();
        let is_blocked = scene.accel.blocked(ray, purpose, filter, &mut counters);
        usage.add(&counters, is_blocked);
        usage.meet(scene.accel.largest_gamma(ray, purpose));
        self.counters += counters;
        is_blocked
    }
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
