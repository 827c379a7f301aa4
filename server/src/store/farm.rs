//! What the regression farm keeps: suites, runs, baselines. Parts of [`Store`](super::Store), in traits of their own.

use std::collections::BTreeMap;

use async_trait::async_trait;
use lightshaft_api::farm::{
    AcceptedPicture, Baseline, CaseState, Decision, DecisionKind, DeliveryAttempt, FarmJob, FarmJobPhase, HistoryPoint,
    ImageResult, ImageTolerance, NewWebhook, PictureSource, Run, RunKind, RunState, RunSummary, Schedule,
    SettingsPatch, Suite, SuiteSummary, TimeMetric, TimeResult, TimeTolerance, Webhook, WebhookDelivery,
};
use lightshaft_api::job::Artifact;
use lightshaft_api::settings::RenderSettings;

use super::{Creation, Idempotency, JobRecord, PageRequest, Result};
use crate::queue::Millis;

/// A new run with its cases.
#[derive(Clone, Debug)]
pub struct RunRecord {
    pub id: String,
    pub kind: RunKind,
    pub suite: String,
    pub suite_name: String,
    pub label: String,
    pub labels: BTreeMap<String, String>,
    pub baseline: String,
    pub scenes: BTreeMap<String, String>,
    pub overrides: SettingsPatch,
    pub priority: i32,
    /// Of a calibration: how often each case is run. 1 otherwise.
    pub times: u32,
    pub cases: Vec<CaseRecord>,
}

#[derive(Clone, Debug)]
pub struct CaseRecord {
    pub name: String,
    /// Id.
    pub scene: String,
    pub settings: RenderSettings,
    pub device_class: Option<String>,
    pub repeat: u32,
    pub tolerance: ImageTolerance,
    pub time_tolerance: TimeTolerance,
}

/// A case without a verdict, of a run that goes on.
#[derive(Clone, Debug)]
pub struct OpenCase {
    pub run: String,
    pub kind: RunKind,
    pub times: u32,
    pub baseline: String,
    pub suite_name: String,
    pub label: String,
    pub priority: i32,
    pub state: CaseState,
    /// Begun anew when its worker was lost: only jobs of this generation count.
    pub generation: u32,
    pub case: CaseRecord,
    pub worker: Option<String>,
    pub versions: BTreeMap<String, String>,
    /// Of a case that is being confirmed, as far as it is known.
    pub image: Option<ImageResult>,
    pub time: Option<TimeResult>,
    pub jobs: Vec<FarmJob>,
}

/// A job of a case, with what makes it one.
#[derive(Clone, Debug)]
pub struct CaseJob {
    pub phase: FarmJobPhase,
    pub position: u32,
    pub job: JobRecord,
}

/// What changes of an open case; what is `None` stays as it is.
#[derive(Clone, Debug, Default)]
pub struct CaseStep {
    pub state: Option<CaseState>,
    /// Starts anew: jobs of before do not count any more, and their worker is forgotten.
    pub begins_anew: bool,
    pub device_class: Option<String>,
    pub worker: Option<String>,
    pub versions: Option<BTreeMap<String, String>>,
    pub image: Option<ImageResult>,
    pub time: Option<TimeResult>,
    /// Seconds by job.
    pub times_s: Vec<(String, f64)>,
    /// Jobs to be made.
    pub jobs: Vec<CaseJob>,
    pub artifacts: Vec<Artifact>,
    /// Whether it passes, of a case that ends.
    pub ok: Option<bool>,
    /// Of a calibration: how far medians lie apart.
    pub noise_floor: Option<(TimeMetric, f64)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    Done,
    /// It has ended, or begun anew, since it was read.
    Overtaken,
    /// A job could not be made: its scene was deleted.
    SceneGone,
}

#[derive(Clone, Debug, Default)]
pub struct RunQuery {
    pub kind: Option<RunKind>,
    pub state: Option<RunState>,
    pub suite_name: Option<String>,
    pub label: Option<String>,
    pub baseline: Option<String>,
    pub ok: Option<bool>,
}

#[derive(Clone, Debug, Default)]
pub struct DecisionQuery {
    pub kind: Option<DecisionKind>,
    pub suite_name: Option<String>,
    pub case: Option<String>,
    pub baseline: Option<String>,
    pub run: Option<String>,
    pub who: Option<String>,
}

/// Whose baseline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BaselineKey {
    pub baseline: String,
    pub suite_name: String,
    pub case: String,
    pub device_class: String,
}

/// What a picture or a time is judged by.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    pub pictures: Vec<AcceptedPicture>,
    /// Newest first.
    pub times: Vec<ReferenceTimes>,
    /// By metric.
    pub noise_floors: Vec<(TimeMetric, f64)>,
}

/// Times of an accepted run, and what it takes to render them again.
#[derive(Clone, Debug)]
pub struct ReferenceTimes {
    pub metric: TimeMetric,
    pub samples_s: Vec<f64>,
    pub scene: String,
    pub settings: RenderSettings,
    pub versions: BTreeMap<String, String>,
    pub label: String,
}

/// What somebody says of a case of a run.
#[derive(Clone, Debug)]
pub struct CaseDecision {
    pub decision: Decision,
    /// Of an approval: what joins the baseline.
    pub accepted: Option<Acceptance>,
    /// Whether the case is well with it.
    pub ok: bool,
}

#[derive(Clone, Debug)]
pub struct Acceptance {
    pub key: BaselineKey,
    pub pixels: String,
    pub source: PictureSource,
    pub files: Vec<Artifact>,
    pub times: Option<ReferenceTimes>,
    /// Times that were accepted before count no more: the level has changed.
    pub replaces_times: bool,
}

