//! The regression farm.

use bytes::Bytes;
use reqwest::Method;
use reqwest::header::CONTENT_TYPE;

use super::{Client, Result, segment};
use crate::farm::{
    Baseline, BaselineReset, Calibration, Decision, DecisionKind, DecisionNote, Decisions, History, NewCalibration,
    NewRun, NewSchedule, NewSuite, NewWebhook, Run, RunKind, RunState, RunSummary, Schedule, SchedulePatch, Suite,
    SuiteSummary, Webhook, WebhookDelivery,
};
use crate::page::Page;

/// What `GET /v1/farm/runs` may be asked for; empty takes all, newest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunFilter {
    pub kind: Option<RunKind>,
    pub state: Option<RunState>,
    /// Name of a suite.
    pub suite: Option<String>,
    pub label: Option<String>,
    pub baseline: Option<String>,
    /// Only runs that are (or are not) well.
    pub ok: Option<bool>,
    pub limit: Option<u32>,
    pub cursor: Option<String>,
}

/// What `GET /v1/farm/decisions` may be asked for; empty takes all, newest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DecisionFilter {
    pub kind: Option<DecisionKind>,
    /// Name of a suite.
    pub suite: Option<String>,
    pub case: Option<String>,
    pub baseline: Option<String>,
    pub run: Option<String>,
    pub who: Option<String>,
    pub limit: Option<u32>,
    pub cursor: Option<String>,
}

/// Which history: of a case of a suite, by its name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HistoryQuery {
    pub suite: String,
    pub case: String,
    /// The class of the newest run when none is given.
    pub device_class: Option<String>,
    /// `main` when none is given.
    pub baseline: Option<String>,
}

