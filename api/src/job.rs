//! Jobs, their tasks and the attempts at them.

use std::collections::BTreeMap;
use std::fmt;

use jiff::Timestamp;
use serde::de::{DeserializeSeed, Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

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
}

impl JobKind {
    pub const ALL: [Self; 3] = [Self::Render, Self::Benchmark, Self::Build];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Render => "render",
            Self::Benchmark => "benchmark",
            Self::Build => "build",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == name)
    }
}

impl<'de> Deserialize<'de> for JobKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        match Self::from_name(&name) {
            Some(kind) => Ok(kind),
            None if name == "compare" => {
                Err(D::Error::custom("`compare` is not there yet: there are `render`, `benchmark` and `build`"))
            }
            None => Err(D::Error::unknown_variant(&name, &["render", "benchmark", "build"])),
        }
    }
}

/// Body of `POST /v1/jobs`.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct NewJob {
    /// `render` when left out.
    pub kind: JobKind,
    /// Scene id.
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
    /// All of a benchmark.
    Benchmark,
    /// All structures of a scene.
    Build,
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
    /// From when the first task could run, most often the submission, until a worker leased it; null without a service.
    #[serde(default)]
    pub queue_s: Option<f64>,
    /// From the same moment until its first tile began to be rendered; without a service, from the start.
    #[serde(default)]
    pub first_tile_s: Option<f64>,
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
    /// Nodes of all structures: of BVHs those of the binary trees, of grids one.
    #[serde(default)]
    pub structure_nodes: u64,
    pub line_space_bytes: u64,
    /// What Line Spaces were asked and answered; null in a job without.
    #[serde(default)]
    pub line_space: Option<LineSpaceUse>,
    /// On a GPU, the longest that it was held at a stretch, once its kernels were compiled; 0 on a CPU.
    #[serde(default)]
    pub longest_submit_s: f64,
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

impl Metrics {
    /// Adds another task of the same job: times and rays add up, but the first task says when the job began; sizes and
    /// samples are those of the largest, since tasks share the same structures and a merge reports the samples of the
    /// whole picture. Reports of one structure from one source become one, whose seconds add up.
    pub fn add(&mut self, other: &Self) {
        self.queue_s = earliest(self.queue_s, other.queue_s);
        self.first_tile_s = earliest(self.first_tile_s, other.first_tile_s);
        self.scene_s += other.scene_s;
        self.build_s += other.build_s;
        self.prepare_s += other.prepare_s;
        self.render_s += other.render_s;
        self.output_s += other.output_s;
        self.total_s += other.total_s;
        self.rays.primary += other.rays.primary;
        self.rays.shadow += other.rays.shadow;
        self.rays.ao += other.rays.ao;
        self.rays.indirect += other.rays.indirect;
        self.mrays_per_s = if self.render_s > 0.0 { self.rays.total() as f64 / self.render_s / 1e6 } else { 0.0 };
        self.structure_bytes = self.structure_bytes.max(other.structure_bytes);
        self.structure_nodes = self.structure_nodes.max(other.structure_nodes);
        self.line_space_bytes = self.line_space_bytes.max(other.line_space_bytes);
        self.line_space = match (self.line_space, other.line_space) {
            (Some(a), Some(b)) => Some(a.joined(b)),
            (a, b) => a.or(b),
        };
        self.longest_submit_s = self.longest_submit_s.max(other.longest_submit_s);
        self.peak_bytes = self.peak_bytes.max(other.peak_bytes);
        join_distinct(&mut self.device, &other.device);
        join_distinct(&mut self.device_kind, &other.device_kind);
        self.spp = self.spp.max(other.spp);
        self.cache.extend(other.cache.iter().cloned());
        join_reports(&mut self.cache);
        for (name, version) in &other.versions {
            self.versions.entry(name.clone()).or_insert_with(|| version.clone());
        }
        for warning in &other.warnings {
            if !self.warnings.contains(warning) {
                self.warnings.push(warning.clone());
            }
        }
    }
}

/// Of a job with Line Spaces. One ray may ask those of several meshes, and counts each time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LineSpaceUse {
    /// Meshes that have one.
    pub meshes: u64,
    /// Of those, the ones that are asked: where it pays.
    pub asked: u64,
    /// Rays that asked: the sum of those below.
    pub rays: u64,
    /// That start in the mesh's box: the structure was walked.
    pub starts_inside: u64,
    /// Whose line passes the mesh's box by.
    pub beside: u64,
    /// Whose shaft is empty: the mesh was skipped.
    pub empty: u64,
    /// Whose shaft is blocked throughout; an occlusion ray that crosses the whole box was answered.
    pub opaque: u64,
    /// Of whose shaft nothing is certain: the structure was walked.
    pub mixed: u64,
    /// Of all those, the ones that policy `approximate_occlusion` answered without proof.
    pub approximated: u64,
    /// That start too far away for single precision: the structure was walked.
    pub too_far: u64,
    /// Nodes of an N-tree whose shaft was looked up, by all rays.
    #[serde(default)]
    pub node_look_ups: u64,
    /// Of those, the ones that were passed by with all below them.
    #[serde(default)]
    pub skipped_nodes: u64,
}

