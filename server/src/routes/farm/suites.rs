//! `/v1/farm/suites`

use axum::Json as Reply;
use axum::extract::{FromRequest, Request, State};
use axum::response::{IntoResponse, Response};
use http::{StatusCode, header};
use lightshaft_api::farm::{NewSuite, Suite, SuiteSummary};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::app::Shared;
use crate::error::{ApiError, ApiResult};
use crate::problems::Code;
use crate::store::PageRequest;
use crate::web::body::{Id, PageParams, Params, is_json, media_type, parse, read_whole};
use crate::web::page::page;

/// A suite, in TOML or JSON.
pub(in crate::routes) struct SuiteBody(NewSuite);

impl FromRequest<Shared> for SuiteBody {
    type Rejection = ApiError;

    async fn from_request(request: Request, app: &Shared) -> ApiResult<Self> {
        let limits = &app.config.limits;
        if is_json(request.headers()) {
            return parse(&read_whole(request, limits.json_bytes, limits.upload_stall).await?).map(Self);
        }
        if media_type(request.headers()).as_deref() != Some("application/toml") {
            let detail = "expected Content-Type: application/toml, or application/json";
            return Err(ApiError::new(Code::UnsupportedMediaType, detail));
        }
        let body = read_whole(request, limits.json_bytes, limits.upload_stall).await?;
        let not_text = |_| ApiError::new(Code::BadToml, "the body is not UTF-8");
        let text = std::str::from_utf8(&body).map_err(not_text)?;
        NewSuite::from_toml(text).map(Self).map_err(|errors| match errors.first() {
            Some(syntax) if syntax.pointer.is_empty() => ApiError::new(Code::BadToml, syntax.detail.clone()),
            _ => ApiError::fields(errors),
        })
    }
}

/// Adds a version of a suite, in TOML or JSON. The same content gives the same suite, whatever its form.
#[utoipa::path(
    post, path = "/v1/farm/suites", tag = "farm",
    request_body(content((NewSuite = "application/json"), (String = "application/toml"))),
    responses(
        (status = 201, description = "A new version", body = Suite),
        (status = 200, description = "Known before", body = Suite),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn create_suite(State(app): State<Shared>, body: SuiteBody) -> ApiResult<Response> {
    let (suite, is_new) = app.create_suite(&body.0).await?;
    if !is_new {
        return Ok(Reply::<Suite>(suite).into_response());
    }
    let location = [(header::LOCATION, format!("/v1/farm/suites/{}", suite.id))];
    Ok((StatusCode::CREATED, location, Reply::<Suite>(suite)).into_response())
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::routes) struct ListParams {
    /// Versions of the suite of this name.
    name: Option<String>,
    /// Rows, 1 to 200; 50 by default.
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Versions of suites, newest first.
#[utoipa::path(
    get, path = "/v1/farm/suites", tag = "farm", params(ListParams),
    responses(
        (status = 200, body = Page<SuiteSummary>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn list_suites(
    State(app): State<Shared>,
    Params(params): Params<ListParams>,
) -> ApiResult<Reply<Page<SuiteSummary>>> {
    let rows = PageParams { limit: params.limit, cursor: params.cursor };
    let request = PageRequest { limit: rows.limit()? + 1, after: rows.after_id()? };
    Ok(page(app.suites(params.name.as_deref(), &request).await?, request.limit, |suite| &suite.id))
}

/// A version of a suite, with every default filled in.
#[utoipa::path(
    get, path = "/v1/farm/suites/{id}", tag = "farm", params(("id" = String, Path, description = "The suite")),
    responses(
        (status = 200, body = Suite),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(in crate::routes) async fn get_suite(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Suite>> {
    Ok(Reply(app.suite(&id).await?))
}
