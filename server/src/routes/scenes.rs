//! `/v1/scenes`

use axum::Json as Reply;
use axum::extract::{Request, State};
use axum::response::{IntoResponse, Response};
use http::{HeaderMap, StatusCode, header};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use lightshaft_api::scene::{Scene, SceneSummary};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::app::{Shared, Uploaded};
use crate::error::ApiResult;
use crate::store::PageRequest;
use crate::web::body::{Id, PageParams, Params};
use crate::web::file::{self, Binary};
use crate::web::page::page;

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct UploadParams {
    /// What people call it, 1 to 200 characters; from the file names when not given.
    name: Option<String>,
    /// Check the scene and keep nothing: answers 200 with its summary.
    #[serde(default)]
    validate_only: bool,
}

/// Scenes, newest first.
#[utoipa::path(
    get, path = "/v1/scenes", tag = "scenes", params(PageParams),
    responses(
        (status = 200, body = Page<Scene>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_scenes(
    State(app): State<Shared>,
    Params(params): Params<PageParams>,
) -> ApiResult<Reply<Page<Scene>>> {
    let request = PageRequest { limit: params.limit()? + 1, after: params.after_id()? };
    Ok(page(app.scenes(&request).await?, request.limit, |scene| &scene.id))
}

/// Uploads a scene: a `.glb`, a `.zip` with one `.gltf` or `.glb` and its files, a `.gltf` whose data is all inside, or
/// `multipart/form-data` with a part for each file, named by its relative path. The same bytes give the same scene.
#[utoipa::path(
    post, path = "/v1/scenes", tag = "scenes", params(UploadParams),
    request_body(
        content(
            (inline(Binary) = "model/gltf-binary"),
            (inline(Binary) = "application/zip"),
            (inline(Binary) = "model/gltf+json"),
            (inline(Binary) = "multipart/form-data"),
        )
    ),
    responses(
        (status = 201, description = "A new scene", body = Scene),
        (status = 200, description = "A scene that was there already; with `validate_only`, the summary", body = Scene),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn upload_scene(
    State(app): State<Shared>,
    Params(params): Params<UploadParams>,
    request: Request,
) -> ApiResult<Response> {
    Ok(match app.upload_scene(request, params.name, params.validate_only).await? {
        Uploaded::New(scene) => {
            let location = [(header::LOCATION, format!("/v1/scenes/{}", scene.id))];
            (StatusCode::CREATED, location, Reply::<Scene>(*scene)).into_response()
        }
        Uploaded::Known(scene) => Reply::<Scene>(*scene).into_response(),
        Uploaded::Valid(summary) => Reply::<SceneSummary>(*summary).into_response(),
    })
}

#[utoipa::path(
    get, path = "/v1/scenes/{id}", tag = "scenes", params(("id" = String, Path, description = "The scene")),
    responses(
        (status = 200, body = Scene),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_scene(State(app): State<Shared>, Id(id): Id) -> ApiResult<Reply<Scene>> {
    Ok(Reply(app.scene(&id).await?))
}

/// Deletes a scene; 409 while unfinished jobs use it. Finished jobs and their pictures stay.
#[utoipa::path(
    delete, path = "/v1/scenes/{id}", tag = "scenes", params(("id" = String, Path, description = "The scene")),
    responses(
        (status = 204, description = "Deleted"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_scene(State(app): State<Shared>, Id(id): Id) -> ApiResult<StatusCode> {
    app.delete_scene(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// A small picture, rendered by an automatic job of low priority; 404 until then.
#[utoipa::path(
    get, path = "/v1/scenes/{id}/thumbnail.png", tag = "scenes",
    params(("id" = String, Path, description = "The scene")),
    responses(
        (status = 200, body = inline(Binary), content_type = "image/png"),
        (status = 304, description = "Not modified"),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_thumbnail(State(app): State<Shared>, Id(id): Id, headers: HeaderMap) -> ApiResult<Response> {
    let hash = app.thumbnail(&id).await?;
    file::serve(&app, &hash, "image/png", file::REVALIDATE, &headers, "thumbnail").await
}
