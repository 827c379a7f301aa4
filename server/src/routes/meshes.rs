//! `/v1/meshes`

use axum::Json as Reply;
use axum::extract::State;
use lightshaft_api::mesh::{FindStructures, FoundStructures, Mesh, NewStructure, Structure};
use lightshaft_api::page::Page;
use lightshaft_api::problem::Problem;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::app::Shared;
use crate::error::ApiResult;
use crate::store::PageRequest;
use crate::web::body::{Id, Json, PageParams, Params};
use crate::web::page::page;

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MeshParams {
    /// Meshes of this scene.
    scene: Option<String>,
    /// Rows, 1 to 200; 50 by default.
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Meshes in order of their hash.
#[utoipa::path(
    get, path = "/v1/meshes", tag = "meshes", params(MeshParams),
    responses(
        (status = 200, body = Page<Mesh>),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_meshes(
    State(app): State<Shared>,
    Params(MeshParams { scene, limit, cursor }): Params<MeshParams>,
) -> ApiResult<Reply<Page<Mesh>>> {
    let params = PageParams { limit, cursor };
    let request = PageRequest { limit: params.limit()? + 1, after: params.after_hash()? };
    Ok(page(app.meshes(scene.as_deref(), &request).await?, request.limit, |mesh| &mesh.hash))
}

/// A mesh and the structures that exist for it.
#[utoipa::path(
    get, path = "/v1/meshes/{hash}", tag = "meshes",
    params(("hash" = String, Path, description = "The mesh's hash")),
    responses(
        (status = 200, body = Mesh),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_mesh(State(app): State<Shared>, Id(hash): Id) -> ApiResult<Reply<Mesh>> {
    Ok(Reply(app.mesh(&hash).await?))
}

/// Which of many meshes have a structure of one kind, and the blobs that hold it: one call for a whole scene.
#[utoipa::path(
    post, path = "/v1/meshes:structures", tag = "meshes", request_body = FindStructures,
    responses(
        (status = 200, body = FoundStructures),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn find_structures(
    State(app): State<Shared>,
    Json(wanted): Json<FindStructures>,
) -> ApiResult<Reply<FoundStructures>> {
    Ok(Reply(app.find_structures(&wanted).await?))
}

/// Tells of a structure whose blob was put before. Of several with the same key, the first is kept and answered.
#[utoipa::path(
    post, path = "/v1/meshes/{hash}/structures", tag = "meshes",
    params(("hash" = String, Path, description = "The mesh's hash")), request_body = NewStructure,
    responses(
        (status = 200, body = Structure),
        (status = "default", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn add_structure(
    State(app): State<Shared>,
    Id(hash): Id,
    Json(structure): Json<NewStructure>,
) -> ApiResult<Reply<Structure>> {
    Ok(Reply(app.add_structure(&hash, &structure).await?))
}
