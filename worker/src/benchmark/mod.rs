//! Benchmarks: configurations of spatial structures against a reference, over the same rays, in the same minutes.
//!
//! ```text
//! plan (what, from settings or a preset) ─► stage (light, views) ─► build (each from nothing) ─► measure (interleaved)
//!                                                                                        └─► report (tables, CSV)
//! ```
//!
//! One comparison is a scene, an effect, a reference and some configurations. Pictures come first: they warm everything
//! up and say how far each is from the reference's. Then come rounds, in each of which every configuration is timed
//! once, between two times of the reference. Rays are a pure function of pixel, sample and seed, so all configurations
//! trace the same ones until an approximation changes a path.
//!
//! `lightshaft bench` and benchmark jobs come here; neither knows more than the other.

mod build;
mod measure;
mod plan;
mod presets;
pub mod report;
mod run;
mod stage;

pub use plan::{SceneInput, Scenes};
pub use presets::{Generate, KnownFile, Preset, PresetScene, load};
pub use run::BenchmarkOutputs;
