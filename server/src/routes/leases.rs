//! `/v1/leases`: the worker protocol, described in `lightshaft_api::lease`.

use axum::Json as Reply;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use http::StatusCode;
use lightshaft_api::lease::{
    Complete, Fail, Heartbeat, HeartbeatReply, Lease, LeaseClosed, LeaseRequest, LogAccepted, LogChunk, Release,
};
use lightshaft_api::problem::Problem;

use crate::app::Shared;
use crate::error::ApiResult;
use crate::web::body::{Id, Json, Report};

/// Waits for a task, up to `wait_s`.
#[utoipa::path(
    post, path = "/v1/leases", tag = "leases", request_body = LeaseRequest,
    responses(
        (status = 200, body = Lease),
        (status = 204, description = "No task for this worker: ask again"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn lease_task(State(app): State<Shared>, Json(request): Json<LeaseRequest>) -> ApiResult<Response> {
    Ok(match app.lease(request).await? {
        Some(lease) => Reply(lease).into_response(),
        None => StatusCode::NO_CONTENT.into_response(),
    })
}

/// Keeps a lease; 410 when it has ended.
#[utoipa::path(
    post, path = "/v1/leases/{token}/heartbeat", tag = "leases", request_body = Heartbeat,
    params(("token" = String, Path, description = "The lease's token")),
    responses(
        (status = 200, body = HeartbeatReply),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn heartbeat(
    State(app): State<Shared>,
    Id(token): Id,
    Json(heartbeat): Json<Heartbeat>,
) -> ApiResult<Reply<HeartbeatReply>> {
    Ok(Reply(app.heartbeat(&token, &heartbeat).await?))
}

/// Appends to the attempt's log. Lines that are there already are skipped; lines after a gap are not taken.
#[utoipa::path(
    post, path = "/v1/leases/{token}/logs", tag = "leases", request_body = LogChunk,
    params(("token" = String, Path, description = "The lease's token")),
    responses(
        (status = 200, body = LogAccepted),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn append_log(
    State(app): State<Shared>,
    Id(token): Id,
    Json(chunk): Json<LogChunk>,
) -> ApiResult<Reply<LogAccepted>> {
    Ok(Reply(app.append_log(&token, &chunk).await?))
}

/// The task succeeded. Its artifacts were put as blobs before; 409 when the lease has ended.
#[utoipa::path(
    post, path = "/v1/leases/{token}/complete", tag = "leases", request_body = Complete,
    params(("token" = String, Path, description = "The lease's token")),
    responses(
        (status = 200, body = LeaseClosed),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn complete(
    State(app): State<Shared>,
    Id(token): Id,
    Report(report): Report<Complete>,
) -> ApiResult<Reply<LeaseClosed>> {
    Ok(Reply(app.complete(&token, &report).await?))
}

/// The task failed; its class says what becomes of it. 409 when the lease has ended.
#[utoipa::path(
    post, path = "/v1/leases/{token}/fail", tag = "leases", request_body = Fail,
    params(("token" = String, Path, description = "The lease's token")),
    responses(
        (status = 200, body = LeaseClosed),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn fail(
    State(app): State<Shared>,
    Id(token): Id,
    Json(report): Json<Fail>,
) -> ApiResult<Reply<LeaseClosed>> {
    Ok(Reply(app.fail(&token, &report).await?))
}

/// The work was given up: cancelled, or the worker stops. No attempt is spent.
#[utoipa::path(
    post, path = "/v1/leases/{token}/release", tag = "leases", request_body = Release,
    params(("token" = String, Path, description = "The lease's token")),
    responses(
        (status = 200, body = LeaseClosed),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn release(
    State(app): State<Shared>,
    Id(token): Id,
    Json(report): Json<Release>,
) -> ApiResult<Reply<LeaseClosed>> {
    Ok(Reply(app.release(&token, &report).await?))
}
