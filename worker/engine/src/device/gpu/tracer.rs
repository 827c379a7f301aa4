//! Batches of rays against a structure, without shading: what the benchmark times and the tests compare.

use bytemuck::{Pod, Zeroable};

use super::context::{Context, whole};
use super::gates;
use super::shader::{Variant, compose};
use super::structure::{GpuStructure, HostStructure};
use crate::accel::line_space::GateCounters;
use crate::device::DeviceError;
use crate::trace::{Hit, Ray};

/// Threads of a workgroup in every stage.
pub(super) const WORKGROUP: u32 = 64;

/// Which kernel walks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// The product's for the structure.
    Product,
    /// The benchmark's base: a plain binary tree with a private stack.
    Baseline,
}

/// As in `shaders/shared/rays.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct GpuHit {
    pub t: f32,
    pub u: f32,
    pub v: f32,
    pub instance: u32,
    pub primitive: u32,
}
const _: () = assert!(size_of::<GpuHit>() == 20);

#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct GpuRay {
    pub origin: [f32; 3],
    pub t_min: f32,
    pub direction: [f32; 3],
    pub t_max: f32,
}
const _: () = assert!(size_of::<GpuRay>() == 32);

impl GpuRay {
    pub(super) fn new(ray: &Ray) -> Self {
        Self {
            origin: ray.origin.into(),
            // The kernel knows no negative one, -0 included.
            t_min: if ray.t_min > 0.0 { ray.t_min } else { 0.0 },
            direction: ray.direction.into(),
            t_max: ray.t_max.min(f32::MAX),
        }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct GpuPath {
    /// Of use to the shaders alone.
    pub state: [u32; 8],
    pub radiance: [f32; 4],
    pub contribution: [f32; 4],
}
const _: () = assert!(size_of::<GpuPath>() == 64);

/// Traces ray batches on one structure.
pub struct Tracer<'a> {
    context: &'a Context,
    structure: GpuStructure,
    kernel: Kernel,
}

/// A batch on the device, to be traced any number of times.
pub struct Batch {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    result: wgpu::Buffer,
    queue: wgpu::Buffer,
    rays: u32,
}

impl<'a> Tracer<'a> {
    pub fn new(context: &'a Context, host: &HostStructure, kernel: Kernel) -> Result<Self, DeviceError> {
        Ok(Self { context, structure: GpuStructure::upload(context, host)?, kernel })
    }

    pub fn bytes(&self) -> u64 {
        self.structure.bytes
    }

    /// The nearest hit of each ray.
    pub fn closest(&self, rays: &[Ray]) -> Result<Vec<Option<Hit>>, DeviceError> {
        let batch = self.prepare(rays, false)?;
        self.run(&batch)?;
        let hits: Vec<GpuHit> = self.context.read(&batch.result, rays.len())?;
        let hit = |h: GpuHit| Hit { t: h.t, u: h.u, v: h.v, instance: h.instance, primitive: h.primitive };
        Ok(hits.into_iter().map(|h| (h.instance != crate::pack::NONE).then(|| hit(h))).collect())
    }

    /// Whether anything stands in each ray's way.
    pub fn occluded(&self, rays: &[Ray]) -> Result<Vec<bool>, DeviceError> {
        let batch = self.prepare(rays, true)?;
        self.run(&batch)?;
        self.occlusion(&batch)
    }

    /// Uploads rays and compiles the kernel.
    pub fn prepare(&self, rays: &[Ray], any_hit: bool) -> Result<Batch, DeviceError> {
        let context = self.context;
        let gpu_rays: Vec<_> = rays.iter().map(GpuRay::new).collect();
        let count = rays.len() as u32;
        let mut queue: Vec<u32> = std::iter::once(count).chain(0..count).collect();
        queue.resize(queue.len() + gates::COUNTERS * gates::COPIES, 0);
        let ray_buffer = context.upload("rays", bytemuck::cast_slice(&gpu_rays))?;
        let queue = context.upload("queue", bytemuck::cast_slice(&queue))?;
        let (stage, result, buffers) = if any_hit {
            let path = GpuPath { contribution: [1.0; 4], ..GpuPath::default() };
            let paths = context.upload("paths", bytemuck::cast_slice(&vec![path; rays.len()]))?;
            ("trace_shadow", paths.clone(), vec![ray_buffer, paths, queue.clone()])
        } else {
            let hits = context.upload("hits", bytemuck::cast_slice(&vec![GpuHit::default(); rays.len()]))?;
            ("trace_closest", hits.clone(), vec![ray_buffer, hits, queue.clone()])
        };
        let (layout, group) = context.bind_buffers("rays", &buffers.iter().map(whole).collect::<Vec<_>>());
        let replacements: Vec<_> = match self.kernel {
            Kernel::Product => self.structure.replacements().collect(),
            Kernel::Baseline => vec![("traverse", "traverse_baseline")],
        };
        let source = compose(
            stage,
            &Variant {
                constants: self.structure.constants(any_hit, false),
                pools: &self.structure.pools,
                replacements: &replacements,
            },
        );
        let pipeline = context.pipeline(&source, &[Some(&self.structure.layout), None, Some(&layout)]);
        context.check()?;
        Ok(Batch { pipeline, group, result, queue, rays: count })
    }

    /// What gates told the rays of the batch, in all its runs.
    pub fn gate_counters(&self, batch: &Batch) -> Result<GateCounters, DeviceError> {
        let start = 4 * (u64::from(batch.rays) + 1);
        let words: Vec<u32> = self.context.read_at(&batch.queue, start, gates::COUNTERS * gates::COPIES)?;
        let sum = |counter| words.iter().skip(counter).step_by(gates::COUNTERS).map(|&word| u64::from(word)).sum();
        Ok(gates::counters(std::array::from_fn(sum)))
    }

    /// Whether anything stands in each ray's way, for a batch that has been traced so.
    pub fn occlusion(&self, batch: &Batch) -> Result<Vec<bool>, DeviceError> {
        let paths: Vec<GpuPath> = self.context.read(&batch.result, batch.rays as usize)?;
        Ok(paths.into_iter().map(|path| path.radiance[0] == 0.0).collect())
    }

    /// Traces the batch and waits for it.
    pub fn run(&self, batch: &Batch) -> Result<(), DeviceError> {
        let mut encoder = self.context.encoder();
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&batch.pipeline);
        pass.set_bind_group(0, &self.structure.group, &[]);
        pass.set_bind_group(2, &batch.group, &[]);
        pass.dispatch_workgroups(batch.rays.div_ceil(WORKGROUP), 1, 1);
        drop(pass);
        self.context.submit(encoder).map(|_| ())
    }
}
