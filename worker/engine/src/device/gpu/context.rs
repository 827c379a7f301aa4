//! One wgpu device with its queue, and what every user of it needs: trusted shaders, buffers that fail with a reason
//! instead of a panic, bounded waits, and the news of a lost device.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::adapter;
use super::shader::Source;
use crate::device::{DeviceError, DeviceInfo};

/// A submit is sized to tens of milliseconds; one that takes this long means a hung driver.
const SUBMIT_TIMEOUT: Duration = Duration::from_secs(60);

/// The same for drivers that run on the CPU: they compile a kernel in the first submit that uses it, which takes minutes
/// on a machine that is busy with other work.
const SOFTWARE_SUBMIT_TIMEOUT: Duration = Duration::from_secs(900);

/// Waits are cut into slices of this length, so that the news of a lost device is not waited for.
const WAIT_SLICE: Duration = Duration::from_millis(250);

/// Why the device is of no more use; set once, by wgpu's callbacks or by a wait that ran out.
type Failure = Arc<Mutex<Option<String>>>;

/// An open device. Dropping it frees everything made from it.
pub struct Context {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub info: DeviceInfo,
    pub(super) limits: wgpu::Limits,
    adapter: wgpu::AdapterInfo,
    checks: bool,
    failure: Failure,
    /// Held from a submit to its end.
    turn: Mutex<()>,
    pipelines: Mutex<HashMap<String, wgpu::ComputePipeline>>,
}

impl Context {
    /// Opens the preferred adapter, or the first whose name contains `name`, with all the limits that it has.
    pub fn open(name: Option<&str>) -> Result<Self, DeviceError> {
        Self::open_within(name, u32::MAX, u64::MAX)
    }

    /// As [`Self::open`], but as if the adapter bound no more than so many storage buffers per shader stage, of so many
    /// bytes each: for tests of what other adapters can do.
    pub fn open_within(name: Option<&str>, storage_buffers: u32, binding_bytes: u64) -> Result<Self, DeviceError> {
        let adapter = adapter::select(name)?;
        let mut limits = adapter.limits();
        limits.max_storage_buffers_per_shader_stage = limits.max_storage_buffers_per_shader_stage.min(storage_buffers);
        limits.max_storage_buffer_binding_size = limits.max_storage_buffer_binding_size.min(binding_bytes);
        Self::open_adapter(&adapter, limits)
    }

    /// Opens the adapter anew on which this context was lost, with the same limits.
    ///
    /// # Errors
    /// [`DeviceError::NoAdapter`] when it is gone: no other takes its place unasked.
    pub(super) fn reopen(&self) -> Result<Self, DeviceError> {
        Self::open_adapter(&adapter::select_again(&self.adapter)?, self.limits.clone())
    }

