//! `/meshes` and `/meshes/{hash}`: which structures exist, who holds them, and how often they need not be built.

use askama::Template;
use axum::extract::{Path, Query};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lightshaft_api::job::CacheSource;
use lightshaft_api::mesh::Mesh;
use lightshaft_api::page::Page as List;
use lightshaft_api::worker::{Worker, WorkerState};

use super::client::{Api, escape, with_query};
use super::filters;
use super::page::{Page, PageError};
use super::scenes::Cursor;

/// The counter of structures that workers got, by where from.
const STRUCTURES_METRIC: &str = "lightshaft_structures_total";

#[derive(Template)]
#[template(path = "mesh.html")]
struct MeshPage {
    here: &'static str,
    mesh: Mesh,
    workers: Vec<Worker>,
}

impl MeshPage {
    fn worker_name<'a>(&'a self, id: &'a str) -> &'a str {
        worker_name(&self.workers, id)
    }
}

/// What a worker calls itself; its id where nothing is known of it any more.
fn worker_name<'a>(workers: &'a [Worker], id: &'a str) -> &'a str {
    workers.iter().find(|worker| worker.id == id).map_or(id, |worker| &worker.name)
}

pub(super) async fn show(api: Api, Path(hash): Path<String>) -> Result<Response, PageError> {
    let mesh: Mesh = api.get(&format!("/v1/meshes/{}", escape(&hash))).await?;
    let workers: List<Worker> = api.get("/v1/workers").await?;
    Ok(Page(MeshPage { here: "meshes", mesh, workers: workers.items }).into_response())
}

#[derive(Template)]
#[template(path = "meshes.html")]
struct MeshesPage {
    here: &'static str,
    meshes: Vec<Held>,
    sources: Sources,
    workers: Vec<Worker>,
    first: bool,
    next: Option<String>,
}

/// A mesh, with its structures taken together.
pub(super) struct Held {
    pub(super) mesh: Mesh,
    pub(super) bytes: u64,
    pub(super) build_s: f64,
    pub(super) built_at: Option<Timestamp>,
    /// Names of workers that hold one of them warm.
    pub(super) workers: Vec<String>,
}

impl Held {
    pub(super) fn new(mesh: Mesh, workers: &[Worker]) -> Self {
        let mut holders: Vec<String> = mesh
            .structures
            .iter()
            .flat_map(|structure| &structure.workers)
            .map(|id| worker_name(workers, id).to_owned())
            .collect();
        holders.sort();
        holders.dedup();
        Self {
            bytes: mesh.structures.iter().map(|structure| structure.bytes).sum(),
            build_s: mesh.structures.iter().map(|structure| structure.build_s).sum(),
            built_at: mesh.structures.iter().map(|structure| structure.built_at).max(),
            workers: holders,
            mesh,
        }
    }
}

/// Where workers got structures from since the service started.
#[derive(Debug, Default, PartialEq)]
struct Sources {
    memory: u64,
    disk: u64,
    fetched: u64,
    built: u64,
}

impl Sources {
    /// From the metrics in Prometheus' text format.
    fn read(metrics: &str) -> Self {
        let count = |source: CacheSource| {
            let label = format!("source=\"{}\"", source.as_str());
            let line = metrics.lines().find(|line| line.starts_with(STRUCTURES_METRIC) && line.contains(&label));
            line.and_then(|line| line.rsplit(' ').next()?.parse::<f64>().ok()).unwrap_or_default() as u64
        };
        Self {
            memory: count(CacheSource::Memory),
            disk: count(CacheSource::Disk),
            fetched: count(CacheSource::Fetched),
            built: count(CacheSource::Built),
        }
    }

    /// Share of structures that were there already; `None` before the first.
    fn hit_rate(&self) -> Option<f64> {
        let hits = self.memory + self.disk + self.fetched;
        let all = hits + self.built;
        (all > 0).then(|| hits as f64 / all as f64)
    }
}

pub(super) async fn list(api: Api, Query(query): Query<Cursor>) -> Result<Response, PageError> {
    let meshes: List<Mesh> = api.get(&with_query("/v1/meshes", &[("cursor", &query.cursor)])).await?;
    let workers: List<Worker> = api.get("/v1/workers").await?;
    let page = MeshesPage {
        here: "meshes",
        sources: Sources::read(&api.text("/metrics").await?),
        first: query.cursor.is_empty(),
        next: meshes.next_cursor.map(|cursor| with_query("/meshes", &[("cursor", &cursor)])),
        meshes: meshes.items.into_iter().map(|mesh| Held::new(mesh, &workers.items)).collect(),
        workers: workers.items.into_iter().filter(|worker| worker.state != WorkerState::Gone).collect(),
    };
    Ok(Page(page).into_response())
}

#[cfg(test)]
mod tests {
    use super::super::tests::fixture;
    use super::*;

    #[test]
    fn the_hit_rate_is_that_of_the_metrics() {
        let sources = Sources::read(fixture::METRICS);
        assert_eq!(sources, Sources { memory: 12, disk: 3, fetched: 1, built: 4 });
        assert_eq!(sources.hit_rate(), Some(0.8));
        assert_eq!(Sources::read("").hit_rate(), None);
    }

    #[test]
    fn a_mesh_sums_its_structures_and_names_their_holders() {
        let mut mesh = fixture::mesh();
        mesh.structures.push(mesh.structures[0].clone());
        let held = Held::new(mesh, &[fixture::worker("w1", "idle")]);
        assert_eq!((held.bytes, held.workers), (2 * 9_123_456, vec!["render & co".to_owned()]));
    }
}
