//! Jobs, their tasks and the attempts at them.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::settings::RenderSettings;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    Render,
}

/// Body of `POST /v1/jobs`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewJob {
    #[serde(default = "render")]
    pub kind: JobKind,
    /// Scene id.
    pub scene: String,
    /// Higher runs first; -100 to 100.
    #[serde(default)]
    pub priority: i32,
    /// At most 32, keys up to 64 and values up to 256 characters.
    #[serde(default)]
    pub labels: BTreeMap<String, String>,
    /// Attempts at each task, 1 to 20; 3 when null.
    #[serde(default)]
    pub max_attempts: Option<u32>,
    #[serde(default)]
    pub settings: RenderSettings,
}

fn render() -> JobKind {
    JobKind::Render
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    Queued,
    Running,
    Succeeded,
    Failed,
    Cancelled,
}

impl JobState {
    pub fn is_final(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Job {
    pub id: String,
    pub kind: JobKind,
    pub scene: String,
    pub scene_name: String,
    pub state: JobState,
    pub paused: bool,
    pub cancel_requested: bool,
    pub priority: i32,
    pub labels: BTreeMap<String, String>,
    /// 0 to 1 over all tasks.
    pub progress: f64,
    /// What a failed job failed of.
    pub error: Option<String>,
    pub created_at: Timestamp,
    pub started_at: Option<Timestamp>,
    pub finished_at: Option<Timestamp>,
    pub settings: RenderSettings,
    pub tasks: Vec<Task>,
    pub attempts: Vec<Attempt>,
    pub artifacts: Vec<Artifact>,
    pub metrics: Option<Metrics>,
    /// W3C trace id, 32 hex digits, the same in every log line from submit to done.
    pub trace_id: String,
}

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
    /// `running`, `succeeded`, `worker`, `task`, `transient`, `interrupted`, `deferred`, `expired`, `cancelled`.
    pub outcome: String,
    pub error: Option<String>,
    pub phase: Option<String>,
    pub started_at: Timestamp,
    pub finished_at: Option<Timestamp>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Artifact {
    pub name: String,
    pub media_type: String,
    pub bytes: u64,
    /// BLAKE3 of the content; also its ETag.
    pub hash: String,
    pub href: String,
}

/// Measured by the worker; summed over a job's tasks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Metrics {
    /// Fetching and decoding the scene.
    pub scene_s: f64,
    /// Getting every structure: built, loaded or fetched.
    pub build_s: f64,
    /// Packing and uploading to the device.
    pub prepare_s: f64,
    pub render_s: f64,
    /// Encoding and uploading pictures.
    pub output_s: f64,
    pub total_s: f64,
    pub rays: RayCounts,
    /// Rays of all kinds over `render_s`.
    pub mrays_per_s: f64,
    pub structure_bytes: u64,
    pub line_space_bytes: u64,
    /// Highest resident memory of the worker process.
    pub peak_bytes: u64,
    pub device: String,
    pub device_kind: String,
    pub spp: u32,
    pub cache: Vec<CacheReport>,
    /// Engine, driver and shader versions.
    pub versions: BTreeMap<String, String>,
    pub warnings: Vec<String>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RayCounts {
    pub primary: u64,
    pub shadow: u64,
    pub ao: u64,
    pub indirect: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CacheSource {
    Built,
    Memory,
    Disk,
    Fetched,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CacheReport {
    pub mesh: String,
    /// Structure kind and parameters.
    pub structure: String,
    pub source: CacheSource,
    pub seconds: f64,
    pub bytes: u64,
}