#[async_trait]
pub trait SuiteStore {
    /// The id of the suite with this content, and whether it is new.
    async fn insert_suite(&self, suite: &Suite) -> Result<(String, bool)>;
    async fn suite(&self, id: &str) -> Result<Option<Suite>>;
    async fn suites(&self, name: Option<&str>, page: &PageRequest) -> Result<Vec<SuiteSummary>>;
}

#[async_trait]
pub trait RunStore {
    /// Its scenes must be there.
    async fn create_run(&self, run: &RunRecord, idempotency: Option<&Idempotency>, now: Millis) -> Result<Creation>;
    /// The run of a key used before, when the request was the same.
    async fn repeated_run(&self, idempotency: &Idempotency) -> Result<Option<Creation>>;
    async fn run(&self, id: &str) -> Result<Option<Run>>;
    /// How often a calibration runs each case; `None` of a run that is none.
    async fn calibration_times(&self, id: &str) -> Result<Option<u32>>;
    async fn runs(&self, query: &RunQuery, page: &PageRequest) -> Result<Vec<RunSummary>>;
    /// Cases without a verdict of runs that go on, oldest run first.
    async fn open_cases(&self) -> Result<Vec<OpenCase>>;
    /// Takes a case further, and ends its run with its last case. Jobs that a case leaves unfinished when it ends or begins
    /// anew are cancelled. All or nothing, and only from the state and generation that it was read in.
    async fn step_case(&self, case: &OpenCase, step: &CaseStep, now: Millis) -> Result<Step>;
    /// Cancels a run that goes on, with its jobs. Its state then; `None` for an unknown run.
    async fn cancel_run(&self, id: &str, now: Millis) -> Result<Option<RunState>>;
    /// Ids of runs that have ended, beyond the newest of each suite, oldest first.
    async fn old_runs(&self, keep: u32, limit: u32) -> Result<Vec<String>>;
    /// Deletes a run that has ended; the blobs of which one name less is left.
    async fn delete_run(&self, id: &str) -> Result<Vec<String>>;
}

#[async_trait]
pub trait BaselineStore {
    async fn reference(&self, key: &BaselineKey) -> Result<Reference>;
    async fn baselines(&self, baseline: &str, suite_name: &str) -> Result<Vec<Baseline>>;
    /// Keeps decisions with what they change: all or nothing.
    async fn decide(&self, decisions: &[CaseDecision], now: Millis) -> Result<()>;
    /// Forgets what was accepted; returns the blobs of which one name less is left.
    async fn reset_baseline(&self, decision: &Decision) -> Result<Vec<String>>;
    async fn decisions(&self, query: &DecisionQuery, page: &PageRequest) -> Result<Vec<Decision>>;
    /// Device classes on which a case was rendered, that of the newest run first.
    async fn device_classes(&self, suite_name: &str, case: &str) -> Result<Vec<String>>;
    /// The newest finished checks of a case, at most `limit`, oldest first.
    async fn history(&self, suite_name: &str, case: &str, class: &str, limit: u32) -> Result<Vec<HistoryPoint>>;
}

#[async_trait]
pub trait ScheduleStore {
    /// False when there is one of this name.
    async fn add_schedule(&self, schedule: &Schedule) -> Result<bool>;
    /// All by name, or those that are due at a time.
    async fn schedules(&self, due_at: Option<Millis>) -> Result<Vec<Schedule>>;
    /// False for an unknown one.
    async fn delete_schedule(&self, id: &str) -> Result<bool>;
    /// Pauses a schedule, whose next time is then none, or resumes it; false for an unknown one.
    async fn change_schedule(&self, id: &str, paused: bool, next_at: Option<Millis>) -> Result<bool>;
    /// Moves a due schedule to its next time; false when another has done so, or it is gone.
    async fn take_schedule(&self, due: &Schedule, next_at: Option<Millis>, now: Millis) -> Result<bool>;
    /// The id of the run that it began, or why it could not.
    async fn note_begun(&self, id: &str, run: std::result::Result<&str, &str>) -> Result<()>;
}

/// A message that is to be sent now.
#[derive(Clone, Debug)]
pub struct DueDelivery {
    pub id: String,
    pub webhook: String,
    pub url: String,
    pub secret: String,
    /// JSON.
    pub body: String,
    /// Before this one.
    pub attempts: u32,
}

/// What becomes of a message after an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterAttempt {
    Delivered,
    AgainAt(Millis),
    GivenUp,
}

/// Messages are put into the outbox by what they tell of: steps of cases, decisions and resets.
#[async_trait]
pub trait WebhookStore {
    async fn add_webhook(&self, id: &str, new: &NewWebhook, now: Millis) -> Result<()>;
    /// All, or the one with an id; oldest first.
    async fn webhooks(&self, id: Option<&str>) -> Result<Vec<Webhook>>;
    /// With its messages; false for an unknown one.
    async fn delete_webhook(&self, id: &str) -> Result<bool>;
    /// Messages whose time has come, the longest due first.
    async fn due_deliveries(&self, now: Millis, limit: u32) -> Result<Vec<DueDelivery>>;
    async fn note_attempt(&self, due: &DueDelivery, attempt: &DeliveryAttempt, after: AfterAttempt) -> Result<()>;
    /// Newest first.
    async fn deliveries(&self, webhook: &str, page: &PageRequest) -> Result<Vec<WebhookDelivery>>;
    /// `None` of a message that is unknown, or another webhook's.
    async fn delivery(&self, webhook: &str, id: &str) -> Result<Option<WebhookDelivery>>;
    /// Has a message sent now, whatever became of it; false for an unknown one.
    async fn resend(&self, webhook: &str, delivery: &str, now: Millis) -> Result<bool>;
    /// Forgets messages of before a time that wait no longer, at most a batch; returns how many.
    async fn forget_deliveries(&self, before: Millis) -> Result<u64>;
}
