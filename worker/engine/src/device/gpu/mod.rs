//! The GPU device: wgpu compute, wavefront kernels.

mod adapter;
mod context;
mod pool;
mod shader;
mod structure;
mod tracer;
mod wide;

pub use adapter::{REQUIRED_STORAGE_BUFFERS, adapters, is_software};
pub use context::Context;
pub use structure::{HostStructure, MeshView, PlacementView};
pub use tracer::{Batch, Kernel, Tracer};
