//! The GPU device against the CPU and a brute-force oracle. Runs on whatever adapter wgpu prefers (lavapipe where there
//! is no GPU) and fails where there is none: a GPU path that nobody runs would rot.

#[path = "../common/mod.rs"]
mod common;
mod failures;
mod pictures;
mod portability;
mod scenes;
mod shafts;
mod traversal;

use std::sync::{Arc, OnceLock};

use lightshaft_engine::device::gpu::Context;

/// One device for all tests, so that each kernel is compiled once.
fn context() -> Arc<Context> {
    static CONTEXT: OnceLock<Arc<Context>> = OnceLock::new();
    CONTEXT
        .get_or_init(|| {
            let adapter = std::env::var("LIGHTSHAFT_ADAPTER").ok();
            Arc::new(Context::open(adapter.as_deref()).expect("tests need an adapter (mesa-vulkan-drivers has one)"))
        })
        .clone()
}
