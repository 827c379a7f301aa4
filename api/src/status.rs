//! The state of the whole service.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Status {
    pub state: ServiceState,
    pub version: String,
    pub uptime_s: f64,
    pub jobs: StateCounts,
    pub tasks_ready: u64,
    pub tasks_leased: u64,
    pub workers: WorkerCounts,
    pub scenes: u64,
    pub blob_bytes: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ServiceState {
    /// Work is being done.
    Active,
    Idle,
    /// There is work, and a worker that has not taken it yet.
    Waiting,
    /// There is work, and no worker.
    Inoperable,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StateCounts {
    pub queued: u64,
    pub running: u64,
    pub succeeded: u64,
    pub failed: u64,
    pub cancelled: u64,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct WorkerCounts {
    pub idle: u64,
    pub busy: u64,
    pub draining: u64,
    pub gone: u64,
}
