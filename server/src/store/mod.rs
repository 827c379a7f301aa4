//! The service's memory: one trait, so that SQLite and later Postgres behave alike, and one conformance suite
//! ([`conformance`]) in which every behaviour is a sentence. All SQL lives below this module.
//!
//! Every method is one transaction. Times come from the caller: no statement asks a database or a worker for them.

#[cfg(test)]
mod conformance;
mod farm;
pub mod sqlite;

use std::collections::BTreeMap;
use std::error::Error;

use async_trait::async_trait;
use lightshaft_api::event::Event;
use lightshaft_api::job::{
    Artifact, Attempt, AttemptOutcome, Job, JobKind, JobState, JobSummary, Phase, Task, TaskWork,
};
use lightshaft_api::lease::{Complete, Fail, LeaseScene, Part, SceneFile};
use lightshaft_api::mesh::{FindStructures, Mesh, NewStructure, Structure};
use lightshaft_api::queue::{BlockedWorker, HeldTask};
use lightshaft_api::scene::{Scene, SceneSummary};
use lightshaft_api::settings::{Integrator, JobSettings};
use lightshaft_api::status::StateCounts;
use lightshaft_api::worker::{NewWorker, Worker};

pub use self::farm::{
    Acceptance, AfterAttempt, BaselineKey, BaselineStore, CaseDecision, CaseJob, CaseRecord, CaseStep, DecisionQuery,
    DueDelivery, OpenCase, Reference, ReferenceTimes, RunQuery, RunRecord, RunStore, ScheduleStore, Step, SuiteStore,
    WebhookStore,
};
use crate::queue::{Demand, Millis, TaskCounts};

/// Something is wrong with the database itself; never the client's fault.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("{context}: {source}")]
    Database { context: &'static str, source: Box<dyn Error + Send + Sync> },
    #[error("the database holds what it must not: {0}")]
    Corrupt(String),
}

pub type Result<T, E = StoreError> = std::result::Result<T, E>;

/// A page of a list, newest first: what comes after `cursor`, at most `limit` rows.
#[derive(Clone, Debug, Default)]
pub struct PageRequest {
    pub limit: u32,
    /// Id of the last row of the page before.
    pub after: Option<String>,
}

#[derive(Clone, Debug, Default)]
pub struct JobQuery {
    pub state: Option<JobState>,
    pub kind: Option<JobKind>,
    pub scene: Option<String>,
    pub labels: BTreeMap<String, String>,
    /// Part of the scene's name or of a label's value, or the start of the id.
    pub text: Option<String>,
    /// Only (or no) jobs that the service made by itself.
    pub automatic: Option<bool>,
}

#[derive(Clone, Debug)]
pub struct SceneRecord {
    pub id: String,
    pub hash: String,
    pub name: String,
    pub bytes: u64,
    pub summary: SceneSummary,
    pub files: Vec<SceneFile>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Removal {
    Done,
    Unknown,
    /// Unfinished work needs it.
    InUse,
}

/// A small picture that nobody asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Automatic {
    /// Of the scene.
    Thumbnail,
    /// Of what one of its cameras sees.
    Camera,
}

#[derive(Clone, Debug)]
pub struct JobRecord {
    pub id: String,
    pub scene: String,
    pub priority: i32,
    pub max_attempts: u32,
    pub labels: BTreeMap<String, String>,
    pub settings: JobSettings,
    pub tasks: Vec<TaskWork>,
    pub trace_id: String,
    /// Why the service makes it by itself; `None` when somebody asked for it.
    pub automatic: Option<Automatic>,
    /// The only worker that may do it; any when `None`.
    pub worker: Option<String>,
}

/// How far a job's tasks are, of which the leased ones go on while nobody writes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TaskProgress {
    pub tasks: u32,
    /// Summed over all tasks that are not leased.
    pub settled: f64,
    /// By id of the leased tasks, as last written.
    pub leased: BTreeMap<String, f64>,
}