type Query = Vec<(&'static str, String)>;

fn query(fields: impl IntoIterator<Item = (&'static str, Option<String>)>) -> Query {
    fields.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
}

impl RunFilter {
    fn query(&self) -> Query {
        query([
            ("kind", self.kind.map(|kind| kind.as_str().to_owned())),
            ("state", self.state.map(|state| state.as_str().to_owned())),
            ("suite", self.suite.clone()),
            ("label", self.label.clone()),
            ("baseline", self.baseline.clone()),
            ("ok", self.ok.map(|ok| ok.to_string())),
            ("limit", self.limit.map(|limit| limit.to_string())),
            ("cursor", self.cursor.clone()),
        ])
    }
}

impl DecisionFilter {
    fn query(&self) -> Query {
        query([
            ("kind", self.kind.map(|kind| kind.as_str().to_owned())),
            ("suite", self.suite.clone()),
            ("case", self.case.clone()),
            ("baseline", self.baseline.clone()),
            ("run", self.run.clone()),
            ("who", self.who.clone()),
            ("limit", self.limit.map(|limit| limit.to_string())),
            ("cursor", self.cursor.clone()),
        ])
    }
}

impl Client {
    /// Adds a version of a suite; the same content gives the same suite.
    pub async fn create_suite(&self, suite: &NewSuite) -> Result<Suite> {
        self.post_json("v1/farm/suites", suite).await
    }

    /// The same from its TOML.
    pub async fn create_suite_from_toml(&self, text: &str) -> Result<Suite> {
        let request = self.request(Method::POST, "v1/farm/suites").header(CONTENT_TYPE, "application/toml");
        self.send_json(request.body(text.to_owned())).await
    }

    /// Versions of suites, newest first; those of one name when it is given.
    pub async fn suites(&self, name: Option<&str>, cursor: Option<&str>) -> Result<Page<SuiteSummary>> {
        self.get_json("v1/farm/suites", &[("name", name), ("cursor", cursor)]).await
    }

    pub async fn suite(&self, id: &str) -> Result<Suite> {
        self.get_json(&format!("v1/farm/suites/{}", segment(id)), &()).await
    }

    /// Begins a run; with a key, a repeated call gives the run that the first one began.
    pub async fn create_run(&self, run: &NewRun, idempotency_key: Option<&str>) -> Result<Run> {
        self.post_once("v1/farm/runs", run, idempotency_key).await
    }

    pub async fn runs(&self, filter: &RunFilter) -> Result<Page<RunSummary>> {
        self.get_json("v1/farm/runs", &filter.query()).await
    }

    pub async fn run(&self, id: &str) -> Result<Run> {
        self.get_json(&run_path(id, ""), &()).await
    }

    pub async fn cancel_run(&self, id: &str) -> Result<Run> {
        self.post_json(&run_path(id, "/cancel"), &()).await
    }

    pub async fn approve_case(&self, run: &str, case: &str, note: &DecisionNote) -> Result<Decision> {
        self.post_json(&case_path(run, case, "/approve"), note).await
    }

    pub async fn reject_case(&self, run: &str, case: &str, note: &DecisionNote) -> Result<Decision> {
        self.post_json(&case_path(run, case, "/reject"), note).await
    }

    pub async fn approve_cases(&self, run: &str, decisions: &Decisions) -> Result<Page<Decision>> {
        self.post_json(&run_path(run, "/approve"), decisions).await
    }

    pub async fn reject_cases(&self, run: &str, decisions: &Decisions) -> Result<Page<Decision>> {
        self.post_json(&run_path(run, "/reject"), decisions).await
    }

    /// An artifact of a run's case: `image.png`, `image.exr`, `heat-map.png`, `difference.png`.
    pub async fn case_artifact(&self, run: &str, case: &str, name: &str) -> Result<Bytes> {
        self.bytes(&case_path(run, case, &format!("/artifacts/{}", segment(name)))).await
    }

    pub async fn decisions(&self, filter: &DecisionFilter) -> Result<Page<Decision>> {
        self.get_json("v1/farm/decisions", &filter.query()).await
    }

    /// What was accepted under a baseline's name for a suite.
    pub async fn baselines(&self, baseline: &str, suite: &str) -> Result<Page<Baseline>> {
        self.get_json(&format!("v1/farm/baselines/{}", segment(baseline)), &[("suite", suite)]).await
    }

    pub async fn reset_baseline(&self, baseline: &str, reset: &BaselineReset) -> Result<Decision> {
        self.post_json(&format!("v1/farm/baselines/{}/reset", segment(baseline)), reset).await
    }

    pub async fn history(&self, wanted: &HistoryQuery) -> Result<History> {
        let fields = query([
            ("suite", Some(wanted.suite.clone())),
            ("case", Some(wanted.case.clone())),
            ("device_class", wanted.device_class.clone()),
            ("baseline", wanted.baseline.clone()),
        ]);
        self.get_json("v1/farm/history", &fields).await
    }

    pub async fn create_calibration(&self, calibration: &NewCalibration) -> Result<Calibration> {
        self.post_json("v1/farm/calibrations", calibration).await
    }

    pub async fn calibration(&self, id: &str) -> Result<Calibration> {
        self.get_json(&format!("v1/farm/calibrations/{}", segment(id)), &()).await
    }

    pub async fn create_schedule(&self, schedule: &NewSchedule) -> Result<Schedule> {
        self.post_json("v1/farm/schedules", schedule).await
    }

    pub async fn schedules(&self) -> Result<Page<Schedule>> {
        self.get_json("v1/farm/schedules", &()).await
    }

    /// Pauses a schedule, or resumes it from now on.
    pub async fn change_schedule(&self, id: &str, patch: &SchedulePatch) -> Result<Schedule> {
        self.send_json(self.request(Method::PATCH, &format!("v1/farm/schedules/{}", segment(id))).json(patch)).await
    }

    pub async fn delete_schedule(&self, id: &str) -> Result<()> {
        let path = format!("v1/farm/schedules/{}", segment(id));
        self.send(self.request(Method::DELETE, &path)).await.map(|_| ())
    }
}

impl Client {
    pub async fn create_webhook(&self, webhook: &NewWebhook) -> Result<Webhook> {
        self.post_json("v1/farm/webhooks", webhook).await
    }

    pub async fn webhooks(&self) -> Result<Page<Webhook>> {
        self.get_json("v1/farm/webhooks", &()).await
    }

    pub async fn webhook(&self, id: &str) -> Result<Webhook> {
        self.get_json(&webhook_path(id), &()).await
    }

    pub async fn delete_webhook(&self, id: &str) -> Result<()> {
        self.send(self.request(Method::DELETE, &webhook_path(id))).await.map(|_| ())
    }

    /// Sends a message again, now; whatever became of it.
    pub async fn resend_delivery(&self, webhook: &str, delivery: &str) -> Result<WebhookDelivery> {
        let path = format!("{}/deliveries/{}/resend", webhook_path(webhook), segment(delivery));
        self.post_json(&path, &()).await
    }

    /// A webhook's messages with the attempts to deliver them, newest first.
    pub async fn deliveries(&self, webhook: &str, cursor: Option<&str>) -> Result<Page<WebhookDelivery>> {
        self.get_json(&format!("{}/deliveries", webhook_path(webhook)), &[("cursor", cursor)]).await
    }
}

fn webhook_path(id: &str) -> String {
    format!("v1/farm/webhooks/{}", segment(id))
}

fn run_path(id: &str, rest: &str) -> String {
    format!("v1/farm/runs/{}{rest}", segment(id))
}

fn case_path(run: &str, case: &str, rest: &str) -> String {
    run_path(run, &format!("/cases/{}{rest}", segment(case)))
}
