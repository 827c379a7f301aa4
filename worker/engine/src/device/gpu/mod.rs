//! The GPU device: wgpu compute, wavefront kernels (Laine, Karras and Aila 2013, "Megakernels Considered Harmful").
//!
//! The shaders are in `shaders/`, one stage per file; they repeat `integrate/` line by line, so that both devices give
//! the same picture. Where there is no GPU, a software Vulkan such as Mesa's lavapipe runs them.

mod adapter;
mod build;
mod context;
mod flat;
mod gates;
mod layers;
mod pace;
mod pool;
mod renderer;
mod scene;
mod shader;
#[cfg(test)]
mod shader_tests;
mod shafts;
mod stages;
mod structure;
mod tracer;

use std::sync::Arc;

pub use adapter::{REQUIRED_STORAGE_BUFFERS, adapters, is_software};
pub use build::{BuiltLineSpace, LineSpaceBuilder};
pub use context::Context;
pub use shafts::{LocatedShaft, locate_shafts};
pub use structure::{HostStructure, MeshView, PlacementView};
pub use tracer::{Batch, Kernel, Tracer};

use structure::Kept;

use super::{Device, DeviceError, DeviceInfo, Renderer};
use crate::pack::PackedScene;
use crate::settings::RenderSettings;

/// One adapter, opened.
pub struct GpuDevice {
    context: Arc<Context>,
    structure: Kept,
    builder: Arc<LineSpaceBuilder>,
}

impl GpuDevice {
    /// Opens the preferred adapter, or the first whose name contains `adapter` (case-insensitive).
    ///
    /// # Errors
    /// [`DeviceError::NoAdapter`] with a list of what there is, or with what the adapter lacks.
    pub fn open(adapter: Option<&str>) -> Result<Self, DeviceError> {
        let context = Arc::new(Context::open(adapter)?);
        context.check_can_shade()?;
        Ok(Self::with_context(context))
    }

    /// The device that renders on `context`, for whoever shares it.
    pub fn with_context(context: Arc<Context>) -> Self {
        let builder = Arc::new(LineSpaceBuilder::new(Arc::clone(&context)));
        Self { context, structure: Kept::default(), builder }
    }

    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }
}

impl Device for GpuDevice {
    fn info(&self) -> DeviceInfo {
        self.context.info.clone()
    }

    fn prepare(
        &mut self,
        scene: Arc<PackedScene>,
        settings: &RenderSettings,
    ) -> Result<Box<dyn Renderer>, DeviceError> {
        if !scene.accel.is_flat() && scene.accel.structures().iter().any(|structure| structure.bvh().is_none()) {
            return Err(DeviceError::Other(
                "the GPU walks two levels of BVHs, or one structure over everything".into(),
            ));
        }
        // A job before this one may have lost the device.
        if self.context.check().is_err() {
            *self = Self::with_context(Arc::new(self.context.reopen()?));
        }
        let structure = self.structure.of_scene(&self.context, &scene)?;
        let renderer = renderer::GpuRenderer::new(self.context.clone(), structure, scene, settings)?;
        Ok(Box::new(renderer))
    }

    fn line_space_builder(&self) -> Option<Arc<LineSpaceBuilder>> {
        Some(Arc::clone(&self.builder))
    }
}
