//! Baselines: what was accepted, by whom and why; and the history of a case.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::image::{ImageVerdict, PictureSource};
use super::text::{check_name, check_text};
use super::time::{ConfirmationState, TimeVerdict};
use super::tolerance::TimeMetric;
use crate::job::Artifact;
use crate::problem::FieldError;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DecisionKind {
    /// The case's picture joins the accepted ones, and its times the baseline's.
    Approved,
    /// The case stays red, whatever its verdicts are.
    Rejected,
    /// What was accepted before is no longer.
    Reset,
}

impl DecisionKind {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Approved => "approved",
            Self::Rejected => "rejected",
            Self::Reset => "reset",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Approved, Self::Rejected, Self::Reset].into_iter().find(|kind| kind.as_str() == name)
    }
}

/// Body of approving and rejecting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({ "who": "Ada", "why": "the new sampler is less noisy, as intended" }))]
pub struct DecisionNote {
    /// Whoever decides; 1 to 100 characters.
    pub who: String,
    /// At most 2000 characters.
    #[serde(default)]
    pub why: String,
}

impl DecisionNote {
    pub fn validate(&self) -> Vec<FieldError> {
        check_name(&self.who, 100, "/who").into_iter().chain(check_text(&self.why, 2000, "/why")).collect()
    }
}

/// Body of deciding of many cases of a run at once. Nothing is done unless all of it can be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({ "who": "Ada", "why": "new tone mapping", "cases": ["cornell-path", "cornell-ao"] }))]
pub struct Decisions {
    /// Whoever decides; 1 to 100 characters.
    pub who: String,
    /// At most 2000 characters.
    #[serde(default)]
    pub why: String,
    /// Names of cases; when empty, every finished case that does not pass and of which nobody has decided.
    #[serde(default)]
    pub cases: Vec<String>,
}

impl Decisions {
    pub fn note(&self) -> DecisionNote {
        DecisionNote { who: self.who.clone(), why: self.why.clone() }
    }
}

/// Body of `POST /v1/farm/baselines/{baseline}/reset`: which accepted pictures and times are no longer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({ "who": "Ada", "why": "new reference machine", "suite": "generated", "case": "cornell-path" }))]
pub struct BaselineReset {
    pub who: String,
    #[serde(default)]
    pub why: String,
    /// Name of the suite.
    pub suite: String,
    /// Name of the case; all of the suite when null.
    #[serde(default)]
    pub case: Option<String>,
    /// All device classes when null.
    #[serde(default)]
    pub device_class: Option<String>,
}

impl BaselineReset {
    pub fn note(&self) -> DecisionNote {
        DecisionNote { who: self.who.clone(), why: self.why.clone() }
    }
}

/// What somebody decided. Never changed, never deleted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Decision {
    pub id: String,
    pub kind: DecisionKind,
    pub who: String,
    pub why: String,
    pub at: Timestamp,
    pub baseline: String,
    /// Name of the suite.
    pub suite: String,
    /// Null of a reset of all cases.
    pub case: Option<String>,
    pub device_class: Option<String>,
    /// Null of a reset. A run may have been deleted since.
    pub run: Option<String>,
    pub label: Option<String>,
    /// Identity of the picture that was decided of.
    pub pixels: Option<String>,
}

/// What a case has to be like, on a class of devices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Baseline {
    pub baseline: String,
    /// Name of the suite.
    pub suite: String,
    pub case: String,
    pub device_class: String,
    pub pictures: Vec<AcceptedPicture>,
    pub times: Vec<AcceptedTimes>,
}

/// Any of a case's accepted pictures is right.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AcceptedPicture {
    /// BLAKE3 of the decoded pixels.
    pub pixels: String,
    pub source: PictureSource,
    pub artifacts: Vec<Artifact>,
    /// Id of the decision.
    pub decision: String,
    pub label: String,
    pub accepted_at: Timestamp,
}

/// The times of an accepted run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct AcceptedTimes {
    pub metric: TimeMetric,
    pub samples_s: Vec<f64>,
    pub label: String,
    pub decision: String,
    pub accepted_at: Timestamp,
    /// What rendered it: versions of engine, structures and build.
    pub versions: BTreeMap<String, String>,
}

/// A case over its labels, oldest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct History {
    /// Name of the suite.
    pub suite: String,
    pub case: String,
    pub device_class: String,
    /// Every class that the case was rendered on.
    pub device_classes: Vec<String>,
    pub baseline: String,
    pub points: Vec<HistoryPoint>,
    /// Indices into `points` at which the times change to another level (E-divisive, 99 % confidence).
    pub change_points: Vec<u32>,
    /// Of unchanged runs; null without a calibration.
    pub noise_floor: Option<f64>,
    pub pictures: Vec<AcceptedPicture>,
    /// Newest first.
    pub decisions: Vec<Decision>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HistoryPoint {
    pub run: String,
    pub label: String,
    pub labels: BTreeMap<String, String>,
    pub at: Timestamp,
    pub ok: bool,
    pub image: ImageVerdict,
    pub time: Option<TimeVerdict>,
    pub confirmation: ConfirmationState,
    pub pixels: Option<String>,
    pub metric: TimeMetric,
    pub median_s: Option<f64>,
    pub lower_quartile_s: Option<f64>,
    pub upper_quartile_s: Option<f64>,
    /// Where its picture is, as PNG.
    pub picture: Option<String>,
}
