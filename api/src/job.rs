//! Jobs as they are asked for and told of; their tasks and what they cost are in modules of their own.

mod metrics;
mod task;

use std::collections::BTreeMap;
use std::fmt;

use jiff::Timestamp;
use serde::de::{DeserializeSeed, Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

pub use self::metrics::{BuiltOn, CacheReport, CacheSource, LineSpaceUse, Metrics, RayCounts};
pub use self::task::{Attempt, AttemptOutcome, Phase, Task, TaskState, TaskWork};
use crate::estimate::Estimate;
use crate::problem::{FieldError, escape_pointer};
use crate::settings::JobSettings;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    Render,
    /// Times configurations of structures against each other.
    Benchmark,
    /// Makes structures for later jobs.
    Build,
    /// Compares two pictures, as `POST /v1/compare` does at once.
    Compare,
}

impl JobKind {
    pub const ALL: [Self; 4] = [Self::Render, Self::Benchmark, Self::Build, Self::Compare];
    /// As messages list them.
    pub const NAMES: &[&str] = &["render", "benchmark", "build", "compare"];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Render => "render",
            Self::Benchmark => "benchmark",
            Self::Build => "build",
            Self::Compare => "compare",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == name)
    }
}

impl<'de> Deserialize<'de> for JobKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::from_name(&name).ok_or_else(|| D::Error::unknown_variant(&name, Self::NAMES))
    }
}

/// Body of `POST /v1/jobs`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct NewJob {
    /// `render` when left out.
    pub kind: JobKind,
    /// Scene id. Of `compare` it may be left out where a picture is a job's: then it is that job's scene.
    #[schema(required = false)]
    pub scene: String,
    /// Higher runs first; -100 to 100.
    #[schema(required = false)]
    pub priority: i32,
    /// At most 32, keys up to 64 and values up to 256 characters.
    #[schema(required = false)]
    pub labels: BTreeMap<String, String>,
    /// Attempts at each task, 1 to 20; 3 when null.
    #[schema(required = false)]
    pub max_attempts: Option<u32>,
    /// Of the kind.
    #[schema(required = false)]
    pub settings: JobSettings,
}

impl<'de> Deserialize<'de> for NewJob {
    /// By hand: which settings there are depends on the kind, and each field must keep its place in errors.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(NewJobVisitor)
    }
}

struct NewJobVisitor;

const NEW_JOB_FIELDS: &[&str] = &["kind", "scene", "priority", "labels", "max_attempts", "settings"];

impl<'de> Visitor<'de> for NewJobVisitor {
    type Value = NewJob;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a job: an object with a scene")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<NewJob, A::Error> {
        let (mut kind, mut scene, mut priority, mut labels, mut max_attempts) = (None, None, None, None, None);
        let mut settings: Option<JobSettings> = None;
        while let Some(field) = map.next_key::<String>()? {
            match field.as_str() {
                "kind" => fill("kind", &mut kind, map.next_value()?)?,
                "scene" => fill("scene", &mut scene, map.next_value()?)?,
                "priority" => fill("priority", &mut priority, map.next_value()?)?,
                "labels" => fill("labels", &mut labels, map.next_value()?)?,
                "max_attempts" => fill("max_attempts", &mut max_attempts, map.next_value()?)?,
                // In an object whose fields are sorted the kind has come before, if there is one.
                "settings" => {
                    let read = map.next_value_seed(OfKind(kind.unwrap_or(JobKind::Render)))?;
                    fill("settings", &mut settings, read)?;
                }
                other => return Err(A::Error::unknown_field(other, NEW_JOB_FIELDS)),
            }
        }
        let kind = kind.unwrap_or(JobKind::Render);
        let settings = settings.unwrap_or_else(|| JobSettings::default_of(kind));
        if settings.kind() != kind {
            return Err(A::Error::custom("the kind must stand before the settings"));
        }
        let has_scene_of_picture = kind == JobKind::Compare;
        let scene = scene.or_else(|| has_scene_of_picture.then(String::new));
        Ok(NewJob {
            kind,
            scene: scene.ok_or_else(|| A::Error::missing_field("scene"))?,
            priority: priority.unwrap_or_default(),
            labels: labels.unwrap_or_default(),
            max_attempts: max_attempts.unwrap_or_default(),
            settings,
        })
    }
}

