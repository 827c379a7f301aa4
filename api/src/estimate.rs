//! What a job will take, as far as can be told before it runs.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Bytes from what is known of the scene and the settings, seconds from what was measured of jobs like it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Estimate {
    /// Geometry, textures and structures in a worker's memory, roughly.
    pub scene_bytes: u64,
    /// Line Spaces at most, of an N-tree roughly; 0 without, and null of kinds that neither render nor build.
    pub line_space_bytes: Option<u64>,
    /// The picture with its layers in single precision, while it is rendered; 0 for kinds that do not render.
    pub picture_bytes: u64,
    /// All of these that are known.
    pub bytes: u64,
    /// Rendering alone, without fetching and building; null while nothing like it was measured.
    pub render_s: Option<f64>,
    /// What `render_s` rests on.
    pub measured: Option<MeasuredJobs>,
}

/// Jobs with the same integrator on one device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MeasuredJobs {
    pub jobs: u32,
    /// Whether they rendered the same scene.
    pub same_scene: bool,
    pub device: String,
    /// Median.
    pub mrays_per_s: f64,
    /// Rays of all kinds for each sample of a pixel, median.
    pub rays_per_sample: f64,
}
