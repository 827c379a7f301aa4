//! `/farm`: the regression farm's runs and suites, and what waits for somebody's decision.

mod chart;
pub(super) mod decisions;
pub(super) mod history;
pub(super) mod run;
pub(super) mod schedules;
pub(super) mod webhooks;

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::farm::{RunState, RunSummary, SuiteSummary};
use lightshaft_api::page::Page as List;
use serde::Deserialize;

use super::client::{Api, with_query};
use super::filters;
use super::page::{Page, PageError};

/// Filters, as the form of the page sends them: empty means any.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Filter {
    suite: String,
    label: String,
    baseline: String,
    /// `true` or `false`.
    ok: String,
    cursor: String,
}

impl Filter {
    fn any(&self) -> bool {
        [&self.suite, &self.label, &self.baseline, &self.ok].iter().any(|filter| !filter.is_empty())
    }

    fn url(&self, path: &str, cursor: &str) -> String {
        let pairs = [("suite", &self.suite), ("label", &self.label), ("baseline", &self.baseline), ("ok", &self.ok)];
        let mut pairs: Vec<(&str, &str)> = pairs.iter().map(|(name, value)| (*name, value.trim())).collect();
        pairs.push(("cursor", cursor));
        with_query(path, &pairs)
    }
}

/// The farm in a few words, for the overview too.
pub(super) struct Health {
    /// Newest finished run of each suite and baseline.
    pub(super) latest: Vec<RunSummary>,
    /// Runs with cases of which nobody has decided.
    pub(super) undecided: Vec<RunSummary>,
    pub(super) running: Vec<RunSummary>,
}

impl Health {
    /// `None` where there is no farm, or nothing has ever run in it.
    pub(super) async fn of(api: &Api) -> Result<Option<Self>, PageError> {
        let runs: Option<List<RunSummary>> = api.find("/v1/farm/runs?kind=check&limit=100").await?;
        Ok(runs.filter(|runs| !runs.items.is_empty()).map(|runs| Self::from_runs(runs.items)))
    }

    fn from_runs(runs: Vec<RunSummary>) -> Self {
        let mut latest: Vec<RunSummary> = Vec::new();
        for run in runs.iter().filter(|run| run.state == RunState::Finished) {
            let is_same = |known: &RunSummary| (&known.suite_name, &known.baseline) == (&run.suite_name, &run.baseline);
            if !latest.iter().any(is_same) {
                latest.push(run.clone());
            }
        }
        let undecided = latest.iter().filter(|run| run.counts.undecided > 0).cloned().collect();
        let running = runs.into_iter().filter(|run| run.state == RunState::Running).collect();
        Self { latest, undecided, running }
    }

    pub(super) fn undecided_cases(&self) -> u32 {
        self.undecided.iter().map(|run| run.counts.undecided).sum()
    }
}

#[derive(Template)]
#[template(path = "farm.html")]
struct Farm {
    here: &'static str,
    health: Option<Health>,
    runs: Vec<RunSummary>,
    suites: Vec<SuiteSummary>,
    filter: Filter,
    first: Option<String>,
    next: Option<String>,
}

pub(super) async fn list(api: Api, Query(filter): Query<Filter>) -> Result<Response, PageError> {
    let runs: List<RunSummary> = api.get(&filter.url("/v1/farm/runs", &filter.cursor)).await?;
    let suites: List<SuiteSummary> = api.get("/v1/farm/suites").await?;
    let page = Farm {
        here: "farm",
        health: Health::of(&api).await?,
        first: (!filter.cursor.is_empty()).then(|| filter.url("/farm", "")),
        next: runs.next_cursor.map(|cursor| filter.url("/farm", &cursor)),
        runs: runs.items,
        suites: suites.items,
        filter,
    };
    Ok(Page(page).into_response())
}

/// How a run stands, as a word that has a colour.
pub(super) fn standing(run: &RunSummary) -> &'static str {
    match (run.state, run.ok) {
        (RunState::Running, _) => "running",
        (RunState::Cancelled, _) => "cancelled",
        (RunState::Finished, Some(true)) => "ok",
        (RunState::Finished, _) if run.counts.undecided > 0 => "undecided",
        (RunState::Finished, _) => "regressed",
    }
}

/// The counts of a run that are not 0, worst first.
pub(super) fn tally(run: &RunSummary) -> Vec<(&'static str, u32)> {
    let counts = &run.counts;
    let all = [
        ("failed", counts.failed),
        ("changed", counts.changed),
        ("slower", counts.slower),
        ("missing", counts.missing),
        ("too_noisy_to_say", counts.too_noisy_to_say),
        ("faster", counts.faster),
        ("within_tolerance", counts.within_tolerance),
        ("identical", counts.identical),
    ];
    all.into_iter().filter(|(_, count)| *count > 0).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::fixture;
    use super::*;

    #[test]
    fn health_looks_at_the_newest_finished_run_of_each_suite() {
        let mut old = fixture::run().summary;
        old.id = "old".to_owned();
        let mut running = old.clone();
        running.state = RunState::Running;
        let health = Health::from_runs(vec![running, fixture::run().summary, old]);
        assert_eq!((health.latest.len(), health.running.len()), (1, 1));
        assert_eq!(health.latest[0].id, fixture::run().summary.id);
        assert_eq!(health.undecided_cases(), 1);
    }
}
