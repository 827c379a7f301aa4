//! Shafts of rays, located on the device: what the tests hold against [`ShaftGrid::locate`].

use bytemuck::{Pod, Zeroable};

use super::context::{Context, whole};
use super::shader::{Variant, compose};
use super::tracer::{GpuRay, WORKGROUP};
use crate::accel::line_space::ShaftGrid;
use crate::device::DeviceError;
use crate::trace::Ray;

/// As in `shaders/locate_shafts.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct LocatedShaft {
    /// See [`Self::THROUGH`] and its like; 0 for a ray that meets nothing in the box.
    pub flags: u32,
    /// Number of the shaft; 0 unless the ray goes through the box.
    pub symmetric: u32,
    pub directed: u32,
}
const _: () = assert!(size_of::<LocatedShaft>() == 12);

impl LocatedShaft {
    pub const THROUGH: u32 = 1;
    pub const TOO_FAR: u32 = 2;
    pub const STARTS_OUTSIDE: u32 = 4;
    pub const REACHES_EXIT: u32 = 8;
}

/// The shaft of each ray in `grid`'s box.
pub fn locate_shafts(context: &Context, grid: &ShaftGrid, rays: &[Ray]) -> Result<Vec<LocatedShaft>, DeviceError> {
    if rays.is_empty() {
        return Ok(Vec::new());
    }
    let gpu_rays: Vec<_> = rays.iter().map(GpuRay::new).collect();
    let grid = context.upload("shaft grid", bytemuck::cast_slice(&grid.to_words()))?;
    let ray_buffer = context.upload("rays", bytemuck::cast_slice(&gpu_rays))?;
    let located = context.upload("located shafts", bytemuck::cast_slice(&vec![LocatedShaft::default(); rays.len()]))?;
    let (layout, group) = context.bind_buffers("locate shafts", &[whole(&grid), whole(&ray_buffer), whole(&located)]);
    let source = compose("locate_shafts", &Variant::default());
    let pipeline = context.pipeline(&source, &[None, None, Some(&layout)]);
    let mut encoder = context.encoder();
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    pass.set_pipeline(&pipeline);
    pass.set_bind_group(2, &group, &[]);
    pass.dispatch_workgroups((rays.len() as u32).div_ceil(WORKGROUP), 1, 1);
    drop(pass);
    context.submit(encoder)?;
    context.read(&located, rays.len())
}
