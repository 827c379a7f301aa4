//! The compute stages of one scene and integrator, and the buffers between them.
//!
//! ```text
//! GENERATE ─► [ PREPARE ─► TRACE closest ─► SHADE ─► PREPARE ─► TRACE shadow ] per bounce ─► ACCUMULATE
//! ```
//!
//! TRACE knows no materials (but for the alpha filter's variant), SHADE no structure. Queues of slot numbers lead from
//! stage to stage; PREPARE turns their lengths into dispatch arguments on the device, so the host never waits for one.

use super::context::{Context, whole};
use super::gates;
use super::scene::{GpuScene, Wave};
use super::shader::{Source, Variant, compose};
use super::structure::GpuStructure;
use super::tracer::{GpuHit, GpuPath, GpuRay, WORKGROUP};
use crate::accel::line_space::GateCounters;
use crate::device::DeviceError;
use crate::settings::Integrator;

/// Bytes of all buffers for one slot: two rays, hit, path, three queue entries.
const SLOT_BYTES: u64 = 2 * RAY_BYTES + size_of::<GpuHit>() as u64 + size_of::<GpuPath>() as u64 + 3 * 4;
const RAY_BYTES: u64 = size_of::<GpuRay>() as u64;
/// Words of a queue beyond its slots (`paths.wgsl`): parts of a buffer that are bound for themselves start at multiples
/// of 256 bytes, and so do both kinds of rays in theirs.
/// Behind its slots a queue has the counters of the gates.
const QUEUE_HEADER: u64 = 384;
const _: () = assert!(QUEUE_HEADER > (gates::COUNTERS * gates::COPIES) as u64);
/// Fewest slots for which that holds.
pub(super) const MIN_SLOTS: u32 = 256;
/// What a slot takes in the buffer where it takes most: that of the rays, or of the paths.
pub(super) const WIDEST_SLOT_BYTES: u64 = 2 * RAY_BYTES;
const _: () = assert!(WIDEST_SLOT_BYTES >= size_of::<GpuPath>() as u64);
/// Bytes of a pixel's sums.
const SUM_BYTES: u64 = 32;

pub(super) struct Stages {
    generate: wgpu::ComputePipeline,
    trace_closest: wgpu::ComputePipeline,
    shade: wgpu::ComputePipeline,
    prepare: wgpu::ComputePipeline,
    trace_shadow: wgpu::ComputePipeline,
    accumulate: wgpu::ComputePipeline,
    /// In scenes with gates.
    tally: Option<wgpu::ComputePipeline>,
    buffers: Buffers,
    pub slots: u32,
}

/// Bind group 2 of each stage. Pairs: one for each queue of paths.
struct Buffers {
    paths: wgpu::BindGroup,
    closest: [wgpu::BindGroup; 2],
    shadow: wgpu::BindGroup,
    prepare_active: [wgpu::BindGroup; 2],
    prepare_shadow: wgpu::BindGroup,
    tally_active: [wgpu::BindGroup; 2],
    tally_shadow: wgpu::BindGroup,
    accumulate: wgpu::BindGroup,
    queues: wgpu::Buffer,
    active_arguments: wgpu::Buffer,
    shadow_arguments: wgpu::Buffer,
    active_total: wgpu::Buffer,
    shadow_total: wgpu::Buffer,
    gate_totals: wgpu::Buffer,
    sums: wgpu::Buffer,
}

