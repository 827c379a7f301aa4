//! For whoever watches over the process.

use axum::extract::State;
use http::header;
use lightshaft_api::problem::Problem;

use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::telemetry;

/// The process answers.
#[utoipa::path(
    get, path = "/healthz", tag = "service",
    responses((status = 200, body = String, content_type = "text/plain"))
)]
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// The database and the blob store can be written; 503 otherwise, and while the service shuts down.
#[utoipa::path(
    get, path = "/readyz", tag = "service",
    responses(
        (status = 200, body = String, content_type = "text/plain"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn readyz(State(app): State<Shared>) -> ApiResult<&'static str> {
    app.check_ready().await?;
    Ok("ready\n")
}

/// Metrics in Prometheus' text format.
#[utoipa::path(
    get, path = "/metrics", tag = "service",
    responses(
        (status = 200, body = String, content_type = "text/plain"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn metrics(State(app): State<Shared>) -> ApiResult<([(header::HeaderName, &'static str); 1], String)> {
    let handle = telemetry::metrics().map_err(ApiError::internal)?;
    app.refresh_gauges().await?;
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], handle.render()))
}
