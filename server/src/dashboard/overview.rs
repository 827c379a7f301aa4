//! `/`: what the service does right now.

use askama::Template;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use lightshaft_api::page::Page as List;
use lightshaft_api::status::{ServiceState, Status};
use lightshaft_api::worker::{Worker, WorkerState};

use super::client::Api;
use super::farm::Health;
use super::filters;
use super::job::JobCard;
use super::page::{Page, PageError};

#[derive(Template)]
#[template(path = "overview.html")]
struct Overview {
    here: &'static str,
    status: Status,
    running: Vec<JobCard>,
    recent: Vec<JobCard>,
    workers: Vec<Worker>,
    farm: Option<Health>,
    /// Nothing has been uploaded yet: show how to begin.
    empty: bool,
    base_url: String,
}

pub(super) async fn show(api: Api, headers: HeaderMap) -> Result<Response, PageError> {
    let status: Status = api.get("/v1/status").await?;
    let running = JobCard::of_list(&api, "/v1/jobs?state=running&limit=12").await?;
    let recent = JobCard::of_list(&api, "/v1/jobs?state=succeeded&automatic=false&limit=18").await?;
    let workers: List<Worker> = api.get("/v1/workers").await?;
    let page = Overview {
        here: "overview",
        empty: status.scenes == 0,
        status,
        running,
        recent: recent.into_iter().filter(|card| card.picture.is_some()).collect(),
        workers: workers.items.into_iter().filter(|worker| worker.state != WorkerState::Gone).collect(),
        farm: Health::of(&api).await?,
        base_url: base_url(&headers),
    };
    Ok(Page(page).into_response())
}

/// The address under which the browser reached us, for commands to copy.
pub(super) fn base_url(headers: &HeaderMap) -> String {
    let text = |name: &str| headers.get(name).and_then(|value| value.to_str().ok());
    let host = text(header::HOST.as_str()).unwrap_or("localhost:8080");
    let scheme = match text("x-forwarded-proto") {
        Some("https") => "https",
        _ => "http",
    };
    format!("{scheme}://{host}")
}

fn explain(state: &ServiceState) -> &'static str {
    match state {
        ServiceState::Active => "Rendering",
        ServiceState::Idle => "Idle: nothing to do",
        ServiceState::Waiting => "Jobs wait for a worker to take them",
        ServiceState::Inoperable => "Jobs wait, and no worker is there",
    }
}
