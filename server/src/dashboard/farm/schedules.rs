//! `/farm/schedules`: runs that begin by the clock, and adding one.

use std::collections::BTreeMap;

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::farm::{Run, RunSummary, Schedule, Suite, SuiteSummary};
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::Scene;
use serde::Deserialize;

use super::super::client::{Api, escape, with_query};
use super::super::filters;
use super::super::page::{Page, PageError};

/// What a new schedule begins with.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(in crate::dashboard) struct Start {
    /// Id of the suite.
    suite: String,
}

#[derive(Template)]
#[template(path = "farm_schedules.html")]
struct SchedulesPage {
    here: &'static str,
    schedules: Vec<Schedule>,
    suites: Vec<SuiteSummary>,
    scenes: Vec<Scene>,
    /// The suite that a new schedule is for.
    chosen: Option<Chosen>,
}

/// A suite to be scheduled.
struct Chosen {
    suite: Suite,
    /// Names of its scenes, with the scene that the last run took.
    scenes: Vec<(String, Option<String>)>,
}

impl Chosen {
    /// The newest version of a suite of that id, or the newest suite of all.
    async fn of(api: &Api, suites: &[SuiteSummary], wanted: &str) -> Result<Option<Self>, PageError> {
        let id = match (wanted, suites.first()) {
            ("", None) => return Ok(None),
            ("", Some(newest)) => &newest.id,
            (id, _) => id,
        };
        let suite: Suite = api.get(&format!("/v1/farm/suites/{}", escape(id))).await?;
        let last = with_query("/v1/farm/runs?limit=1", &[("suite", &suite.name)]);
        let last: List<RunSummary> = api.get(&last).await?;
        let taken = match last.items.first() {
            Some(run) => api.find::<Run>(&format!("/v1/farm/runs/{}", escape(&run.id))).await?.map(|run| run.scenes),
            None => None,
        };
        let scenes = scenes_of(&suite, &taken.unwrap_or_default());
        Ok(Some(Self { suite, scenes }))
    }
}

/// The names that a run must map to scenes. Others are scenes already, by id or hash.
fn scenes_of(suite: &Suite, taken: &BTreeMap<String, String>) -> Vec<(String, Option<String>)> {
    suite.scenes.keys().map(|name| (name.clone(), taken.get(name).cloned())).collect()
}

impl SchedulesPage {
    /// What a suite calls itself.
    fn suite_name<'a>(&'a self, schedule: &'a Schedule) -> &'a str {
        let id = &schedule.run.suite;
        self.suites.iter().find(|suite| suite.id == *id).map_or(id, |suite| &suite.name)
    }
}

pub(in crate::dashboard) async fn show(api: Api, Query(start): Query<Start>) -> Result<Response, PageError> {
    let schedules: List<Schedule> = api.get("/v1/farm/schedules").await?;
    let suites: List<SuiteSummary> = api.get("/v1/farm/suites?limit=200").await?;
    let scenes: List<Scene> = api.get("/v1/scenes?limit=200").await?;
    let chosen = Chosen::of(&api, &suites.items, &start.suite).await?;
    let page =
        SchedulesPage { here: "farm", schedules: schedules.items, suites: suites.items, scenes: scenes.items, chosen };
    Ok(Page(page).into_response())
}