impl LineSpaceUse {
    /// Rays that need not look at the mesh, of those that asked.
    pub fn answered_percent(&self) -> f64 {
        if self.rays == 0 { 0.0 } else { 100.0 * (self.beside + self.empty + self.opaque) as f64 / self.rays as f64 }
    }

    /// Of two tasks of one job, or two passes of one task.
    pub fn joined(self, other: Self) -> Self {
        Self {
            meshes: self.meshes.max(other.meshes),
            asked: self.asked.max(other.asked),
            rays: self.rays + other.rays,
            starts_inside: self.starts_inside + other.starts_inside,
            beside: self.beside + other.beside,
            empty: self.empty + other.empty,
            opaque: self.opaque + other.opaque,
            mixed: self.mixed + other.mixed,
            approximated: self.approximated + other.approximated,
            too_far: self.too_far + other.too_far,
            node_look_ups: self.node_look_ups + other.node_look_ups,
            skipped_nodes: self.skipped_nodes + other.skipped_nodes,
        }
    }
}

fn join_reports(reports: &mut Vec<CacheReport>) {
    fn key(report: &CacheReport) -> (&str, &str, CacheSource) {
        (&report.mesh, &report.structure, report.source)
    }
    reports.sort_by(|a, b| key(a).cmp(&key(b)));
    reports.dedup_by(|next, kept| {
        let is_same = key(next) == key(kept);
        if is_same {
            kept.seconds += next.seconds;
            kept.bytes = kept.bytes.max(next.bytes);
        }
        is_same
    });
}

fn earliest(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.into_iter().chain(b).min_by(f64::total_cmp)
}

/// Appends the items of `other` to a list separated by semicolons (names of devices hold commas), each only once.
fn join_distinct(list: &mut String, other: &str) {
    for item in other.split("; ").filter(|item| !item.is_empty()) {
        if list.split("; ").any(|known| known == item) {
            continue;
        }
        if !list.is_empty() {
            list.push_str("; ");
        }
        list.push_str(item);
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RayCounts {
    pub primary: u64,
    pub shadow: u64,
    pub ao: u64,
    pub indirect: u64,
}

impl RayCounts {
    pub fn total(&self) -> u64 {
        self.primary + self.shadow + self.ao + self.indirect
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CacheSource {
    Built,
    Memory,
    Disk,
    Fetched,
}

impl CacheSource {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Built => "built",
            Self::Memory => "memory",
            Self::Disk => "disk",
            Self::Fetched => "fetched",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CacheReport {
    /// Hash of the mesh; of a structure over all instances, a hash over their meshes and transforms.
    pub mesh: String,
    /// Structure kind and parameters.
    pub structure: String,
    pub source: CacheSource,
    pub seconds: f64,
    pub bytes: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_many_tasks_took_from_the_same_place_is_told_once() {
        let report = |mesh: &str, source, seconds| CacheReport {
            mesh: mesh.to_owned(),
            structure: "bvh".to_owned(),
            source,
            seconds,
            bytes: 100,
        };
        let task = |reports: &[CacheReport]| Metrics { cache: reports.to_vec(), ..Metrics::default() };
        let mut sum = task(&[report("b", CacheSource::Built, 2.0), report("a", CacheSource::Built, 1.0)]);
        for _ in 0..100 {
            sum.add(&task(&[report("a", CacheSource::Memory, 0.5), report("b", CacheSource::Memory, 0.5)]));
        }
        let expected = [
            report("a", CacheSource::Built, 1.0),
            report("a", CacheSource::Memory, 50.0),
            report("b", CacheSource::Built, 2.0),
            report("b", CacheSource::Memory, 50.0),
        ];
        assert_eq!(sum.cache, expected);
    }

    #[test]
    fn metrics_of_two_tasks_add_up() {
        let mut sum = Metrics {
            queue_s: Some(0.5),
            render_s: 1.0,
            rays: RayCounts { primary: 1_000_000, ..RayCounts::default() },
            structure_bytes: 10,
            device: "AVX2, 2 threads".into(),
            spp: 4,
            warnings: vec!["w".into()],
            ..Metrics::default()
        };
        let other = Metrics {
            queue_s: Some(0.2),
            first_tile_s: Some(0.3),
            render_s: 3.0,
            rays: RayCounts { shadow: 7_000_000, ..RayCounts::default() },
            structure_bytes: 30,
            device: "GPU".into(),
            spp: 8,
            warnings: vec!["w".into()],
            ..Metrics::default()
        };
        sum.add(&other);
        assert_eq!(sum.mrays_per_s, 2.0);
        assert_eq!((sum.queue_s, sum.first_tile_s), (Some(0.2), Some(0.3)), "those of the first task");
        assert_eq!((sum.structure_bytes, sum.spp), (30, 8));
        assert_eq!(sum.device, "AVX2, 2 threads; GPU");
        assert_eq!(sum.warnings, ["w"]);
        sum.add(&other);
        sum.add(&sum.clone());
        assert_eq!(sum.device, "AVX2, 2 threads; GPU");
    }
}
