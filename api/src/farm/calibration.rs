//! Calibrations: how far the times of what is unchanged scatter.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::run::{RunState, SettingsPatch, check_labels};
use super::text::check_name;
use super::tolerance::TimeMetric;
use crate::problem::FieldError;

/// Body of `POST /v1/farm/calibrations`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "suite": "01980000-0000-7000-8000-000000000000",
    "label": "3f2a91c",
    "times": 10,
    "scenes": { "cornell": "01980000-0000-7000-8000-000000000001" }
}))]
pub struct NewCalibration {
    /// Id of a suite.
    pub suite: String,
    pub label: String,
    #[serde(default)]
    pub labels: BTreeMap<String, String>,
    /// How many runs of each case: 3 to 50. Each has as many repetitions as the case.
    #[serde(default = "ten")]
    pub times: u32,
    #[serde(default)]
    pub scenes: BTreeMap<String, String>,
    #[serde(default)]
    pub overrides: SettingsPatch,
    /// Only these cases; all when empty.
    #[serde(default)]
    pub cases: Vec<String>,
    /// Of its jobs, -100 to 100.
    #[serde(default)]
    pub priority: i32,
}

fn ten() -> u32 {
    10
}

impl NewCalibration {
    /// Every field that is out of range; what depends on the suite and the scenes is checked by the service.
    pub fn validate(&self) -> Vec<FieldError> {
        let mut errors = Vec::new();
        errors.extend(check_name(&self.label, 200, "/label"));
        errors.extend(check_labels(&self.labels));
        if !(3..=50).contains(&self.times) {
            errors.push(FieldError::new("/times", "must be 3 to 50"));
        }
        if !(-100..=100).contains(&self.priority) {
            errors.push(FieldError::new("/priority", "must be -100 to 100"));
        }
        errors
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Calibration {
    /// Also the id of its run: `GET /v1/farm/runs/{id}` tells of its jobs.
    pub id: String,
    pub suite: String,
    pub suite_name: String,
    pub label: String,
    pub labels: BTreeMap<String, String>,
    pub times: u32,
    pub state: RunState,
    pub cases: Vec<CalibrationCase>,
    pub created_at: Timestamp,
    pub finished_at: Option<Timestamp>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CalibrationCase {
    pub case: String,
    pub device_class: Option<String>,
    pub metric: TimeMetric,
    /// The median of each run of the case that has ended.
    pub medians_s: Vec<f64>,
    /// How far two of them lie apart, as a ratio less 1, in 19 of 20 pairs; null until the case has finished.
    pub noise_floor: Option<f64>,
    /// Whether all pictures were the same to the pixel; null until the case has finished. If not, `identical` is no fit
    /// tolerance.
    pub steady: Option<bool>,
}