impl Stages {
    /// Compiles the stages and reserves buffers for `slots` paths in flight, a power of two.
    pub(super) fn new(
        context: &Context,
        structure: &GpuStructure,
        scene: &GpuScene,
        integrator: Integrator,
        slots: u32,
    ) -> Result<Self, DeviceError> {
        let slots = slots.max(MIN_SLOTS);
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let buffer = |label: &str, stride: u64| context.buffer(label, u64::from(slots) * stride, storage);
        let arguments = |label: &str| context.buffer(label, 12, storage | wgpu::BufferUsages::INDIRECT);
        let rays = buffer("rays", 2 * RAY_BYTES)?;
        let hits = buffer("hits", size_of::<GpuHit>() as u64)?;
        let paths = buffer("paths", size_of::<GpuPath>() as u64)?;
        let sums = buffer("sums", SUM_BYTES)?;
        let queues = context.buffer("queues", 3 * queue_bytes(slots), storage)?;
        let active_arguments = arguments("active arguments")?;
        let shadow_arguments = arguments("shadow arguments")?;
        let active_total = context.buffer("active total", 8, storage)?;
        let shadow_total = context.buffer("shadow total", 8, storage)?;
        let gate_totals = context.buffer("gate totals", 8 * gates::COUNTERS as u64, storage)?;

        let part = |buffer, offset, size| wgpu::BufferBinding { buffer, offset, size: wgpu::BufferSize::new(size) };
        let ray_bytes = u64::from(slots) * RAY_BYTES;
        let path_rays = part(&rays, 0, ray_bytes);
        let shadow_rays = part(&rays, ray_bytes, ray_bytes);
        let [q0, q1, shadow_queue] =
            [0, 1, SHADOW_QUEUE].map(|queue| part(&queues, queue * queue_bytes(slots), queue_bytes(slots)));
        let (path_layout, path_group) =
            context.bind_buffers("paths", &[whole(&rays), whole(&hits), whole(&paths), whole(&queues)]);
        let bind_closest = |queue| context.bind_buffers("closest", &[path_rays.clone(), whole(&hits), queue]);
        let (closest_layout, closest0) = bind_closest(q0.clone());
        let (_, closest1) = bind_closest(q1.clone());
        let (shadow_layout, shadow) =
            context.bind_buffers("shadow", &[shadow_rays, whole(&paths), shadow_queue.clone()]);
        let bind_prepare =
            |queue, arguments, total| context.bind_buffers("prepare", &[queue, whole(arguments), whole(total)]);
        let bind_tally = |queue| {
            let entry =
                |binding, buffer| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::Buffer(buffer) };
            context.bind_storage("tally", &[entry(0, whole(&gate_totals)), entry(2, queue)], false)
        };
        let (tally_layout, tally0) = bind_tally(q0.clone());
        let (_, tally1) = bind_tally(q1.clone());
        let (_, tally_shadow) = bind_tally(shadow_queue.clone());
        let (prepare_layout, prepare0) = bind_prepare(q0, &active_arguments, &active_total);
        let (_, prepare1) = bind_prepare(q1, &active_arguments, &active_total);
        let (_, prepare_shadow) = bind_prepare(shadow_queue, &shadow_arguments, &shadow_total);
        let (accumulate_layout, accumulate) = context.bind_buffers("accumulate", &[whole(&paths), whole(&sums)]);

