//! Devices: a device renders passes over a packed scene. `cpu` is native Rust, `gpu` is wgpu compute.

use std::sync::Arc;

use crate::film::{AovBuffers, PassFilm};
use crate::pack::PackedScene;
use crate::settings::RenderSettings;
use crate::trace::Counters;

pub mod cpu;
pub mod gpu;

#[derive(Clone, Debug, PartialEq)]
pub struct DeviceInfo {
    /// `cpu` or `gpu`.
    pub kind: &'static str,
    /// Such as `AVX2, 2 threads` or the adapter's name.
    pub name: String,
    /// GPU only: driver name and version.
    pub driver: String,
    /// `Vulkan`, `Metal`, `Dx12`; empty for the CPU.
    pub backend: String,
    /// `DiscreteGpu`, `IntegratedGpu`, `VirtualGpu`, `Cpu`.
    pub device_type: String,
    /// Largest storage-buffer binding, bytes (GPU only).
    pub max_binding_bytes: u64,
}

#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// No adapter, or none of the asked name: the message lists what there is.
    #[error("no GPU: {0}")]
    NoAdapter(String),
    /// The scene cannot be held by this device.
    #[error("{0}")]
    TooLarge(String),
    /// Lost, and a retry on a new device failed as well.
    #[error("the GPU was lost: {0}")]
    Lost(String),
    #[error("the render was cancelled")]
    Cancelled,
    #[error("{0}")]
    Other(String),
}

/// A rectangle of pixels; `x` to the right, `y` down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
}

impl Region {
    pub fn full(settings: &RenderSettings) -> Self {
        Self { x: 0, y: 0, width: settings.width, height: settings.height }
    }

    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Whether `inner` lies within this region and has pixels.
    pub fn contains(&self, inner: Region) -> bool {
        let end = |start: u32, length: u32| u64::from(start) + u64::from(length);
        inner.width > 0
            && inner.height > 0
            && inner.x >= self.x
            && inner.y >= self.y
            && end(inner.x, inner.width) <= end(self.x, self.width)
            && end(inner.y, inner.height) <= end(self.y, self.height)
    }

    /// The error of a pass that does not lie within what its film covers.
    fn check_within(self, outer: Self) -> Result<(), DeviceError> {
        if outer.contains(self) && u32::try_from(self.pixels()).is_ok() {
            return Ok(());
        }
        Err(DeviceError::Other(format!("the pass covers {self:?}, the film {outer:?}")))
    }

    /// For each pixel, row by row, its place in a row-major buffer over `target`, which must contain this region.
    pub(crate) fn places_in(self, target: Self) -> impl Iterator<Item = usize> {
        let first = (self.y - target.y) as usize * target.width as usize + (self.x - target.x) as usize;
        (0..self.height as usize).flat_map(move |row| {
            let start = first + row * target.width as usize;
            start..start + self.width as usize
        })
    }
}

/// Samples `first_sample .. first_sample + samples` of every pixel in `region`.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    pub region: Region,
    pub first_sample: u32,
    pub samples: u32,
}

/// Rays traced, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCounts {
    pub primary: u64,
    pub shadow: u64,
    pub ao: u64,
    pub indirect: u64,
}

impl RayCounts {
    pub fn total(&self) -> u64 {
        self.primary + self.shadow + self.ao + self.indirect
    }
}

impl std::ops::AddAssign for RayCounts {
    fn add_assign(&mut self, other: Self) {
        self.primary += other.primary;
        self.shadow += other.shadow;
        self.ao += other.ao;
        self.indirect += other.indirect;
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub struct PassStats {
    pub rays: RayCounts,
    pub counters: Counters,
    /// Seconds in which rays were traced and shaded (without upload and read-back).
    pub seconds: f64,
    /// GPU only: the most seconds that the device was held at a stretch, once its kernels were compiled.
    pub longest_submit_s: f64,
}

/// Whoever ordered a pass: may end it, and is told how far it is. A closure that answers whether to stop will do.
pub trait Watch: Sync {
    /// Asked between tiles: rendering stops within one tile (tens of milliseconds) once it answers true.
    fn cancelled(&self) -> bool;

    /// Told after every tile or slice: the share of the pass that is done, 0 to 1. Threads may tell out of order, and a
    /// tile that is lost with its device is told of again.
    fn progress(&self, _done: f64) {}
}

impl<F: Fn() -> bool + Sync> Watch for F {
    fn cancelled(&self) -> bool {
        self()
    }
}

pub trait Device: Send {
    fn info(&self) -> DeviceInfo;

    /// Uploads the scene (a no-op on the CPU).
    fn prepare(&mut self, scene: Arc<PackedScene>, settings: &RenderSettings)
    -> Result<Box<dyn Renderer>, DeviceError>;

    /// What builds Line Spaces on this device; none where the CPU does.
    fn line_space_builder(&self) -> Option<Arc<gpu::LineSpaceBuilder>> {
        None
    }
}

/// A scene on a device, ready to render passes of one job.
pub trait Renderer: Send {
    /// Adds the pass's samples to the film.
    fn render(&mut self, pass: &Pass, film: &mut PassFilm, watch: &dyn Watch) -> Result<PassStats, DeviceError>;

    /// AOVs of a region: of first hits through pixel centres; on the CPU also what Line Spaces did for the first sample.
    fn aovs(&mut self, region: Region, out: &mut AovBuffers, watch: &dyn Watch) -> Result<PassStats, DeviceError>;

    /// Bytes that the device holds for this scene.
    fn device_bytes(&self) -> u64;
}
