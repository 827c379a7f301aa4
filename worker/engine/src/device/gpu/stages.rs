//! The compute stages of one scene and integrator, and the buffers between them.
//!
//! ```text
//! GENERATE ─► [ PREPARE ─► TRACE closest ─► SHADE ─► PREPARE ─► TRACE shadow ] per bounce ─► ACCUMULATE
//! ```
//!
//! TRACE knows no materials (but for the alpha filter's variant), SHADE no structure. Queues of slot numbers lead from
//! stage to stage; PREPARE turns their lengths into dispatch arguments on the device, so the host never waits for one.

use super::context::Context;
use super::scene::{GpuScene, Wave};
use super::shader::{Source, Variant, compose};
use super::structure::GpuStructure;
use super::tracer::WORKGROUP;
use crate::device::DeviceError;
use crate::settings::Integrator;

/// Bytes of all buffers for one slot: two rays, hit, path, two colours, three queue entries.
const SLOT_BYTES: u64 = 32 + 20 + 32 + 16 + 32 + 16 + 3 * 4;
/// Bytes of a pixel's sums.
const SUM_BYTES: u64 = 32;

pub(super) struct Stages {
    generate: wgpu::ComputePipeline,
    trace_closest: wgpu::ComputePipeline,
    shade: wgpu::ComputePipeline,
    prepare: wgpu::ComputePipeline,
    trace_shadow: wgpu::ComputePipeline,
    accumulate: wgpu::ComputePipeline,
    buffers: Buffers,
    pub slots: u32,
}

/// Bind group 2 of each stage. Pairs: the two queues of active paths swap roles after each bounce.
struct Buffers {
    paths: [wgpu::BindGroup; 2],
    closest: [wgpu::BindGroup; 2],
    shadow: wgpu::BindGroup,
    prepare_active: [wgpu::BindGroup; 2],
    prepare_shadow: wgpu::BindGroup,
    accumulate: wgpu::BindGroup,
    active_queues: [wgpu::Buffer; 2],
    shadow_queue: wgpu::Buffer,
    active_arguments: wgpu::Buffer,
    shadow_arguments: wgpu::Buffer,
    active_total: wgpu::Buffer,
    shadow_total: wgpu::Buffer,
    sums: wgpu::Buffer,
}