impl TaskProgress {
    /// Of the whole job, 0 to 1, when `live` knows better how far leased tasks are.
    pub fn of_job(&self, live: impl Fn(&str) -> Option<f64>) -> f64 {
        let running = self.leased.iter().map(|(task, &written)| live(task).map_or(written, |live| live.max(written)));
        let sum = self.settled + running.sum::<f64>();
        (sum / f64::from(self.tasks.max(1))).clamp(0.0, 1.0)
    }
}

/// A line of the list of jobs.
#[derive(Clone, Debug)]
pub struct ListedJob {
    pub summary: JobSummary,
    pub progress: TaskProgress,
}

/// A line of the queue.
#[derive(Clone, Debug)]
pub struct QueuedRecord {
    pub job: ListedJob,
    pub demand: Demand,
    /// The only worker that may do it, as id and name; any when `None`.
    pub worker: Option<(String, String)>,
    pub tasks_ready: u32,
    pub tasks_blocked: u32,
    /// When the first of its waiting tasks may run.
    pub ready_at: Option<Millis>,
    pub failures: u32,
    pub last_error: Option<String>,
    pub leases: Vec<HeldTask>,
    pub blocked_workers: Vec<BlockedWorker>,
}

/// How quickly a finished job rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    pub scene: String,
    /// Pixels times samples of each.
    pub samples: f64,
    pub rays: f64,
    pub mrays_per_s: f64,
    pub device: String,
    pub device_kind: String,
}

/// The key of a repeated request, and what the request said.
#[derive(Clone, Debug)]
pub struct Idempotency {
    pub key: String,
    pub fingerprint: String,
    /// Keys older than this are forgotten.
    pub not_before: Millis,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Creation {
    Created,
    /// The key was used before, for the same request: this job or run came of it.
    Repeated(String),
    /// The key was used before, for another request.
    KeyReused,
    /// The scene is gone.
    UnknownScene,
}

/// The answer to something that is asked of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    Done,
    Unknown,
    /// Not in this state.
    Refused(JobState),
    /// Retrying a job whose scene was deleted.
    SceneGone,
}

/// The answer to the wish to delete a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobRemoval {
    Done {
        /// Blobs of which one name less is left.
        blobs: Vec<String>,
        /// Its attempts, which may have left logs.
        attempts: Vec<String>,
    },
    Unknown,
    /// It has not ended yet.
    Unfinished(JobState),
}

/// A worker asks for a task.
#[derive(Clone, Debug)]
pub struct Claim {
    pub worker: String,
    pub token: String,
    pub attempt: String,
    pub now: Millis,
    pub expires_at: Millis,
    /// Meshes whose structures the worker holds warm.
    pub warm: Vec<String>,
}

#[derive(Clone, Debug)]
pub enum Claimed {
    UnknownWorker,
    /// No task for this worker now.
    Nothing,
    Task(Box<ClaimedTask>),
}

#[derive(Clone, Debug)]
pub struct ClaimedTask {
    pub job: String,
    pub task: String,
    pub number: u32,
    pub work: TaskWork,
    pub settings: JobSettings,
    pub trace_id: String,
    pub scene: LeaseScene,
    /// Further scenes of a benchmark.
    pub more_scenes: Vec<LeaseScene>,
    pub parts: Vec<Part>,
    /// From the moment the task could run to this lease.
    pub waited_ms: Millis,
}

/// An attempt, found by its token.
#[derive(Clone, Debug)]
pub struct LeaseState {
    pub attempt: String,
    pub task: String,
    pub job: String,
    pub worker: String,
    pub outcome: AttemptOutcome,
    pub phase: Option<Phase>,
    /// Zero once the lease has ended.
    pub expires_at: Millis,
    pub cancel_requested: bool,
    pub draining: bool,
}

