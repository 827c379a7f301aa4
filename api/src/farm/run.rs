//! Runs: a suite at a label, and what came of each case.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::DEFAULT_BASELINE;
use super::baseline::Decision;
use super::image::ImageResult;
use super::text::check_name;
use super::time::TimeResult;
use super::tolerance::{ImageTolerance, TimeTolerance};
use crate::job::Artifact;
use crate::problem::{FieldError, escape_pointer};
use crate::settings::RenderSettings;

/// Settings of a render of which only some are given, over others: field by field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(transparent)]
#[schema(value_type = Object)]
pub struct SettingsPatch(pub Map<String, Value>);

impl SettingsPatch {
    /// Puts these over what is there.
    pub fn apply(&self, fields: &mut Map<String, Value>) {
        fields.extend(self.0.iter().map(|(name, value)| (name.clone(), value.clone())));
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Body of `POST /v1/farm/runs`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "suite": "01980000-0000-7000-8000-000000000000",
    "label": "3f2a91c",
    "labels": { "commit": "3f2a91c", "build": "release", "driver": "560.35" },
    "baseline": "main",
    "scenes": { "cornell": "01980000-0000-7000-8000-000000000001" }
}))]
pub struct NewRun {
    /// Id of a suite.
    pub suite: String,
    /// What is judged, as people call it: most often a commit. 1 to 200 characters.
    pub label: String,
    /// `commit`, `build`, `driver`, and whatever else there is to know; as a job's labels.
    #[serde(default)]
    pub labels: BTreeMap<String, String>,
    /// The name of the baseline that it is judged against; it need not be there yet.
    #[serde(default = "default_baseline")]
    pub baseline: String,
    /// Ids or hashes of the scenes that the suite calls by a name.
    #[serde(default)]
    pub scenes: BTreeMap<String, String>,
    /// Settings that go before those of every case: to see the farm find what they break.
    #[serde(default)]
    pub overrides: SettingsPatch,
    /// Only these cases; all when empty.
    #[serde(default)]
    pub cases: Vec<String>,
    /// Of its jobs, -100 to 100.
    #[serde(default)]
    pub priority: i32,
}

fn default_baseline() -> String {
    DEFAULT_BASELINE.to_owned()
}

impl NewRun {
    /// A run of a whole suite against the default baseline.
    pub fn new(suite: impl Into<String>, label: impl Into<String>) -> Self {
        Self {
            suite: suite.into(),
            label: label.into(),
            labels: BTreeMap::new(),
            baseline: default_baseline(),
            scenes: BTreeMap::new(),
            overrides: SettingsPatch::default(),
            cases: Vec::new(),
            priority: 0,
        }
    }

    /// Every field that is out of range; what depends on the suite and the scenes is checked by the service.
    pub fn validate(&self) -> Vec<FieldError> {
        let mut errors = Vec::new();
        errors.extend(check_name(&self.label, 200, "/label"));
        errors.extend(check_name(&self.baseline, 100, "/baseline"));
        errors.extend(check_labels(&self.labels));
        if !(-100..=100).contains(&self.priority) {
            errors.push(FieldError::new("/priority", "must be -100 to 100"));
        }
        errors
    }
}

/// Labels of a run: at most 32, keys up to 64 and values up to 256 characters.
pub fn check_labels(labels: &BTreeMap<String, String>) -> Vec<FieldError> {
    let mut errors = Vec::new();
    if labels.len() > 32 {
        errors.push(FieldError::new("/labels", "must be at most 32 labels"));
    }
    for (key, value) in labels {
        let pointer = format!("/labels/{}", escape_pointer(key));
        if key.is_empty() || key.chars().count() > 64 {
            errors.push(FieldError::new(pointer.clone(), "the key must have 1 to 64 characters"));
        }
        if value.chars().count() > 256 {
            errors.push(FieldError::new(pointer, "the value must have at most 256 characters"));
        }
    }
    errors
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RunKind {
    /// Judged against a baseline.
    Check,
    /// Repeats what is unchanged, to learn how its times scatter.
    Calibration,
}

impl RunKind {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Check => "check",
            Self::Calibration => "calibration",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Check, Self::Calibration].into_iter().find(|kind| kind.as_str() == name)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RunState {
    Running,
    /// Every case has its verdict.
    Finished,
    Cancelled,
}

impl RunState {
    pub const ALL: [Self; 3] = [Self::Running, Self::Finished, Self::Cancelled];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Finished => "finished",
            Self::Cancelled => "cancelled",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == name)
    }
}

