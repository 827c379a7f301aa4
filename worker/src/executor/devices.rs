//! The devices of this worker: opened when first needed, kept warm between tasks.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lightshaft_api::settings::DeviceChoice;
use lightshaft_api::worker;
use lightshaft_engine::device::cpu::CpuDevice;
use lightshaft_engine::device::gpu::{self, GpuDevice, LineSpaceBuilder};
use lightshaft_engine::device::{Device, DeviceError, DeviceInfo, Renderer};
use lightshaft_engine::pack::PackedScene;
use lightshaft_engine::settings::RenderSettings;

/// Which of this machine's devices may be used, and those that are open.
pub struct Devices {
    /// What the worker was started with: `auto` allows everything.
    allowed: DeviceChoice,
    /// Looked for once: it loads drivers, which takes longer than a small picture.
    adapters: OnceLock<Vec<DeviceInfo>>,
    open: Mutex<HashMap<Choice, Box<dyn Device>>>,
}

impl fmt::Debug for Devices {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Devices").field("allowed", &self.allowed).finish_non_exhaustive()
    }
}

/// One device of the machine.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Choice {
    Cpu,
    /// The first adapter whose name contains the text.
    Gpu(Option<String>),
}

/// A scene on a device, and which device that is.
pub(crate) struct OnDevice {
    pub renderer: Box<dyn Renderer>,
    pub info: DeviceInfo,
}

impl Devices {
    pub fn new(allowed: DeviceChoice) -> Self {
        Self { allowed, adapters: OnceLock::new(), open: Mutex::default() }
    }

    /// What this machine has and this worker may use, the CPU first.
    pub fn list(&self) -> Vec<worker::Device> {
        let mut devices = Vec::new();
        if self.allowed != DeviceChoice::Gpu {
            devices.push(CpuDevice::new().info());
        }
        if self.allowed != DeviceChoice::Cpu {
            devices.extend(self.adapters().iter().cloned());
        }
        devices.into_iter().map(describe).collect()
    }

    fn adapters(&self) -> &[DeviceInfo] {
        self.adapters.get_or_init(gpu::adapters)
    }

    /// Which device a job gets. `auto` takes a GPU only where there is a real one.
    pub(crate) fn choose(&self, wanted: DeviceChoice, adapter: Option<&str>) -> Result<Choice, DeviceError> {
        let effective = match (self.allowed, wanted) {
            (DeviceChoice::Auto, wanted) => wanted,
            (allowed, DeviceChoice::Auto) => allowed,
            (allowed, wanted) if allowed == wanted => wanted,
            (DeviceChoice::Cpu, _) => {
                return Err(DeviceError::NoAdapter("this worker was started with --device cpu".into()));
            }
            (_, _) => {
                return Err(DeviceError::Other(
                    "the job demands the CPU, but this worker was started with --device gpu".into(),
                ));
            }
        };
        let has_real_gpu = || {
            let wanted_name = adapter.map(str::to_lowercase);
            self.adapters().iter().any(|info| {
                !gpu::is_software(info)
                    && wanted_name.as_ref().is_none_or(|part| info.name.to_lowercase().contains(part))
            })
        };
        Ok(match effective {
            DeviceChoice::Gpu => Choice::Gpu(adapter.map(str::to_owned)),
            DeviceChoice::Auto if has_real_gpu() => Choice::Gpu(adapter.map(str::to_owned)),
            DeviceChoice::Auto | DeviceChoice::Cpu => Choice::Cpu,
        })
    }

    /// Puts the scene on the device, opening it first where needed. A device that fails is closed, so that the next
    /// task opens it anew.
    pub(crate) fn prepare(
        &self,
        choice: &Choice,
        scene: &Arc<PackedScene>,
        settings: &RenderSettings,
    ) -> Result<OnDevice, DeviceError> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let mut device = take_or_open(&mut open, choice)?;
        let renderer = device.prepare(Arc::clone(scene), settings)?;
        let info = device.info();
        open.insert(choice.clone(), device);
        Ok(OnDevice { renderer, info })
    }

    /// What builds Line Spaces for a job: the GPU that it is to run on. None where the CPU builds them, also where the device cannot be
    /// opened, for then the job does not run on it.
    pub(crate) fn line_space_builder(
        &self,
        wanted: DeviceChoice,
        adapter: Option<&str>,
    ) -> Option<Arc<LineSpaceBuilder>> {
        let choice = self.choose(wanted, adapter).ok().filter(|choice| *choice != Choice::Cpu)?;
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let device = take_or_open(&mut open, &choice).ok()?;
        let builder = device.line_space_builder();
        open.insert(choice, device);
        builder
    }

    /// Forgets a device that was lost.
    pub(super) fn close(&self, choice: &Choice) {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).remove(choice);
    }
}

fn take_or_open(open: &mut HashMap<Choice, Box<dyn Device>>, choice: &Choice) -> Result<Box<dyn Device>, DeviceError> {
    Ok(match (open.remove(choice), choice) {
        (Some(device), _) => device,
        (None, Choice::Cpu) => Box::new(CpuDevice::new()),
        (None, Choice::Gpu(adapter)) => Box::new(GpuDevice::open(adapter.as_deref())?),
    })
}

fn describe(info: DeviceInfo) -> worker::Device {
    worker::Device {
        kind: if info.kind == "gpu" { worker::DeviceKind::Gpu } else { worker::DeviceKind::Cpu },
        name: info.name,
        driver: info.driver,
        backend: info.backend,
        device_type: info.device_type,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_uses_only_what_it_was_allowed() {
        let cpu_only = Devices::new(DeviceChoice::Cpu);
        assert_eq!(cpu_only.choose(DeviceChoice::Auto, None).unwrap(), Choice::Cpu);
        let error = cpu_only.choose(DeviceChoice::Gpu, None).unwrap_err();
        assert!(error.to_string().contains("--device cpu"), "{error}");
        assert!(cpu_only.list().iter().all(|device| device.kind == worker::DeviceKind::Cpu));
        let gpu_only = Devices::new(DeviceChoice::Gpu);
        assert_eq!(gpu_only.choose(DeviceChoice::Auto, Some("x")).unwrap(), Choice::Gpu(Some("x".into())));
        assert!(gpu_only.choose(DeviceChoice::Cpu, None).is_err());
    }
}
