//! `/v1/status`

use axum::Json as Reply;
use axum::extract::State;
use lightshaft_api::problem::Problem;
use lightshaft_api::status::Status;

use crate::app::Shared;
use crate::error::ApiResult;

/// The state of the whole service, in numbers.
#[utoipa::path(
    get, path = "/v1/status", tag = "service",
    responses(
        (status = 200, body = Status),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_status(State(app): State<Shared>) -> ApiResult<Reply<Status>> {
    Ok(Reply(app.status().await?))
}
