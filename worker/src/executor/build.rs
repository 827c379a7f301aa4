//! Makes the structures of a scene's meshes, and keeps them for later tasks: here, and at the service.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use lightshaft_api::job::{Metrics, Phase, TaskWork};
use lightshaft_api::settings::{BuildSettings, RenderSettings};
use lightshaft_engine::device::Device;
use lightshaft_engine::device::cpu::CpuDevice;

use super::{
    Executor, Inputs, Observer, Outputs, PREPARE_STARTS, Progress, STRUCTURES_START, Task, TaskError, metrics, output,
};
use crate::settings::Wanted;

impl Executor {
    /// Blocks; uses rayon's global pool. `settings` must have been validated. What was made, and from where the rest came,
    /// is in the metrics' `cache`.
    ///
    /// # Errors
    /// As those of [`Self::run`].
    pub fn build(
        &self,
        settings: &BuildSettings,
        inputs: &dyn Inputs,
        observer: &dyn Observer,
        stop: &AtomicBool,
    ) -> Result<Outputs, TaskError> {
        let render = RenderSettings { acceleration: settings.acceleration.clone(), ..RenderSettings::default() };
        let task = Task {
            work: &TaskWork::Build,
            settings: &render,
            inputs,
            structures: &self.structures,
            observer: &Stretched(observer),
            stop,
            started: Instant::now(),
        };
        let mut measured = Metrics { queue_s: inputs.waited_s(), versions: metrics::versions(), ..Metrics::default() };
        let scene = self.scene(&task, &mut measured)?;
        task.check_stop()?;
        task.report(Phase::Structures, STRUCTURES_START, 0);
        let started = Instant::now();
        let accel = self.accelerate(&task, &scene, &Wanted::of(&settings.acceleration), &mut measured)?;
        measured.build_s = started.elapsed().as_secs_f64();
        super::count_structures(&mut measured, &accel);
        let device = CpuDevice::new().info();
        (measured.device, measured.device_kind) = (device.name, device.kind.to_owned());
        measured.peak_bytes = metrics::peak_bytes();
        measured.total_s = task.started.elapsed().as_secs_f64();
        Ok(Outputs { artifacts: vec![output::metrics_json(&measured)?], metrics: measured })
    }
}

/// Structures are nearly all of this task's work, not the little of a render's.
struct Stretched<'a>(&'a dyn Observer);

impl Observer for Stretched<'_> {
    fn progress(&self, progress: Progress) {
        let within = (progress.fraction - STRUCTURES_START) / (PREPARE_STARTS - STRUCTURES_START);
        let fraction = if within < 0.0 { progress.fraction } else { STRUCTURES_START + 0.95 * within.min(1.0) };
        self.0.progress(Progress { fraction, ..progress });
    }

    fn log(&self, line: String) {
        self.0.log(line);
    }

    fn wants_preview(&self) -> bool {
        false
    }

    fn preview(&self, _: Vec<u8>) {}
}