    fn open_adapter(adapter: &wgpu::Adapter, limits: wgpu::Limits) -> Result<Self, DeviceError> {
        let info = adapter::describe(adapter);
        let descriptor =
            wgpu::DeviceDescriptor { label: Some("lightshaft"), required_limits: limits.clone(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| DeviceError::NoAdapter(format!("`{}` cannot be opened: {e}", info.name)))?;
        let failure = Failure::default();
        let lost = failure.clone();
        device.set_device_lost_callback(move |reason, message| fail(&lost, format!("{reason:?} {message}")));
        let uncaptured = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| fail(&uncaptured, error.to_string())));
        let checks = cfg!(test) || std::env::var_os("LIGHTSHAFT_SHADER_CHECKS").is_some_and(|v| v == "1");
        Ok(Self {
            device,
            queue,
            info,
            limits,
            adapter: adapter.get_info(),
            checks,
            failure,
            turn: Mutex::default(),
            pipelines: Mutex::default(),
        })
    }

    /// Fails when shading stages cannot bind all that they need; tracing alone needs no more than any adapter has.
    pub(super) fn check_can_shade(&self) -> Result<(), DeviceError> {
        let has = self.limits.max_storage_buffers_per_shader_stage;
        if has >= adapter::REQUIRED_STORAGE_BUFFERS {
            return Ok(());
        }
        Err(DeviceError::NoAdapter(format!(
            "`{}` binds {has} storage buffers per shader stage, {} are needed",
            self.info.name,
            adapter::REQUIRED_STORAGE_BUFFERS
        )))
    }

    /// Gives the device up, as if its driver had been reset: all work on it fails from now on.
    pub fn destroy(&self) {
        self.device.destroy();
    }

    /// Fails with [`DeviceError::Lost`] once the device is lost or in error.
    pub(super) fn check(&self) -> Result<(), DeviceError> {
        match &*self.failure.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(reason) => Err(DeviceError::Lost(reason.clone())),
            None => Ok(()),
        }
    }

    /// Compiles an embedded stage. Without runtime checks unless asked for (`LIGHTSHAFT_SHADER_CHECKS=1`): naga's
    /// bounds checks and loop counters cost a traversal kernel a multiple of its time.
    pub(super) fn shader(&self, source: &Source) -> wgpu::ShaderModule {
        let checks =
            if self.checks { wgpu::ShaderRuntimeChecks::checked() } else { wgpu::ShaderRuntimeChecks::unchecked() };
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(source.stage),
            source: wgpu::ShaderSource::Wgsl(source.wgsl.as_str().into()),
        };
        // SAFETY: only shaders embedded in this program get here. Their indices come from structures that are
        // validated before upload, their loops are bounded by tree size or counts, their divisors are not zero; the
        // tests run the same shaders with all checks on.
        unsafe { self.device.create_shader_module_trusted(descriptor, checks) }
    }

    /// A buffer, big enough for one element of any of our arrays even when it is empty; [`DeviceError::TooLarge`] when the device has no room for it.
    pub(super) fn buffer(
        &self,
        label: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer, DeviceError> {
        let size = bytes.next_multiple_of(4).max(128);
        let too_large = |limit: String| {
            DeviceError::TooLarge(format!("{label}: {} do not fit on `{}` ({limit})", amount(size), self.info.name))
        };
        if size > self.limits.max_buffer_size {
            return Err(too_large(format!("largest buffer {}", amount(self.limits.max_buffer_size))));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        });
        match pollster::block_on(scope.pop()) {
            Some(_) => Err(too_large("out of memory".to_owned())),
            None => self.check().map(|()| buffer),
        }
    }

    /// A storage buffer with `bytes` in it.
    pub(super) fn upload(&self, label: &str, bytes: &[u8]) -> Result<wgpu::Buffer, DeviceError> {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
        let buffer = self.buffer(label, bytes.len() as u64, usage)?;
        self.write(&buffer, 0, bytes)?;
        Ok(buffer)
    }

    /// A uniform buffer with `bytes` in it.
    pub(super) fn uniform(&self, label: &str, bytes: &[u8]) -> Result<wgpu::Buffer, DeviceError> {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let buffer = self.buffer(label, bytes.len() as u64, usage)?;
        self.write(&buffer, 0, bytes)?;
        Ok(buffer)
    }

    /// Writes ahead of the next submit.
    pub(super) fn write(&self, buffer: &wgpu::Buffer, offset: u64, bytes: &[u8]) -> Result<(), DeviceError> {
        // In pieces, so that wgpu's staging copy of a big array stays small.
        const PIECE: usize = 16 << 20;
        for (i, piece) in bytes.chunks(PIECE).enumerate() {
            self.queue.write_buffer(buffer, offset + (i * PIECE) as u64, piece);
            if bytes.len() > PIECE {
                self.submit(self.encoder())?;
            }
        }
        Ok(())
    }

    /// [`DeviceError::TooLarge`] when a shader stage would bind more storage buffers than the device can: the case of
    /// scenes whose arrays take several bindings each.
    pub(super) fn check_bindings(&self, needed: usize) -> Result<(), DeviceError> {
        let has = self.limits.max_storage_buffers_per_shader_stage;
        if needed <= has as usize {
            return Ok(());
        }
        Err(DeviceError::TooLarge(format!(
            "the scene takes {needed} storage buffers of up to {} in one shader stage, `{}` binds {has}",
            amount(self.binding_limit()),
            self.info.name
        )))
    }

    /// Bytes that one storage binding may have.
    pub(super) fn binding_limit(&self) -> u64 {
        self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)
    }

    /// [`DeviceError::TooLarge`] when an array does not fit one storage binding.
    pub(super) fn check_binding(&self, what: &str, bytes: u64) -> Result<(), DeviceError> {
        if bytes <= self.binding_limit() {
            return Ok(());
        }
        Err(DeviceError::TooLarge(format!(
            "{what}: {}, but `{}` can hold {}",
            amount(bytes),
            self.info.name,
            amount(self.binding_limit())
        )))
    }

    /// A bind group of storage buffers and its layout.
    pub(super) fn bind_storage(
        &self,
        label: &str,
        entries: &[wgpu::BindGroupEntry<'_>],
        read_only: bool,
    ) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
        self.bind(label, entries, wgpu::BufferBindingType::Storage { read_only })
    }

    /// A bind group of read-write storage buffers at bindings 0, 1, … and its layout.
    pub(super) fn bind_buffers(
        &self,
        label: &str,
        buffers: &[wgpu::BufferBinding<'_>],
    ) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
        self.bind(label, &numbered(buffers), wgpu::BufferBindingType::Storage { read_only: false })
    }

    /// A bind group of uniform buffers at bindings 0, 1, … and its layout.
    pub(super) fn bind_uniforms(
        &self,
        label: &str,
        buffers: &[wgpu::BufferBinding<'_>],
    ) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
        self.bind(label, &numbered(buffers), wgpu::BufferBindingType::Uniform)
    }

    fn bind(
        &self,
        label: &str,
        entries: &[wgpu::BindGroupEntry<'_>],
        ty: wgpu::BufferBindingType,
    ) -> (wgpu::BindGroupLayout, wgpu::BindGroup) {
        let layout_entries: Vec<_> = entries
            .iter()
            .map(|entry| wgpu::BindGroupLayoutEntry {
                binding: entry.binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
                count: None,
            })
            .collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &layout_entries };
        let layout = self.device.create_bind_group_layout(&descriptor);
        let descriptor = wgpu::BindGroupDescriptor { label: Some(label), layout: &layout, entries };
        let group = self.device.create_bind_group(&descriptor);
        (layout, group)
    }

    /// The pipeline of a stage for the bind groups that it uses (`None`: the stage has no such group). Compiled once
    /// per source: scenes differ little in what they need, and compiling costs up to half a second a stage.
    pub(super) fn pipeline(&self, source: &Source, groups: &[Option<&wgpu::BindGroupLayout>]) -> wgpu::ComputePipeline {
        let mut pipelines = self.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipeline) = pipelines.get(&source.wgsl) {
            return pipeline.clone();
        }
        let module = self.shader(source);
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(source.stage),
            bind_group_layouts: groups,
            immediate_size: 0,
        });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(source.stage),
            layout: Some(&layout),
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions {
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        pipelines.insert(source.wgsl.clone(), pipeline.clone());
        pipeline
    }

    pub(super) fn encoder(&self) -> wgpu::CommandEncoder {
        self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Submits and waits until it is done; answers the seconds that took. Renderers that share a device take turns: so
    /// each one's time is its own, and a wait never spans another's work.
    pub(super) fn submit(&self, encoder: wgpu::CommandEncoder) -> Result<f64, DeviceError> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        self.check()?;
        let started = Instant::now();
        let index = self.queue.submit([encoder.finish()]);
        self.wait(index)?;
        Ok(started.elapsed().as_secs_f64())
    }

    /// `count` values from the start of `source`, after all that was submitted.
    pub(super) fn read<T: bytemuck::Pod>(&self, source: &wgpu::Buffer, count: usize) -> Result<Vec<T>, DeviceError> {
        self.read_at(source, 0, count)
    }

    /// `count` values from byte `offset` on.
    pub(super) fn read_at<T: bytemuck::Pod>(
        &self,
        source: &wgpu::Buffer,
        offset: u64,
        count: usize,
    ) -> Result<Vec<T>, DeviceError> {
        let bytes = (count * size_of::<T>()) as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let staging = self.buffer("read-back", bytes, usage)?;
        let mut encoder = self.encoder();
        encoder.copy_buffer_to_buffer(source, offset, &staging, 0, bytes);
        encoder.map_buffer_on_submit(&staging, wgpu::MapMode::Read, 0..bytes, |_| ());
        self.submit(encoder)?;
        let view = staging
            .get_mapped_range(0..bytes)
            .map_err(|e| self.check().err().unwrap_or_else(|| DeviceError::Lost(format!("read-back: {e}"))))?;
        let mut values = vec![T::zeroed(); count];
        bytemuck::cast_slice_mut::<T, u8>(&mut values).copy_from_slice(&view);
        Ok(values)
    }

    fn wait(&self, index: wgpu::SubmissionIndex) -> Result<(), DeviceError> {
        let timeout = if adapter::is_software(&self.info) { SOFTWARE_SUBMIT_TIMEOUT } else { SUBMIT_TIMEOUT };
        let deadline = Instant::now() + timeout;
        loop {
            let wait = wgpu::PollType::Wait { submission_index: Some(index.clone()), timeout: Some(WAIT_SLICE) };
            match self.device.poll(wait) {
                Err(wgpu::PollError::Timeout) if Instant::now() < deadline => self.check()?,
                Err(error) => {
                    fail(&self.failure, format!("a submit did not end: {error}"));
                    break;
                }
                Ok(_) => break,
            }
        }
        self.check()
    }
}

/// All of a buffer, to be bound.
pub(super) fn whole(buffer: &wgpu::Buffer) -> wgpu::BufferBinding<'_> {
    buffer.as_entire_buffer_binding()
}

/// Bytes for people.
pub(super) fn amount(bytes: u64) -> String {
    if bytes < 1 << 20 { format!("{} KiB", bytes >> 10) } else { format!("{} MiB", bytes >> 20) }
}

fn numbered<'a>(buffers: &[wgpu::BufferBinding<'a>]) -> Vec<wgpu::BindGroupEntry<'a>> {
    let entry = |(binding, buffer): (u32, &wgpu::BufferBinding<'a>)| wgpu::BindGroupEntry {
        binding,
        resource: wgpu::BindingResource::Buffer(buffer.clone()),
    };
    (0..).zip(buffers).map(entry).collect()
}

fn fail(failure: &Failure, reason: String) {
    let mut slot = failure.lock().unwrap_or_else(PoisonError::into_inner);
    slot.get_or_insert(reason);
}
