//! `/jobs`: the table of jobs, newest first.

use askama::Template;
use axum::extract::Query;
use axum::response::{IntoResponse, Response};
use lightshaft_api::job::{JobState, JobSummary};
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::Scene;
use serde::Deserialize;

use super::client::{Api, escape, with_query};
use super::filters;
use super::job::JobRow;
use super::page::{Page, PageError};

/// Filters, as the form of the page sends them: empty means any.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Filter {
    /// Part of a scene's name or of a label's value, or the start of an id.
    q: String,
    state: String,
    scene: String,
    /// `key=value`.
    label: String,
    /// Not empty: with the jobs that the service made by itself, such as thumbnails.
    automatic: String,
    cursor: String,
}

impl Filter {
    fn any(&self) -> bool {
        [&self.q, &self.state, &self.scene, &self.label, &self.automatic].iter().any(|filter| !filter.is_empty())
    }

    /// This page with the same filters.
    fn page_url(&self, cursor: &str) -> String {
        with_query(
            "/jobs",
            &[
                ("q", &self.q),
                ("state", &self.state),
                ("scene", &self.scene),
                ("label", &self.label),
                ("automatic", &self.automatic),
                ("cursor", cursor),
            ],
        )
    }

    pub(super) fn api_url(&self) -> String {
        let (key, value) = self.label.split_once('=').unwrap_or((&self.label, ""));
        let label = format!("label.{}", escape(key.trim()));
        let automatic = if self.automatic.is_empty() { "false" } else { "" };
        with_query(
            "/v1/jobs?limit=50",
            &[
                ("q", &self.q),
                ("state", &self.state),
                ("scene", &self.scene),
                (&label, value.trim()),
                ("automatic", automatic),
                ("cursor", &self.cursor),
            ],
        )
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
    let jobs: List<JobSummary> = api.get(&filter.api_url()).await?;
    let scenes: List<Scene> = api.get("/v1/scenes?limit=200").await?;
    let page = Jobs {
        here: "jobs",
        first: (!filter.cursor.is_empty()).then(|| filter.page_url("")),
        next: jobs.next_cursor.map(|cursor| filter.page_url(&cursor)),
        jobs: jobs.items.into_iter().map(|job| JobRow { job }).collect(),
        scenes: scenes.items,
        filter,
        states: JobState::ALL,
    };
    Ok(Page(page).into_response())
}
