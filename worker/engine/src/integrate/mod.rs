//! Integrators, and what they share: random numbers, cameras, surfaces, materials, lights.
//!
//! One Rust file per WGSL file: plain functions over the packed arrays, `f32` throughout, no recursion, so that
//! `shaders/` can repeat them line by line and both devices give the same picture.

pub mod alpha;
pub mod bsdf;
pub mod camera;
pub mod environment;
pub mod math;
pub mod sampler;
pub mod surface;
pub mod texture;
