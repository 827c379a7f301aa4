//! Decisions of cases, `/v1/farm/decisions` and `/v1/farm/baselines`

use axum::Json as Reply;
use axum::extract::State;
use lightshaft_api::farm::{Baseline, BaselineReset, Decision, DecisionKind, DecisionNote, Decisions};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use serde::Deserialize;
use utoipa::IntoParams;

use super::choice;
use crate::app::Shared;
use crate::error::ApiResult;
use crate::store::{DecisionQuery, PageRequest};
use crate::web::body::{Id, Ids, Json, PageParams, Params};
use crate::web::page::page;

/// Approves a finished case: its picture joins the accepted ones of the run's baseline, its times the baseline's; where they
/// were slower or faster, they take the place of those before.
#[utoipa::path(
    post, path = "/v1/farm/runs/{id}/cases/{case}/approve", tag = "farm", request_body = DecisionNote,
    params(
        ("id" = String, Path, description = "The run"),
        ("case" = String, Path, description = "Name of the case"),
    ),
    responses(
        (status = 200, body = Decision),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn approve_case(
    State(app): State<Shared>,
    Ids(id, case): Ids,
    Json(note): Json<DecisionNote>,
) -> ApiResult<Reply<Decision>> {
    Ok(Reply(app.decide(&id, &case, DecisionKind::Approved, &note).await?))
}

/// Rejects a finished case: it stays red, and what an approval of it accepted before is accepted no longer.
#[utoipa::path(
    post, path = "/v1/farm/runs/{id}/cases/{case}/reject", tag = "farm", request_body = DecisionNote,
    params(
        ("id" = String, Path, description = "The run"),
        ("case" = String, Path, description = "Name of the case"),
    ),
    responses(
        (status = 200, body = Decision),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn reject_case(
    State(app): State<Shared>,
    Ids(id, case): Ids,
    Json(note): Json<DecisionNote>,
) -> ApiResult<Reply<Decision>> {
    Ok(Reply(app.decide(&id, &case, DecisionKind::Rejected, &note).await?))
}

/// Approves many cases of a run: all of them, or none when one cannot be. Without names, every case that has a picture, does
/// not pass and is undecided.
#[utoipa::path(
    post, path = "/v1/farm/runs/{id}/approve", tag = "farm", request_body = Decisions,
    params(("id" = String, Path, description = "The run")),
    responses(
        (status = 200, body = Page<Decision>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn approve_cases(
    State(app): State<Shared>,
    Id(id): Id,
    Json(wanted): Json<Decisions>,
) -> ApiResult<Reply<Page<Decision>>> {
    let items = app.decide_many(&id, &wanted.cases, DecisionKind::Approved, &wanted.note()).await?;
    Ok(Reply(Page { items, next_cursor: None }))
}

/// Rejects many cases of a run: all of them, or none when one cannot be. Without names, every case that does not pass and is
/// undecided.
#[utoipa::path(
    post, path = "/v1/farm/runs/{id}/reject", tag = "farm", request_body = Decisions,
    params(("id" = String, Path, description = "The run")),
    responses(
        (status = 200, body = Page<Decision>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn reject_cases(
    State(app): State<Shared>,
    Id(id): Id,
    Json(wanted): Json<Decisions>,
) -> ApiResult<Reply<Page<Decision>>> {
    let items = app.decide_many(&id, &wanted.cases, DecisionKind::Rejected, &wanted.note()).await?;
    Ok(Reply(Page { items, next_cursor: None }))
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::routes) struct ListParams {
    /// `approved`, `rejected` or `reset`.
    kind: Option<String>,
    /// Name of a suite.
    suite: Option<String>,
    /// Name of a case.
    case: Option<String>,
    /// Name of a baseline.
    baseline: Option<String>,
    /// Id of a run.
    run: Option<String>,
    who: Option<String>,
    /// Rows, 1 to 200; 50 by default.
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Who decided what, when and why; newest first. Nothing of it is ever deleted.
#[utoipa::path(
    get, path = "/v1/farm/decisions", tag = "farm", params(ListParams),
    responses(
        (status = 200, body = Page<Decision>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_decisions(
    State(app): State<Shared>,
    Params(params): Params<ListParams>,
) -> ApiResult<Reply<Page<Decision>>> {
    let query = DecisionQuery {
        kind: choice("kind", params.kind.as_deref(), DecisionKind::from_name, "approved, rejected or reset")?,
        suite_name: params.suite,
        case: params.case,
        baseline: params.baseline,
        run: params.run,
        who: params.who,
    };
    let rows = PageParams { limit: params.limit, cursor: params.cursor };
    let request = PageRequest { limit: rows.limit()? + 1, after: rows.after_id()? };
    Ok(page(app.decisions(&query, &request).await?, request.limit, |decision| &decision.id))
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::routes) struct BaselineParams {
    /// Name of the suite.
    suite: String,
}

/// What was accepted under a baseline's name: pictures and times of each case and device class of a suite.
#[utoipa::path(
    get, path = "/v1/farm/baselines/{baseline}", tag = "farm",
    params(("baseline" = String, Path, description = "Name of the baseline, such as `main`"), BaselineParams),
    responses(
        (status = 200, body = Page<Baseline>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_baselines(
    State(app): State<Shared>,
    Id(baseline): Id,
    Params(params): Params<BaselineParams>,
) -> ApiResult<Reply<Page<Baseline>>> {
    let items = app.baselines(&baseline, &params.suite).await?;
    Ok(Reply(Page { items, next_cursor: None }))
}

/// Takes back what was accepted: of a suite, of one of its cases, or of one device class. The next run finds nothing to
/// compare with. The decision is kept.
#[utoipa::path(
    post, path = "/v1/farm/baselines/{baseline}/reset", tag = "farm", request_body = BaselineReset,
    params(("baseline" = String, Path, description = "Name of the baseline, such as `main`")),
    responses(
        (status = 200, body = Decision),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn reset_baseline(
    State(app): State<Shared>,
    Id(baseline): Id,
    Json(reset): Json<BaselineReset>,
) -> ApiResult<Reply<Decision>> {
    Ok(Reply(app.reset_baseline(&baseline, &reset).await?))
}
