//! Which GPUs there are, and which one a job gets.

use crate::device::{DeviceError, DeviceInfo};

/// Storage buffers that one shader stage of ours binds at most, where each pool fits one binding: WebGPU's default
/// limit, which every adapter has.
pub const REQUIRED_STORAGE_BUFFERS: u32 = 8;

/// Every adapter that wgpu finds, the preferred one first: hardware before software, discrete before integrated.
/// Adapters that miss a requirement are listed all the same; preparing a scene on one says what it lacks.
pub fn adapters() -> Vec<DeviceInfo> {
    enumerate().iter().map(describe).collect()
}

/// Whether the adapter runs shaders on the CPU (lavapipe, SwiftShader, WARP): right for tests, slower than the `cpu`
/// device for real work.
pub fn is_software(info: &DeviceInfo) -> bool {
    info.device_type == "Cpu"
}

/// The preferred adapter, or the first whose name contains `name` (case-insensitive).
pub(super) fn select(name: Option<&str>) -> Result<wgpu::Adapter, DeviceError> {
    let wanted = name.map(str::to_lowercase);
    let mut found = Vec::new();
    for adapter in enumerate() {
        let info = describe(&adapter);
        if wanted.as_ref().is_none_or(|part| info.name.to_lowercase().contains(part)) {
            return Ok(adapter);
        }
        found.push(format!("`{}`", info.name));
    }
    Err(DeviceError::NoAdapter(match (name, found.is_empty()) {
        (_, true) => {
            "wgpu found no adapter; install a Vulkan, Metal or DX12 driver (mesa-vulkan-drivers has lavapipe, \
                      which runs on any CPU)"
                .to_owned()
        }
        (Some(name), false) => format!("no adapter's name contains `{name}`; there are {}", found.join(", ")),
        (None, false) => format!("none of {} can be used", found.join(", ")),
    }))
}

/// The adapter that was open before, and no other: pictures, speed and limits of another one would differ.
///
/// # Errors
/// [`DeviceError::NoAdapter`] when it is not there any more, or has another driver now.
pub(super) fn select_again(before: &wgpu::AdapterInfo) -> Result<wgpu::Adapter, DeviceError> {
    let mut found = Vec::new();
    for adapter in enumerate() {
        let info = adapter.get_info();
        if info == *before {
            return Ok(adapter);
        }
        found.push(identity(&info));
    }
    let there_are =
        if found.is_empty() { "there is none".to_owned() } else { format!("there are {}", found.join(", ")) };
    Err(DeviceError::NoAdapter(format!(
        "{} was lost and cannot be opened again, because it is gone or has changed; {there_are}",
        identity(before)
    )))
}

/// What tells adapters apart, for people.
fn identity(info: &wgpu::AdapterInfo) -> String {
    let wgpu::AdapterInfo { name, vendor, device, driver, driver_info, .. } = info;
    format!("`{name}` (vendor {vendor:#06x}, device {device:#06x}, driver {driver} {driver_info})")
}

pub(super) fn describe(adapter: &wgpu::Adapter) -> DeviceInfo {
    let info = adapter.get_info();
    let limits = adapter.limits();
    DeviceInfo {
        kind: "gpu",
        name: info.name,
        driver: [info.driver, info.driver_info].into_iter().filter(|s| !s.is_empty()).collect::<Vec<_>>().join(" "),
        backend: format!("{:?}", info.backend),
        device_type: format!("{:?}", info.device_type),
        max_binding_bytes: limits.max_storage_buffer_binding_size,
    }
}

fn enumerate() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    adapters
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_adapter_is_selected_again() {
        let info = select(None).expect("tests need an adapter (mesa-vulkan-drivers has one)").get_info();
        assert_eq!(select_again(&info).expect("is there").get_info(), info);
        for other in [
            wgpu::AdapterInfo { device: info.device ^ 1, ..info.clone() },
            wgpu::AdapterInfo { driver_info: "another version".to_owned(), ..info.clone() },
        ] {
            let Err(DeviceError::NoAdapter(message)) = select_again(&other) else { panic!("took another adapter") };
            assert!(message.contains(&identity(&other)) && message.contains(&identity(&info)), "{message}");
        }
    }
}
