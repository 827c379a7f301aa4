//! The worker protocol: lease, heartbeat, complete. Every write of a worker carries the lease token as its fence.
//!
//! | status | the worker |
//! |---|---|
//! | 200 | goes on |
//! | 204 (lease) | asks again |
//! | 404 on `POST /v1/leases` (worker unknown) | registers anew |
//! | 410 on a heartbeat, 409 on complete, fail, release and logs (stale lease), 404 (unknown lease) | drops the work at once, reports nothing |
//! | other 4xx | the request is at fault: fails the task with class `task` |
//! | 429, 5xx, no answer | waits with back-off and repeats; every call may be repeated |
//!
//! Repeating `complete`, `fail` or `release` with the same token answers as the first time. A worker that registers
//! again under its old id has lost what it was doing: its leases end as if they had expired.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::job::{AttemptOutcome, Metrics, Phase, TaskWork};
use crate::settings::JobSettings;
use crate::worker::CacheStatus;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseRequest {
    pub worker: String,
    /// Long poll: how long to wait for work, 0 to 30.
    #[serde(default)]
    pub wait_s: u32,
    /// Hashes of meshes whose structures the worker holds warm (at most 4096).
    #[serde(default)]
    pub warm: Vec<String>,
    #[serde(default)]
    pub cache: CacheStatus,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Lease {
    /// The fence: secret, unique per attempt.
    pub token: String,
    /// For how long the worker may be silent, in seconds.
    pub ttl_s: u32,
    /// Seconds between heartbeats, at most a third of `ttl_s`.
    pub heartbeat_s: f64,
    pub expires_at: Timestamp,
    pub job: String,
    pub task: String,
    pub attempt: String,
    pub attempt_number: u32,
    /// From when the task could run until this lease.
    pub waited_s: f64,
    /// W3C traceparent to go on with.
    pub traceparent: String,
    pub work: TaskWork,
    pub settings: JobSettings,
    pub scene: LeaseScene,
    /// Further scenes of a benchmark.
    #[serde(default)]
    pub more_scenes: Vec<LeaseScene>,
    /// For a merge: the parts of the other tasks.
    pub parts: Vec<Part>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeaseScene {
    pub id: String,
    pub name: String,
    /// Blobs that make up the scene: one `.glb` or `.zip`, or the files of a multipart upload.
    pub files: Vec<SceneFile>,
    /// Mesh hashes, so that structures can be fetched while the scene still loads.
    pub meshes: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneFile {
    /// Relative path as the glTF names it.
    pub path: String,
    pub blob: String,
    pub bytes: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Part {
    pub work: TaskWork,
    pub blob: String,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Heartbeat {
    pub phase: Phase,
    /// Of the whole task, 0 to 1.
    pub progress: f64,
    /// Blob of a PNG of the picture so far.
    #[serde(default)]
    pub preview: Option<String>,
    /// Samples per pixel so far.
    #[serde(default)]
    pub spp: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HeartbeatReply {
    pub expires_at: Timestamp,
    /// Stop within a tile, then `fail` nothing: answer with `release { cancelled: true }`.
    pub cancel: bool,
    /// Finish this task, then lease no more.
    pub drain: bool,
}

/// Answer to `complete`, `fail` and `release`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LeaseClosed {
    pub outcome: AttemptOutcome,
}

/// Lines for the attempt's log. Sequence numbers make repeats harmless.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LogChunk {
    /// Number of the first line, counted from 0 over the whole attempt.
    pub first_sequence: u64,
    pub lines: Vec<String>,
}

/// How far the log reaches: the worker goes on from here, repeating what is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LogAccepted {
    pub next_sequence: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Complete {
    pub artifacts: Vec<NewArtifact>,
    pub metrics: Metrics,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewArtifact {
    /// 1 to 128 letters, digits, `.`, `_` and `-`.
    pub name: String,
    pub media_type: String,
    pub bytes: u64,
    pub blob: String,
}

impl NewArtifact {
    /// What a tile or pass task leaves for the merge.
    pub const PART: &str = "part";
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RetryClass {
    /// Device lost, out of memory, disk: another worker; this one counts towards the job's blocklist.
    Worker,
    /// Bad scene or settings: an attempt is spent, and waiting would not help.
    Task,
    /// A download or an upload failed: back off.
    Transient,
}

impl RetryClass {
    /// How an attempt that failed this way is noted.
    pub fn outcome(self) -> AttemptOutcome {
        match self {
            Self::Worker => AttemptOutcome::Worker,
            Self::Task => AttemptOutcome::Task,
            Self::Transient => AttemptOutcome::Transient,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Fail {
    pub class: RetryClass,
    pub error: String,
    /// A further attempt cannot help: the task fails now (class `task` only).
    #[serde(default)]
    pub fatal: bool,
}

/// `POST .../release`: the work was given up (cancelled or drained).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Release {
    /// True when the heartbeat asked to cancel.
    #[serde(default)]
    pub cancelled: bool,
}
