//! `/v1/workers`

use axum::Json as Reply;
use axum::extract::State;
use http::StatusCode;
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use lightshaft_api::worker::{NewWorker, Registered, Worker};

use crate::app::Shared;
use crate::error::ApiResult;
use crate::web::body::{Id, Json};

/// All workers by name.
#[utoipa::path(
    get, path = "/v1/workers", tag = "workers",
    responses(
        (status = 200, body = Page<Worker>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_workers(State(app): State<Shared>) -> ApiResult<Reply<Page<Worker>>> {
    Ok(Reply(Page { items: app.workers().await?, next_cursor: None }))
}

/// Registers a worker, or one that comes back under its old id: what that one was doing is lost, and goes back to the
/// queue.
#[utoipa::path(
    post, path = "/v1/workers", tag = "workers", request_body = NewWorker,
    responses(
        (status = 201, body = Registered),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn register_worker(
    State(app): State<Shared>,
    Json(worker): Json<NewWorker>,
) -> ApiResult<(StatusCode, Reply<Registered>)> {
    Ok((StatusCode::CREATED, Reply(app.register_worker(&worker).await?)))
}

#[utoipa::path(
    get, path = "/v1/workers/{id}", tag = "workers", params(("id" = String, Path, description = "The worker")),
    responses(
        (status = 200, body = Worker),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_worker(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Worker>> {
    Ok(Reply(app.worker(&id).await?))
}

/// Lets a worker finish what it has, and gives it nothing more.
#[utoipa::path(
    post, path = "/v1/workers/{id}/drain", tag = "workers", params(("id" = String, Path, description = "The worker")),
    responses(
        (status = 200, body = Worker),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn drain_worker(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Worker>> {
    Ok(Reply(app.set_draining(&id, true).await?))
}

/// Gives a drained worker tasks again.
#[utoipa::path(
    post, path = "/v1/workers/{id}/undrain", tag = "workers", params(("id" = String, Path, description = "The worker")),
    responses(
        (status = 200, body = Worker),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn undrain_worker(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Worker>> {
    Ok(Reply(app.set_draining(&id, false).await?))
}

/// A worker says that it leaves: a poll of its that is waiting is answered now, and it gets nothing more until it
/// registers again.
#[utoipa::path(
    post, path = "/v1/workers/{id}/part", tag = "workers", params(("id" = String, Path, description = "The worker")),
    responses(
        (status = 204, description = "Noted"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn part_worker(State(app): State<Shared>, Id(id): Id) -> ApiResult<StatusCode> {
    app.part_worker(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Forgets a worker; 409 while it holds a lease.
#[utoipa::path(
    delete, path = "/v1/workers/{id}", tag = "workers", params(("id" = String, Path, description = "The worker")),
    responses(
        (status = 204, description = "Forgotten"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn remove_worker(State(app): State<Shared>, Id(id): Id) -> ApiResult<StatusCode> {
    app.remove_worker(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}
