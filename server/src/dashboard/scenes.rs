//! `/scenes` and `/scenes/{id}`: what can be rendered.

use askama::Template;
use axum::extract::{Path, Query};
use axum::response::{IntoResponse, Response};
use lightshaft_api::job::{CAMERA_LABEL, JobSummary};
use lightshaft_api::mesh::Mesh;
use lightshaft_api::page::Page as List;
use lightshaft_api::scene::{Bounds, CameraSummary, Scene};
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
    cameras: Vec<CameraCard>,
    /// Structures of its meshes, of the first [`MOST_MESHES`].
    held: Vec<Held>,
}

/// A camera, with what it sees.
struct CameraCard {
    name: String,
    kind: String,
    /// Address of its picture, once there is one.
    picture: Option<String>,
}

/// The first camera's picture is the thumbnail; of the others there may be automatic `jobs`.
fn cameras(scene: &Scene, jobs: &[JobSummary]) -> Vec<CameraCard> {
    let picture = |index: usize| match index {
        0 => scene.thumbnail.clone(),
        _ => {
            let number = index.to_string();
            let job = jobs.iter().find(|job| job.labels.get(CAMERA_LABEL) == Some(&number))?;
            Some(format!("/v1/jobs/{}/artifacts/image.png", escape(&job.id)))
        }
    };
    let card = |(index, camera): (usize, &CameraSummary)| CameraCard {
        name: camera.name.clone(),
        kind: camera.kind.clone(),
        picture: picture(index),
    };
    scene.summary.cameras.iter().enumerate().map(card).collect()
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
    let views = with_query("/v1/jobs?automatic=true&state=succeeded&limit=50", &[("scene", &scene.id)]);
    let views: List<JobSummary> = api.get(&views).await?;
    let page = ScenePage {
        here: "scenes",
        cameras: cameras(&scene, &views.items),
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

#[cfg(test)]
mod tests {
    use super::super::tests::fixture;
    use super::*;

    #[test]
    fn each_camera_shows_its_own_picture() {
        let scene = fixture::scene("s1", "two cameras");
        let mut job = fixture::job("j-view", "succeeded").summary;
        assert_eq!(cameras(&scene, std::slice::from_ref(&job))[1].picture, None, "some other automatic job");
        job.labels.insert(CAMERA_LABEL.to_owned(), "1".to_owned());
        let cards = cameras(&scene, &[job]);
        assert_eq!((cards.len(), cards[0].picture.clone()), (2, scene.thumbnail));
        assert_eq!(cards[1].picture.as_deref(), Some("/v1/jobs/j-view/artifacts/image.png"));
    }
}
