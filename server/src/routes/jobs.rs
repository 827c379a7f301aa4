//! `/v1/jobs`, and the events of jobs.

use std::convert::Infallible;
use std::time::Duration;

use axum::Json as Reply;
use axum::body::Body;
use axum::extract::State;
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures::Stream;
use futures::stream;
use http::{HeaderMap, StatusCode, header};
use lightshaft_api::event::Event;
use lightshaft_api::job::{
    Artifact, Attempt, Job, JobKind, JobPatch, JobState, JobSummary, NewJob, Task, ValidatedJob,
};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::app::{EventStream, Shared, is_label_key};
use crate::error::{ApiError, ApiResult};
use crate::store::{JobQuery, PageRequest};
use crate::web::body::{Id, IdempotencyKey, Ids, Json, PageParams, Params};
use crate::web::file::{self, Binary};
use crate::web::page::page;

const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// For the documentation: labels make the set of parameters open, so they are read by hand.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "only describes the parameters")]
pub(super) struct ListParams {
    /// Jobs in this state.
    state: Option<String>,
    /// Jobs of this kind.
    kind: Option<String>,
    /// Jobs of this scene.
    scene: Option<String>,
    /// Part of the scene's name or of a label's value, or the start of the id.
    q: Option<String>,
    /// Only (or no) jobs that the service made by itself, such as thumbnails.
    automatic: Option<bool>,
    /// `label.<key>=<value>`: jobs with this label; may be given several times.
    #[param(rename = "label.<key>")]
    label: Option<String>,
    /// Rows, 1 to 200; 50 by default.
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

fn read_list_params(params: Vec<(String, String)>) -> ApiResult<(JobQuery, PageParams)> {
    let mut query = JobQuery::default();
    let mut page = PageParams::default();
    for (key, value) in params {
        let wrong = |detail: &str| ApiError::bad_request(&format!("query/{key}"), detail);
        match key.as_str() {
            "state" => {
                let expected = "must be queued, running, succeeded, failed or cancelled";
                query.state = Some(JobState::from_name(&value).ok_or_else(|| wrong(expected))?);
            }
            "kind" => {
                let expected = "must be render, benchmark, build or compare";
                query.kind = Some(JobKind::from_name(&value).ok_or_else(|| wrong(expected))?);
            }
            "scene" => query.scene = Some(value),
            "q" if value.is_empty() => {}
            "q" if value.chars().count() <= 200 => query.text = Some(value),
            "q" => return Err(wrong("must have at most 200 characters")),
            "automatic" => query.automatic = Some(value.parse().map_err(|_| wrong("must be true or false"))?),
            "limit" => page.limit = Some(value.parse().map_err(|_| wrong("must be 1 to 200"))?),
            "cursor" => page.cursor = Some(value),
            _ => match key.strip_prefix("label.") {
                Some(label) if is_label_key(label) => {
                    query.labels.insert(label.to_owned(), value);
                }
                _ => {
                    let expected = "is not a parameter: there are state, kind, scene, q, automatic, label.<key>, limit \
                                    and cursor";
                    return Err(wrong(expected));
                }
            },
        }
    }
    Ok((query, page))
}

/// Jobs, newest first.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", params(ListParams),
    responses(
        (status = 200, body = Page<JobSummary>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_jobs(
    State(app): State<Shared>,
    Params(params): Params<Vec<(String, String)>>,
) -> ApiResult<Reply<Page<JobSummary>>> {
    let (query, params) = read_list_params(params)?;
    let request = PageRequest { limit: params.limit()? + 1, after: params.after_id()? };
    Ok(page(app.jobs(&query, &request).await?, request.limit, |job| &job.id))
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CreateParams {
    /// Check the job and make nothing: answers 200 with the job as it would be.
    #[serde(default)]
    validate_only: bool,
}

/// Makes a job. With an `Idempotency-Key`, repeating the request within 24 hours answers 200 with the job made first,
/// and another request under the same key is refused.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs", request_body = NewJob,
    params(
        CreateParams,
        ("Idempotency-Key" = Option<String>, Header, description = "1 to 255 visible ASCII characters"),
    ),
    responses(
        (status = 201, description = "Made", body = Job),
        (status = 200, description = "Made before under this key; or, with `validate_only`, valid", body = ValidatedJob),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn create_job(
    State(app): State<Shared>,
    Params(params): Params<CreateParams>,
    IdempotencyKey(key): IdempotencyKey,
    Json(new): Json<NewJob>,
) -> ApiResult<Response> {
    if params.validate_only {
        return Ok(Reply::<ValidatedJob>(app.validate_job(&new).await?).into_response());
    }
    let created = app.create_job(&new, key.as_deref()).await?;
    if !created.is_new {
        return Ok(Reply::<Job>(created.job).into_response());
    }
    let location = [(header::LOCATION, format!("/v1/jobs/{}", created.job.summary.id))];
    Ok((StatusCode::CREATED, location, Reply::<Job>(created.job)).into_response())
}

#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Job),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_job(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Job>> {
    Ok(Reply(app.job(&id).await?))
}

/// Changes a job's priority, or pauses it: only what is given changes.
#[utoipa::path(
    patch, path = "/v1/jobs/{id}", tag = "jobs", request_body = JobPatch,
    params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Job),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn change_job(
    State(app): State<Shared>,
    Id(id): Id,
    Json(patch): Json<JobPatch>,
) -> ApiResult<Reply<Job>> {
    Ok(Reply(app.patch_job(&id, &patch).await?))
}

/// Deletes a finished job with its pictures and logs; 409 while it is unfinished.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 204, description = "Deleted"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_job(State(app): State<Shared>, Id(id): Id) -> ApiResult<StatusCode> {
    app.delete_job(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Cancels a job: waiting tasks end now, running ones within a tile after their next heartbeat. May be repeated.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Job),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn cancel_job(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Job>> {
    Ok(Reply(app.cancel_job(&id).await?))
}

/// Starts the failed and cancelled tasks of a job afresh; what succeeded stays.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/retry", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Job),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn retry_job(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Job>> {
    Ok(Reply(app.retry_job(&id).await?))
}

fn whole<T>(items: Vec<T>) -> Reply<Page<T>> {
    Reply(Page { items, next_cursor: None })
}

/// A job's tasks: one, or parts and their merge.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/tasks", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Page<Task>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_tasks(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Page<Task>>> {
    Ok(whole(app.job(&id).await?.tasks))
}

/// Every lease of every task of a job, oldest first.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/attempts", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Page<Attempt>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_attempts(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Page<Attempt>>> {
    Ok(whole(app.job(&id).await?.attempts))
}

/// What a job left: pictures, metrics.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = Page<Artifact>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_artifacts(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Page<Artifact>>> {
    Ok(whole(app.job(&id).await?.artifacts))
}

