//! `/v1/farm/schedules`

use axum::Json as Reply;
use axum::extract::State;
use http::StatusCode;
use lightshaft_api::farm::{NewSchedule, Schedule, SchedulePatch};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;

use crate::app::Shared;
use crate::error::ApiResult;
use crate::web::body::{Id, Json};

/// Adds a schedule: a run that begins by the clock. Suite, scenes and settings are checked now.
#[utoipa::path(
    post, path = "/v1/farm/schedules", tag = "farm", request_body = NewSchedule,
    responses(
        (status = 201, description = "Added", body = Schedule),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn create_schedule(
    State(app): State<Shared>,
    Json(new): Json<NewSchedule>,
) -> ApiResult<(StatusCode, Reply<Schedule>)> {
    Ok((StatusCode::CREATED, Reply(app.create_schedule(&new).await?)))
}

/// All schedules by name.
#[utoipa::path(
    get, path = "/v1/farm/schedules", tag = "farm",
    responses(
        (status = 200, body = Page<Schedule>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_schedules(State(app): State<Shared>) -> ApiResult<Reply<Page<Schedule>>> {
    Ok(Reply(Page { items: app.schedules().await?, next_cursor: None }))
}

/// Pauses a schedule, or resumes it from now on: times that passed while it was paused are skipped.
#[utoipa::path(
    patch, path = "/v1/farm/schedules/{id}", tag = "farm", request_body = SchedulePatch,
    params(("id" = String, Path, description = "The schedule")),
    responses(
        (status = 200, body = Schedule),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn change_schedule(
    State(app): State<Shared>,
    Id(id): Id,
    Json(patch): Json<SchedulePatch>,
) -> ApiResult<Reply<Schedule>> {
    Ok(Reply(app.change_schedule(&id, &patch).await?))
}

/// Deletes a schedule. Runs that it began stay.
#[utoipa::path(
    delete, path = "/v1/farm/schedules/{id}", tag = "farm", params(("id" = String, Path, description = "The schedule")),
    responses(
        (status = 204, description = "Deleted"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn delete_schedule(State(app): State<Shared>, Id(id): Id) -> ApiResult<StatusCode> {
    app.delete_schedule(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}
