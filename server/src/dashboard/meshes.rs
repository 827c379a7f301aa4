//! `/meshes/{hash}`: which structures exist for a mesh, and who holds them.

use askama::Template;
use axum::extract::Path;
use axum::response::{IntoResponse, Response};
use lightshaft_api::mesh::Mesh;

use super::client::{Api, escape};
use super::filters;
use super::page::{Page, PageError};

#[derive(Template)]
#[template(path = "mesh.html")]
struct MeshPage {
    here: &'static str,
    mesh: Mesh,
}

pub(super) async fn show(api: Api, Path(hash): Path<String>) -> Result<Response, PageError> {
    let mesh: Mesh = api.get(&format!("/v1/meshes/{}", escape(&hash))).await?;
    Ok(Page(MeshPage { here: "scenes", mesh }).into_response())
}