        let shading = Variant { pools: &scene.pools, ..Variant::default() };
        let shaded = [None, Some(&scene.layout), Some(&path_layout), Some(&scene.uniform_layout)];
        let shade = match integrator {
            Integrator::Aov => "shade_normal",
            Integrator::Ao { .. } => "shade_ao",
            Integrator::Whitted { .. } => "shade_whitted",
            Integrator::Direct | Integrator::Path { .. } => "shade_path",
        };
        let (scene_layout, uniform_layout) =
            if structure.filtered { (Some(&scene.layout), Some(&scene.uniform_layout)) } else { (None, None) };
        let trace = |stage, any_hit, layout| {
            let source = compose_trace(stage, structure, scene, any_hit, false);
            context.pipeline(&source, &[Some(&structure.layout), scene_layout, Some(layout), uniform_layout])
        };
        let stages = Self {
            generate: context.pipeline(&compose("generate", &shading), &shaded),
            trace_closest: trace("trace_closest", false, &closest_layout),
            shade: context.pipeline(&compose(shade, &shading), &shaded),
            prepare: context
                .pipeline(&compose("prepare", &Variant::default()), &[None, None, Some(&prepare_layout), None]),
            trace_shadow: trace("trace_shadow", true, &shadow_layout),
            accumulate: context.pipeline(
                &compose("accumulate", &shading),
                &[None, Some(&scene.layout), Some(&accumulate_layout), Some(&scene.uniform_layout)],
            ),
            tally: structure.gated.then(|| {
                context.pipeline(&compose("tally", &Variant::default()), &[None, None, Some(&tally_layout), None])
            }),
            buffers: Buffers {
                paths: path_group,
                closest: [closest0, closest1],
                shadow,
                prepare_active: [prepare0, prepare1],
                prepare_shadow,
                tally_active: [tally0, tally1],
                tally_shadow,
                accumulate,
                queues,
                active_arguments,
                shadow_arguments,
                active_total,
                shadow_total,
                gate_totals,
                sums,
            },
            slots,
        };
        context.check()?;
        Ok(stages)
    }

    /// Starts the paths of `wave` in the active queue.
    pub(super) fn generate(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            let mut pass = run.pass(encoder, &self.generate, &self.buffers.paths);
            pass.dispatch_workgroups((wave.pixels * wave.samples).div_ceil(WORKGROUP), 1, 1);
        })
    }

    /// Traces and shades the paths of the active queue, and leaves the survivors in the other one.
    pub(super) fn bounce(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            self.empty_queue(encoder, 1 - u64::from(wave.active_queue));
            self.empty_queue(encoder, SHADOW_QUEUE);
            self.closest(run, encoder, wave.active_queue);
            self.shade_and_connect(run, encoder);
        })
    }

    /// Traces the paths of the active queue, to be shaded any number of times by [`Self::shade`].
    pub(super) fn trace(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| self.closest(run, encoder, wave.active_queue))
    }

    /// Shades the hits of the active queue and traces the shadow rays that come of it.
    pub(super) fn shade(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            self.empty_queue(encoder, SHADOW_QUEUE);
            self.shade_and_connect(run, encoder);
        })
    }

    /// Adds the wave's radiance to its pixels' sums.
    pub(super) fn accumulate(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            let mut pass = run.pass(encoder, &self.accumulate, &self.buffers.accumulate);
            pass.dispatch_workgroups(wave.pixels.div_ceil(WORKGROUP), 1, 1);
        })
    }

    /// Whether queue `active` has paths left.
    pub(super) fn has_paths(&self, context: &Context, active: u32) -> Result<bool, DeviceError> {
        let start = u64::from(active) * queue_bytes(self.slots);
        Ok(context.read_at::<u32>(&self.buffers.queues, start, 1)?[0] > 0)
    }

    /// The sums of `pixels` pixels.
    pub(super) fn sums(&self, context: &Context, pixels: u32) -> Result<Vec<[f64; 3]>, DeviceError> {
        let pairs: Vec<[[f32; 4]; 2]> = context.read(&self.buffers.sums, pixels as usize)?;
        let sum = |[high, low]: [[f32; 4]; 2]| [0, 1, 2].map(|c| f64::from(high[c]) + f64::from(low[c]));
        Ok(pairs.into_iter().map(sum).collect())
    }

    /// What was counted since these stages were made.
    pub(super) fn totals(&self, context: &Context) -> Result<Totals, DeviceError> {
        let mut totals = Totals::default();
        let read = |buffer, into: &mut [u64]| -> Result<(), DeviceError> {
            let pairs: Vec<[u32; 2]> = context.read(buffer, into.len())?;
            into.iter_mut().zip(pairs).for_each(|(into, [low, high])| *into = u64::from(low) | u64::from(high) << 32);
            Ok(())
        };
        read(&self.buffers.active_total, std::slice::from_mut(&mut totals.closest))?;
        read(&self.buffers.shadow_total, std::slice::from_mut(&mut totals.shadow))?;
        if self.tally.is_some() {
            read(&self.buffers.gate_totals, &mut totals.gates)?;
        }
        Ok(totals)
    }

    /// Bytes of the buffers between the stages.
    pub(super) fn bytes(&self) -> u64 {
        u64::from(self.slots) * (SLOT_BYTES + SUM_BYTES)
    }

    fn empty_queue(&self, encoder: &mut wgpu::CommandEncoder, queue: u64) {
        encoder.clear_buffer(&self.buffers.queues, queue * queue_bytes(self.slots), Some(4));
    }

    fn closest(&self, run: &Run<'_>, encoder: &mut wgpu::CommandEncoder, active: u32) {
        let buffers = &self.buffers;
        let active = active as usize;
        run.pass(encoder, &self.prepare, &buffers.prepare_active[active]).dispatch_workgroups(1, 1, 1);
        run.pass(encoder, &self.trace_closest, &buffers.closest[active])
            .dispatch_workgroups_indirect(&buffers.active_arguments, 0);
        self.tally(run, encoder, &buffers.tally_active[active]);
    }

    fn tally(&self, run: &Run<'_>, encoder: &mut wgpu::CommandEncoder, group: &wgpu::BindGroup) {
        if let Some(tally) = &self.tally {
            run.pass(encoder, tally, group).dispatch_workgroups(1, 1, 1);
        }
    }

    fn shade_and_connect(&self, run: &Run<'_>, encoder: &mut wgpu::CommandEncoder) {
        let buffers = &self.buffers;
        run.pass(encoder, &self.shade, &buffers.paths).dispatch_workgroups_indirect(&buffers.active_arguments, 0);
        run.pass(encoder, &self.prepare, &buffers.prepare_shadow).dispatch_workgroups(1, 1, 1);
        run.pass(encoder, &self.trace_shadow, &buffers.shadow)
            .dispatch_workgroups_indirect(&buffers.shadow_arguments, 0);
        self.tally(run, encoder, &buffers.tally_shadow);
    }
}

