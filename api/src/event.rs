//! Server-sent events of jobs.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One event; `id` is also the SSE id, so that `Last-Event-ID` resumes after it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Event {
    pub id: i64,
    pub at: Timestamp,
    pub job: String,
    /// `job.created`, `job.started`, `job.progress`, `job.preview`, `job.succeeded`, `job.failed`, `job.cancelled`,
    /// `job.retried`, `task.leased`, `task.succeeded`, `task.failed`, `task.retried`, `task.expired`.
    pub kind: String,
    #[serde(default)]
    pub data: serde_json::Value,
}