/// The answer to a report that ends a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Close {
    Unknown,
    Closed(AttemptOutcome),
    /// Ended before, like this.
    Already(AttemptOutcome),
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Completed {
    pub close: Close,
    /// Blobs of which one name less is left.
    pub freed: Vec<String>,
}

/// A task whose lease ran out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Expired {
    pub job: String,
    pub task: String,
    pub attempt: String,
    pub worker: String,
    /// Whether it will be tried again.
    pub again: bool,
}

/// A job with tasks that could run, were there a worker with the device that they demand.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Demanding {
    pub job: String,
    pub demand: Demand,
    /// From when on the first of its tasks could run.
    pub ready_since: Millis,
}

#[derive(Clone, Debug, Default)]
pub struct Totals {
    pub jobs: StateCounts,
    pub tasks: TaskCounts,
    pub scenes: u64,
}

#[async_trait]
pub trait Store: SuiteStore + RunStore + BaselineStore + ScheduleStore + WebhookStore + Send + Sync + 'static {
    /// Fails when nothing can be written.
    async fn check_writable(&self, now: Millis) -> Result<()>;
    async fn totals(&self) -> Result<Totals>;

    // Scenes, meshes, blobs.

    /// Returns the id of the scene with these bytes, and whether it is new.
    async fn insert_scene(&self, scene: &SceneRecord, now: Millis) -> Result<(String, bool)>;
    async fn scene(&self, id: &str) -> Result<Option<Scene>>;
    async fn scene_by_hash(&self, hash: &str) -> Result<Option<Scene>>;
    async fn scenes(&self, page: &PageRequest) -> Result<Vec<Scene>>;
    /// Blobs that make up a scene.
    async fn scene_blobs(&self, id: &str) -> Result<Vec<String>>;
    /// Scenes with something in them that no job was ever made for to render their thumbnail.
    async fn scenes_without_thumbnail(&self, limit: u32) -> Result<Vec<Scene>>;
    async fn thumbnail_job(&self, scene: &str) -> Result<Option<String>>;
    /// Refused while a job that people asked for is unfinished; unfinished automatic jobs are cancelled.
    async fn delete_scene(&self, id: &str, now: Millis) -> Result<Removal>;
    /// In order of their hash: all, or those of a scene.
    async fn meshes(&self, scene: Option<&str>, page: &PageRequest) -> Result<Vec<Mesh>>;
    async fn mesh(&self, hash: &str) -> Result<Option<Mesh>>;
    /// Blobs of the structures that these meshes have, by mesh.
    async fn find_structures(&self, wanted: &FindStructures) -> Result<BTreeMap<String, String>>;
    /// The first to tell of a structure is kept, unless its blob is the one that `replaces` names; `None` for an unknown
    /// mesh.
    async fn add_structure(&self, mesh: &str, structure: &NewStructure, now: Millis) -> Result<Option<Structure>>;
    /// Whether a scene, a structure, an artifact or a job's settings name this blob.
    async fn is_blob_used(&self, hash: &str) -> Result<bool>;

    // Jobs.

    async fn create_job(&self, job: &JobRecord, idempotency: Option<&Idempotency>, now: Millis) -> Result<Creation>;
    /// The job of a key used before, when the request was the same.
    async fn repeated_job(&self, idempotency: &Idempotency) -> Result<Option<Creation>>;
    async fn job(&self, id: &str) -> Result<Option<Job>>;
    async fn job_state(&self, id: &str) -> Result<Option<JobState>>;
    async fn jobs(&self, query: &JobQuery, page: &PageRequest) -> Result<Vec<ListedJob>>;
    /// Of the newest jobs that rendered with this integrator and succeeded, newest first.
    async fn measurements(&self, integrator: Integrator, limit: u32) -> Result<Vec<Measurement>>;
    /// Unfinished jobs: those that run, then those that wait by priority and age, then paused ones.
    async fn queue(&self, limit: u32, now: Millis) -> Result<Vec<QueuedRecord>>;
    /// Nothing of an unknown job.
    async fn task_progress(&self, job: &str) -> Result<TaskProgress>;
    async fn tasks(&self, job: &str) -> Result<Vec<Task>>;
    async fn attempts(&self, job: &str) -> Result<Vec<Attempt>>;
    async fn artifacts(&self, job: &str) -> Result<Vec<Artifact>>;
    async fn cancel_job(&self, id: &str, now: Millis) -> Result<Change>;
    /// Failed, dead and cancelled tasks start afresh; what succeeded stays.
    async fn retry_job(&self, id: &str, now: Millis) -> Result<Change>;
    /// Jobs that are not paused and have ready tasks that demand a device.
    async fn demanding_jobs(&self) -> Result<Vec<Demanding>>;
    /// Fails a job that nobody can do, unless somebody has taken its tasks meanwhile; returns whether.
    async fn give_up_job(&self, id: &str, error: &str, now: Millis) -> Result<bool>;
    /// Deletes a finished job with all that belongs to it.
    async fn delete_job(&self, id: &str, now: Millis) -> Result<JobRemoval>;
    /// Ids of jobs that ended before a time, oldest first; thumbnails of scenes that are there are not among them, nor is
    /// what a run of the farm that goes on still has to look at.
    async fn jobs_finished_before(&self, before: Millis, limit: u32) -> Result<Vec<String>>;
    async fn patch_job(&self, id: &str, priority: Option<i32>, paused: Option<bool>, now: Millis) -> Result<Change>;

    // Workers and leases.

    /// Leases that the worker still held under this id have been lost, and expire.
    async fn register_worker(&self, id: &str, worker: &NewWorker, now: Millis) -> Result<Vec<Expired>>;
    async fn worker(&self, id: &str) -> Result<Option<Worker>>;
    async fn workers(&self) -> Result<Vec<Worker>>;
    async fn touch_worker(&self, id: &str, now: Millis) -> Result<()>;
    /// False for an unknown worker.
    async fn set_draining(&self, id: &str, draining: bool) -> Result<bool>;
    async fn remove_worker(&self, id: &str, now: Millis) -> Result<Removal>;
    /// Whether a claim of this worker would find a task: a look that does not keep others from writing. `None` for an
    /// unknown worker.
    async fn has_task_for(&self, worker: &str, now: Millis) -> Result<Option<bool>>;
    async fn claim(&self, claim: &Claim) -> Result<Claimed>;
    async fn lease(&self, token: &str) -> Result<Option<LeaseState>>;
    /// False when the lease has ended. One that has run out, but that nobody has taken away, goes on.
    async fn renew(&self, token: &str, phase: Phase, progress: f64, expires_at: Millis) -> Result<bool>;
    /// Notes how far a leased task is, without extending its lease.
    async fn note_progress(&self, token: &str, progress: f64) -> Result<()>;
    /// A merge also drops the parts that it was made of.
    async fn complete(&self, token: &str, report: &Complete, now: Millis) -> Result<Completed>;
    /// `jitter` is uniform in -1 to 1.
    async fn fail(&self, token: &str, report: &Fail, jitter: f64, now: Millis) -> Result<Close>;
    /// Given back: cancelled when that was asked for, ready again otherwise.
    async fn release(&self, token: &str, cancelled: bool, now: Millis) -> Result<Close>;
    /// Ends leases that have run out, at most a batch.
    async fn expire_leases(&self, now: Millis) -> Result<Vec<Expired>>;

    // Events and upkeep.

    /// Events after an id, oldest first.
    async fn events_after(&self, id: i64, job: Option<&str>, limit: u32) -> Result<Vec<Event>>;
    async fn last_event(&self) -> Result<i64>;
    /// Forgets idempotency keys and events that are older; returns how many.
    async fn forget_before(&self, keys: Millis, events: Millis) -> Result<u64>;
    /// Keeps the write-ahead log small.
    async fn checkpoint(&self) -> Result<()>;
}
