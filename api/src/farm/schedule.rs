//! Schedules: runs that begin by the clock.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::run::NewRun;
use super::text::check_name;
use crate::problem::FieldError;

/// Body of `POST /v1/farm/schedules`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "name": "nightly",
    "cron": "30 2 * * 1-5",
    "run": {
        "suite": "01980000-0000-7000-8000-000000000000",
        "label": "nightly",
        "scenes": { "cornell": "01980000-0000-7000-8000-000000000001" }
    }
}))]
pub struct NewSchedule {
    /// Unique; 1 to 100 characters.
    pub name: String,
    /// Minute, hour, day of the month, month and day of the week, as crontab(5) has them; in UTC.
    pub cron: String,
    /// What begins then. The time is added to its label: `nightly 2026-11-23T02:30Z`.
    pub run: NewRun,
    /// Whether it begins nothing until it is resumed.
    #[serde(default)]
    pub paused: bool,
}

/// Body of `PATCH /v1/farm/schedules/{id}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SchedulePatch {
    /// True pauses it. False resumes it from now on: times that passed while it was paused are skipped.
    pub paused: bool,
}

impl NewSchedule {
    /// Every field that is out of range; the run's suite and scenes, and the pattern, are checked by the service.
    pub fn validate(&self) -> Vec<FieldError> {
        let mut errors = Vec::new();
        errors.extend(check_name(&self.name, 100, "/name"));
        if self.run.label.chars().count() > 180 {
            errors.push(FieldError::new("/run/label", "must have at most 180 characters: the time is added to it"));
        }
        errors
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Schedule {
    pub id: String,
    pub name: String,
    pub cron: String,
    pub run: NewRun,
    /// Whether it begins nothing until it is resumed.
    pub paused: bool,
    /// Null while it is paused, and when the pattern has no next time.
    pub next_at: Option<Timestamp>,
    /// When it was last due. Times that passed while the service was down count once.
    pub begun_at: Option<Timestamp>,
    /// Id of the last run that it began; the run may have been deleted since.
    pub last_run: Option<String>,
    /// Why the last run could not begin; null when it did.
    pub error: Option<String>,
    pub created_at: Timestamp,
}
