//! `/workers`: who renders, on what, and what they keep warm.

use askama::Template;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use lightshaft_api::page::Page as List;
use lightshaft_api::worker::{Worker, WorkerState};

use super::client::Api;
use super::filters;
use super::overview::base_url;
use super::page::{Page, PageError};

#[derive(Template)]
#[template(path = "workers.html")]
struct Workers {
    here: &'static str,
    present: Vec<Worker>,
    gone: Vec<Worker>,
    base_url: String,
}

pub(super) async fn list(api: Api, headers: HeaderMap) -> Result<Response, PageError> {
    let workers: List<Worker> = api.get("/v1/workers").await?;
    let (gone, present) = workers.items.into_iter().partition(|worker| worker.state == WorkerState::Gone);
    Ok(Page(Workers { here: "workers", present, gone, base_url: base_url(&headers) }).into_response())
}
