//! The regression farm: is the picture still right, and is it still as fast?
//!
//! A *suite* is a list of cases, versioned by its content. A *run* renders every case of a suite at a label (a commit, a
//! build, a driver) and judges each picture and each time against a *baseline*: the pictures that people accepted for
//! the case and its device class, and the times of the runs that they accepted. A *calibration* repeats what is
//! unchanged, to learn how far its times scatter. A *decision* is what somebody said of a case, and why.

mod baseline;
mod calibration;
mod image;
mod run;
mod schedule;
mod suite;
mod text;
mod time;
mod tolerance;
mod webhook;

pub use baseline::{
    AcceptedPicture, AcceptedTimes, Baseline, BaselineReset, Decision, DecisionKind, DecisionNote, Decisions, History,
    HistoryPoint,
};
pub use calibration::{Calibration, CalibrationCase, NewCalibration};
pub use image::{ImageFigures, ImageResult, ImageVerdict, PictureSource, ZTestBlocks, ZTestFigures};
pub use run::{
    CaseState, FarmJob, FarmJobPhase, NewRun, Run, RunCase, RunCounts, RunKind, RunState, RunSummary, SettingsPatch,
    check_labels,
};
pub use schedule::{NewSchedule, Schedule, SchedulePatch};
pub use suite::{CaseDefaults, NewSuite, SceneSource, Suite, SuiteCase, SuiteSummary, SuiteTestCase};
pub use text::{check_name, check_text};
pub use time::{Confirmation, ConfirmationState, Spread, TimeRatio, TimeResult, TimeVerdict};
pub use tolerance::{ImageLimits, ImageTolerance, TimeLimit, TimeMetric, TimeTolerance, ZTest};
pub use webhook::{
    CaseNews, DeliveryAttempt, DeliveryState, NewWebhook, Webhook, WebhookData, WebhookDelivery, WebhookEvent,
    WebhookMessage,
};

/// The baseline that is meant when none is named.
pub const DEFAULT_BASELINE: &str = "main";