fn fill<T, E: Error>(field: &'static str, place: &mut Option<T>, value: T) -> Result<(), E> {
    if place.replace(value).is_some() { Err(E::duplicate_field(field)) } else { Ok(()) }
}

struct OfKind(JobKind);

impl<'de> DeserializeSeed<'de> for OfKind {
    type Value = JobSettings;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<JobSettings, D::Error> {
        JobSettings::read(self.0, deserializer)
    }
}

/// Labels that start with this are the service's own.
pub const RESERVED_LABEL_PREFIX: &str = "lightshaft.";
/// Of automatic jobs that render what one of a scene's cameras sees: its index.
pub const CAMERA_LABEL: &str = "lightshaft.camera";

impl NewJob {
    /// Every field that is out of range; what depends on the scene is checked by the service.
    pub fn validate(&self) -> Vec<FieldError> {
        let mut errors = Vec::new();
        if !(-100..=100).contains(&self.priority) {
            errors.push(FieldError::new("/priority", "must be -100 to 100"));
        }
        if self.max_attempts.is_some_and(|n| !(1..=20).contains(&n)) {
            errors.push(FieldError::new("/max_attempts", "must be 1 to 20"));
        }
        if self.labels.len() > 32 {
            errors.push(FieldError::new("/labels", "must be at most 32 labels"));
        }
        for (key, value) in &self.labels {
            let pointer = || format!("/labels/{}", escape_pointer(key));
            if key.is_empty() || key.chars().count() > 64 {
                errors.push(FieldError::new(pointer(), "the key must have 1 to 64 characters"));
            }
            if key.starts_with(RESERVED_LABEL_PREFIX) {
                errors.push(FieldError::new(pointer(), "keys that start with `lightshaft.` are the service's own"));
            }
            if value.chars().count() > 256 {
                errors.push(FieldError::new(pointer(), "the value must have at most 256 characters"));
            }
        }
        if self.kind != self.settings.kind() {
            errors.push(FieldError::new("/settings", format!("must be those of a {}", self.kind.as_str())));
        }
        errors.extend(self.settings.validate("/settings"));
        errors
    }
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
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == name)
    }

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

/// One line of the list of jobs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobSummary {
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
    pub tasks_total: u32,
    /// Succeeded tasks.
    pub tasks_done: u32,
    /// What a failed job failed of.
    pub error: Option<String>,
    pub created_at: Timestamp,
    pub started_at: Option<Timestamp>,
    pub finished_at: Option<Timestamp>,
    /// W3C trace id, 32 hex digits, the same in every log line from submit to done.
    pub trace_id: String,
}

/// A whole job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Job {
    #[serde(flatten)]
    pub summary: JobSummary,
    /// Attempts at each task.
    pub max_attempts: u32,
    pub settings: JobSettings,
    pub tasks: Vec<Task>,
    pub attempts: Vec<Attempt>,
    pub artifacts: Vec<Artifact>,
    pub metrics: Option<Metrics>,
    /// Why none of its tasks runs, while the job waits.
    pub waiting: Option<String>,
    /// Where the picture so far is, while the job runs and a worker has sent one.
    pub preview: Option<String>,
}

/// Body of `PATCH /v1/jobs/{id}`: only what is given changes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JobPatch {
    /// Higher runs first; -100 to 100.
    pub priority: Option<i32>,
    /// A paused job's tasks are not leased; running ones go on.
    pub paused: Option<bool>,
}

/// Answer to `POST /v1/jobs?validate_only=true`: the job as it would be made, every default filled in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ValidatedJob {
    pub job: NewJob,
    /// How many tasks it would have.
    pub tasks: u32,
    pub estimate: Estimate,
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