/// Rays traced, and what gates told them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Totals {
    pub closest: u64,
    pub shadow: u64,
    gates: [u64; gates::COUNTERS],
}

impl Totals {
    pub(super) fn since(&self, before: &Self) -> Self {
        Self {
            closest: self.closest - before.closest,
            shadow: self.shadow - before.shadow,
            gates: std::array::from_fn(|i| self.gates[i] - before.gates[i]),
        }
    }

    pub(super) fn gates(&self) -> GateCounters {
        gates::counters(self.gates)
    }
}

/// Number of the queue of shadow rays, as in `paths.wgsl`.
const SHADOW_QUEUE: u64 = 2;

fn queue_bytes(slots: u32) -> u64 {
    4 * (u64::from(slots) + QUEUE_HEADER)
}

/// What every submit binds, and how long the longest took.
pub(super) struct Run<'a> {
    pub context: &'a Context,
    pub structure: &'a GpuStructure,
    pub scene: &'a GpuScene,
    pub longest_s: std::cell::Cell<f64>,
}

impl Run<'_> {
    /// Submits what `record` records and waits for it: submits are sized to tens of milliseconds, so the gaps between
    /// them are small, and a display or another job on the same GPU gets its turn.
    pub(super) fn submit(
        &self,
        wave: &Wave,
        record: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> Result<(), DeviceError> {
        self.context.queue.write_buffer(&self.scene.wave, 0, bytemuck::bytes_of(wave));
        let mut encoder = self.context.encoder();
        record(&mut encoder);
        let seconds = self.context.submit(encoder)?;
        self.longest_s.set(self.longest_s.get().max(seconds));
        Ok(())
    }

    /// A pass for one dispatch of `pipeline` with `group` as its group 2.
    ///
    /// Stages must not share a pass. Vulkan keeps a set bound only while all lower-numbered ones are laid out as before
    /// ("Pipeline Layout Compatibility"), but wgpu-core 30 does not bind it again where the next pipeline has no
    /// lower-numbered group at all: SHADE right after TRACE with the alpha filter may then read the scene from anywhere,
    /// and does on Mesa 22.3's lavapipe. A new pass binds every group.
    pub(super) fn pass<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        pipeline: &wgpu::ComputePipeline,
        group: &wgpu::BindGroup,
    ) -> wgpu::ComputePass<'e> {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        pass.set_bind_group(2, group, &[]);
        pass.set_bind_group(0, &self.structure.group, &[]);
        pass.set_bind_group(1, &self.scene.group, &[]);
        pass.set_bind_group(3, &self.scene.uniforms, &[]);
        pass
    }
}

/// Storage buffers of the stage that binds most of them: SHADE with the scene, TRACE with the structure and for the
/// alpha filter the scene, or the first-hit layers with both.
pub(super) fn most_bindings(structure: &GpuStructure, scene: &GpuScene) -> usize {
    let shade = 4 + scene.bindings;
    let trace = 3 + structure.bindings + if structure.filtered { scene.bindings } else { 0 };
    let first_hit = 1 + structure.bindings + scene.bindings;
    shade.max(trace).max(first_hit)
}

/// Composes a tracing stage for a scene. Only a scene with alpha pays for the filter, only one with spheres for their
/// test. `shading`: the stage shades too, so it needs the scene's arrays in any case.
pub(super) fn compose_trace(
    stage: &'static str,
    structure: &GpuStructure,
    scene: &GpuScene,
    any_hit: bool,
    shading: bool,
) -> Source {
    let pools: Vec<_> = structure.pools.iter().chain(&scene.pools).cloned().collect();
    let filter = structure.filtered.then_some(("accept_all", "accept_alpha"));
    let replacements: Vec<_> = structure.replacements().chain(filter).collect();
    compose(
        stage,
        &Variant { constants: structure.constants(any_hit, shading), pools: &pools, replacements: &replacements },
    )
}
