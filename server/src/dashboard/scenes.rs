//! `/scenes` and `/scenes/{id}`: what can be rendered.

use askama::Template;
use axum::extract::{Path, Query};
use axum::response::{IntoResponse, Response};
use lightshaft_api::job::JobSummary;
use lightshaft_api::mesh::Mesh;
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::{Bounds, Scene};
use lightshaft_api::worker::Worker;
use serde::Deserialize;

use super::client::{Api, escape, with_query};
use super::filters::{self, human_number};
use super::job::JobRow;
use super::meshes::Held;
use super::page::{Page, PageError};

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Cursor {
    pub(super) cursor: String,
}

#[derive(Template)]
#[template(path = "scenes.html")]
struct Scenes {
    here: &'static str,
    scenes: Vec<Scene>,
    first: bool,
    next: Option<String>,
}

pub(super) async fn list(api: Api, Query(query): Query<Cursor>) -> Result<Response, PageError> {
    let scenes: List<Scene> = api.get(&with_query("/v1/scenes?limit=60", &[("cursor", &query.cursor)])).await?;
    let page = Scenes {
        here: "scenes",
        first: query.cursor.is_empty(),
        next: scenes.next_cursor.map(|cursor| with_query("/scenes", &[("cursor", &cursor)])),
        scenes: scenes.items,
    };
    Ok(Page(page).into_response())
}

#[derive(Template)]
#[template(path = "scene.html")]
struct ScenePage {
    here: &'static str,
    scene: Scene,
    jobs: Vec<JobRow>,
    /// Structures of its meshes, of the first [`MOST_MESHES`].
    held: Vec<Held>,
}

/// Meshes of a scene whose structures are shown.
const MOST_MESHES: u32 = 200;

impl ScenePage {
    /// Structures of the mesh.
    fn held(&self, hash: &str) -> Option<&Held> {
        self.held.iter().find(|held| held.mesh.hash == hash)
    }

    fn structure_bytes(&self) -> u64 {
        self.held.iter().map(|held| held.bytes).sum()
    }
}

pub(super) async fn show(api: Api, Path(id): Path<String>) -> Result<Response, PageError> {
    let scene: Scene = api.get(&format!("/v1/scenes/{}", escape(&id))).await?;
    let jobs: List<JobSummary> =
        api.get(&with_query("/v1/jobs?automatic=false&limit=12", &[("scene", &scene.id)])).await?;
    let meshes = with_query(&format!("/v1/meshes?limit={MOST_MESHES}"), &[("scene", &scene.id)]);
    let meshes: List<Mesh> = api.get(&meshes).await?;
    let workers: List<Worker> = api.get("/v1/workers").await?;
    let page = ScenePage {
        here: "scenes",
        scene,
        jobs: jobs.items.into_iter().map(|job| JobRow { job }).collect(),
        held: meshes.items.into_iter().map(|mesh| Held::new(mesh, &workers.items)).collect(),
    };
    Ok(Page(page).into_response())
}

/// Extent along each axis, and the middle.
fn extent(bounds: &Option<Bounds>) -> String {
    match bounds {
        None => "empty".to_owned(),
        Some(bounds) => {
            let [x, y, z] = std::array::from_fn(|axis| human_number(f64::from(bounds.max[axis] - bounds.min[axis])));
            format!("{x} × {y} × {z}")
        }
    }
}

/// Both corners, for the title of [`extent`].
fn corners(bounds: &Option<Bounds>) -> String {
    let point = |[x, y, z]: [f32; 3]| format!("({x}, {y}, {z})");
    bounds.as_ref().map_or_else(String::new, |bounds| format!("from {} to {}", point(bounds.min), point(bounds.max)))
}
