//! The GPU device against the CPU and a brute-force oracle. Runs on whatever adapter wgpu prefers (lavapipe where there
//! is no GPU) and fails where there is none: a GPU path that nobody runs would rot.

mod builds;
#[path = "../common/mod.rs"]
mod common;
mod failures;
mod flat;
mod gates;
#[path = "../line_space/meshes.rs"]
mod hard_meshes;
mod pictures;
mod portability;
mod scenes;
mod shafts;
mod submits;
mod traversal;

use std::sync::{Arc, OnceLock};

use lightshaft_engine::device::gpu::Context;

/// One device for all tests, so that each kernel is compiled once.
fn context() -> Arc<Context> {
    static CONTEXT: OnceLock<Arc<Context>> = OnceLock::new();
    CONTEXT.get_or_init(|| context_within(u32::MAX, u64::MAX)).clone()
}

/// A device of its own, which binds no more than so many storage buffers of so many bytes.
fn context_within(storage_buffers: u32, binding_bytes: u64) -> Arc<Context> {
    let adapter = std::env::var("LIGHTSHAFT_ADAPTER").ok();
    let context = Context::open_within(adapter.as_deref(), storage_buffers, binding_bytes);
    Arc::new(context.expect("tests need an adapter (mesa-vulkan-drivers has one)"))
}
