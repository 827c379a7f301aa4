//! Tasks, into which a job is split, and the attempts at them.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskState {
    Blocked,
    Ready,
    Leased,
    Succeeded,
    Failed,
    Cancelled,
    Dead,
}

impl TaskState {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Blocked => "blocked",
            Self::Ready => "ready",
            Self::Leased => "leased",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
            Self::Dead => "dead",
        }
    }
}

/// What a task does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum TaskWork {
    /// The whole picture.
    Frame,
    /// A rectangle of the picture, all samples. Leaves the artifact `part`.
    Tile { x: u32, y: u32, width: u32, height: u32 },
    /// The whole picture, some samples. Leaves the artifact `part`.
    Pass { first_sample: u32, samples: u32 },
    /// Puts the parts of the other tasks together.
    Merge,
    /// All of a benchmark.
    Benchmark,
    /// All structures of a scene.
    Build,
    /// Two pictures.
    Compare,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Task {
    pub id: String,
    pub index: u32,
    pub work: TaskWork,
    pub state: TaskState,
    pub progress: f64,
    /// Attempts spent.
    pub attempt: u32,
    pub max_attempts: u32,
    /// From when on a waiting task may run: in the future after a failure that is worth a pause.
    pub ready_at: Option<Timestamp>,
    /// What it failed of where no attempt says it: no worker has the device that it demands.
    pub error: Option<String>,
}

/// One lease of one task. Never overwritten.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Attempt {
    pub id: String,
    pub task: String,
    /// From 1.
    pub number: u32,
    pub worker: String,
    pub worker_name: String,
    pub outcome: AttemptOutcome,
    pub error: Option<String>,
    /// The last phase that a heartbeat told of.
    pub phase: Option<Phase>,
    pub started_at: Timestamp,
    pub finished_at: Option<Timestamp>,
}

/// How an attempt ended; the failures are the retry classes of [`RetryClass`](crate::lease::RetryClass).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AttemptOutcome {
    Running,
    Succeeded,
    Worker,
    Task,
    Transient,
    /// Given back before its end: drain or shutdown.
    Interrupted,
    /// No heartbeat came within the lease's time to live.
    Expired,
    Cancelled,
}

impl AttemptOutcome {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Worker => "worker",
            Self::Task => "task",
            Self::Transient => "transient",
            Self::Interrupted => "interrupted",
            Self::Expired => "expired",
            Self::Cancelled => "cancelled",
        }
    }
}

/// What a worker is at within a task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Downloading the scene's blobs.
    #[default]
    Fetch,
    /// Decoding the scene.
    Import,
    /// Building, loading or fetching structures.
    Structures,
    /// Packing and uploading to the device.
    Prepare,
    Render,
    /// Encoding and uploading pictures.
    Output,
}

impl Phase {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Fetch => "fetch",
            Self::Import => "import",
            Self::Structures => "structures",
            Self::Prepare => "prepare",
            Self::Render => "render",
            Self::Output => "output",
        }
    }
}
