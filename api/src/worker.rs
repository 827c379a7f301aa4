//! Workers as they register and as the API shows them.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewWorker {
    /// The id that an earlier registration gave, kept on the worker's disk.
    #[serde(default)]
    pub id: Option<String>,
    pub name: String,
    pub version: String,
    pub devices: Vec<Device>,
    #[serde(default)]
    pub tags: Vec<String>,
}

impl NewWorker {
    /// A worker that is new to the service, without tags.
    pub fn new(name: &str, version: &str, devices: Vec<Device>) -> Self {
        Self { id: None, name: name.to_owned(), version: version.to_owned(), devices, tags: Vec::new() }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Device {
    pub kind: DeviceKind,
    pub name: String,
    #[serde(default)]
    pub driver: String,
    #[serde(default)]
    pub backend: String,
    /// `DiscreteGpu`, `IntegratedGpu`, `VirtualGpu` or `Cpu`.
    #[serde(default)]
    pub device_type: String,
}

impl Device {
    /// A device of which nothing but its name is known.
    pub fn named(kind: DeviceKind, name: &str) -> Self {
        let unknown = String::new;
        Self { kind, name: name.to_owned(), driver: unknown(), backend: unknown(), device_type: unknown() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeviceKind {
    Cpu,
    Gpu,
}

impl DeviceKind {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Registered {
    /// Keep it on disk, and give it on the next registration.
    pub id: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WorkerState {
    Idle,
    Busy,
    /// Finishes what it has and leases no more.
    Draining,
    /// It has left, or was not heard of for a minute and a half.
    Gone,
}

impl WorkerState {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Busy => "busy",
            Self::Draining => "draining",
            Self::Gone => "gone",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Worker {
    pub id: String,
    pub name: String,
    pub version: String,
    pub devices: Vec<Device>,
    pub tags: Vec<String>,
    pub state: WorkerState,
    pub draining: bool,
    pub registered_at: Timestamp,
    pub last_seen_at: Timestamp,
    /// Job and task that it works on.
    pub current: Option<CurrentWork>,
    pub tasks_done: u64,
    pub cache: CacheStatus,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CurrentWork {
    pub job: String,
    pub task: String,
}

/// What a worker's structure cache holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CacheStatus {
    pub memory_bytes: u64,
    pub memory_budget_bytes: u64,
    pub disk_bytes: u64,
    pub entries: u64,
}
