//! Lightshaft's engine: everything that touches a ray.
//!
//! It knows nothing of HTTP, jobs or databases. The road through it:
//!
//! ```text
//! scene::import ─► scene::Scene ─► accel (one structure per unique mesh) ─┐
//!                       └────────► pack::PackedScene ◄────────────────────┘
//!                                        └─► device (cpu | gpu) ─► film ─► PNG, EXR
//! ```

pub mod accel;
pub mod device;
pub mod film;
pub mod integrate;
pub mod pack;
pub mod scene;
pub mod settings;
pub mod trace;

/// Version of the engine, as reported in metrics.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
