//! `/v1/farm/runs`, `/v1/farm/calibrations` and `/v1/farm/history`

use axum::Json as Reply;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use http::{HeaderMap, StatusCode, header};
use lightshaft_api::farm::{
    Calibration, DEFAULT_BASELINE, History, NewCalibration, NewRun, Run, RunKind, RunState, RunSummary,
};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use serde::Deserialize;
use utoipa::IntoParams;

use super::choice;
use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::store::{PageRequest, RunQuery};
use crate::web::body::{Id, IdempotencyKey, Json, PageParams, Params, ThreeIds};
use crate::web::file::{self, Binary};
use crate::web::page::page;

/// What was made, and where it is.
pub(super) type Made<T> = (StatusCode, [(header::HeaderName, String); 1], Reply<T>);

/// Begins a run of a suite at a label. Its cases become jobs with the labels `farm_run`, `farm_case`, `farm_phase` and
/// `farm_repetition`. With an `Idempotency-Key`, repeating the request within 24 hours answers 200 with the run begun first,
/// and another request under the same key is refused.
#[utoipa::path(
    post, path = "/v1/farm/runs", tag = "farm", request_body = NewRun,
    params(("Idempotency-Key" = Option<String>, Header, description = "1 to 255 visible ASCII characters")),
    responses(
        (status = 201, description = "Begun", body = Run),
        (status = 200, description = "Begun before under this key", body = Run),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn create_run(
    State(app): State<Shared>,
    IdempotencyKey(key): IdempotencyKey,
    Json(new): Json<NewRun>,
) -> ApiResult<Response> {
    let (run, is_new) = app.create_run(&new, key.as_deref()).await?;
    if !is_new {
        return Ok(Reply::<Run>(run).into_response());
    }
    let location = [(header::LOCATION, format!("/v1/farm/runs/{}", run.summary.id))];
    Ok((StatusCode::CREATED, location, Reply::<Run>(run)).into_response())
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::routes) struct ListParams {
    /// `check` or `calibration`.
    kind: Option<String>,
    /// `running`, `finished` or `cancelled`.
    state: Option<String>,
    /// Runs of the suite of this name.
    suite: Option<String>,
    label: Option<String>,
    /// Name of a baseline.
    baseline: Option<String>,
    /// Finished runs that are (or are not) well.
    ok: Option<bool>,
    /// Rows, 1 to 200; 50 by default.
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Runs and calibrations, newest first.
#[utoipa::path(
    get, path = "/v1/farm/runs", tag = "farm", params(ListParams),
    responses(
        (status = 200, body = Page<RunSummary>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_runs(
    State(app): State<Shared>,
    Params(params): Params<ListParams>,
) -> ApiResult<Reply<Page<RunSummary>>> {
    let query = RunQuery {
        kind: choice("kind", params.kind.as_deref(), RunKind::from_name, "check or calibration")?,
        state: choice("state", params.state.as_deref(), RunState::from_name, "running, finished or cancelled")?,
        suite_name: params.suite,
        label: params.label,
        baseline: params.baseline,
        ok: params.ok,
    };
    let rows = PageParams { limit: params.limit, cursor: params.cursor };
    let request = PageRequest { limit: rows.limit()? + 1, after: rows.after_id()? };
    Ok(page(app.runs(&query, &request).await?, request.limit, |run| &run.id))
}

/// A run with its cases: verdicts, figures, jobs, pictures, decisions.
#[utoipa::path(
    get, path = "/v1/farm/runs/{id}", tag = "farm", params(("id" = String, Path, description = "The run")),
    responses(
        (status = 200, body = Run),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn get_run(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Run>> {
    Ok(Reply(app.run(&id).await?))
}

/// Cancels a running run with its jobs. May be repeated.
#[utoipa::path(
    post, path = "/v1/farm/runs/{id}/cancel", tag = "farm", params(("id" = String, Path, description = "The run")),
    responses(
        (status = 200, body = Run),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn cancel_run(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Run>> {
    Ok(Reply(app.cancel_run(&id).await?))
}

/// A picture of a case. Takes If-None-Match and Range.
#[utoipa::path(
    get, path = "/v1/farm/runs/{id}/cases/{case}/artifacts/{name}", tag = "farm",
    params(
        ("id" = String, Path, description = "The run"),
        ("case" = String, Path, description = "Name of the case"),
        ("name" = String, Path, description = "`image.png`, `image.exr`, `heat-map.png`, `difference.png`, `accepted.png`, `accepted.exr`"),
    ),
    responses(
        (status = 200, body = inline(Binary), content_type = "application/octet-stream"),
        (status = 206, description = "The range that was asked for", body = inline(Binary), content_type = "application/octet-stream"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn get_case_artifact(
    State(app): State<Shared>,
    ThreeIds(id, case, name): ThreeIds,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let run = app.run(&id).await?;
    let found = run.cases.into_iter().find(|one| one.name == case);
    let found = found.ok_or_else(|| ApiError::not_found("case of this run", &case))?;
    let artifact = found.artifacts.into_iter().find(|artifact| artifact.name == name);
    let artifact = artifact.ok_or_else(|| ApiError::not_found("picture of this case", &name))?;
    file::serve(&app, &artifact.hash, &artifact.media_type, file::REVALIDATE, &headers, "picture").await
}

/// Repeats every case as it is, to learn how far the times of unchanged runs lie apart: the noise floor of a case on a
/// device class, below which nothing is called slower.
#[utoipa::path(
    post, path = "/v1/farm/calibrations", tag = "farm", request_body = NewCalibration,
    responses(
        (status = 201, description = "Begun", body = Calibration),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn create_calibration(
    State(app): State<Shared>,
    Json(new): Json<NewCalibration>,
) -> ApiResult<Made<Calibration>> {
    let calibration = app.create_calibration(&new).await?;
    let location = [(header::LOCATION, format!("/v1/farm/calibrations/{}", calibration.id))];
    Ok((StatusCode::CREATED, location, Reply(calibration)))
}

/// A calibration: the medians of each case's runs, and the noise floor. It is a run, too, and can be cancelled as one.
#[utoipa::path(
    get, path = "/v1/farm/calibrations/{id}", tag = "farm",
    params(("id" = String, Path, description = "The calibration")),
    responses(
        (status = 200, body = Calibration),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn get_calibration(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Calibration>> {
    Ok(Reply(app.calibration(&id).await?))
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::routes) struct HistoryParams {
    /// Name of the suite.
    suite: String,
    /// Name of the case.
    case: String,
    /// The newest run's when left out.
    device_class: Option<String>,
    /// Whose accepted pictures and decisions; `main` when left out.
    baseline: Option<String>,
}

/// A case over its labels, at most the newest 500 runs: times with change points, accepted pictures, decisions.
#[utoipa::path(
    get, path = "/v1/farm/history", tag = "farm", params(HistoryParams),
    responses(
        (status = 200, body = History),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn get_history(
    State(app): State<Shared>,
    Params(params): Params<HistoryParams>,
) -> ApiResult<Reply<History>> {
    let baseline = params.baseline.as_deref().unwrap_or(DEFAULT_BASELINE);
    Ok(Reply(app.history(&params.suite, &params.case, params.device_class.as_deref(), baseline).await?))
}
