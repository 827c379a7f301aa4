//! The queue: what runs and what waits, in the order of its turn.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::job::{JobSummary, Phase, TaskWork};

/// Unfinished jobs: those that run, then those that wait by priority and age, then paused ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Queue {
    pub jobs: Vec<QueuedJob>,
    /// Unfinished jobs in all, of which these are the first.
    pub total: u64,
}

/// A job that has not ended, and what it waits for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct QueuedJob {
    #[serde(flatten)]
    pub summary: JobSummary,
    /// What a worker must have, in words; null when any will do.
    pub needs: Option<String>,
    /// Tasks that wait for their turn.
    pub tasks_ready: u32,
    /// Tasks that wait for others of the same job.
    pub tasks_blocked: u32,
    /// Why none of its tasks runs; null when one does.
    pub waiting: Option<String>,
    /// From when on the first of its waiting tasks may run: in the future after a failure that is worth a pause.
    pub ready_at: Option<Timestamp>,
    /// Attempts that failed so far.
    pub failures: u32,
    /// What the last of them failed of.
    pub last_error: Option<String>,
    /// Tasks that workers hold.
    pub leases: Vec<HeldTask>,
    /// Workers that failed at it and are kept from it for a while.
    pub blocked_workers: Vec<BlockedWorker>,
}

/// A task that a worker has leased.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HeldTask {
    pub task: String,
    pub work: TaskWork,
    pub worker: String,
    pub worker_name: String,
    /// From 1.
    pub attempt: u32,
    /// The last phase that a heartbeat told of.
    pub phase: Option<Phase>,
    /// When it goes to another worker, should this one stay silent.
    pub expires_at: Timestamp,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BlockedWorker {
    pub worker: String,
    pub worker_name: String,
    pub failures: u32,
    pub until: Timestamp,
}