impl Stages {
    /// Compiles the stages and reserves buffers for `slots` paths in flight.
    pub(super) fn new(
        context: &Context,
        structure: &GpuStructure,
        scene: &GpuScene,
        integrator: Integrator,
        slots: u32,
    ) -> Result<Self, DeviceError> {
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let buffer = |label: &str, stride: u64| context.buffer(label, u64::from(slots) * stride, storage);
        let queue = |label: &str| context.buffer(label, (u64::from(slots) + 1) * 4, storage);
        let arguments = |label: &str| context.buffer(label, 12, storage | wgpu::BufferUsages::INDIRECT);
        let rays = buffer("rays", 32)?;
        let hits = buffer("hits", 20)?;
        let paths = buffer("paths", 32)?;
        let radiance = buffer("radiance", 16)?;
        let shadow_rays = buffer("shadow rays", 32)?;
        let contributions = buffer("contributions", 16)?;
        let sums = buffer("sums", SUM_BYTES)?;
        let active_queues = [queue("active paths")?, queue("next paths")?];
        let shadow_queue = queue("shadow rays queued")?;
        let active_arguments = arguments("active arguments")?;
        let shadow_arguments = arguments("shadow arguments")?;
        let active_total = context.buffer("active total", 8, storage)?;
        let shadow_total = context.buffer("shadow total", 8, storage)?;

        let mut layouts = Vec::new();
        let mut bind = |label: &str, buffers: &[&wgpu::Buffer]| {
            let (layout, group) = context.bind_buffers(label, buffers);
            layouts.push(layout);
            group
        };
        let mut path_group = |active: &wgpu::Buffer, next: &wgpu::Buffer| {
            bind("paths", &[&rays, &hits, &paths, &radiance, &shadow_rays, &contributions, active, next, &shadow_queue])
        };
        let [q0, q1] = &active_queues;
        let path_groups = [path_group(q0, q1), path_group(q1, q0)];
        let closest = [bind("closest", &[&rays, &hits, q0]), bind("closest", &[&rays, &hits, q1])];
        let shadow = bind("shadow", &[&shadow_rays, &contributions, &radiance, &shadow_queue]);
        let prepare_active = [
            bind("prepare", &[q0, &active_arguments, &active_total]),
            bind("prepare", &[q1, &active_arguments, &active_total]),
        ];
        let prepare_shadow = bind("prepare", &[&shadow_queue, &shadow_arguments, &shadow_total]);
        let accumulate = bind("accumulate", &[&radiance, &sums]);
        let [path_layout, _, closest_layout, _, shadow_layout, prepare_layout, _, _, accumulate_layout] = &layouts[..]
        else {
            unreachable!("nine bind groups were made above")
        };

        let shading = Variant { pools: &scene.pools, ..Variant::default() };
        let shaded = [None, Some(&scene.layout), Some(path_layout), Some(&scene.uniform_layout)];
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
            trace_closest: trace("trace_closest", false, closest_layout),
            shade: context.pipeline(&compose(shade, &shading), &shaded),
            prepare: context
                .pipeline(&compose("prepare", &Variant::default()), &[None, None, Some(prepare_layout), None]),
            trace_shadow: trace("trace_shadow", true, shadow_layout),
            accumulate: context.pipeline(
                &compose("accumulate", &shading),
                &[None, Some(&scene.layout), Some(accumulate_layout), Some(&scene.uniform_layout)],
            ),
            buffers: Buffers {
                paths: path_groups,
                closest,
                shadow,
                prepare_active,
                prepare_shadow,
                accumulate,
                shadow_queue,
                active_arguments,
                shadow_arguments,
                active_total,
                shadow_total,
                sums,
                active_queues,
            },
            slots,
        };
        context.check()?;
        Ok(stages)
    }

    /// Starts the paths of `wave` in queue 0.
    pub(super) fn generate(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            let mut pass = run.pass(encoder);
            pass.set_pipeline(&self.generate);
            pass.set_bind_group(2, &self.buffers.paths[0], &[]);
            pass.dispatch_workgroups((wave.pixels * wave.samples).div_ceil(WORKGROUP), 1, 1);
        })
    }

    /// Traces and shades the paths of queue `active`, and leaves the survivors in the other one.
    pub(super) fn bounce(&self, run: &Run<'_>, wave: &Wave, active: usize) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            encoder.clear_buffer(&self.buffers.active_queues[1 - active], 0, Some(4));
            encoder.clear_buffer(&self.buffers.shadow_queue, 0, Some(4));
            let mut pass = run.pass(encoder);
            self.closest(&mut pass, active);
            self.shade_and_connect(&mut pass, active);
        })
    }

    /// Traces the paths of queue 0, to be shaded any number of times by [`Self::shade`].
    pub(super) fn trace(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| self.closest(&mut run.pass(encoder), 0))
    }

    /// Shades the hits of queue 0 and traces the shadow rays that come of it.
    pub(super) fn shade(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            encoder.clear_buffer(&self.buffers.shadow_queue, 0, Some(4));
            self.shade_and_connect(&mut run.pass(encoder), 0);
        })
    }

    /// Adds the wave's radiance to its pixels' sums.
    pub(super) fn accumulate(&self, run: &Run<'_>, wave: &Wave) -> Result<(), DeviceError> {
        run.submit(wave, |encoder| {
            let mut pass = run.pass(encoder);
            pass.set_pipeline(&self.accumulate);
            pass.set_bind_group(2, &self.buffers.accumulate, &[]);
            pass.dispatch_workgroups(wave.pixels.div_ceil(WORKGROUP), 1, 1);
        })
    }

    /// Whether queue `active` has paths left.
    pub(super) fn has_paths(&self, context: &Context, active: usize) -> Result<bool, DeviceError> {
        Ok(context.read::<u32>(&self.buffers.active_queues[active], 1)?[0] > 0)
    }

    /// The sums of `pixels` pixels.
    pub(super) fn sums(&self, context: &Context, pixels: u32) -> Result<Vec<[f64; 3]>, DeviceError> {
        let pairs: Vec<[[f32; 4]; 2]> = context.read(&self.buffers.sums, pixels as usize)?;
        let sum = |[high, low]: [[f32; 4]; 2]| [0, 1, 2].map(|c| f64::from(high[c]) + f64::from(low[c]));
        Ok(pairs.into_iter().map(sum).collect())
    }

    /// Closest-hit and shadow rays traced since these stages were made.
    pub(super) fn ray_totals(&self, context: &Context) -> Result<(u64, u64), DeviceError> {
        let total = |buffer| -> Result<u64, DeviceError> {
            let words: Vec<u32> = context.read(buffer, 2)?;
            Ok(u64::from(words[0]) | u64::from(words[1]) << 32)
        };
        Ok((total(&self.buffers.active_total)?, total(&self.buffers.shadow_total)?))
    }

    /// Bytes of the buffers between the stages.
    pub(super) fn bytes(&self) -> u64 {
        u64::from(self.slots) * (SLOT_BYTES + SUM_BYTES)
    }

    fn closest(&self, pass: &mut wgpu::ComputePass<'_>, active: usize) {
        pass.set_pipeline(&self.prepare);
        pass.set_bind_group(2, &self.buffers.prepare_active[active], &[]);
        pass.dispatch_workgroups(1, 1, 1);
        pass.set_pipeline(&self.trace_closest);
        pass.set_bind_group(2, &self.buffers.closest[active], &[]);
        pass.dispatch_workgroups_indirect(&self.buffers.active_arguments, 0);
    }

    fn shade_and_connect(&self, pass: &mut wgpu::ComputePass<'_>, active: usize) {
        pass.set_pipeline(&self.shade);
        pass.set_bind_group(2, &self.buffers.paths[active], &[]);
        pass.dispatch_workgroups_indirect(&self.buffers.active_arguments, 0);
        pass.set_pipeline(&self.prepare);
        pass.set_bind_group(2, &self.buffers.prepare_shadow, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        pass.set_pipeline(&self.trace_shadow);
        pass.set_bind_group(2, &self.buffers.shadow, &[]);
        pass.dispatch_workgroups_indirect(&self.buffers.shadow_arguments, 0);
    }
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

    pub(super) fn pass<'e>(&self, encoder: &'e mut wgpu::CommandEncoder) -> wgpu::ComputePass<'e> {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_bind_group(0, &self.structure.group, &[]);
        pass.set_bind_group(1, &self.scene.group, &[]);
        pass.set_bind_group(3, &self.scene.uniforms, &[]);
        pass
    }
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
    compose(
        stage,
        &Variant {
            constants: structure.constants(any_hit, shading),
            pools: &pools,
            replacements: if structure.filtered { &[("accept_all", "accept_alpha")] } else { &[] },
        },
    )
}
