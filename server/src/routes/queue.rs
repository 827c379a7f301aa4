//! `/v1/queue`

use axum::Json as Reply;
use axum::extract::State;
use lightshaft_api::problem::Problem;
use lightshaft_api::queue::Queue;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::web::body::Params;

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct QueueParams {
    /// Jobs, 1 to 200; 50 by default.
    #[serde(default = "default_limit")]
    limit: u32,
}

fn default_limit() -> u32 {
    50
}

/// Unfinished jobs in the order of their turn, with what each waits for: devices, leases, pauses after failures, workers
/// that are kept from it.
#[utoipa::path(
    get, path = "/v1/queue", tag = "jobs", params(QueueParams),
    responses(
        (status = 200, body = Queue),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_queue(
    State(app): State<Shared>,
    Params(params): Params<QueueParams>,
) -> ApiResult<Reply<Queue>> {
    if !(1..=200).contains(&params.limit) {
        return Err(ApiError::bad_request("query/limit", "must be 1 to 200"));
    }
    Ok(Reply(app.queue(params.limit).await?))
}
