//! First-hit layers: one stage that traces and shades rays through pixel centres.

use super::context::whole;
use super::renderer::Resident;
use super::scene::Wave;
use super::stages::{Run, compose_trace};
use super::tracer::WORKGROUP;
use crate::device::{DeviceError, Region};
use crate::integrate::aov::FirstHit;
use crate::pack::NONE;

pub(super) struct Layers {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    buffer: wgpu::Buffer,
    pixels: u32,
}

impl Layers {
    /// The stage in `slot` with room for `pixels`, made or made anew where there is none.
    pub(super) fn reserve<'a>(
        slot: &'a mut Option<Self>,
        resident: &Resident,
        pixels: u32,
    ) -> Result<&'a Self, DeviceError> {
        if slot.as_ref().is_some_and(|layers| layers.pixels < pixels) {
            *slot = None;
        }
        if slot.is_none() {
            *slot = Some(Self::new(resident, pixels.next_power_of_two())?);
        }
        slot.as_ref().ok_or_else(|| DeviceError::Other("no room for first hits".to_owned()))
    }

    fn new(resident: &Resident, pixels: u32) -> Result<Self, DeviceError> {
        let Resident { context, structure, scene } = resident;
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let buffer = context.buffer("first hits", u64::from(pixels) * size_of::<FirstHit>() as u64, storage)?;
        let (layout, group) = context.bind_buffers("first hits", &[whole(&buffer)]);
        let source = compose_trace("first_hit", structure, scene, false, true);
        let groups = [Some(&structure.layout), Some(&scene.layout), Some(&layout), Some(&scene.uniform_layout)];
        let pipeline = context.pipeline(&source, &groups);
        context.check()?;
        Ok(Self { pipeline, group, buffer, pixels })
    }

    /// So many pixels from the `first` in the region's order on.
    pub(super) fn render(
        &self,
        run: &Run<'_>,
        region: Region,
        first: u32,
        pixels: u32,
    ) -> Result<Vec<FirstHit>, DeviceError> {
        let wave = Wave { pixels, samples: 1, closest_number: NONE, ..Wave::over(region, first) };
        run.submit(&wave, |encoder| {
            let mut pass = run.pass(encoder, &self.pipeline, &self.group);
            pass.dispatch_workgroups(pixels.div_ceil(WORKGROUP), 1, 1);
        })?;
        run.context.read(&self.buffer, pixels as usize)
    }
}