/// A run in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunSummary {
    pub id: String,
    pub kind: RunKind,
    pub suite: String,
    pub suite_name: String,
    pub label: String,
    pub labels: BTreeMap<String, String>,
    pub baseline: String,
    pub state: RunState,
    /// Whether every case passes or was approved; null until it has finished. A calibration passes when nothing failed.
    pub ok: Option<bool>,
    pub counts: RunCounts,
    pub created_at: Timestamp,
    pub finished_at: Option<Timestamp>,
}

/// How many cases of a run are what.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RunCounts {
    pub cases: u32,
    /// Cases with a verdict.
    pub finished: u32,
    /// Finished ones that pass, or were approved.
    pub ok: u32,
    /// Finished ones that do not pass, and of which nobody has decided.
    pub undecided: u32,
    pub rejected: u32,
    pub identical: u32,
    pub within_tolerance: u32,
    pub changed: u32,
    pub missing: u32,
    pub failed: u32,
    pub faster: u32,
    pub same: u32,
    pub slower: u32,
    pub too_noisy_to_say: u32,
}

/// A whole run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Run {
    #[serde(flatten)]
    pub summary: RunSummary,
    /// Scenes by the names that the suite gives them.
    pub scenes: BTreeMap<String, String>,
    pub overrides: SettingsPatch,
    pub priority: i32,
    /// In the suite's order.
    pub cases: Vec<RunCase>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaseState {
    /// Its jobs wait or run.
    Rendering,
    /// A slow-down is suspected: baseline and this run are rendered in turns.
    Confirming,
    Finished,
    Cancelled,
}

impl CaseState {
    pub const ALL: [Self; 4] = [Self::Rendering, Self::Confirming, Self::Finished, Self::Cancelled];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Rendering => "rendering",
            Self::Confirming => "confirming",
            Self::Finished => "finished",
            Self::Cancelled => "cancelled",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == name)
    }
}

/// One case of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RunCase {
    pub name: String,
    pub state: CaseState,
    /// Whether it passes or was approved; null until it has finished.
    pub ok: Option<bool>,
    /// Id of the scene.
    pub scene: String,
    /// As rendered, the run's overrides included.
    pub settings: RenderSettings,
    pub repeat: u32,
    pub tolerance: ImageTolerance,
    pub time_tolerance: TimeTolerance,
    /// Null until its first job has ended.
    pub device_class: Option<String>,
    /// The worker that renders all of it, once it is known.
    pub worker: Option<String>,
    /// Of what rendered it: engine, structures, and the hash of the program.
    pub versions: BTreeMap<String, String>,
    /// Null until it has finished.
    pub image: Option<ImageResult>,
    /// Null until it has finished, and without a picture.
    pub time: Option<TimeResult>,
    /// What somebody decided of it last.
    pub decision: Option<Decision>,
    pub jobs: Vec<FarmJob>,
    /// `image.png`, `image.exr`; of a changed picture also `heat-map.png`, `difference.png`, and `accepted.png`,
    /// `accepted.exr`: what it was compared with.
    pub artifacts: Vec<Artifact>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FarmJobPhase {
    /// Not timed.
    WarmUp,
    /// A timed repetition.
    Sample,
    /// Of the confirmation, the baseline's side; position 0 is not timed.
    A,
    /// Of the confirmation, this run's side; position 0 is not timed.
    B,
}

impl FarmJobPhase {
    pub const ALL: [Self; 4] = [Self::WarmUp, Self::Sample, Self::A, Self::B];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::WarmUp => "warm_up",
            Self::Sample => "sample",
            Self::A => "a",
            Self::B => "b",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|phase| phase.as_str() == name)
    }
}

/// A job of a case. It may have been deleted since.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FarmJob {
    pub job: String,
    pub phase: FarmJobPhase,
    /// From 0, in its phase.
    pub position: u32,
    /// The metric that the case is timed by; null until the job has succeeded.
    pub time_s: Option<f64>,
}
