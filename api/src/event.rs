//! Server-sent events of jobs.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One event; `id` is also the SSE id, so that `Last-Event-ID` resumes after it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Event {
    /// Null for `job.progress` and `job.preview`: those are not kept, and a stream that resumes does not repeat them.
    pub id: Option<i64>,
    pub at: Timestamp,
    pub job: String,
    pub kind: EventKind,
    /// `task`, `attempt`, `worker`, `error`, `class`, `progress` (of the task), `job_progress`, `phase`, `spp`, `href`: what the kind has to say.
    #[serde(default)]
    pub data: serde_json::Value,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
pub enum EventKind {
    #[serde(rename = "job.created")]
    JobCreated,
    #[serde(rename = "job.changed")]
    JobChanged,
    #[serde(rename = "job.started")]
    JobStarted,
    #[serde(rename = "job.progress")]
    JobProgress,
    #[serde(rename = "job.preview")]
    JobPreview,
    #[serde(rename = "job.succeeded")]
    JobSucceeded,
    #[serde(rename = "job.failed")]
    JobFailed,
    #[serde(rename = "job.cancelled")]
    JobCancelled,
    #[serde(rename = "job.retried")]
    JobRetried,
    #[serde(rename = "job.deleted")]
    JobDeleted,
    #[serde(rename = "task.leased")]
    TaskLeased,
    #[serde(rename = "task.succeeded")]
    TaskSucceeded,
    /// Failed for good.
    #[serde(rename = "task.failed")]
    TaskFailed,
    /// Failed, and will be tried again.
    #[serde(rename = "task.retried")]
    TaskRetried,
    #[serde(rename = "task.expired")]
    TaskExpired,
    #[serde(rename = "task.cancelled")]
    TaskCancelled,
}

impl EventKind {
    pub const ALL: [Self; 16] = [
        Self::JobCreated,
        Self::JobChanged,
        Self::JobStarted,
        Self::JobProgress,
        Self::JobPreview,
        Self::JobSucceeded,
        Self::JobFailed,
        Self::JobCancelled,
        Self::JobRetried,
        Self::JobDeleted,
        Self::TaskLeased,
        Self::TaskSucceeded,
        Self::TaskFailed,
        Self::TaskRetried,
        Self::TaskExpired,
        Self::TaskCancelled,
    ];

    /// The SSE event name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::JobCreated => "job.created",
            Self::JobChanged => "job.changed",
            Self::JobStarted => "job.started",
            Self::JobProgress => "job.progress",
            Self::JobPreview => "job.preview",
            Self::JobSucceeded => "job.succeeded",
            Self::JobFailed => "job.failed",
            Self::JobCancelled => "job.cancelled",
            Self::JobRetried => "job.retried",
            Self::JobDeleted => "job.deleted",
            Self::TaskLeased => "task.leased",
            Self::TaskSucceeded => "task.succeeded",
            Self::TaskFailed => "task.failed",
            Self::TaskRetried => "task.retried",
            Self::TaskExpired => "task.expired",
            Self::TaskCancelled => "task.cancelled",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == name)
    }

    /// After it nothing happens to the job any more, unless it is retried.
    pub fn ends_job(self) -> bool {
        matches!(self, Self::JobSucceeded | Self::JobFailed | Self::JobCancelled)
    }
}
