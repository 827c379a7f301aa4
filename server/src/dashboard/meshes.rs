//! `/meshes/{hash}`: which structures exist for a mesh, and who holds them.

use askama::Template;
use axum::extract::Path;
use axum::response::{IntoResponse, Response};
use lightshaft_api::mesh::Mesh;
use lightshaft_api::page::Page as List;
use lightshaft_api::worker::Worker;

use super::client::{Api, escape};
use super::filters;
use super::page::{Page, PageError};

#[derive(Template)]
#[template(path = "mesh.html")]
struct MeshPage {
    here: &'static str,
    mesh: Mesh,
    workers: Vec<Worker>,
}

impl MeshPage {
    /// What a worker calls itself; its id where nothing is known of it any more.
    fn worker_name<'a>(&'a self, id: &'a str) -> &'a str {
        self.workers.iter().find(|worker| worker.id == id).map_or(id, |worker| &worker.name)
    }
}

pub(super) async fn show(api: Api, Path(hash): Path<String>) -> Result<Response, PageError> {
    let mesh: Mesh = api.get(&format!("/v1/meshes/{}", escape(&hash))).await?;
    let workers: List<Worker> = api.get("/v1/workers").await?;
    Ok(Page(MeshPage { here: "scenes", mesh, workers: workers.items }).into_response())
}