/// The bytes of an artifact. Takes If-None-Match and Range.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/artifacts/{name}", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("name" = String, Path, description = "`image.png`, `image.exr`, `metrics.json`"),
    ),
    responses(
        (status = 200, body = inline(Binary), content_type = "application/octet-stream"),
        (status = 206, description = "The range that was asked for", body = inline(Binary), content_type = "application/octet-stream"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_artifact(
    State(app): State<Shared>,
    Ids(id, name): Ids,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let artifact = app.artifact(&id, &name).await?;
    file::serve(&app, &artifact.hash, &artifact.media_type, file::REVALIDATE, &headers, "artifact").await
}

/// The picture so far of a running job, or the whole one (`image.png`) of a job that has ended; 404 while there is none.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/preview.png", tag = "jobs", params(("id" = String, Path, description = "The job")),
    responses(
        (status = 200, body = inline(Binary), content_type = "image/png"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_preview(State(app): State<Shared>, Id(id): Id, headers: HeaderMap) -> ApiResult<Response> {
    let hash = app.preview(&id).await?;
    file::serve(&app, &hash, "image/png", file::REVALIDATE, &headers, "preview").await
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LogParams {
    /// Only the log of this attempt.
    attempt: Option<String>,
}

/// What the workers logged: all attempts under headings, or one.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/log", tag = "jobs",
    params(("id" = String, Path, description = "The job"), LogParams),
    responses(
        (status = 200, body = String, content_type = "text/plain"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_log(
    State(app): State<Shared>,
    Id(id): Id,
    Params(params): Params<LogParams>,
) -> ApiResult<Response> {
    let log = app.job_log(&id, params.attempt.as_deref()).await?;
    let plain = [(header::CONTENT_TYPE, "text/plain; charset=utf-8")];
    Ok((plain, Body::from_stream(log)).into_response())
}

/// Events of a job from its beginning, or after `Last-Event-ID`, as server-sent events. Ends with the job.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", tag = "jobs",
    params(
        ("id" = String, Path, description = "The job"),
        ("Last-Event-ID" = Option<i64>, Header, description = "Go on after this event"),
    ),
    responses(
        (status = 200, description = "The data of each is an Event", body = String, content_type = "text/event-stream"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn job_events(State(app): State<Shared>, Id(id): Id, headers: HeaderMap) -> ApiResult<Response> {
    let stream = EventStream::open(app, Some(id), last_event_id(&headers)?).await?;
    Ok(to_sse(stream).into_response())
}

/// Events of all jobs from now on, or after `Last-Event-ID`, as server-sent events.
#[utoipa::path(
    get, path = "/v1/events", tag = "jobs",
    params(("Last-Event-ID" = Option<i64>, Header, description = "Go on after this event")),
    responses(
        (status = 200, description = "The data of each is an Event", body = String, content_type = "text/event-stream"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn all_events(State(app): State<Shared>, headers: HeaderMap) -> ApiResult<Response> {
    let stream = EventStream::open(app, None, last_event_id(&headers)?).await?;
    Ok(to_sse(stream).into_response())
}

fn last_event_id(headers: &HeaderMap) -> ApiResult<Option<i64>> {
    let Some(value) = headers.get("last-event-id") else { return Ok(None) };
    let id = value.to_str().ok().and_then(|text| text.trim().parse::<i64>().ok()).filter(|&id| id >= 0);
    let wrong = || ApiError::bad_request("header/last-event-id", "must be the id of an event");
    id.map(Some).ok_or_else(wrong)
}

fn to_sse(events: EventStream) -> Sse<impl Stream<Item = Result<sse::Event, Infallible>>> {
    let stream = stream::unfold(events, |mut events| async move {
        match events.next().await {
            Ok(event) => Some((Ok(to_sse_event(&event?)), events)),
            Err(error) => {
                tracing::error!(error = %error, "a stream of events ended");
                None
            }
        }
    });
    Sse::new(stream).keep_alive(KeepAlive::new().interval(KEEP_ALIVE).text("keep-alive"))
}

fn to_sse_event(event: &Event) -> sse::Event {
    let data = serde_json::to_string(event).unwrap_or_default();
    let sse = sse::Event::default().event(event.kind.as_str()).data(data);
    match event.id {
        Some(id) => sse.id(id.to_string()),
        None => sse,
    }
}
