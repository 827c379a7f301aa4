//! `/jobs`: the table of jobs, newest first.

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::job::{JobState, JobSummary};
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::Scene;
use serde::Deserialize;

use super::client::{Api, with_query};
use super::filters;
use super::job::JobRow;
use super::page::{Page, PageError};

/// Filters, as the form of the page sends them: empty means any.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Filter {
    state: String,
    scene: String,
    label: String,
    cursor: String,
}

impl Filter {
    fn any(&self) -> bool {
        !(self.state.is_empty() && self.scene.is_empty() && self.label.is_empty())
    }

    fn url(&self, path: &str, cursor: &str) -> String {
        with_query(path, &[("state", &self.state), ("scene", &self.scene), ("label", &self.label), ("cursor", cursor)])
    }
}

#[derive(Template)]
#[template(path = "jobs.html")]
struct Jobs {
    here: &'static str,
    jobs: Vec<JobRow>,
    scenes: Vec<Scene>,
    filter: Filter,
    states: [JobState; 5],
    first: Option<String>,
    next: Option<String>,
}

impl Jobs {
    fn thumbnail(&self, row: &JobRow) -> Option<&str> {
        self.scenes.iter().find(|scene| scene.id == row.job.scene)?.thumbnail.as_deref()
    }
}

pub(super) async fn list(api: Api, Query(filter): Query<Filter>) -> Result<Response, PageError> {
    let jobs: List<JobSummary> = api.get(&filter.url("/v1/jobs?limit=50", &filter.cursor)).await?;
    let scenes: List<Scene> = api.get("/v1/scenes?limit=200").await?;
    let page = Jobs {
        here: "jobs",
        first: (!filter.cursor.is_empty()).then(|| filter.url("/jobs", "")),
        next: jobs.next_cursor.map(|cursor| filter.url("/jobs", &cursor)),
        jobs: jobs.items.into_iter().map(|job| JobRow { job }).collect(),
        scenes: scenes.items,
        filter,
        states: JobState::ALL,
    };
    Ok(Page(page).into_response())
}
